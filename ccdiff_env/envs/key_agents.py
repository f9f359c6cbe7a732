"""Ranking of the agents that matter to the ego, from their states alone."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env._native import Scene
from ccdiff_env.config import unknown

__all__ = ["RANKINGS", "KeyRanking", "logged_vehicles", "rank_agents", "ranking_named"]

F32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]
KeyRanking: TypeAlias = Literal["cliques", "nearest", "ttc", "first", "random"]

#: Ways to rank: clique occurrences in the causal graph, nearest to the ego, time to contact with
#: the ego (then distance), the scene's order, chance.
RANKINGS: tuple[KeyRanking, ...] = ("cliques", "nearest", "ttc", "first", "random")


def ranking_named(name: str) -> KeyRanking:
    """Return the ranking of a name.

    Raises
    ------
    ConfigError
        For another name.
    """
    for known in RANKINGS:
        if name == known:
            return known
    raise unknown("ranking", str(name), RANKINGS)


def rank_agents(
    ranking: KeyRanking,
    *,
    position: F32,
    heading: F32,
    speed: F32,
    size: F32,
    valid: Bool,
    candidates: Bool,
    ego_idx: int,
    seed: int = 0,
) -> list[int]:
    """Return the candidates, most important first.

    Parameters
    ----------
    ranking
        One of :data:`RANKINGS`.
    position, heading, speed, valid
        States [A, T, 2] m, [A, T] rad, [A, T] m/s, [A, T], oldest first; all but ``"cliques"``
        use the last step alone.
    size
        Length and width [A, 2], metres.
    candidates
        Who may be ranked [A]; those not valid at the last step, and the ego, are left out.
    ego_idx
        The ego.
    seed
        For ``"random"``.

    Raises
    ------
    ConfigError
        For another ranking.
    """
    # rankings look at one moment after the other
    x, y, headings, speeds, there = (
        np.ascontiguousarray(states.T)
        for states in (position[..., 0], position[..., 1], heading, speed, valid)
    )
    length, width = np.ascontiguousarray(size.T)
    return _native.causal_key_agents(
        ranking_named(ranking),
        x,
        y,
        headings,
        speeds,
        length,
        width,
        there,
        candidates,
        ego_idx,
        seed,
    )


def logged_vehicles(scene: Scene, step: int, ranking: KeyRanking, seed: int = 0) -> list[int]:
    """Rank the vehicles of a scene that are there at a step of the log; the ego comes first.

    Parameters
    ----------
    scene
        The scene.
    step
        Step of the log; ``"cliques"`` looks at the three seconds before it as well.
    ranking
        One of :data:`RANKINGS`. Without an ego, the first vehicle takes its place.
    seed
        For ``"random"``.

    Returns
    -------
    list
        Indices of agents.
    """
    tracks = scene.tracks()
    first = max(step - round(3.0 / scene.dt), 0)
    steps = slice(first, step + 1)
    valid = tracks["valid"][:, steps]
    vehicles = np.array([kind == "vehicle" for kind in scene.agent_types]) & valid[:, -1]
    vehicles[[towed for towed, _ in scene.towed]] = False
    if not vehicles.any():
        return []
    ids = scene.agent_ids
    ego_idx = ids.index("ego") if "ego" in ids and vehicles[ids.index("ego")] else None
    if ego_idx is None:
        ego_idx = int(np.argmax(vehicles))
    velocity = tracks["velocity"][:, steps]
    others = rank_agents(
        ranking,
        position=tracks["position"][:, steps],
        heading=tracks["heading"][:, steps],
        speed=np.linalg.norm(velocity, axis=-1).astype(np.float32),
        size=scene.sizes[:, :2].copy(),
        valid=valid,
        candidates=vehicles,
        ego_idx=ego_idx,
        seed=seed,
    )
    return [ego_idx, *others]
