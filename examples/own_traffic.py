"""Train a small traffic model in torch, and let it drive: ``python examples/own_traffic.py``.

The model sees the last second of each vehicle on its own and proposes accelerations and yaw rates
for the next second. It is trained on the logs of scenes (``--scenes``, by default embedded ones),
then drives in place of IDM.
The benchmarks take it by its path, once it is trained::

    PYTHONPATH=examples ccdiff-env bench traffic --methods own_traffic:SmallTraffic --out runs/own
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import nn

import ccdiff_env
from ccdiff_env.errors import ConfigError
from ccdiff_env.scenes.arguments import add_other_scenes, add_scene_arguments, scenes_from
from ccdiff_env.traffic import PythonTraffic, TrafficBatch

HISTORY, STEPS = 11, 10
WEIGHTS = Path("runs/own_traffic.pt")
#: Largest acceleration (m/s²) and yaw rate (rad/s) that the model proposes.
LIMITS = torch.tensor([4.0, 0.6])


def features(heading: np.ndarray, speed: np.ndarray) -> torch.Tensor:
    """Speeds and turns [M, 2 H] of the last steps, in the units of the network."""
    turn = np.angle(np.exp(1j * (heading - heading[:, -1:])))
    return torch.from_numpy(np.concatenate([speed / 10.0, turn], axis=1).astype(np.float32))


class SmallTraffic:
    """A network of two layers as a traffic model; untrained where no file of weights is named."""

    def __init__(self, path: Path | None = WEIGHTS) -> None:
        torch.manual_seed(0)
        self.network = nn.Sequential(nn.Linear(2 * HISTORY, 64), nn.Tanh(), nn.Linear(64, 2))
        self.trained = path is not None
        if path is not None:
            if not path.is_file():
                raise ConfigError(
                    f"no weights at {path}: python examples/own_traffic.py trains them"
                )
            self.network.load_state_dict(torch.load(path, weights_only=True))

    def actions(self, rows: torch.Tensor) -> torch.Tensor:
        """Accelerations and yaw rates [M, STEPS, 2], the same at every step."""
        return (LIMITS * torch.tanh(self.network(rows)))[:, None].expand(-1, STEPS, -1)

    def __call__(self, batch: TrafficBatch) -> torch.Tensor:
        """Return actions [M, STEPS, 2] of all agents of a batch."""
        if not self.trained:
            raise ConfigError("these weights are untrained and do not drive")
        with torch.no_grad():
            return self.actions(
                features(batch.heading_rad[:, -HISTORY:], batch.speed_mps[:, -HISTORY:])
            )


def samples(scenes: Sequence[ccdiff_env.Scene]) -> tuple[torch.Tensor, torch.Tensor]:
    """What vehicles of the logs did [N, 2 H], and their mean acceleration and yaw rate after it."""
    rows, targets = [], []
    for scene in scenes:
        steps = range(HISTORY - 1, scene.num_steps - STEPS, 5)
        # what the model is told when it drives, and what came after
        batch, future = TrafficBatch.from_log(
            [scene] * len(steps), steps, history_states=HISTORY, future_steps=STEPS
        )
        kept = batch.drives & batch.valid.all(axis=1) & future.valid.all(axis=1)
        heading, speed = batch.heading_rad[kept], batch.speed_mps[kept]
        rows.append(features(heading, speed))
        change = np.stack([future.speed_mps[kept, -1] - speed[:, -1],
                           future.heading_rad[kept, -1] - heading[:, -1]], axis=-1)  # fmt: skip
        targets.append(torch.from_numpy(change / np.float32(STEPS * batch.dt_s)))
    return torch.cat(rows), torch.cat(targets)


def train(model: SmallTraffic, scenes: Sequence[ccdiff_env.Scene], steps: int) -> float:
    """Fit the model to the logs; returns the mean error of the last steps."""
    rows, targets = samples(scenes)
    optimiser = torch.optim.Adam(model.network.parameters(), lr=3e-3)
    draw = torch.Generator().manual_seed(0)
    errors = []
    for step in range(1, steps + 1):
        picked = torch.randint(len(rows), (256,), generator=draw)
        loss = ((model.actions(rows[picked])[:, 0] - targets[picked]) / LIMITS).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        errors.append(float(loss.detach()))
        if step % 500 == 0:
            print(f"step {step} of {steps}, error {np.mean(errors[-20:]):.3f}", flush=True)
    model.trained = True
    return float(np.mean(errors[-20:]))


def main() -> None:
    """Train, save, drive."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    parser.add_argument("--steps", type=int, default=3000, help="training steps")
    parser.add_argument("--out", type=Path, default=WEIGHTS, help="file of the weights")
    parser.add_argument("--smoke", action="store_true", help="a few steps of everything")
    args = parser.parse_args()
    torch.set_num_threads(1)  # of small networks the fastest
    model = SmallTraffic(None)
    error = train(model, scenes_from(args), 40 if args.smoke else args.steps)
    print(f"error of the actions, in shares of their limits: {error:.3f}")
    if not args.smoke:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        torch.save(model.network.state_dict(), args.out)
    traffic = PythonTraffic(
        model, replan_steps=5, history_states=HISTORY, least_history_states=HISTORY
    )
    scenes = scenes_from(args, other=True)
    env = ccdiff_env.make_vec(4, scenes=scenes, traffic=traffic, driver="idm")
    env.reset(seed=0)
    for _ in range(10 if args.smoke else 100):
        env.step(np.zeros(env.action_space.shape, np.float32))
    plan = env.explain(0)
    assert plan is not None
    print(f"world 0 follows a plan of {len(plan.agents)} vehicles, made at step {plan.made_at}")


if __name__ == "__main__":
    main()
