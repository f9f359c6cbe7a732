"""The network that learns to drive: :class:`~ccdiff_env.planners.ego.EgoPolicy` with gradients."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import nn

from ccdiff_env.errors import ConfigError
from ccdiff_env.planners.ego import EgoPolicy
from ccdiff_env.training.recipe import CORRELATION
from ccdiff_env.worlds.spaces import Layout

Floats: TypeAlias = np.ndarray[Any, Any]
WIDTH_ROWS, WIDTH = 64, 128
#: Updates in bfloat16 take half the time where the processor has it, eight times as long where not.
HALF = torch.cpu._is_avx512_bf16_supported()
CLONE_STEPS, CLONE_BATCH = 500, 1024  #: Minibatches of :func:`imitate`, and their size.


#: Columns of observations that change their sign in a mirror. Those named after a side change it.
_ACROSS = ("y", "sin", "velocity_y", "yaw_rate", "route_distance", "route_sin", "last_action_1")


def reflection(layout: Layout) -> tuple[torch.Tensor, torch.Tensor]:
    """Return places [D] and signs [D] of a row's numbers in a mirror, where left is right."""
    places, signs = torch.arange(layout.size), torch.ones(layout.size)
    for entry in layout.entries:
        for i, name in enumerate(entry.columns):
            there = slice(entry.offset + i, entry.offset + entry.size, len(entry.columns))
            signs[there] = -1.0 if name in _ACROSS else 1.0
            sides = ("left", "right") if "left" in name else ("right", "left")
            places[there] += entry.columns.index(name.replace(*sides)) - i
    return places, signs


class Greatest(torch.autograd.Function):
    """The greatest of each feature, at least 0, over parts of rows [N, F]: the first of B each."""

    @staticmethod
    def forward(ctx: Any, rows: torch.Tensor, parts: list[int], size: int) -> torch.Tensor:
        """Return [B, F]."""
        found = rows.new_zeros(size, rows.shape[1])
        ctx.parts = [slice(end - n, end) for n, end in zip(parts, np.cumsum(parts), strict=True)]
        for n, part in zip(parts, ctx.parts, strict=True):
            torch.maximum(found[:n], rows[part], out=found[:n])
        ctx.save_for_backward(rows, found)
        return found

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        """Hand the gradient to the rows that were greatest."""
        rows, found = ctx.saved_tensors
        grad = torch.zeros_like(rows)
        for part in ctx.parts:
            n = part.stop - part.start
            torch.mul(grads[0][:n], rows[part] == found[:n], out=grad[part])
        return grad, None, None


