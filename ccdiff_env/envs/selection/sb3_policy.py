"""A policy of sb3-contrib that scores every candidate by the same network."""

from __future__ import annotations

from typing import Any

import gymnasium
import torch
from gymnasium import spaces
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

__all__ = ["CandidatePolicy"]

#: Features of a candidate behind the network.
WIDTH = 64


class _Candidates(BaseFeaturesExtractor):
    """From observations to [B, (M + 1) W]: W features of each candidate, then those of nobody.

    A candidate is its row of ``agents``, its relations with the ego, and the ego's row. Nobody has
    the greatest of every feature over the candidates that are there.
    """

    def __init__(self, observation_space: spaces.Dict) -> None:
        num_rows, num_features = observation_space["agents"].shape or (0, 0)
        super().__init__(observation_space, num_rows * WIDTH)
        self.network = nn.Sequential(
            nn.Linear(2 * num_features + 7, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU()
        )

    def forward(self, obs: dict[str, torch.Tensor]) -> torch.Tensor:
        agents = obs["agents"]
        others = agents[:, 1:]
        ego = agents[:, :1].expand_as(others)
        relations = [obs["ttc"][:, 0, 1:], obs["distance"][:, 0, 1:]]
        for name in ("graph", "attention"):
            relations += [obs[name][:, 0, 1:], obs[name][:, 1:, 0]]
        relations.append(obs["time_left"].expand(-1, others.shape[1]))
        rows = torch.cat([others, ego, torch.stack(relations, dim=-1)], dim=-1)
        found = self.network(rows)
        nobody = (found * obs["mask"].unsqueeze(-1)).amax(dim=1, keepdim=True)
        return torch.cat([found, nobody], dim=1).flatten(1)


class _Scores(nn.Module):
    """Logits [B, M + 1] of the candidates and of nobody."""

    def __init__(self) -> None:
        super().__init__()
        self.somebody, self.nobody = nn.Linear(WIDTH, 1), nn.Linear(WIDTH, 1)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        rows = features.reshape(len(features), -1, WIDTH)
        scores = [self.somebody(rows[:, :-1]), self.nobody(rows[:, -1:])]
        return torch.cat(scores, dim=1).squeeze(-1)


class CandidatePolicy(MaskableMultiInputActorCriticPolicy):
    """Policy for action mode ``"discrete"``: what is learned of one candidate holds for all.

    Use it as ``MaskablePPO(CandidatePolicy, env)``; ``net_arch`` is that of the value function.

    Parameters
    ----------
    observation_space, action_space, lr_schedule, **options
        As stable-baselines3 hands them to policies.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: gymnasium.Space[Any],
        lr_schedule: Any,
        **options: Any,
    ) -> None:
        options["features_extractor_class"] = _Candidates
        options["net_arch"] = {"pi": [], "vf": options.get("net_arch") or [WIDTH]}
        super().__init__(observation_space, action_space, lr_schedule, **options)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net = _Scores()
        optimizer: Any = self.optimizer_class
        self.optimizer = optimizer(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)
