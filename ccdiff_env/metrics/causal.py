"""Which agents matter to which: times to contact, distances, rankings of key agents.

Matrices have shape [M, M] (or [T, M, M] over a history), row i belongs to agent i. Measures
and rankings are computed by the Rust code that the running world and the training features use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.errors import ShapeError, expect_shape
from ccdiff_env.metrics.motion import booleans

TTC_CAP_S = 20.0  #: Times to contact are capped here, seconds.
DISTANCE_CAP_M = 20.0  #: Distances beyond this are 0 in the normalised form, metres.
NODE_LIMIT = 20_000  #: Cliques that a search visits per step at most, by default.
#: Agents are joined in the causal graph up to this time to contact, s, and distance, m.
GRAPH_TTC_S, GRAPH_DISTANCE_M = _native.GRAPH_THRESHOLDS

__all__ = [
    "DISTANCE_CAP_M", "GRAPH_DISTANCE_M", "GRAPH_TTC_S", "NODE_LIMIT", "TTC_CAP_S", "Ranking",
    "apart", "distance", "normalise_distance", "normalise_ttc", "rank", "ttc",
]  # fmt: skip


def _history(
    name: str, values: npt.ArrayLike, dtype: Any, ndim: int
) -> tuple[npt.NDArray[Any], bool]:
    """Return the array with a leading step axis, C-contiguous, and whether that axis was added."""
    array = np.asarray(values, dtype=dtype)
    single = array.ndim == ndim - 1
    if single:
        array = array[None]
    if array.ndim != ndim:
        raise ShapeError(f"{name} has {array.ndim} axes, expected {ndim - 1} or {ndim}")
    return np.ascontiguousarray(array), single


def _states(
    position: npt.ArrayLike, valid: npt.ArrayLike | None
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_], bool]:
    """Return positions [T, M, 2] and validity [T, M]; agents whose position is not finite are
    absent.
    """
    points, single = _history("position", position, np.float32, 3)
    if points.shape[-1] != 2:
        raise ShapeError(f"position has shape {points.shape}, expected [..., M, 2]")
    there = np.isfinite(points).all(axis=-1)
    if valid is not None:
        given = booleans(valid)
        if given.shape not in (there.shape, there.shape[1:]):
            raise ShapeError(f"valid has shape {given.shape}, expected {there.shape} or [M]")
        there = there & given
    return points, np.ascontiguousarray(there), single


def apart(elevation_m: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Return which pairs of agents are on different levels [..., M, M]: over 2.5 m apart in height.

    Args:
        elevation_m: [..., M], metres, of the ground below the agents.
    """
    heights = np.asarray(elevation_m, dtype=np.float32)
    gaps: npt.NDArray[np.float32] = np.abs(heights[..., :, None] - heights[..., None, :])
    return gaps > _native.LEVEL_M


def _pairs(
    states: npt.NDArray[np.float32],
    sizes: npt.NDArray[np.float32],
    there: npt.NDArray[np.bool_],
    elevation_m: npt.ArrayLike | None,
    none: float,
) -> npt.NDArray[np.float32]:
    """Return times to contact, or distances where ``none`` is infinite; ``none`` between levels."""
    pairs = _native.causal_pairs(none == TTC_CAP_S, states, sizes, there)
    if elevation_m is not None:
        heights, _ = _history("elevation_m", elevation_m, np.float32, 2)
        expect_shape("elevation_m", heights, pairs.shape[:2])
        pairs[apart(heights)] = none
    return pairs


def ttc(
    position: npt.ArrayLike,
    heading: npt.ArrayLike,
    speed: npt.ArrayLike,
    size: npt.ArrayLike,
    valid: npt.ArrayLike | None = None,
    *,
    elevation_m: npt.ArrayLike | None = None,
    normalised: bool = True,
) -> npt.NDArray[np.float32]:
    """Compute the times to contact of all pairs of agents that keep their velocities.

    Args:
        position: [M, 2] or [T, M, 2], metres, T oldest first. Agents whose position is not finite
            are absent.
        heading: [M] or [T, M], radians counter-clockwise from +x.
        speed: [M] or [T, M], metres per second along the heading.
        size: [M, 2], length and width, metres.
        valid: bool [M] or [T, M], optional; agents that are not valid meet nobody.
        elevation_m: [M] or [T, M], metres, in scenes with levels; agents more than 2.5 m higher or
            lower meet nobody.
        normalised: give (20 - ttc) / 20, 1 for contact now and 0 for 20 s or later, in place of
            seconds.

    Returns:
        float32 [M, M] or [T, M, M]. Pairs with an absent agent hold "no contact" (0, or 20 s).

    Raises:
        ShapeError: Where shapes do not agree.

    Examples:
        Two cars nose to nose, 30 m apart, closing at 15 m/s, 4.5 m long:

        >>> position, size = [[0, 0], [30, 0]], [[4.5, 2], [4.5, 2]]
        >>> seconds = ttc(position, [0, np.pi], [10, 5], size, normalised=False)
        >>> round(float(seconds[0, 1]), 3)
        1.7
    """
    points, there, single = _states(position, valid)
    headings, _ = _history("heading", heading, np.float32, 2)
    speeds, _ = _history("speed", speed, np.float32, 2)
    sizes = np.ascontiguousarray(size, dtype=np.float32)
    shape = points.shape[:2]
    expect_shape("heading", headings, shape)
    expect_shape("speed", speeds, shape)
    expect_shape("size", sizes, (shape[1], 2))
    states = np.dstack([points, headings, speeds])
    seconds = _pairs(states, sizes, there, elevation_m, TTC_CAP_S)
    out = normalise_ttc(seconds) if normalised else seconds
    return out[0] if single else out


