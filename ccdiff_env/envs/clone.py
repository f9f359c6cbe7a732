"""Imitation of a rule, before PPO: the policy drives, and is told what the rule would do there.

Ross, Gordon, Bagnell: "A reduction of imitation learning and structured prediction to no-regret
online learning" (DAgger), AISTATS 2011. The rule asks the worlds; the policy sees its observation.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Protocol

import numpy as np
import torch

from ccdiff_env.envs.ego_network import Agent
from ccdiff_env.planners.rules import RULES

__all__ = ["imitate"]

#: Decisions of each world between updates, updates, rows of one, rollouts that are kept.
ROLLOUT, UPDATES, ROWS, KEPT = 16, 100, 2048, 24
LEARNING_RATE = 1e-3
#: Noise that shakes who drives, so that the policy learns to come back.
NOISE = 0.1


class _Worlds(Protocol):
    """Vector environments side by side, as :mod:`ccdiff_env.envs.ppo` has them."""

    envs: list[Any]
    obs: np.ndarray[Any, Any]
    episodes: list[Any]

    def step(self, actions: np.ndarray[Any, Any]) -> Any:
        """Take the actions [E, W] of all worlds."""


def imitate(agent: Agent, worlds: _Worlds, teacher: str, *, decisions: int, seed: int) -> float:
    """Train the means of a policy on the actions of a rule; returns the last mean error.

    The rule ``teacher``, of :data:`~ccdiff_env.planners.rules.RULES`, drives fewer and fewer of the
    worlds, for ``decisions`` of all of them together. Its actions are those of one step, also where
    the policy holds them for more. ``seed`` chooses who drives, and the noise. Assisted dynamics
    are a :class:`ConfigError`.
    """
    rules = [RULES[teacher](env.worlds) for env in worlds.envs]
    rng, size = np.random.default_rng(seed), len(worlds.obs)
    optimiser = torch.optim.Adam(agent.parameters(), lr=LEARNING_RATE)
    kept: deque[tuple[torch.Tensor, torch.Tensor]] = deque(maxlen=KEPT)
    noise, error = np.zeros((size, len(agent.log_std))), np.nan
    for done in range(0, decisions, ROLLOUT * size):
        share, seen, told = done / decisions, [], []
        itself = (rng.random(size) < 1.2 * share)[:, None]
        for _ in range(ROLLOUT):
            obs = torch.from_numpy(worlds.obs.copy())
            actions: Any = np.concatenate([rule(None) for rule in rules])
            with torch.no_grad():
                agent.see(obs)
            mine = agent.act(worlds.obs)
            seen.append(obs)
            told.append(torch.from_numpy(actions))
            noise = 0.7 * noise + 0.7 * rng.normal(0.0, NOISE, noise.shape)
            driven = np.where(itself, mine, actions) + noise
            worlds.step(np.clip(driven, -1.0, 1.0).astype(np.float32))
        kept.append((torch.cat(seen), torch.cat(told)))
        x, wanted = (torch.cat(part) for part in zip(*kept, strict=True))
        optimiser.param_groups[0]["lr"] = LEARNING_RATE * max(1.0 - share, 0.05)
        errors = []
        for _ in range(UPDATES):
            rows = torch.randint(len(x), (ROWS,))
            loss = (agent(agent.normalised(x[rows]))[0] - wanted[rows]).abs().mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            errors.append(float(loss.detach()))
        error = float(np.mean(errors))
    worlds.episodes.clear()
    return error
