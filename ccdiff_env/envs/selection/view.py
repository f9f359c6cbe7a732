"""What the chooser of adversaries sees of a world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from ccdiff_env import causal

__all__ = ["FEATURES", "SceneView", "observation_space", "observe"]

F32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]

#: Columns of the agents' features; row 0 is the ego, in whose frame positions and velocities are.
FEATURES = (
    "x",  # m / 50
    "y",  # m / 50
    "cos_heading",
    "sin_heading",
    "velocity_x",  # relative to the ego, (m/s) / 15
    "velocity_y",
    "speed",  # (m/s) / 15
    "acceleration",  # (m/s²) / 5
    "length",  # m / 10
    "width",  # m / 5
    "ttc",  # with the ego: 1 contact now, 0 in 20 s or never
    "was_adversary",  # in the decision before
    "present",
)
_MAX = 5.0
_DISTANCE_M = 50.0


@dataclass(frozen=True)
class SceneView:
    """States of all agents of a world, and who sits in which row.

    Parameters
    ----------
    states
        As the native world gives them.
    size
        Length and width [A, 2], metres.
    ego
        Index of the ego.
    rows
        Agents in the rows behind the ego's, nearest first.
    before
        Adversaries of the decision before.
    plan
        What the policy says about its latest plan, if it has one.
    time_left
        Share of the episode that is left.
    """

    states: Any
    size: F32
    ego: int
    rows: list[int]
    before: frozenset[int]
    plan: dict[str, Any] | None
    time_left: float


def observation_space(num_rows: int) -> spaces.Dict:
    """Return the space of observations of M candidates; matrices have M + 1 rows, the ego first."""
    n = num_rows + 1

    def unit() -> spaces.Box:
        return spaces.Box(0.0, 1.0, (n, n), np.float32)

    return spaces.Dict(
        {
            "agents": spaces.Box(-_MAX, _MAX, (n, len(FEATURES)), np.float32),
            "ttc": unit(),
            "distance": unit(),
            "graph": unit(),
            "attention": unit(),
            "mask": spaces.MultiBinary(num_rows),
            "time_left": spaces.Box(0.0, 1.0, (1,), np.float32),
        }
    )


def observe(view: SceneView, num_rows: int) -> dict[str, npt.NDArray[Any]]:
    """Return what the chooser sees.

    ``agents`` [M + 1, F] are the columns of :data:`FEATURES`; ``ttc`` is 1 for contact now and 0
    for 20 s or never, ``distance`` 1 for the same place and 0 for 50 m or more, ``graph`` the
    decision causal graph, ``attention`` that of the latest plan (zero where there is none).
    """
    chosen = [view.ego, *view.rows]
    n, k = num_rows + 1, len(chosen)
    s = view.states
    position, heading, speed = s["position"][chosen], s["heading"][chosen], s["speed"][chosen]
    seconds = causal.ttc(position, heading, speed, view.size[chosen], normalised=False)
    metres = causal.distance(position)
    graph = causal.graph(seconds, metres).joined
    agents = np.zeros((n, len(FEATURES)), np.float32)
    agents[:k] = _features(view, chosen, causal.normalise_ttc(seconds)[0])
    matrices = {
        "ttc": causal.normalise_ttc(seconds),
        "distance": 1.0 - np.minimum(metres, _DISTANCE_M) / _DISTANCE_M,
        "graph": graph,
        "attention": _attention(view.plan, chosen),
    }
    out: dict[str, npt.NDArray[Any]] = {"agents": agents}
    for name, values in matrices.items():
        full = np.zeros((n, n), np.float32)
        full[:k, :k] = values
        out[name] = full
    out["mask"] = (np.arange(num_rows) < k - 1).astype(np.int8)
    out["time_left"] = np.array([view.time_left], np.float32)
    return out


def _features(view: SceneView, chosen: list[int], ttc: F32) -> F32:
    s, ego = view.states, view.ego
    cos, sin = np.cos(s["heading"][ego]), np.sin(s["heading"][ego])
    turn = np.array([[cos, -sin], [sin, cos]])  # from the scene frame to the ego's, from the right
    at = (s["position"][chosen] - s["position"][ego]) @ turn
    moving = (s["velocity"][chosen] - s["velocity"][ego]) @ turn
    angle = s["heading"][chosen] - s["heading"][ego]
    before = [agent in view.before for agent in chosen]
    columns = [
        at[:, 0] / 50.0,
        at[:, 1] / 50.0,
        np.cos(angle),
        np.sin(angle),
        moving[:, 0] / 15.0,
        moving[:, 1] / 15.0,
        s["speed"][chosen] / 15.0,
        s["acceleration"][chosen] / 5.0,
        view.size[chosen, 0] / 10.0,
        view.size[chosen, 1] / 5.0,
        ttc,
        np.array(before),
        np.ones(len(chosen)),
    ]
    clipped: F32 = np.clip(np.stack(columns, axis=1), -_MAX, _MAX).astype(np.float32)
    return clipped


def _attention(plan: dict[str, Any] | None, chosen: list[int]) -> F32:
    out = np.zeros((len(chosen), len(chosen)), np.float32)
    if plan is None or plan["attention"] is None:
        return out
    place = {int(agent): i for i, agent in enumerate(plan["agents"])}
    known = [(row, place[agent]) for row, agent in enumerate(chosen) if agent in place]
    for row, i in known:
        for column, j in known:
            out[row, column] = min(max(float(plan["attention"][i, j]), 0.0), 1.0)
    return out