def distance(
    position: npt.ArrayLike,
    valid: npt.ArrayLike | None = None,
    *,
    elevation_m: npt.ArrayLike | None = None,
    normalised: bool = False,
) -> npt.NDArray[np.float32]:
    """Compute the distances of the centres of all pairs of agents.

    Args:
        position: [M, 2] or [T, M, 2], metres.
        valid: bool [M] or [T, M], optional.
        elevation_m: [M] or [T, M], metres, in scenes with levels.
        normalised: give (20 - d) / 20 clipped to [0, 1] in place of metres.

    Returns:
        float32 [M, M] or [T, M, M]. Pairs with an absent agent, or on levels more than
        2.5 m apart, are infinitely far apart.
    """
    points, there, single = _states(position, valid)
    states = np.pad(points, [(0, 0), (0, 0), (0, 2)])
    metres = _pairs(states, np.zeros(points.shape[1:], np.float32), there, elevation_m, np.inf)
    out = normalise_distance(metres) if normalised else metres
    return out[0] if single else out


def normalise_ttc(ttc_s: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Turn seconds into (20 - ttc) / 20, 1 for contact now and 0 for 20 s or later."""
    return _near(ttc_s, TTC_CAP_S)


def normalise_distance(distance_m: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Turn metres into (20 - d) / 20, 1 for the same place and 0 for 20 m or beyond."""
    return _near(distance_m, DISTANCE_CAP_M)


def _near(values: npt.ArrayLike, cap: float) -> npt.NDArray[np.float32]:
    given = np.asarray(values, dtype=np.float32)
    return (cap - np.clip(given, 0.0, cap)) / np.float32(cap)


@dataclass(frozen=True)
class Ranking:
    """Key agents, most important first."""

    agents: list[int]  #: Agent indices, no repeats.
    num_named: int  #: How many of them the ranker named; the rest was filled up.
    exact: bool  #: False where a clique search was cut short by its limit.


def rank(
    ranker: Literal["cliques", "distance_cliques", "greedy", "first", "random", "listed", "scores"],
    *,
    top_k: int,
    valid: npt.ArrayLike,
    ttc: npt.ArrayLike | None = None,
    distance: npt.ArrayLike | None = None,
    agents: Sequence[int] | None = None,
    scores: npt.ArrayLike | None = None,
    weights: npt.ArrayLike | None = None,
    seed: int = 0,
    threshold: float = 0.0,
    min_size: int = 2,
    top_per_frame: int = 3,
    node_limit: int = NODE_LIMIT,
) -> Ranking:
    """Choose key agents by a named ranker and fill up by ascending time to contact, then distance,
    then index.

    Agents i and j are joined where a measure of ``[t, i, j]`` or ``[t, j, i]`` exceeds the
    threshold; the weight of the pair is the sum of the two. Not all cliques are listed: a
    branch-and-bound search finds the heaviest. The defaults are those that made the released lists
    of key agents; ``threshold=0.5, min_size=3`` are those of the released script.

    Args:
        ranker: ``"cliques"`` and ``"distance_cliques"`` count in how many of the heaviest cliques
            of every step an agent takes part, equal counts in the order of first appearance,
            ``"greedy"`` sorts by the clique grown greedily from each agent on ``weights`` (the
            paper's algorithm), ``"first"`` takes agents in their order, ``"random"`` shuffles by
            the seed, ``"listed"`` takes ``agents``, ``"scores"`` sorts by falling ``scores``.
        top_k: agents to choose; fewer only where fewer are there.
        valid: bool [M], whether an agent is there.
        ttc, distance: [T, M, M] or [M, M], normalised, NaN for absent agents; for their rankers and
            for filling up.
        agents: a list, as of a person, for ``"listed"``.
        scores: [M], for ``"scores"``, such as the alignment of the gradients of realism and
            guidance.
        weights: [M, M], the causal graph times attention, at least 0, for ``"greedy"``.
        seed: for ``"random"``.
        threshold: at least 0.
        min_size: smallest clique that counts.
        top_per_frame: heaviest cliques taken per step.
        node_limit: cliques visited per step before the search settles for the heaviest seen.

    Examples:
        >>> near = np.zeros((1, 4, 4))
        >>> near[0, 1, 3] = 0.9
        >>> found = rank("cliques", top_k=3, valid=[True] * 4, ttc=near)
        >>> found.agents, found.num_named
        ([1, 3, 0], 2)
    """
    there = booleans(valid)

    def pairs(name: str, values: npt.ArrayLike | None) -> npt.NDArray[np.float32] | None:
        if values is None:
            return None
        array, _ = _history(name, values, np.float32, 3)
        if array.shape[1:] != (there.size, there.size):
            raise ShapeError(
                f"{name} has shape {array.shape}, expected [T, {there.size}, {there.size}]"
            )
        return array

    chosen, num_named, exact = _native.causal_rank(
        ranker,
        top_k,
        there,
        pairs("ttc", ttc),
        pairs("distance", distance),
        None if agents is None else [int(agent) for agent in agents],
        None if scores is None else np.ascontiguousarray(scores, dtype=np.float32),
        None if weights is None else np.ascontiguousarray(weights, dtype=np.float32),
        seed,
        (threshold, min_size, top_per_frame, node_limit),
    )
    return Ranking(agents=chosen, num_named=num_named, exact=exact)
