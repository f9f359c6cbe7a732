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

#: Hidden units of every layer, the same in ``rust/nets/src/traffic/adversary_policy.rs``.
WIDTH = 64
#: From this column on, rows say the same: what the ego does.
EGO = FEATURES.index("ego_speed")


class Scores(BaseFeaturesExtractor):
    """From rows [B, R, F] to [B, R S + 2]: a score of each action, nobody last, and a value.

    Every candidate is seen beside the greatest of each hidden unit over all of them. Nobody is a
    row that holds only what the ego does.
    """

    def __init__(self, observation_space: spaces.Box, num_strengths: int) -> None:
        num_rows, num_features = observation_space.shape
        super().__init__(observation_space, num_rows * num_strengths + 2)
        self.num_strengths = num_strengths
        self.row = nn.Sequential(
            nn.Linear(num_features, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU()
        )
        self.head = nn.Sequential(
            nn.Linear(2 * WIDTH, WIDTH), nn.ReLU(), nn.Linear(WIDTH, num_strengths + 2)
        )

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        nobody = torch.cat([torch.zeros_like(rows[:, :1, :EGO]), rows[:, :1, EGO:]], dim=-1)
        found = self.row(torch.cat([rows, nobody], dim=1))
        greatest = (found[:, :-1] * rows[:, :, :1]).amax(dim=1, keepdim=True)
        out = self.head(torch.cat([found, greatest.expand_as(found)], dim=-1))
        somebody = out[:, :-1, : self.num_strengths].flatten(1)
        return torch.cat([somebody, out[:, -1, self.num_strengths :]], dim=1)


class Columns(nn.Module):
    """Some columns of what :class:`Scores` gives."""

    def __init__(self, columns: slice) -> None:
        super().__init__()
        self.columns = columns

    def forward(self, scores: torch.Tensor) -> torch.Tensor:
        return scores[:, self.columns]


class CandidatePolicy(MaskableActorCriticPolicy):
    """What is learned of one candidate holds for all: ``MaskablePPO(CandidatePolicy, env)``.

    Parameters
    ----------
    observation_space, action_space, lr_schedule, **options
        As stable-baselines3 hands them to policies.
    """

    def __init__(
        self, observation_space: spaces.Box, action_space: Any, lr_schedule: Any, **options: Any
    ) -> None:
        options["features_extractor_class"] = Scores
        num_strengths = (int(action_space.n) - 1) // observation_space.shape[0]
        options["features_extractor_kwargs"] = {"num_strengths": num_strengths}
        options["net_arch"], options["share_features_extractor"] = [], False
        super().__init__(observation_space, action_space, lr_schedule, **options)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        both: Any = self.pi_features_extractor, self.vf_features_extractor
        for scores in both:
            nn.init.orthogonal_(scores.head[-1].weight, 0.05)
        heads: Any = Columns(slice(-1)), Columns(slice(-1, None))
        self.action_net, self.value_net = heads


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
    tensors = policy.pi_features_extractor.state_dict()
    header = {
        "format": 1,
        "kind": "adversary_policy",
        "features": list(FEATURES),
        "max_candidates": int(policy.observation_space.shape[0]),
        "strengths": list(strengths),
        "notes": dict(notes or {}),
    }
    arrays = {name: value.numpy() for name, value in tensors.items()}
    write_tensors(path, arrays, {"ccdiff_env": json.dumps(header)})
