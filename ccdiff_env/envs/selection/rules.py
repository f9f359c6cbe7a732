"""Choices of adversaries without learning, to compare learned ones with."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import unknown
from ccdiff_env.envs.selection.vector import FEATURES, AdversarySelectionVectorEnv
from ccdiff_env.errors import ConfigError

__all__ = ["RULES", "fork_actions", "rule_actions"]

#: Nobody, chance, the nearest to the ego, the soonest contact with it, and the closest approach in
#: the coming 4 s at constant velocity, the ego along its route.
RULES = ("none", "random", "nearest", "ttc", "approach")
_TTC, _APPROACH = FEATURES.index("ttc"), FEATURES.index("approach")
#: What ``approach`` is divided by in an observation, metres.
_APPROACH_M = 30.0


def rule_actions(
    env: AdversarySelectionVectorEnv,
    rule: str,
    *,
    strength: int = -1,
    gate_m: float | None = None,
    seed: int = 0,
) -> npt.NDArray[np.int64]:
    """Return what a rule chooses in each world [E].

    Parameters
    ----------
    env
        The worlds.
    rule
        One of :data:`RULES`.
    strength
        Index of the criticality among those of the environment.
    gate_m
        Nobody where the closest approach of the vehicle found is farther, metres.
    seed
        For ``"random"``.

    Raises
    ------
    UnknownNameError
        For another rule.
    """
    if rule not in RULES:
        raise unknown("rule", rule, RULES)
    obs, num_strengths = env.observation(), len(env.strengths)
    there = obs[:, :, 0] > 0.5
    rows = np.zeros(len(obs), np.int64)
    if rule == "random":
        draws = np.random.default_rng(seed).random(there.shape)
        rows = np.where(there, draws, -1.0).argmax(axis=1)
    elif rule == "ttc":
        rows = np.where(there, obs[:, :, _TTC], -1.0).argmax(axis=1)
    elif rule == "approach":
        rows = np.where(there, obs[:, :, _APPROACH], np.inf).argmin(axis=1)
    actions = rows * num_strengths + strength % num_strengths
    nobody = ~there.any(axis=1) | (rule == "none")
    if gate_m is not None:
        nobody |= obs[np.arange(len(obs)), rows, _APPROACH] * _APPROACH_M > gate_m
    return np.where(nobody, env.nobody, actions)


def fork_actions(env: AdversarySelectionVectorEnv, steps: int) -> npt.NDArray[np.int64]:
    """Return, in each world [E], the weakest choice that makes contact in a fork, else nobody.

    Every candidate is tried at every strength; the worlds stay where they are.

    Parameters
    ----------
    env
        The worlds.
    steps
        Steps of the worlds that a fork lasts.

    Raises
    ------
    ConfigError
        If the ego is a policy, whose memory a fork does not hold.
    """
    if env._act is not None:
        raise ConfigError("forks need an ego that worlds drive themselves, such as idm")
    native, num_envs = env.worlds.native, env.num_envs
    found = np.full(num_envs, env.nobody, np.int64)
    saved = [native.snapshot(e) for e in range(num_envs)]
    for strength in range(len(env.strengths)):
        for row in range(env.max_candidates):
            tried = np.array([row < len(agents) for agents in env.candidates])
            running = tried & ~env._ended & (found == env.nobody)
            for e in np.flatnonzero(running).tolist():
                native.restore(e, saved[e])
                guided, criticality = [env.candidates[e][row]], env.strengths[strength]
                native.override_plan(e, guided=guided, criticality=criticality)
            for _ in range(steps):
                if not running.any():
                    break
                out = env.worlds.arrays()
                native.step(env._ego_actions(running), out, running)
                for e in np.flatnonzero(running & out.done).tolist():
                    pair = (int(env._egos[e]), env.candidates[e][row])
                    if any((i, j) == pair for i, j, *_ in native.contacts(e)):
                        found[e] = row * len(env.strengths) + strength
                running &= ~out.done
    for e in range(num_envs):
        native.restore(e, saved[e])
    return found
