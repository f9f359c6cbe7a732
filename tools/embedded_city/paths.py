"""Paths that the embedded traffic drives or walks: lanes in order, lane changes, dense points with
arc length.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from tools.embedded_city.city import City
from tools.embedded_city.curves import Curve, Pose, Xy, wrap

Floats = npt.NDArray[np.float64]

STEP_M = 0.5
LATERAL_ACCELERATION_MPS2 = 2.2
SLOWING_MPS2 = 1.7
"""Deceleration with which curves are approached."""


class Path:
    """Dense points along a way, with arc length, direction and the speed that its curves allow.

    Attributes
    ----------
    s, x, y, yaw, speed : numpy.ndarray of float64, shape [P]
        Arc length (m), place (m), unwrapped direction (rad) and greatest speed (m/s) of each point.
    """

    def __init__(self, poses: Sequence[Pose]) -> None:
        kept = [poses[0]]
        for pose in poses[1:]:
            if math.dist(pose.xy, kept[-1].xy) > 0.05:
                kept.append(pose)
        s, yaw = [0.0], [kept[0].yaw]
        for a, b in pairwise(kept):
            s.append(s[-1] + math.dist(a.xy, b.xy))
            yaw.append(yaw[-1] + wrap(b.yaw - yaw[-1]))
        self.s: Floats = np.array(s)
        self.x: Floats = np.array([p.x for p in kept])
        self.y: Floats = np.array([p.y for p in kept])
        self.yaw: Floats = np.array(yaw)
        self.cos: Floats = np.array([math.cos(a) for a in yaw])
        self.sin: Floats = np.array([math.sin(a) for a in yaw])
        self.speed: Floats = self._speed_limits()

    @property
    def length(self) -> float:
        """Length in metres."""
        return float(self.s[-1])

    def _speed_limits(self) -> Floats:
        bend = np.abs(np.diff(self.yaw)) / np.diff(self.s)
        bend = np.append(bend, bend[-1])
        return self._approached(np.sqrt(LATERAL_ACCELERATION_MPS2 / np.maximum(bend, 1e-4)))

    def _approached(self, limit: Floats) -> Floats:
        """Return speed limits lowered where the next ones could not be reached by slowing down."""
        for i in range(len(limit) - 2, -1, -1):
            reachable = limit[i + 1] ** 2 + 2.0 * SLOWING_MPS2 * (self.s[i + 1] - self.s[i])
            limit[i] = min(limit[i], math.sqrt(reachable))
        return limit

    def slow_to(self, along_m: float, speed_mps: float) -> None:
        """Lower the speed at one place, and on the way to it."""
        self.speed[np.searchsorted(self.s, along_m)] = speed_mps
        self._approached(self.speed)

    def at(self, along_m: float) -> Pose:
        """Return the pose after ``along_m`` metres, clamped to the path."""
        x = float(np.interp(along_m, self.s, self.x))
        y = float(np.interp(along_m, self.s, self.y))
        return Pose(x, y, float(np.interp(along_m, self.s, self.yaw)))

    def limit_at(self, along_m: float) -> float:
        """Return the speed that the curves allow after ``along_m`` metres."""
        return float(np.interp(along_m, self.s, self.speed))

    def ahead(self, along_m: float, reach_m: float) -> slice:
        """Return the indices of the points from ``along_m`` on, at most ``reach_m`` metres, every
        second one.
        """
        first, last = np.searchsorted(self.s, (along_m, along_m + reach_m))
        return slice(int(first), int(last), 2)


def lanes_path(
    city: City,
    lanes: Sequence[str],
    *,
    changes: Mapping[str, tuple[float, float]] | None = None,
    right_m: float = 0.0,
) -> Path:
    """Return the path along lanes.

    Parameters
    ----------
    city
        Where the lanes are.
    lanes
        Names of lanes in driving order. The connector between two of them is added; where there is
        none, the second must be a neighbour of the first on a straight road, and the path changes
        lanes.
    changes
        For a lane that is left by a lane change: distance from its start at which the change
        begins, and its length, in metres.
    right_m
        Shift of the whole path to the right (cyclists beside the lane).
    """
    poses: list[Pose] = []
    begin = 0.0
    for name, after in zip(lanes, [*lanes[1:], ""], strict=True):
        curve = city.lanes[name].curve
        if f"{name}>{after}" in city.lanes or not after:
            poses += curve.trimmed(begin, curve.length).sampled(STEP_M)
            begin = 0.0
            if after:
                poses += city.lanes[f"{name}>{after}"].curve.sampled(STEP_M)
        else:
            at, over = (changes or {})[name]
            poses += curve.trimmed(begin, at).sampled(STEP_M)
            poses += _lane_change(curve, city.lanes[after].curve, at, over)
            begin = at + over
    if right_m:
        poses = [p.ahead(0.0, -right_m) for p in poses]
    return Path(poses)


def _lane_change(before: Curve, after: Curve, at_m: float, over_m: float) -> list[Pose]:
    """Return poses that drift from one straight lane to its neighbour, smooth to the second
    derivative.
    """
    a, b = before.at(at_m), after.at(at_m)
    left = -math.sin(a.yaw) * (b.x - a.x) + math.cos(a.yaw) * (b.y - a.y)
    out = []
    for i in range(1, math.ceil(over_m / STEP_M)):
        u = i / math.ceil(over_m / STEP_M)
        drift = left * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
        slope = left * 30.0 * (u * (1.0 - u)) ** 2 / over_m
        pose = before.at(at_m + u * over_m).ahead(0.0, drift)
        out.append(Pose(pose.x, pose.y, wrap(pose.yaw + math.atan(slope))))
    return out


def walk_path(points: Sequence[Xy]) -> Path:
    """Return the path of a pedestrian through points, at least two."""
    poses = []
    for a, b in pairwise(points):
        yaw = math.atan2(b[1] - a[1], b[0] - a[0])
        num = max(1, math.ceil(math.dist(a, b) / STEP_M))
        for i in range(num + 1):
            poses.append(Pose(a[0] + (b[0] - a[0]) * i / num, a[1] + (b[1] - a[1]) * i / num, yaw))
    path = Path(poses)
    path.speed[:] = 10.0
    return path
