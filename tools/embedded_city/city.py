"""The embedded city: roads and junctions, and the lanes, connectors, kerbs and crossings that
follow from them.

A road has a reference curve between the centres of two junctions; its lanes are parallels of that
curve, to the right for traffic along it and to the left for traffic against it (right-hand
traffic). Lanes end where a junction's arm ends; connectors lead through the junction. Frame: x
east, y north, metres.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from tools.embedded_city.curves import (
    Curve,
    Pose,
    Xy,
    connection,
    crossing_of,
    filleted,
    wrap,
)

LANE_WIDTH_M = 3.5
SHOULDER_M = 0.4
PARKING_M = 2.4
WALKWAY_M = 2.6
KERB_RADIUS_M = 7.0
CROSSING_ROOM_M = 4.6
"""Length of an arm between the kerb's corner and the lanes' end, where a crossing lies."""


@dataclass(frozen=True)
class Road:
    """A road between two junctions."""

    name: str
    start: str
    end: str
    curve: Curve
    forward: int = 1
    """Number of lanes along the curve."""
    backward: int = 1
    """Number of lanes against the curve."""
    parking_right: bool = False
    """Whether there is room to park on the right, looking along the curve."""
    parking_left: bool = False

    @property
    def right_m(self) -> float:
        """Distance from the reference curve to the kerb on its right."""
        return self.forward * LANE_WIDTH_M + SHOULDER_M + PARKING_M * self.parking_right

    @property
    def left_m(self) -> float:
        """Distance from the reference curve to the kerb on its left."""
        return self.backward * LANE_WIDTH_M + SHOULDER_M + PARKING_M * self.parking_left


@dataclass(frozen=True)
class Junction:
    """A place where roads meet or end."""

    name: str
    centre: Xy
    signals: bool = False
    crossings: bool = False
    reach_m: float = 0.0
    """Least distance from the centre to where lanes end."""
    double_left: frozenset[str] = frozenset()
    """Roads from which two lanes turn left."""


@dataclass(frozen=True)
class Arm:
    """A road as seen from one of its junctions, looking outward."""

    road: Road
    outward: Pose
    """Centre of the junction, looking along the road."""
    at_start: bool

    @property
    def away(self) -> int:
        """Number of lanes that leave the junction."""
        return self.road.forward if self.at_start else self.road.backward

    @property
    def toward(self) -> int:
        """Number of lanes that lead to the junction."""
        return self.road.backward if self.at_start else self.road.forward

    @property
    def away_m(self) -> float:
        """Distance to the kerb on the right, looking outward."""
        return self.road.right_m if self.at_start else self.road.left_m

    @property
    def toward_m(self) -> float:
        """Distance to the kerb on the left, looking outward."""
        return self.road.left_m if self.at_start else self.road.right_m

    def away_lane(self, index: int) -> str:
        """Return the name of a lane that leaves, 0 nearest to the road's middle."""
        return f"{self.road.name}:{'f' if self.at_start else 'b'}{index}"

    def toward_lane(self, index: int) -> str:
        """Return the name of a lane that arrives, 0 nearest to the road's middle."""
        return f"{self.road.name}:{'b' if self.at_start else 'f'}{index}"


@dataclass
class Lane:
    """A lane or a connector."""

    name: str
    curve: Curve
    road: str
    """The road, or the junction of a connector."""
    is_connector: bool = False
    turn: str = ""
    """What a connector does: ``left``, ``right`` or ``straight``."""
    incoming: list[str] = field(default_factory=list)
    outgoing: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Crossing:
    """A pedestrian crossing over one arm of a junction."""

    junction: str
    road: str
    start: Xy
    """Middle of its edge at one kerb."""
    end: Xy
    polygon: tuple[Xy, ...]


