"""What a logged scene must satisfy, and what becomes of an ego that keeps its velocity.

A log is what the data set holds: key frames at 2 Hz. It is checked as environments play it,
interpolated linearly to 10 Hz.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tools.embedded_city.city import City
from tools.embedded_city.curves import Pose, Xy, wrap
from tools.embedded_city.traffic import Kind

KEY_FRAME_S = 0.5
PLAY_S = 0.1
EGO_START_S = 3.0
EGO_HORIZON_S = 10.0


@dataclass
class Track:
    """One actor's key frames."""

    name: str
    kind: Kind
    first: int
    """Key frame at which it appears."""
    poses: list[Pose]
    is_parked: bool = False

    def at(self, time_s: float) -> Pose | None:
        """Return the pose at a time, linear between key frames; None outside the track."""
        at = time_s / KEY_FRAME_S - self.first
        i = math.floor(at + 1e-6)
        if i < 0 or at > len(self.poses) - 1 + 1e-6:
            return None
        if i >= len(self.poses) - 1:
            return self.poses[-1]
        a, b, u = self.poses[i], self.poses[i + 1], at - i
        return Pose(a.x + u * (b.x - a.x), a.y + u * (b.y - a.y), a.yaw + u * wrap(b.yaw - a.yaw))


def corners(pose: Pose, length_m: float, width_m: float) -> list[Xy]:
    """Return the corners of a box, counter-clockwise from front left."""
    a, b = length_m / 2.0, width_m / 2.0
    return [pose.ahead(u, v).xy for u, v in ((a, b), (-a, b), (-a, -b), (a, -b))]


def boxes_overlap(a: Sequence[Xy], b: Sequence[Xy]) -> bool:
    """Return whether two convex quadrangles touch (separating axes)."""
    for ring in (a, b):
        for (px, py), (qx, qy) in zip(ring, [*ring[1:], ring[0]], strict=True):
            nx, ny = qy - py, px - qx
            if min(nx * x + ny * y for x, y in a) > max(nx * x + ny * y for x, y in b):
                return False
            if min(nx * x + ny * y for x, y in b) > max(nx * x + ny * y for x, y in a):
                return False
    return True


class DrivableArea:
    """Point queries on the city's drivable area."""

    def __init__(self, city: City) -> None:
        edges = []
        for ring in (city.drivable_exterior, *city.drivable_holes):
            edges += [(*p, *q) for p, q in zip(ring, ring[1:] + ring[:1], strict=True)]
        self.edges: npt.NDArray[np.float64] = np.array(edges)

    def crossings(self, y: float) -> npt.NDArray[np.float64]:
        """Return where its edges cross a line from west to east."""
        ax, ay, bx, by = self.edges.T
        spans = (ay > y) != (by > y)
        across = (y - ay[spans]) / (by[spans] - ay[spans]) * (bx[spans] - ax[spans])
        return np.asarray(ax[spans] + across)

    def contains(self, points: Sequence[Xy]) -> bool:
        """Return whether all points lie inside (even-odd rule)."""
        return all(np.count_nonzero(self.crossings(y) > x) % 2 for x, y in points)


def first_overlap(tracks: Sequence[Track], duration_s: float, room_m: float) -> str:
    """Return which tracks come closer than ``room_m`` and when, empty if none do."""
    for step in range(round(duration_s / PLAY_S) + 1):
        here = [(t, p) for t in tracks if (p := t.at(step * PLAY_S)) is not None]
        boxes = [corners(p, t.kind.length + room_m, t.kind.width + room_m) for t, p in here]
        for i, (a, p) in enumerate(here):
            for j in range(i):
                b, q = here[j]
                far = (a.kind.length + b.kind.length) / 2.0 + 2.0
                if (
                    abs(p.x - q.x) < far
                    and abs(p.y - q.y) < far
                    and boxes_overlap(boxes[i], boxes[j])
                ):
                    return f"{a.name} and {b.name} at {step * PLAY_S:.1f} s"
    return ""


def first_off_road(tracks: Sequence[Track], area: DrivableArea) -> str:
    """Return which vehicle leaves the drivable area and when, empty if none does."""
    for track in tracks:
        if track.kind.is_driven:
            for i in range(2 * len(track.poses) - 1):
                time_s = (track.first + i / 2.0) * KEY_FRAME_S
                pose = track.at(time_s)
                if pose and not area.contains(corners(pose, track.kind.length, track.kind.width)):
                    return f"{track.name} at {time_s:.2f} s"
    return ""


def constant_velocity_end(tracks: Sequence[Track], area: DrivableArea) -> tuple[str, float] | None:
    """Return how and when an ego that keeps its velocity from 3.0 s on fails, None if it gets
    through 10 s.

    The first track is the ego; the others are replayed. It fails by ``collision`` (boxes touch) or
    ``off-road`` (a corner leaves the drivable area).
    """
    ego, others = tracks[0], tracks[1:]
    start, before = ego.at(EGO_START_S), ego.at(EGO_START_S - PLAY_S)
    assert start is not None
    assert before is not None
    speed = math.dist(start.xy, before.xy) / PLAY_S
    for step in range(1, round(EGO_HORIZON_S / PLAY_S) + 1):
        box = corners(start.ahead(speed * step * PLAY_S), ego.kind.length, ego.kind.width)
        time_s = EGO_START_S + step * PLAY_S
        for other in others:
            pose = other.at(time_s)
            if pose is not None and math.dist(pose.xy, box[0]) < 20.0:
                other_box = corners(pose, other.kind.length, other.kind.width)
                if boxes_overlap(box, other_box):
                    return "collision", time_s
        if not area.contains(box):
            return "off-road", time_s
    return None
