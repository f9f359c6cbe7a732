"""Ranking of the agents that matter to the ego, from their states alone."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env import causal
from ccdiff_env._native import Scene
from ccdiff_env.config import unknown
from ccdiff_env.errors import renamed

__all__ = ["RANKINGS", "KeyRanking", "logged_vehicles", "rank_agents", "ranking_named"]

F32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]
KeyRanking: TypeAlias = Literal["cliques", "nearest", "ttc", "first", "random"]

#: Ways to rank: clique occurrences in the causal graph, nearest to the ego, time to contact with
#: the ego (then distance), the scene's order, chance.
RANKINGS: tuple[KeyRanking, ...] = ("cliques", "nearest", "ttc", "first", "random")


def ranking_named(name: str) -> KeyRanking:
    """Return the ranking of a name; ``"distance"`` is the former name of ``"nearest"``.

    Raises
    ------
    ConfigError
        For another name.
    """
    name = renamed("ranking", name, {"distance": "nearest"})
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
    # rankings of the causal graph look at one moment after the other
    position, heading, speed, valid = (
        np.ascontiguousarray(states.swapaxes(0, 1)) for states in (position, heading, speed, valid)
    )
    there = candidates & valid[-1]
    there[ego_idx] = False
    chosen = np.flatnonzero(there)
    distance_m = np.linalg.norm(position[-1] - position[-1, ego_idx], axis=-1)
    ranking = ranking_named(ranking)
    if ranking == "nearest":
        return [int(i) for i in chosen[np.argsort(distance_m[chosen], kind="stable")]]
    if ranking == "ttc":
        now = causal.ttc(position[-1], heading[-1], speed[-1], size, valid[-1], normalised=False)
        order = np.lexsort((distance_m[chosen], now[ego_idx, chosen]))
        return [int(i) for i in chosen[order]]
    if ranking == "cliques":
        near = causal.distance(position, valid, normalised=True)
        contact = causal.ttc(position, heading, speed, size, valid)
        every = causal.rank(
            "cliques", top_k=len(there), valid=valid[-1], ttc=contact, distance=near
        )
        return [i for i in every.agents if there[i]]
    every = causal.rank(ranking, top_k=len(there), valid=there, seed=seed)
    return list(every.agents)


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
