"""The builder of one embedded scene: what scenarios place their actors on."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from itertools import pairwise
from typing import TypeVar

from tools.embedded_city.city import City, Crossing
from tools.embedded_city.curves import Pose
from tools.embedded_city.paths import Path, lanes_path, walk_path
from tools.embedded_city.traffic import Actor, Kind

T = TypeVar("T")

EGO_KIND = Kind("vehicle.car", 4.084, 1.73, 1.562)
BUS = Kind("vehicle.bus.rigid", 10.8, 2.7, 3.2)
ALL_RED_S = 2.0
YIELD_MPS = 3.5
"""Speed at the end of a stem, where the main road has the right of way."""
FOREVER_S = 1e3


class Draw:
    """Random numbers from one seed; uses only ``random()``, whose sequence Python guarantees."""

    def __init__(self, seed: str) -> None:
        self._random = random.Random(seed)

    def between(self, low: float, high: float) -> float:
        """Return a number in [low, high)."""
        return low + (high - low) * self._random.random()

    def whole(self, low: int, high: int) -> int:
        """Return a whole number from low to high, both included."""
        return low + int((high - low + 1) * self._random.random())

    def chance(self, probability: float) -> bool:
        """Return True with a probability."""
        return self._random.random() < probability

    def pick(self, items: Sequence[T]) -> T:
        """Return one of the items."""
        return items[int(len(items) * self._random.random())]

    def car(self) -> Kind:
        """Return a car, now and then a van, truck or motorcycle."""
        which = self._random.random()
        if which < 0.08:
            return Kind("vehicle.truck", round(self.between(5.8, 7.0), 3), 2.3, 2.8)
        if which < 0.16:
            return Kind("vehicle.motorcycle", 2.1, 0.8, 1.5)
        if which < 0.18:
            return Kind("vehicle.construction", 5.9, 2.3, 2.9)
        length = self.between(4.0, 5.1)
        width, height = 1.35 + 0.115 * length, self.between(1.45, 1.85)
        return Kind("vehicle.car", round(length, 3), round(width, 3), round(height, 3))

    def walker(self) -> Kind:
        """Return a pedestrian."""
        if self.chance(0.12):
            return Kind("human.pedestrian.child", 0.5, 0.5, round(self.between(1.1, 1.4), 3))
        return Kind("human.pedestrian.adult", 0.7, 0.65, round(self.between(1.6, 1.9), 3))


class ScenarioBuilder:
    """Actors of a scene under construction; the ego comes first."""

    def __init__(self, city: City, draw: Draw) -> None:
        self.city = city
        self.draw = draw
        self.actors: list[Actor] = []
        self.green: dict[str, tuple[str, float]] = {}
        """For a signalled junction: a road whose axis has green first, and until when (s)."""
        for junction in city.junctions.values():
            if junction.signals:
                axis = city.arms[junction.name][draw.whole(0, 1)].road.name
                until = draw.pick([FOREVER_S, draw.between(4.0, 15.0)])
                self.green[junction.name] = (axis, until)

    # --- ways ------------------------------------------------------------------------------------
    # -----------

    def way(self, lanes: Sequence[str], before_m: float, after_m: float) -> list[str]:
        """Return lanes, with what leads there and on from there, straight on where possible."""
        out = list(lanes)
        while before_m > 0.0 and (connectors := self.city.lanes[out[0]].incoming):
            out.insert(0, self.city.lanes[self._straightest(connectors)].incoming[0])
            before_m -= self.city.lanes[out[0]].curve.length
        while after_m > 0.0 and (connectors := self.city.lanes[out[-1]].outgoing):
            out.append(self.city.lanes[self._straightest(connectors)].outgoing[0])
            after_m -= self.city.lanes[out[-1]].curve.length
        return out

    def _straightest(self, connectors: Sequence[str]) -> str:
        order = {"straight": 0, "right": 1, "left": 2}
        return min(connectors, key=lambda c: order[self.city.lanes[c].turn])

    def wander(self, lane: str, after_m: float) -> list[str]:
        """Return lanes from one on, turning at random."""
        out = [lane]
        while after_m > 0.0 and (connectors := self.city.lanes[out[-1]].outgoing):
            out.append(self.city.lanes[self.draw.pick(connectors)].outgoing[0])
            after_m -= self.city.lanes[out[-1]].curve.length
        return out

    def rank(self, lanes: Sequence[str]) -> int:
        """Return who goes first: avenues before the ring before the stems, straight on before
        turns.
        """
        road = lanes[0].split(":")[0]
        level = 6 if road.startswith("stem") else 3 if road.startswith("ring") else 0
        turns = {
            self.city.lanes[f"{a}>{b}"].turn
            for a, b in pairwise(lanes)
            if f"{a}>{b}" in self.city.lanes
        }
        return level + (2 if "left" in turns else 1 if "right" in turns else 0)

    # --- actors
    # ---------------------------------------------------------------------------------------------

    def drive(
        self, kind: Kind, lanes: Sequence[str], path: Path, along_m: float, speed_mps: float
    ) -> Actor:
        """Add a driver who wants to keep its first speed."""
        actor = Actor(
            kind,
            path,
            along_m=along_m,
            speed_mps=speed_mps,
            wanted_mps=speed_mps,
            rank=self.rank(lanes),
        )
        actor.red_lights = self._red_lights(lanes, path)
        for before, after in pairwise(lanes):
            if before.startswith("stem") and f"{before}>{after}" in self.city.lanes:
                at = nearest(path, self.city.lanes[before].curve.end)
                path.slow_to(at, YIELD_MPS)
        self.actors.append(actor)
        return actor

    def through(
        self,
        lanes: Sequence[str],
        before_m: float,
        speed_mps: float,
        *,
        kind: Kind | None = None,
        after_m: float = 190.0,
    ) -> Actor:
        """Add a driver who is ``before_m`` ahead of the end of the first of ``lanes`` and goes on
        along them.
        """
        length = self.city.lanes[lanes[0]].curve.length
        way = self.way(lanes, before_m - length + 8.0, after_m)
        path = lanes_path(self.city, way)
        end = self.city.lanes[lanes[0]].curve.end
        at = nearest(path, end)
        return self.drive(kind or self.draw.car(), way, path, max(at - before_m, 6.0), speed_mps)

    def _red_lights(
        self, lanes: Sequence[str], path: Path
    ) -> tuple[tuple[float, float, float], ...]:
        out = []
        for before, after in pairwise(lanes):
            connector = self.city.lanes.get(f"{before}>{after}")
            if connector is None or connector.road not in self.green:
                continue
            axis, until = self.green[connector.road]
            arms = [a.road.name for a in self.city.arms[connector.road]]
            same = (arms.index(axis) - arms.index(before.split(":")[0])) % 2 == 0
            at = nearest(path, connector.curve.start)
            red = (until, FOREVER_S) if same else (-FOREVER_S, until + ALL_RED_S)
            out.append((at, *red))
        return tuple(out)

    def walk_over(
        self, crossing: Crossing, departs_s: float, speed_mps: float, *, back: bool = False
    ) -> Actor:
        """Add a pedestrian who waits beside a crossing, then goes over it and stays there."""
        a, b = (crossing.end, crossing.start) if back else (crossing.start, crossing.end)
        yaw = math.atan2(b[1] - a[1], b[0] - a[0])
        aside = self.draw.between(-1.2, 1.2)
        first = Pose(*a, yaw).ahead(-1.2, aside)
        last = Pose(*b, yaw).ahead(2.0, aside)
        path = walk_path([first.xy, last.ahead(3.0).xy])
        actor = Actor(self.draw.walker(), path, wanted_mps=speed_mps, rank=-1, departs_s=departs_s)
        actor.arrives_m = math.dist(first.xy, last.xy)
        self.actors.append(actor)
        return actor

    def stand(self, kind: Kind, place: Pose, *, parked: bool = False) -> Actor:
        """Add what never moves."""
        actor = Actor(kind, None, place, is_parked=parked)
        self.actors.append(actor)
        return actor

    def is_free(self, place: Pose, room_m: float) -> bool:
        """Return whether no actor starts within a distance."""
        starts = (a.place or (a.path.at(a.along_m) if a.path else None) for a in self.actors)
        return all(p is None or math.dist(p.xy, place.xy) >= room_m for p in starts)


def nearest(path: Path, place: Pose) -> float:
    """Return the distance along a path of its point nearest to a place."""
    away = (path.x - place.x) ** 2 + (path.y - place.y) ** 2
    return float(path.s[int(away.argmin())])
