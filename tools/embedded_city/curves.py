"""Plane curves made of straight segments and arcs: what roads, lanes and kerbs of the embedded city
are drawn with.

Everything here is plain ``float`` arithmetic, so that the generated data set is the same on every
machine once its numbers are rounded. Frame: the city's (x east, y north, metres); angles counter-
clockwise from +x, radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

Xy = tuple[float, float]
"""A point (x, y) in metres."""

STRAIGHT_1PM = 1e-9
"""Curvatures below this are straight."""


def wrap(angle_rad: float) -> float:
    """Return the angle in (-pi, pi]."""
    wrapped = math.remainder(angle_rad, 2.0 * math.pi)
    return wrapped if wrapped > -math.pi else math.pi


@dataclass(frozen=True)
class Pose:
    """A place and a direction."""

    x: float
    y: float
    yaw: float

    @property
    def xy(self) -> Xy:
        """The place alone."""
        return (self.x, self.y)

    def ahead(self, along_m: float, left_m: float = 0.0) -> Pose:
        """Return the pose moved along its direction and to its left."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose(self.x + along_m * c - left_m * s, self.y + along_m * s + left_m * c, self.yaw)

    def reversed(self) -> Pose:
        """Return the pose looking the other way."""
        return Pose(self.x, self.y, wrap(self.yaw + math.pi))


@dataclass(frozen=True)
class Segment:
    """A straight segment or an arc of constant curvature (positive to the left)."""

    start: Pose
    length: float
    curvature: float = 0.0

    def at(self, along_m: float) -> Pose:
        """Return the pose after ``along_m`` metres."""
        k, yaw = self.curvature, self.start.yaw
        if abs(k) < STRAIGHT_1PM:
            return self.start.ahead(along_m)
        turned = yaw + k * along_m
        return Pose(
            self.start.x + (math.sin(turned) - math.sin(yaw)) / k,
            self.start.y - (math.cos(turned) - math.cos(yaw)) / k,
            wrap(turned),
        )

    @property
    def end(self) -> Pose:
        """The last pose."""
        return self.at(self.length)

    def offset(self, left_m: float) -> Segment:
        """Return the parallel segment ``left_m`` metres to the left."""
        scale = 1.0 - self.curvature * left_m
        return Segment(self.start.ahead(0.0, left_m), self.length * scale, self.curvature / scale)

    def reversed(self) -> Segment:
        """Return the same segment driven the other way."""
        return Segment(self.end.reversed(), self.length, -self.curvature)


@dataclass(frozen=True)
class Curve:
    """Segments that follow each other with the same direction where they meet."""

    segments: tuple[Segment, ...]

    @property
    def length(self) -> float:
        """Length in metres."""
        return sum(p.length for p in self.segments)

    @property
    def start(self) -> Pose:
        """The first pose."""
        return self.segments[0].start

    @property
    def end(self) -> Pose:
        """The last pose."""
        return self.segments[-1].end

    def at(self, along_m: float) -> Pose:
        """Return the pose after ``along_m`` metres, clamped to the curve."""
        rest = max(along_m, 0.0)
        for segment in self.segments:
            if rest <= segment.length:
                return segment.at(rest)
            rest -= segment.length
        return self.end

    def offset(self, left_m: float) -> Curve:
        """Return the parallel curve ``left_m`` metres to the left."""
        return Curve(tuple(p.offset(left_m) for p in self.segments))

    def reversed(self) -> Curve:
        """Return the same curve driven the other way."""
        return Curve(tuple(p.reversed() for p in reversed(self.segments)))

    def trimmed(self, first_m: float, last_m: float) -> Curve:
        """Return the part between two distances from the start."""
        out, passed = [], 0.0
        for segment in self.segments:
            a, b = max(first_m - passed, 0.0), min(last_m - passed, segment.length)
            if b - a > 1e-6:
                out.append(Segment(segment.at(a), b - a, segment.curvature))
            passed += segment.length
        return Curve(tuple(out))

    def outline(self, step_rad: float = 0.07) -> list[Xy]:
        """Return points of the curve, enough for arcs to look round: one per ``step_rad`` of
        turning.
        """
        out = [self.start.xy]
        for segment in self.segments:
            num = max(1, math.ceil(abs(segment.curvature) * segment.length / step_rad))
            out += [segment.at(segment.length * (i + 1) / num).xy for i in range(num)]
        return out

    def sampled(self, step_m: float) -> list[Pose]:
        """Return poses about ``step_m`` metres apart, both ends included."""
        num = max(1, round(self.length / step_m))
        return [self.at(self.length * i / num) for i in range(num + 1)]