def _hidden(size: int, width: int) -> list[nn.Module]:
    """Two layers."""
    return [nn.Linear(size, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()]


class Agent(nn.Module):
    """Policy and value: all agents pass one network, the greatest of each feature stays.

    Args:
        layout: What it observes.
        noise: Standard deviations [W] of the actions at first.
        width: Of the hidden layers.
        even: Whether it drives in a mirror as it does without: policy and value are means of those
            for what it observes and for that in a mirror, so that each decision teaches both. It
            has two actions then, of which the second is to the left.

    Raises:
        ConfigError: If it is to be even, and there are not two actions.
    """

    mean: torch.Tensor
    var: torch.Tensor
    count: torch.Tensor

    def __init__(
        self, layout: Layout, noise: tuple[float, ...], width: int = WIDTH, *, even: bool = False
    ) -> None:
        super().__init__()
        entries = {entry.name: entry for entry in layout.entries}
        rest, seen = layout.size, 0
        self.shape: tuple[int, ...] = ()
        self.rows = self.mask = slice(rest, rest)
        if "agents" in entries:
            rows, mask = entries["agents"], entries["agents_mask"]
            self.rows, self.shape = slice(rows.offset, rows.offset + rows.size), rows.shape
            self.mask = slice(mask.offset, mask.offset + mask.size)
            rest, seen = rest - rows.size - mask.size, WIDTH_ROWS
            self.encoder = nn.Sequential(*_hidden(rows.shape[1], WIDTH_ROWS))
        self.policy, self.value = (
            nn.Sequential(*_hidden(rest + seen, width), nn.Linear(width, out))
            for out in (len(noise), 1)
        )
        *_, weight, bias = self.policy.parameters()
        nn.init.orthogonal_(weight, 0.01)
        nn.init.zeros_(bias)
        self.log_std = nn.Parameter(torch.tensor(noise).log())
        for name, value in (("mean", 0.0), ("var", 1.0)):
            self.register_buffer(name, torch.full((layout.size,), value))
        self.register_buffer("count", torch.tensor(1e-4))
        self.even = even
        if even:
            if len(noise) != 2:
                raise ConfigError(f"an even policy has two actions, not {len(noise)}")
            self.places, self.signs = reflection(layout)

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return what a file of the policy holds, by name."""
        mirror = {"mirror": self.signs * (self.places + 1)} if self.even else {}
        return self.state_dict() | mirror

    def take(self, policy: EgoPolicy) -> None:
        """Begin with the networks of a policy, and with its means and variances for good."""
        found = {name: torch.from_numpy(array) for name, array in policy.tensors.items()}
        found["var"] = found.pop("std") ** 2 - 1e-4
        self.load_state_dict(found | {"count": torch.tensor(1e9)}, strict=False)

    def see(self, obs: torch.Tensor) -> None:
        """Take observations [E, D] into mean and variance; rows of agents share theirs."""
        if self.even:
            obs = torch.cat([obs, self.reflected(obs)])
        mean, var = obs.mean(0), obs.var(0, unbiased=False)
        if self.shape:
            rows = obs[:, self.rows].reshape(-1, self.shape[1])
            present = rows[obs[:, self.mask].reshape(-1) > 0]
            if len(present) > 1:
                mean[self.rows] = present.mean(0).repeat(self.shape[0])
                var[self.rows] = present.var(0, unbiased=False).repeat(self.shape[0])
        mean[self.mask], var[self.mask] = 0.0, 1.0
        total = self.count + len(obs)
        share, delta = len(obs) / total, mean - self.mean
        self.var += (var - self.var) * share + delta**2 * share * (1.0 - share)
        self.mean += delta * share
        self.count.copy_(total)

    def normalised(self, obs: torch.Tensor) -> torch.Tensor:
        """Observations [E, D] as the networks want them."""
        return ((obs - self.mean) / (self.var + 1e-4).sqrt()).clamp(-5.0, 5.0)

    def features(self, x: torch.Tensor) -> torch.Tensor:
        """What both heads see of normalised observations [B, D]."""
        if not self.shape:
            return x
        # who sees most agents comes first: those of each place are the first rows of all
        count = (x[:, self.mask] > 0).sum(1)
        order = count.argsort(descending=True)
        seen = (count.unsqueeze(1) > torch.arange(self.shape[0])).sum(0).tolist()
        rows = x[:, self.rows].reshape(-1, *self.shape)
        packed = [rows[order[:n], k] for k, n in enumerate(seen)]
        # whole thousands of rows: kernels of bfloat16 are compiled for each number of rows
        packed.append(rows.new_zeros(-sum(seen) % 1024, self.shape[1]))
        encoded = self.encoder(torch.cat(packed))
        found = Greatest.apply(encoded, seen, len(x))  # type: ignore[no-untyped-call]
        rest = x[:, : self.rows.start], x[:, self.mask.stop :]
        return torch.cat([*rest, found[order.argsort()]], dim=1)

    def reflected(self, x: torch.Tensor) -> torch.Tensor:
        """Return observations [B, D] in a mirror."""
        return x[:, self.places] * self.signs.to(x.dtype)

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Means [B, W] of the actions and values [B]."""
        features = self.features(torch.cat([x, self.reflected(x)]) if self.even else x)
        mean, value = self.policy(features), self.value(features).squeeze(1)
        if not self.even:
            return mean, value
        (mean, other), (value, turned) = mean.chunk(2), value.chunk(2)
        return 0.5 * (mean + other * torch.tensor([1.0, -1.0])), 0.5 * (value + turned)

    def quick(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Means and values for an update, by bfloat16 where that is fast."""
        with torch.autocast("cpu", torch.bfloat16, enabled=HALF):
            mean, values = self(x.bfloat16() if HALF else x)
        return mean.float(), values.float()

    def noisy(self, mean: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """Actions [B, W] about their means; the noise [B, W] of the decision before goes on."""
        new = torch.randn_like(noise)
        noise.copy_(CORRELATION * noise + (1.0 - CORRELATION**2) ** 0.5 * new)
        return mean + self.log_std.exp() * noise

    def calm(self, noise: tuple[float, ...], share: float) -> None:
        """Keep the standard deviations above a share of those at first."""
        self.log_std.data.clamp_(min=torch.tensor(noise).mul(share).log())

    def begin(self, obs: torch.Tensor, actions: torch.Tensor, seed: int) -> None:
        """Begin as a clone of decisions that were shown, observations [N, D] and actions [N, W]."""
        self.see(obs)
        actor = [p for name, p in self.named_parameters() if not name.startswith("value")]
        imitate(lambda x: self(x)[0], actor, self.normalised(obs), actions, seed)

    @torch.no_grad()
    def act(self, obs: Floats) -> Floats:
        """Means [B, W] of the actions for observations [B, D]."""
        mean: Floats = self(self.normalised(torch.from_numpy(obs)))[0].clamp(-1.0, 1.0).numpy()
        return mean

    def log_prob(self, mean: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Log density [B] of actions, less a constant."""
        return (-0.5 * ((actions - mean) / self.log_std.exp()) ** 2 - self.log_std).sum(1)


def imitate(
    mean: Callable[[torch.Tensor], torch.Tensor],
    weights: Sequence[nn.Parameter],
    x: torch.Tensor,
    actions: torch.Tensor,
    seed: int = 0,
) -> None:
    """Fit the means of a policy to actions that were shown, by their absolute errors.

    Args:
        mean: Means [B, W] for observations [B, D] as the networks want them.
        weights: What is fitted.
        x: Observations [N, D], as the networks want them.
        actions: Actions [N, W].
        seed: Seed of the minibatches.
    """
    scale, optimiser = actions.std(dim=0) + 1e-3, torch.optim.Adam(weights)
    random = torch.Generator().manual_seed(seed % 2**64)
    for step in range(CLONE_STEPS):
        optimiser.param_groups[0]["lr"] = 1e-3 * (1.0 - step / CLONE_STEPS)
        index = torch.randint(len(x), (CLONE_BATCH,), generator=random)
        loss = ((mean(x[index]) - actions[index]).abs() / scale).mean()
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
