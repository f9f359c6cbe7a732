"""Choices of adversaries without learning, to compare learned ones with."""

from __future__ import annotations

import copy

import numpy as np
import numpy.typing as npt

from ccdiff_env.envs.selection.vector import FEATURES, SCALES, AdversarySelectionVectorEnv
from ccdiff_env.errors import unknown

__all__ = ["RULES", "fork_actions", "rule_actions"]

#: Nobody, chance, the nearest to the ego, the soonest contact with it, and the closest approach in
#: the coming 4 s at constant velocity, the ego along its route.
RULES = ("none", "random", "nearest", "ttc", "approach")
_TTC, _APPROACH = FEATURES.index("ttc"), FEATURES.index("approach")


def rule_actions(
    env: AdversarySelectionVectorEnv,
    rule: str,
    *,
    strength: int = -1,
    gate_m: float = np.inf,
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
    draws = np.random.default_rng(seed).random(obs.shape[:2])
    nearest = -np.arange(obs.shape[1]) * np.ones_like(draws)
    scores = {"random": draws, "ttc": obs[..., _TTC], "approach": -obs[..., _APPROACH]}
    score, there = np.asarray(scores.get(rule, nearest)), obs[:, :, 0] > 0.5
    rows = np.where(there, score, -np.inf).argmax(axis=1)
    gap_m = obs[np.arange(len(obs)), rows, _APPROACH] * SCALES[_APPROACH]
    nobody = ~there.any(axis=1) | (rule == "none") | (gap_m > gate_m)
    return np.where(nobody, env.nobody, rows * num_strengths + strength % num_strengths)


def fork_actions(env: AdversarySelectionVectorEnv, decisions: int = 2) -> npt.NDArray[np.int64]:
    """Return, in each world [E], the weakest choice that makes contact in a fork, else nobody.

    Every candidate is tried at every strength, for some ``decisions``; the worlds stay where they
    are.
    """
    fork, found = copy.deepcopy(env), np.full(env.num_envs, env.nobody, np.int64)
    saved = [env.ego.snapshot(e) for e in range(env.num_envs)]
    order = np.arange(env.nobody).reshape(-1, len(env.strengths)).T.ravel()
    for action in order.tolist():
        tried = env.action_masks()[:, action] & ~env.ended & (found == env.nobody)
        for e in np.flatnonzero(tried).tolist():
            fork.ego.restore(e, saved[e])
        chosen, fork.ended = env.chosen([action] * env.num_envs), ~tried
        fork.adversaries = [set() for _ in fork.adversaries]
        for _ in range(decisions):
            _, table = fork.decide(chosen)
            found[table["collisions"] > 0.0] = action
    return found
