"""A policy of sb3-contrib that scores every candidate by the same network."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from gymnasium import spaces
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from ccdiff_env.envs.selection.vector import FEATURES
from ccdiff_env.system.tensors import write_tensors

__all__ = ["CandidatePolicy", "save_policy"]

#: Features of a candidate behind the network.
WIDTH = 64
#: From this column on, rows say the same: what the ego does.
EGO = FEATURES.index("ego_speed")


class _Candidates(BaseFeaturesExtractor):
    """From rows [B, R, F] to [B, (R + 1) W]: W features of each candidate, then those of nobody.

    A candidate is its row beside the greatest of every feature over the candidates that are there,
    which nobody has with the ego's columns.
    """

    def __init__(self, observation_space: spaces.Box) -> None:
        num_rows, num_features = observation_space.shape
        super().__init__(observation_space, (num_rows + 1) * WIDTH)
        self.row = nn.Sequential(
            nn.Linear(num_features, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU()
        )
        self.among = nn.Sequential(nn.Linear(2 * WIDTH, WIDTH), nn.ReLU())
        self.nobody = nn.Sequential(nn.Linear(WIDTH + num_features - EGO, WIDTH), nn.ReLU())

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        found = self.row(rows) * rows[:, :, :1]
        greatest = found.amax(dim=1, keepdim=True)
        nobody = self.nobody(torch.cat([greatest, rows[:, :1, EGO:]], dim=-1))
        found = self.among(torch.cat([found, greatest.expand_as(found)], dim=-1))
        return torch.cat([found, nobody], dim=1).flatten(1)


class _Scores(nn.Module):
    """Logits [B, R S + 1] of the candidates at each strength and of nobody."""

    def __init__(self, num_strengths: int) -> None:
        super().__init__()
        self.somebody, self.nobody = nn.Linear(WIDTH, num_strengths), nn.Linear(WIDTH, 1)
        for layer in (self.somebody, self.nobody):
            nn.init.orthogonal_(layer.weight, 0.05)
            nn.init.zeros_(layer.bias)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        rows = features.reshape(len(features), -1, WIDTH)
        scores = [self.somebody(rows[:, :-1]).flatten(1), self.nobody(rows[:, -1])]
        return torch.cat(scores, dim=1)


class _Value(nn.Module):
    """Value [B, 1] of the candidates and of nobody."""

    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Linear(2 * WIDTH, WIDTH), nn.ReLU(), nn.Linear(WIDTH, 1))

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        rows = features.reshape(len(features), -1, WIDTH)
        value: torch.Tensor = self.net(torch.cat([rows[:, :-1].amax(dim=1), rows[:, -1]], dim=-1))
        return value


class CandidatePolicy(MaskableActorCriticPolicy):
    """What is learned of one candidate holds for all: ``MaskablePPO(CandidatePolicy, env)``.

    Parameters
    ----------
    *args, **options
        As stable-baselines3 hands them to policies.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        options["features_extractor_class"] = _Candidates
        options["net_arch"] = {"pi": [], "vf": []}
        options["share_features_extractor"] = False
        super().__init__(*args, **options)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        rows: Any = self.observation_space.shape
        actions: Any = self.action_space
        heads: Any = _Scores((int(actions.n) - 1) // rows[0]), _Value()
        self.action_net, self.value_net = heads
        optimizer: Any = self.optimizer_class
        self.optimizer = optimizer(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


def save_policy(
    model: Any,
    path: str | os.PathLike[str],
    strengths: Sequence[float],
    notes: Mapping[str, Any] | None = None,
) -> None:
    """Write what traffic reads as ``ccdiff={"adversary_policy": path}``, without a line of code.

    Parameters
    ----------
    model
        MaskablePPO with a :class:`CandidatePolicy`.
    path
        A ``.safetensors`` file.
    strengths
        Criticalities of the environment that it learned in.
    notes
        Kept in the header.
    """
    policy = model.policy
    parts = {
        **{
            name: getattr(policy.pi_features_extractor, name) for name in ("row", "among", "nobody")
        },
        "somebody": policy.action_net.somebody,
        "nobody_score": policy.action_net.nobody,
    }
    tensors = {
        f"{part}.{name}": value.detach().numpy()
        for part, module in parts.items()
        for name, value in module.state_dict().items()
    }
    header = {
        "format": 1,
        "kind": "adversary_policy",
        "features": list(FEATURES),
        "max_candidates": int(policy.observation_space.shape[0]),
        "strengths": list(strengths),
        "notes": dict(notes or {}),
    }
    write_tensors(path, tensors, {"ccdiff_env": json.dumps(header)})
