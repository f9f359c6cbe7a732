"""What logged drivers did, as decisions of an ego, and a policy that begins with them.

A log has no actions: they are those of the dynamics that lead from each logged state to the next.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ccdiff_env.envs import make_vec
from ccdiff_env.errors import ConfigError
from ccdiff_env.worlds import Scenes
from ccdiff_env.worlds.spaces import F32

WORLDS, STEPS = 512, 60


def demonstrations(
    scenes: Scenes, number: int, *, seed: int = 0, decision_steps: int = 1, **options: Any
) -> tuple[F32, F32]:
    """Return what logged egos saw and did.

    The action of a decision is the mean of those of its steps, clipped to [-1, 1]; the last action
    that is observed is that of the decision before.

    Args:
        scenes: Scenes, as :func:`ccdiff_env.make_vec` takes them.
        number: Decisions N.
        seed: Seed of the draws.
        decision_steps: Steps of a decision.
        options: Other options of the worlds, such as ``ego="any"``; traffic follows the log.

    Returns:
        obs, actions: Flat observations [N, D], actions [N, W] in [-1, 1].

    Raises:
        ConfigError: If ``number`` is below 1, or the dynamics have no inverse.
    """
    if number < 1:
        raise ConfigError(f"number is {number}, expected at least 1")
    goes_on = {"on_collision": "ignore", "on_off_road": "ignore", "terminate_at_goal": False}
    given = options | goes_on | {"traffic": "replay", "driver": "replay"}
    env = make_vec(WORLDS, scenes=scenes, autoreset_mode="same_step", info="none", **given)
    ego = env.worlds.layout.entries[0]
    last = [ego.offset + i for i, n in enumerate(ego.columns) if n.startswith("last_action_")]
    obs, _ = env.reset(seed=seed)
    shape, k, found, have = (STEPS, *(env.action_space.shape or ())), decision_steps, [], 0
    idle, begins = np.zeros(shape[1:], np.float32), np.ones(WORLDS, np.int64)
    while have < number:
        seen = np.empty((STEPS, *obs.shape), np.float32)
        done = np.empty(shape, np.float32)
        episode = np.empty((STEPS, WORLDS), np.int64)
        for t in range(STEPS):
            seen[t], episode[t] = obs, begins
            done[t] = [env.worlds.native.expert_actions(i)[0] for i in range(WORLDS)]
            obs, _, terminated, truncated, _ = env.step(idle)
            begins = begins + (terminated | truncated)
        done = done.clip(-1.0, 1.0)
        for t in range(k, STEPS - k, k):
            whole = (episode[t - k] == episode[t]) & (episode[t + k - 1] == episode[t])
            row = seen[t, whole]
            row[:, last] = done[t - k : t, whole].mean(axis=0)[:, : len(last)]
            found.append((row, done[t : t + k, whole].mean(axis=0)))
            have += len(row)
    rows, actions = (np.concatenate(parts)[:number] for parts in zip(*found, strict=True))
    return rows, actions
