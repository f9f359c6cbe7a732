"""A policy of sb3-contrib that scores every candidate by the same network."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from typing import Any

import torch
from gymnasium import spaces
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from ccdiff_env.envs.selection import FEATURES
from ccdiff_env.system.tensors import write_tensors

__all__ = ["CandidatePolicy", "save_policy"]

#: Hidden units of every layer, the same in ``rust/nets/src/traffic/adversary_policy.rs``.
WIDTH = 64
EGO = FEATURES.index("ego_speed")  #: From this column on, rows say the same: what the ego does.


class Scores(BaseFeaturesExtractor):
    """From rows [B, R, F] to [B, R S + 2]: a score of each action, nobody last, and a value.

    Every candidate is seen beside the greatest of each hidden unit over all of them. Nobody is a
    row that holds only what the ego does.
    """

    def __init__(self, observation_space: spaces.Box, strengths: int) -> None:
        num_rows, num_features = observation_space.shape
        super().__init__(observation_space, num_rows * strengths + 2)
        self.strengths = strengths
        hidden = nn.Linear(num_features, WIDTH), nn.Linear(WIDTH, WIDTH)
        self.row = nn.Sequential(hidden[0], nn.ReLU(), hidden[1], nn.ReLU())
        ends = nn.Linear(2 * WIDTH, WIDTH), nn.Linear(WIDTH, strengths + 2)
        self.head = nn.Sequential(ends[0], nn.ReLU(), ends[1])

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        nobody = torch.cat([torch.zeros_like(rows[:, :1, :EGO]), rows[:, :1, EGO:]], dim=-1)
        found = self.row(torch.cat([rows, nobody], dim=1))
        greatest = (found[:, :-1] * rows[:, :, :1]).amax(dim=1, keepdim=True)
        out = self.head(torch.cat([found, greatest.expand_as(found)], dim=-1))
        somebody = out[:, :-1, : self.strengths].flatten(1)
        return torch.cat([somebody, out[:, -1, self.strengths :]], dim=1)


class Columns(nn.Module):
    """Some columns of what :class:`Scores` gives."""

    def __init__(self, columns: slice) -> None:
        super().__init__()
        self.columns = columns

    def forward(self, scores: torch.Tensor) -> torch.Tensor:
        return scores[:, self.columns]


class CandidatePolicy(MaskableActorCriticPolicy):
    """What is learned of one candidate holds for all: ``MaskablePPO(CandidatePolicy, env)``."""

    def __init__(
        self, observation_space: spaces.Box, action_space: Any, *args: Any, **options: Any
    ) -> None:
        strengths = (int(action_space.n) - 1) // observation_space.shape[0]
        options |= {"net_arch": [], "share_features_extractor": False}
        options["features_extractor_class"] = Scores
        options["features_extractor_kwargs"] = {"strengths": strengths}
        super().__init__(observation_space, action_space, *args, **options)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        both: Any = self.pi_features_extractor, self.vf_features_extractor
        for scores in both:
            nn.init.orthogonal_(scores.head[-1].weight, 0.05)
        heads: Any = Columns(slice(-1)), Columns(slice(-1, None))
        self.action_net, self.value_net = heads


def save_policy(
    model: Any, path: str | os.PathLike[str], strengths: Sequence[float], **notes: Any
) -> None:
    """Write a MaskablePPO with a :class:`CandidatePolicy` without a line of code.

    Traffic reads the ``.safetensors`` file as ``ccdiff={"adversary_policy": path}``. ``strengths``
    are those of the environment that it learned in, ``notes`` are kept in the header.
    """
    policy = model.policy
    header = {
        "format": 1,
        "kind": "adversary_policy",
        "features": list(FEATURES),
        "max_candidates": int(policy.observation_space.shape[0]),
        "strengths": list(strengths),
        "notes": notes,
    }
    tensors = policy.pi_features_extractor.state_dict()
    arrays = {name: value.numpy() for name, value in tensors.items()}
    write_tensors(path, arrays, {"ccdiff_env": json.dumps(header)})
