"""Who else is about in an embedded scene: traffic, cyclists, walkers, parked cars, barriers and
cones.
"""

from __future__ import annotations

import math
from itertools import pairwise

from tools.embedded_city.city import PARKING_M, SHOULDER_M, WALKWAY_M, Road
from tools.embedded_city.curves import Pose
from tools.embedded_city.paths import lanes_path, walk_path
from tools.embedded_city.scenario_builder import BUS, ScenarioBuilder
from tools.embedded_city.traffic import Actor, Kind

NEAR_M = 75.0
BICYCLE = Kind("vehicle.bicycle", 1.75, 0.6, 1.6)
BARRIER = Kind("movable_object.barrier", 0.5, 2.1, 1.0)
CONE = Kind("movable_object.trafficcone", 0.35, 0.35, 0.75)


def add_background_actors(builder: ScenarioBuilder, num_most: int, gap_m: float) -> None:
    """Add background actors near the ego's way, up to about ``num_most`` actors in all, drivers
    ``gap_m`` apart.
    """
    draw = builder.draw
    spare = num_most - len(builder.actors)
    num_parked = draw.whole(1, 4)
    for _ in range(num_parked):
        _park(builder)
    for _ in range(draw.whole(0, 2)):
        _cycle(builder)
    for _ in range(draw.whole(0, 3)):
        _stroll(builder)
    if draw.chance(0.4):
        _works(builder)
    if draw.chance(0.7):
        _bus(builder)
    for _ in range(max(spare, 0)):
        if len(builder.actors) < num_most:
            _traffic(builder, gap_m)


def _focus(builder: ScenarioBuilder) -> list[Pose]:
    """Return places along the ego's way."""
    ego = builder.actors[0]
    assert ego.path is not None
    return [ego.path.at(ego.along_m + d) for d in (0.0, 30.0, 60.0, 90.0)]


def _is_near(builder: ScenarioBuilder, place: Pose) -> bool:
    return any(math.dist(place.xy, p.xy) < NEAR_M for p in _focus(builder))


def _traffic(builder: ScenarioBuilder, gap_m: float) -> None:
    """Add a driver on some lane near the ego's way."""
    draw = builder.draw
    lanes = [lane for lane in builder.city.lanes.values() if not lane.is_connector]
    for _ in range(60):
        lane = draw.pick(lanes)
        along = draw.between(4.0, max(lane.curve.length - 12.0, 5.0))
        place = lane.curve.at(along)
        if _is_near(builder, place) and builder.is_free(place, gap_m):
            way = builder.wander(lane.name, 200.0)
            builder.drive(
                draw.car(), way, lanes_path(builder.city, way), along, draw.between(7.0, 10.5)
            )
            return


def _bus(builder: ScenarioBuilder) -> None:
    """Add a bus that keeps to an avenue."""
    draw = builder.draw
    names = [
        lane.name
        for lane in builder.city.lanes.values()
        if lane.road.startswith(("avenue", "parade")) and lane.name.endswith("1")
    ]
    for _ in range(60):
        lane = builder.city.lanes[draw.pick(names)]
        along = draw.between(8.0, max(lane.curve.length - 20.0, 9.0))
        place = lane.curve.at(along)
        way = builder.way([lane.name], 0.0, 200.0)
        turns = [builder.city.lanes.get(f"{a}>{b}") for a, b in pairwise(way)]
        straight = all(t is None or t.turn == "straight" for t in turns)
        if straight and _is_near(builder, place) and builder.is_free(place, 18.0):
            builder.drive(BUS, way, lanes_path(builder.city, way), along, draw.between(6.5, 8.5))
            return


def _sides(builder: ScenarioBuilder) -> list[tuple[Road, bool]]:
    """Return roads and sides (True: right of the curve) with room to park near the ego's way."""
    return [
        (road, right)
        for road in builder.city.roads.values()
        for right in (True, False)
        if (road.parking_right if right else road.parking_left)
    ]


def _park(builder: ScenarioBuilder) -> None:
    """Add a parked car at a kerb."""
    draw = builder.draw
    for _ in range(30):
        road, right = draw.pick(_sides(builder))
        kerb = builder.city.kerb(road, right, -PARKING_M / 2.0)
        place = kerb.at(draw.between(14.0, kerb.length - 14.0))
        if _is_near(builder, place) and builder.is_free(place, 7.0):
            kind = draw.car()
            if kind.category == "vehicle.car":
                builder.stand(kind, place, parked=True)
                return


def _cycle(builder: ScenarioBuilder) -> None:
    """Add a cyclist beside the lane of a street with room at the kerb."""
    draw = builder.draw
    for _ in range(20):
        road, right = draw.pick(_sides(builder))
        lane = builder.city.lanes[f"{road.name}:{'f' if right else 'b'}0"]
        path = lanes_path(builder.city, [lane.name], right_m=2.45)
        along = draw.between(2.0, path.length * 0.6)
        place = path.at(along)
        if _is_near(builder, place) and builder.is_free(place, 9.0):
            builder.drive(BICYCLE, [lane.name], path, along, draw.between(3.2, 5.0)).rank = 9
            return


def _stroll(builder: ScenarioBuilder) -> None:
    """Add a pedestrian who walks along a walkway."""
    draw = builder.draw
    for _ in range(10):
        road = draw.pick(list(builder.city.roads.values()))
        kerb = builder.city.kerb(road, draw.chance(0.5), WALKWAY_M * draw.between(0.35, 0.7))
        along = draw.between(0.0, kerb.length * 0.6)
        if _is_near(builder, kerb.at(along)) and builder.is_free(kerb.at(along), 3.0):
            poses = [p.xy for p in kerb.trimmed(along, kerb.length).sampled(2.0)]
            if len(poses) < 10:
                continue
            path = walk_path(poses if draw.chance(0.5) else poses[::-1])
            speed = draw.between(1.0, 1.6)
            actor = Actor(draw.walker(), path, speed_mps=speed, wanted_mps=speed, rank=-1)
            actor.arrives_m = path.length - 1.5
            builder.actors.append(actor)
            return


def _works(builder: ScenarioBuilder) -> None:
    """Add barriers and cones round a work site at a kerb."""
    draw = builder.draw
    for _ in range(30):
        road, right = draw.pick(_sides(builder))
        kerb = builder.city.kerb(road, right, -PARKING_M / 2.0 - SHOULDER_M / 2.0)
        along = draw.between(16.0, kerb.length - 24.0)
        places = [kerb.at(along + d) for d in (0.0, 3.0, 6.0, 9.0)]
        if _is_near(builder, places[0]) and all(builder.is_free(p, 6.0) for p in places):
            builder.stand(BARRIER, places[0].ahead(0.0, -0.1))
            builder.stand(BARRIER, places[3].ahead(0.0, -0.1))
            for place in places[1:3]:
                builder.stand(CONE, place.ahead(0.0, 0.7))
            return
