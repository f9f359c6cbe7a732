"""The score of a planner in one episode, part by part, as nuPlan's closed-loop metrics have it.

    score = no_at_fault_collision x on_road x makes_progress x right_way
            x (5 ttc + 5 progress + 4 speed_limit + 2 comfort) / 16

Weights and bounds stand in the file of the protocol, see :mod:`ccdiff_env.bench.protocol`.
docs/evaluation.md says part by part what equals nuPlan, and what differs and why.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from math import factorial
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.worlds import Worlds

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

_SCORE = PROTOCOL.fields["score"]
#: Limits of comfort: accelerations (m/s²), jerks (m/s³), yaw rate (rad/s) and its change (rad/s²).
COMFORT: Mapping[str, tuple[float, float]] = {k: (a, b) for k, (a, b) in _SCORE["comfort"].items()}
TTC_BOUND_S: float = _SCORE["least_ttc_s"]
_OBJECTS = ("static",)  #: Kinds of agents of which one contact at fault costs half.
#: Names of an episode's entries that are not for figures of somebody's own.
ROW = (
    *_SCORE["gates"], *_SCORE["weights"], "comfort_share", "collision", "success", "min_ttc_s",
    "score", "nuplan_score", "scene", "seed", "digest", "actions", "action", "planner", "traffic",
    "own_weights", "job", "city", "tags",
)  # fmt: skip
_DIGITS = 8  #: nuPlan rounds smoothed figures to so many digits.


class Judge:
    """Follows the first slot of one world of a batch while it is driven, and scores the episode."""

    def __init__(self, worlds: Worlds, world_idx: int) -> None:
        self._worlds, self._world_idx = worlds, world_idx
        self._scene = worlds.scenes[worlds.native.status(world_idx).scene_idx]
        self._ego = worlds.native.slot_agents(world_idx)[0]
        self._at = {name: i for i, name in enumerate(worlds.column_names)}
        self._columns: list[F32] = []
        self._heading: list[float] = []
        self._path: list[list[float]] = []
        self._lanes: list[tuple[int, float] | None] = []
        self._met: list[int] = []
        self._at_fault: Counter[str] = Counter()
        self._ttc = True
        self._off_m = 0.0
        self._look()

    def step(self, columns: F32) -> None:
        """Look at the state after a step, whose info columns [M] are these."""
        self._columns.append(columns.copy())
        if columns[self._at["collision"]]:
            partner = int(columns[self._at["collision_partner"]]) - 1
            fault = columns[self._at["at_fault"]] > 0.0 and partner not in self._met
            self._met.append(partner)
            if fault:
                self._at_fault[self._scene.agent_types[partner]] += 1
                self._ttc = False
        if columns[self._at["off_road"]]:
            self._off_m = max(self._off_m, self._worlds.native.off_road_m(self._world_idx)[0])
        self._look()

    def _look(self) -> None:
        before = next((lane for lane in reversed(self._lanes) if lane), None)
        lane, contact_s = self._worlds.native.score_facts(
            self._world_idx, None if before is None else before[0], self._met, TTC_BOUND_S
        )
        self._lanes.append(lane)
        self._ttc &= contact_s is None
        states = self._worlds.native.states(self._world_idx)
        self._heading.append(float(states["heading"][self._ego]))
        self._path.append(states["position"][self._ego].tolist())

    def row(self, metrics: Mapping[str, float]) -> dict[str, Any]:
        """Return the parts of the score, each in [0, 1], the score, and figures beside it.

        Without a road ``on_road`` is ``None``, and no part of the score. ``comfort_share`` is the
        share of the steps within all limits of comfort; ``comfort`` is 1 where all are.
        """
        dt_s = self._worlds.config.dt_s
        columns = dict(zip(self._at, np.array(self._columns, np.float64).T, strict=True))
        calm = comfort(
            columns["acceleration"], columns["lateral_acceleration"], np.array(self._heading), dt_s
        )
        ways_m = self._worlds.native.progress_along_log(self._world_idx, self._path)
        share = progress_share(*ways_m) if ways_m else metrics["route_completion"]
        over = columns["speeding"].mean() / _SCORE["excess_mps"]
        on_road = float(self._off_m < _SCORE["off_road_m"]) if self._scene.has_road else None
        parts = {
            "no_at_fault_collision": no_at_fault(self._at_fault),
            "on_road": on_road,
            "makes_progress": float(share >= _SCORE["least_progress"]),
            "right_way": right_way(self._lanes, dt_s),
            "ttc": float(self._ttc),
            "progress": share,
            "speed_limit": float(max(0.0, 1.0 - over)),
            "comfort": float(calm.all()),
        }
        return {
            **parts,
            "comfort_share": float(calm.mean()),
            "collision": metrics["collision"],
            "success": metrics["is_success"],
            "min_ttc_s": metrics["min_ttc"],
            "score": score_of(parts),
        }


def no_at_fault(contacts: Mapping[str, int]) -> float:
    """Return what is left where contacts at fault with so many agents of each kind happened.

    0 after one with a road user, a half after one with an object, 0 after two.
    """
    others = sum(count for kind, count in contacts.items() if kind not in _OBJECTS)
    objects = sum(contacts.get(kind, 0) for kind in _OBJECTS)
    return 0.0 if others else max(0.0, 1.0 - objects / 2)


def progress_share(along_m: float, way_m: float) -> float:
    """Return an ego's way along the route over the log's, at most 1; 0 for one that drives back.

    Ways count for 2 m at least.
    """
    least_m = float(_SCORE["least_way_m"])
    if along_m < -least_m:
        return 0.0
    return min(1.0, max(along_m, least_m) / max(way_m, least_m))


def right_way(lanes: Sequence[tuple[int, float] | None], dt_s: float) -> float:
    """Return 1, a half or 0 by the distance driven against lanes within a second.

    ``lanes`` are the lane that holds the ego and the position along it, metres, at each step;
    ``None`` in none. Ways count within one lane: the first two steps in another one do not.
    """
    ways, lane_before, along_before = [], None, None
    if lanes and lanes[0] is not None:
        lane_before = lanes[0][0]
    for held in lanes:
        way = 0.0
        if held is not None and held[0] != lane_before:
            lane_before, along_before = held[0], None
        elif held is not None:
            way = 0.0 if along_before is None else held[1] - along_before
            along_before = held[1]
        ways.append(way)
    second = int(1.0 / dt_s + 1e-3)
    within = [sum(ways[max(0, i - second) : i + 1]) for i in range(len(ways))]
    against_m = -min(within, default=0.0)
    half_m, none_m = _SCORE["against_m"]
    return 1.0 if against_m < half_m else 0.5 if against_m < none_m else 0.0


def comfort(acceleration: F64, lateral: F64, heading: F64, dt_s: float) -> Bool:
    """Return whether each state is within all six limits of nuPlan's comfort [T + 1].

    Args:
        acceleration, lateral: Accelerations of the T steps along and across the heading, m/s².
        heading: Headings of the T + 1 states, radians.
        dt_s: Seconds of a step.
    """
    ahead, across = (np.concatenate([a[:1], a]) for a in (acceleration, lateral))
    yaw = np.unwrap(heading)

    def smooth(values: F64) -> F64:
        return savitzky_golay(values, 8, 2)

    def jerk(values: F64) -> F64:
        return savitzky_golay(smooth(values), 15, 2, 1, dt_s)

    found = {
        "acceleration": smooth(ahead),
        "lateral_acceleration": smooth(across),
        "jerk": jerk(np.hypot(ahead, across)),
        "longitudinal_jerk": jerk(ahead),
        "yaw_rate": savitzky_golay(yaw, 5, 2, 1, dt_s),
        "yaw_acceleration": savitzky_golay(yaw, 5, 3, 2, dt_s),
    }
    within = [(low < found[name]) & (found[name] < high) for name, (low, high) in COMFORT.items()]
    return np.asarray(np.all(within, axis=0))


def savitzky_golay(
    values: F64, window: int, degree: int, derivative: int = 0, delta: float = 1.0
) -> F64:
    """Return values [N] smoothed by polynomials, or derivatives of these, as nuPlan takes them.

    As ``scipy.signal.savgol_filter`` with its default treatment of the ends, then rounded. Series
    shorter than the window are one window.
    """
    window = min(window, len(values))
    half, degree = window // 2, min(degree, window - 1)
    if derivative > degree:
        return np.zeros(len(values))

    def weights(place: float) -> F64:
        powers = np.vander(np.arange(window) - place, degree + 1, increasing=True)
        row = np.linalg.pinv(powers)[derivative]
        return np.asarray(row * factorial(derivative) / delta**derivative)

    out = np.empty(len(values))
    inner = len(values) - 2 * half
    # windows of an even length begin one value later
    found = np.correlate(values, weights((window - 1) / 2), "valid")[1 - window % 2 :]
    out[half : half + inner] = found[:inner]
    for i in range(half):
        out[i] = weights(i) @ values[:window]
        out[-1 - i] = weights(window - 1 - i) @ values[len(values) - window :]
    return np.round(out, _DIGITS)


def score_of(parts: Mapping[str, float | None]) -> float:
    """Return the score that the parts of an episode make; a gate that is not known stays open."""
    weights: Mapping[str, float] = _SCORE["weights"]
    known = {name: value for name, value in parts.items() if value is not None}
    product = float(np.prod([known.get(gate, 1.0) for gate in _SCORE["gates"]]))
    return product * (sum(w * known[name] for name, w in weights.items()) / sum(weights.values()))
