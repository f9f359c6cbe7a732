"""How episodes of an ego end: with success, or with a failure of some kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.envs.vector import EgoVectorEnv
from ccdiff_env.errors import ConfigError
from ccdiff_env.worlds.spaces import F32

#: A collision that counts against the ego, another one, a corner off the road; else the goal was
#: not reached: the ego is past it, stands before it (slower than 0.5 m/s), or is on its way.
OUTCOMES = ("success", "drove into", "was hit", "off the road", "past", "stopped", "late")
STANDS_MPS = 0.5


def outcomes(env: EgoVectorEnv, infos: dict[str, Any]) -> npt.NDArray[np.int64]:
    """Return how the worlds that ended in a step ended, as indices of :data:`OUTCOMES`.

    Args:
        env: Worlds in ``same_step`` mode, with columns ``goal_near`` of the ego.
        infos: What the step returned.

    Raises:
        ConfigError: If their observations have no such column.
    """
    if "final_obs" not in infos:
        return np.zeros(0, np.int64)
    ego = env.worlds.layout.entries[0]
    if "goal_near" not in ego.columns:
        raise ConfigError("outcomes: observations without goal_near of the ego")
    ended, said = infos["_final_obs"], infos["final_info"]
    metrics = {name: values[ended] > 0.0 for name, values in said["metrics"].items()}
    last = np.stack(infos["final_obs"][ended])
    cases = (
        metrics["is_success"],
        metrics["collision"] & metrics["at_fault"],
        metrics["collision"],
        metrics["off_road"],
        last[:, ego.offset + ego.columns.index("goal_near")] < 0.0,
        said["speed"][ended] < STANDS_MPS,
    )
    return np.select(cases, range(len(cases)), len(cases))


def play_episodes(
    env: EgoVectorEnv, act: Callable[[F32], F32] | None = None, *, seed: int = 0
) -> npt.NDArray[np.float64]:
    """Play the next episode of every world; return the share of each of :data:`OUTCOMES`.

    Args:
        env: As for :func:`outcomes`.
        act: Actions [E, W] for observations [E, D]; none where a driver is at the wheel.
        seed: World i gets seed + i.
    """
    obs, _ = env.reset(seed=seed)
    found = np.zeros(len(OUTCOMES))
    left = np.ones(env.num_envs, np.bool_)
    idle = np.zeros(env.action_space.shape or (), np.float32)
    while left.any():
        obs, _, terminated, truncated, infos = env.step(idle if act is None else act(obs))
        ended = terminated | truncated
        if ended.any():
            first = left[ended]
            found += np.bincount(outcomes(env, infos)[first], minlength=len(OUTCOMES))
            left &= ~ended
    return found / env.num_envs