class City:
    """All of the city's geometry."""

    def __init__(self, roads: list[Road], junctions: list[Junction], canvas: Xy) -> None:
        self.roads = {r.name: r for r in roads}
        self.junctions = {j.name: j for j in junctions}
        self.canvas = canvas
        self.arms = {j.name: self._arms_of(j) for j in junctions}
        self.reach = {
            (j.name, arm.road.name): self._reach_of(j, index)
            for j in junctions
            for index, arm in enumerate(self.arms[j.name])
        }
        self.lanes: dict[str, Lane] = {}
        for road in roads:
            self._add_lanes(road)
        for junction in junctions:
            self._add_connectors(junction)
        self.crossings = [c for j in junctions if j.crossings for c in self._crossings_of(j)]
        rings = list(self._kerb_rings())
        self.drivable_exterior = max(rings, key=signed_area)
        self.drivable_holes = [r for r in rings if r is not self.drivable_exterior]

    def _arms_of(self, junction: Junction) -> list[Arm]:
        """Return the junction's arms, counter-clockwise."""
        arms = []
        for road in self.roads.values():
            if road.start == junction.name:
                arms.append(Arm(road, road.curve.start, True))
            if road.end == junction.name:
                arms.append(Arm(road, road.curve.end.reversed(), False))
        return sorted(arms, key=lambda a: a.outward.yaw)

    def corner(self, junction: str, index: int) -> tuple[Xy | None, float]:
        """Return where the kerbs of an arm and the next one (counter-clockwise) cross, and the
        angle turned there.
        """
        arms = self.arms[junction]
        arm, after = arms[index], arms[(index + 1) % len(arms)]
        inward = arm.outward.ahead(0.0, arm.toward_m).reversed()
        outward = after.outward.ahead(0.0, -after.away_m)
        turn = wrap(outward.yaw - inward.yaw)
        if len(arms) == 1 or abs(turn) < 0.3:
            return None, 0.0
        return crossing_of(inward, outward), turn

    def _reach_of(self, junction: Junction, index: int) -> float:
        """Return how far from the centre the lanes of an arm end."""
        if junction.reach_m > 0.0 or len(self.arms[junction.name]) == 1:
            return junction.reach_m
        arm = self.arms[junction.name][index].outward
        reach = 0.0
        for which in (index, (index - 1) % len(self.arms[junction.name])):
            at, turn = self.corner(junction.name, which)
            if at is not None:
                along = (at[0] - arm.x) * math.cos(arm.yaw) + (at[1] - arm.y) * math.sin(arm.yaw)
                reach = max(reach, along + KERB_RADIUS_M * math.tan(abs(turn) / 2.0))
        return reach + CROSSING_ROOM_M

    def trimmed(self, road: Road) -> Curve:
        """Return the part of a road's reference curve between its junctions."""
        first = self.reach[(road.start, road.name)]
        return road.curve.trimmed(first, road.curve.length - self.reach[(road.end, road.name)])

    def _add_lanes(self, road: Road) -> None:
        middle = self.trimmed(road)
        for i in range(road.forward):
            curve = middle.offset(-(i + 0.5) * LANE_WIDTH_M)
            self.lanes[f"{road.name}:f{i}"] = Lane(f"{road.name}:f{i}", curve, road.name)
        for i in range(road.backward):
            curve = middle.offset((i + 0.5) * LANE_WIDTH_M).reversed()
            self.lanes[f"{road.name}:b{i}"] = Lane(f"{road.name}:b{i}", curve, road.name)

    def _add_connectors(self, junction: Junction) -> None:
        for arm in self.arms[junction.name]:
            for other in self.arms[junction.name]:
                if other.road is arm.road:
                    continue
                turn = wrap(other.outward.yaw - arm.outward.yaw - math.pi)
                kind = "straight" if abs(turn) < 0.6 else "left" if turn > 0.0 else "right"
                for i, k in self._moves(junction, arm, other, kind):
                    self._connect(junction, arm.toward_lane(i), other.away_lane(k), kind)

    def _moves(self, junction: Junction, arm: Arm, other: Arm, kind: str) -> list[tuple[int, int]]:
        """Return which lane of one arm leads to which lane of another."""
        num_in, num_out = arm.toward, other.away
        if num_in == 0 or num_out == 0:
            return []
        if kind == "left":
            double = arm.road.name in junction.double_left
            return [(i, i) for i in range(min(2, num_in, num_out) if double else 1)]
        if kind == "right":
            return [(num_in - 1, num_out - 1)]
        moves = [(i, i) for i in range(min(num_in, num_out))]
        if len(self.arms[junction.name]) == 2:
            moves += [(i, num_out - 1) for i in range(num_out, num_in)]
            moves += [(num_in - 1, k) for k in range(num_in, num_out)]
        return moves

    def _connect(self, junction: Junction, before: str, after: str, kind: str) -> None:
        name = f"{before}>{after}"
        # a right turn keeps its distance to the kerb
        largest = KERB_RADIUS_M + SHOULDER_M + LANE_WIDTH_M / 2.0 if kind == "right" else math.inf
        curve = connection(self.lanes[before].curve.end, self.lanes[after].curve.start, largest)
        self.lanes[name] = Lane(name, curve, junction.name, True, kind, [before], [after])
        self.lanes[before].outgoing.append(name)
        self.lanes[after].incoming.append(name)

    def _crossings_of(self, junction: Junction) -> Iterator[Crossing]:
        for arm in self.arms[junction.name]:
            reach = self.reach[(junction.name, arm.road.name)]
            near, far = arm.outward.ahead(reach - 4.2), arm.outward.ahead(reach - 1.2)
            middle = arm.outward.ahead(reach - 2.7)
            left, right = arm.toward_m, -arm.away_m
            yield Crossing(
                junction.name,
                arm.road.name,
                middle.ahead(0.0, right).xy,
                middle.ahead(0.0, left).xy,
                tuple(
                    p.xy
                    for p in (
                        near.ahead(0, right),
                        far.ahead(0, right),
                        far.ahead(0, left),
                        near.ahead(0, left),
                    )
                ),
            )

    def corner_curve(self, junction: str, index: int, out_m: float = 0.0) -> Curve | None:
        """Return the kerb from an arm to the next one, moved ``out_m`` away from the road; None at
        a dead end.
        """
        arms = self.arms[junction]
        if len(arms) == 1:
            return None
        arm, after = arms[index], arms[(index + 1) % len(arms)]
        first = arm.outward.ahead(self.reach[(junction, arm.road.name)], arm.toward_m + out_m)
        last = after.outward.ahead(self.reach[(junction, after.road.name)], -after.away_m - out_m)
        inward = Pose(first.x, first.y, wrap(first.yaw + math.pi))
        at, _ = self.corner(junction, index)
        if at is None:
            return filleted([first.xy, last.xy], [])
        corner = crossing_of(inward, last)
        if corner is None:
            return filleted([first.xy, last.xy], [])
        return filleted([first.xy, corner, last.xy], [KERB_RADIUS_M - out_m])

    def kerb(self, road: Road, along: bool, out_m: float = 0.0) -> Curve:
        """Return the kerb on the right of a road, driven along its curve or against it."""
        if along:
            return self.trimmed(road).offset(-road.right_m - out_m)
        return self.trimmed(road).offset(road.left_m + out_m).reversed()

    def _kerb_rings(self) -> Iterator[list[Xy]]:
        """Yield the closed kerb lines, walked with the road on the left."""
        todo = {(name, along): None for name in self.roads for along in (True, False)}
        while todo:
            (name, along), _ = next(iter(todo.items()))
            ring: list[Xy] = []
            while (name, along) in todo:
                del todo[(name, along)]
                road = self.roads[name]
                ring += self.kerb(road, along).outline()
                junction = road.end if along else road.start
                arms = self.arms[junction]
                index = next(
                    i for i, a in enumerate(arms) if a.road is road and a.at_start != along
                )
                corner = self.corner_curve(junction, index)
                ring += corner.outline()[1:-1] if corner is not None else []
                after = arms[(index + 1) % len(arms)]
                name, along = after.road.name, after.at_start
            yield ring


def signed_area(ring: list[Xy]) -> float:
    """Return the area of a ring, positive if counter-clockwise."""
    total = 0.0
    for (ax, ay), (bx, by) in zip(ring, ring[1:] + ring[:1], strict=True):
        total += ax * by - bx * ay
    return total / 2.0
