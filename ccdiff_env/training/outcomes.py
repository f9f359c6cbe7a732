"""How episodes of an ego end: with success, or with a failure of some kind."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.envs.vector import EgoVectorEnv
from ccdiff_env.errors import ConfigError
from ccdiff_env.system.progress import EVERY_S
from ccdiff_env.worlds.spaces import F32

#: A collision that counts against the ego, another one, a corner off the road; else the goal was
#: not reached: the ego is past it, stands before it (slower than 0.5 m/s), or is on its way.
OUTCOMES = ("success", "drove into", "was hit", "off the road", "past", "stopped", "late")
STANDS_MPS = 0.5
#: What tells how far the next light and the goal are, and how fast the ego is.
SEEN = ("light_distance", "route_remaining", "speed")
BRAKING_MPS2 = 2.5  #: Braking by which one may ask an ego to stop at a light.


class Learning:
    """How episodes end while an ego learns: a line that stays current in a terminal, one after the
    other elsewhere, and scalars of TensorBoard in a folder, where it is installed.
    """

    def __init__(self, folder: Path) -> None:
        self._ended, self._said_s = np.zeros(len(OUTCOMES)), time.monotonic()
        self._folder = folder
        self._board: Any = None

    def add(self, kinds: npt.NDArray[np.int64]) -> None:
        """Count episodes that ended, indices of :data:`OUTCOMES`."""
        self._ended += np.bincount(kinds, minlength=len(OUTCOMES))

    def say(self, decisions: int, begin: str, *, last: bool = False) -> None:
        """Say the shares since the last line, if that is long enough ago, or this is the last."""
        count = self._ended.sum()
        if not count or not (last or time.monotonic() - self._said_s >= EVERY_S):
            return
        shares = dict(zip(OUTCOMES, self._ended / count, strict=True))
        line = f"{begin} {decisions:,} decisions, of {count:,.0f} episodes: "
        line += ", ".join(f"{name} {share:.1%}" for name, share in shares.items() if share)
        is_live = sys.stdout.isatty()
        print(f"\x1b[2K{line}" if is_live else line, end="\r" if is_live and not last else "\n")
        sys.stdout.flush()
        if self._board is None and find_spec("tensorboard"):
            self._board = import_module("torch.utils.tensorboard").SummaryWriter(self._folder)
        if self._board is not None:
            for name, share in shares.items():
                self._board.add_scalar(f"outcomes/{name}", share, decisions)
            self._board.flush()
        self._ended[:], self._said_s = 0.0, time.monotonic()


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
    found = np.zeros(len(OUTCOMES))
    for infos, first in _ended(env, act, seed):
        found += np.bincount(outcomes(env, infos)[first], minlength=len(OUTCOMES))
    return found / env.num_envs


def red_of_arrivals(
    env: EgoVectorEnv,
    act: Callable[[F32], F32] | None = None,
    *,
    seed: int = 0,
    draws: int = 1,
) -> tuple[int, int]:
    """Play as :func:`play_episodes`, so many episodes of every world with seeds of their own;
    return how many arrive past a light, and run red on the way.

    Worlds count where the first light is less than 60 m ahead and before the goal, and where
    braking by at most :data:`BRAKING_MPS2` stops the ego in front of it.

    Raises:
        ConfigError: If the ego does not observe its light (columns of :data:`SEEN`), or if the
            weight ``red_light`` of the reward is not negative.
    """
    ego = env.worlds.layout.entries[0]
    if not {*SEEN} <= {*ego.columns} or env.worlds.config.reward.red_light >= 0.0:
        raise ConfigError(f"red_of_arrivals: expected columns {SEEN} and a negative red_light")
    at = [ego.columns.index(name) for name in SEEN]
    arrived = np.zeros(2, np.int64)
    for first_seed in range(seed, seed + draws * env.num_envs, env.num_envs):
        rows, _ = env.reset(seed=first_seed)
        seen = rows[:, [ego.offset + i for i in at]]
        gap_m, goal_m, speed_mps = (seen * [ego.scale[i] for i in at]).T
        stops = speed_mps**2 <= 2.0 * BRAKING_MPS2 * gap_m
        counts = (seen[:, 0] < 1.0) & (gap_m < goal_m) & stops
        for infos, first in _ended(env, act, first_seed):
            ended = infos["_final_obs"]
            metrics = {name: each[ended] for name, each in infos["final_info"]["metrics"].items()}
            success = (metrics["is_success"] > 0.0) & first & counts[ended]
            arrived += success.sum(), (success & (metrics["reward_red_light"] < 0.0)).sum()
    return int(arrived[0]), int(arrived[1])


def _ended(
    env: EgoVectorEnv, act: Callable[[F32], F32] | None, seed: int
) -> Iterator[tuple[dict[str, Any], npt.NDArray[np.bool_]]]:
    """Yield infos of steps in which worlds end, and which of these end their first episode."""
    obs, _ = env.reset(seed=seed)
    left = np.ones(env.num_envs, np.bool_)
    idle = np.zeros(env.action_space.shape or (), np.float32)
    while left.any():
        obs, _, terminated, truncated, infos = env.step(idle if act is None else act(obs))
        ended = terminated | truncated
        if ended.any():
            yield infos, left[ended]
            left &= ~ended