def filleted(points: Sequence[Xy], radii: Sequence[float]) -> Curve:
    """Return the line through ``points`` with its inner corners rounded by arcs of ``radii`` (one
    a corner).
    """
    yaws = [math.atan2(b[1] - a[1], b[0] - a[0]) for a, b in pairwise(points)]
    segments: list[Segment] = []
    at = Pose(*points[0], yaws[0])
    for corner, radius, before, after in zip(points[1:-1], radii, yaws, yaws[1:], strict=False):
        turn = wrap(after - before)
        tangent = radius * math.tan(abs(turn) / 2.0)
        straight = math.dist(at.xy, corner) - tangent
        if straight < 0.0:
            raise ValueError(f"no room for a corner of radius {radius} m at {corner}")
        segments.append(Segment(at, straight))
        arc = Segment(segments[-1].end, radius * abs(turn), math.copysign(1.0 / radius, turn))
        segments.append(arc)
        at = Pose(*arc.end.xy, after)
    segments.append(Segment(at, math.dist(at.xy, points[-1])))
    return Curve(tuple(p for p in segments if p.length > 1e-6))


def crossing_of(a: Pose, b: Pose) -> Xy | None:
    """Return where the lines through two poses cross, None for (nearly) parallel ones."""
    ax, ay, bx, by = math.cos(a.yaw), math.sin(a.yaw), math.cos(b.yaw), math.sin(b.yaw)
    det = ax * by - ay * bx
    if abs(det) < 0.05:
        return None
    along = ((b.x - a.x) * by - (b.y - a.y) * bx) / det
    return a.ahead(along).xy


def connection(start: Pose, end: Pose, largest_m: float = math.inf) -> Curve:
    """Return a smooth curve from one pose to another: one arc between straight lines, or two arcs
    for a shift.

    The arc of the first kind has the largest radius that fits, but none above ``largest_m``.
    """
    turn = wrap(end.yaw - start.yaw)
    corner = crossing_of(start, end)
    if abs(turn) > 0.35 and corner is not None:
        tangent = min(math.dist(start.xy, corner), math.dist(end.xy, corner))
        radius = tangent / math.tan(abs(turn) / 2.0)
        return filleted([start.xy, corner, end.xy], [min(radius * 0.9999, largest_m)])
    return _two_arcs(start, end)


def _two_arcs(start: Pose, end: Pose) -> Curve:
    """Return the biarc with equal tangent lengths between two poses."""
    vx, vy = end.x - start.x, end.y - start.y
    t1, t2 = (math.cos(start.yaw), math.sin(start.yaw)), (math.cos(end.yaw), math.sin(end.yaw))
    v_t = vx * (t1[0] + t2[0]) + vy * (t1[1] + t2[1])
    v_v = vx * vx + vy * vy
    away = 2.0 * (1.0 - t1[0] * t2[0] - t1[1] * t2[1])
    if away < 1e-9:
        tangent = v_v / (2.0 * v_t)
    else:
        tangent = (-v_t + math.sqrt(v_t * v_t + away * v_v)) / away
    a, b = start.ahead(tangent), end.ahead(-tangent)
    middle = ((a.x + b.x) / 2.0, (a.y + b.y) / 2.0)
    first = _arc_to(start, middle)
    return Curve((first, _arc_to(Pose(*middle, first.end.yaw), end.xy)))


def _arc_to(start: Pose, to: Xy) -> Segment:
    """Return the arc that leaves ``start`` along its direction and ends at ``to``."""
    dx, dy = to[0] - start.x, to[1] - start.y
    left = -math.sin(start.yaw) * dx + math.cos(start.yaw) * dy
    ahead = math.cos(start.yaw) * dx + math.sin(start.yaw) * dy
    chord2 = dx * dx + dy * dy
    curvature = 2.0 * left / chord2
    if abs(curvature) < 1e-7:
        return Segment(start, math.sqrt(chord2))
    return Segment(start, 2.0 * math.atan2(left, ahead) / curvature, curvature)
