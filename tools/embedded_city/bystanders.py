"""Who else is about in an embedded scene: traffic, cyclists, walkers, parked cars, barriers and
cones.
"""

from __future__ import annotations

import math
from itertools import pairwise

from tools.embedded_city.city import PARKING_M, SHOULDER_M, WALKWAY_M, Road
from tools.embedded_city.curves import Pose
from tools.embedded_city.paths import lanes_path, walk_path
from tools.embedded_city.stage import BUS, Stage
from tools.embedded_city.traffic import Actor, Kind

NEAR_M = 75.0
BICYCLE = Kind("vehicle.bicycle", 1.75, 0.6, 1.6)
BARRIER = Kind("movable_object.barrier", 0.5, 2.1, 1.0)
CONE = Kind("movable_object.trafficcone", 0.35, 0.35, 0.75)


def add_bystanders(stage: Stage, num_most: int) -> None:
    """Add bystanders near the ego's way until the stage holds about ``num_most`` actors."""
    draw = stage.draw
    spare = num_most - len(stage.actors)
    num_parked = draw.whole(1, 4)
    for _ in range(num_parked):
        _park(stage)
    for _ in range(draw.whole(0, 2)):
        _cycle(stage)
    for _ in range(draw.whole(0, 3)):
        _stroll(stage)
    if draw.chance(0.4):
        _works(stage)
    if draw.chance(0.7):
        _bus(stage)
    for _ in range(max(spare, 0)):
        if len(stage.actors) < num_most:
            _traffic(stage)


def _focus(stage: Stage) -> list[Pose]:
    """Return places along the ego's way."""
    ego = stage.actors[0]
    assert ego.path is not None
    return [ego.path.at(ego.along_m + d) for d in (0.0, 30.0, 60.0, 90.0)]


def _is_near(stage: Stage, place: Pose) -> bool:
    return any(math.dist(place.xy, p.xy) < NEAR_M for p in _focus(stage))


def _traffic(stage: Stage) -> None:
    """Add a driver on some lane near the ego's way."""
    draw = stage.draw
    lanes = [lane for lane in stage.city.lanes.values() if not lane.is_connector]
    for _ in range(60):
        lane = draw.pick(lanes)
        along = draw.between(4.0, max(lane.curve.length - 12.0, 5.0))
        place = lane.curve.at(along)
        if _is_near(stage, place) and stage.is_free(place, 13.0):
            way = stage.wander(lane.name, 200.0)
            stage.drive(
                draw.car(), way, lanes_path(stage.city, way), along, draw.between(7.0, 10.5)
            )
            return


def _bus(stage: Stage) -> None:
    """Add a bus that keeps to an avenue."""
    draw = stage.draw
    names = [
        lane.name
        for lane in stage.city.lanes.values()
        if lane.road.startswith(("avenue", "parade")) and lane.name.endswith("1")
    ]
    for _ in range(60):
        lane = stage.city.lanes[draw.pick(names)]
        along = draw.between(8.0, max(lane.curve.length - 20.0, 9.0))
        place = lane.curve.at(along)
        way = stage.way([lane.name], 0.0, 200.0)
        turns = [stage.city.lanes.get(f"{a}>{b}") for a, b in pairwise(way)]
        straight = all(t is None or t.turn == "straight" for t in turns)
        if straight and _is_near(stage, place) and stage.is_free(place, 18.0):
            stage.drive(BUS, way, lanes_path(stage.city, way), along, draw.between(6.5, 8.5))
            return


def _sides(stage: Stage) -> list[tuple[Road, bool]]:
    """Return roads and sides (True: right of the curve) with room to park near the ego's way."""
    return [
        (road, right)
        for road in stage.city.roads.values()
        for right in (True, False)
        if (road.parking_right if right else road.parking_left)
    ]


def _park(stage: Stage) -> None:
    """Add a parked car at a kerb."""
    draw = stage.draw
    for _ in range(30):
        road, right = draw.pick(_sides(stage))
        kerb = stage.city.kerb(road, right, -PARKING_M / 2.0)
        place = kerb.at(draw.between(14.0, kerb.length - 14.0))
        if _is_near(stage, place) and stage.is_free(place, 7.0):
            kind = draw.car()
            if kind.category == "vehicle.car":
                stage.stand(kind, place, parked=True)
                return


def _cycle(stage: Stage) -> None:
    """Add a cyclist beside the lane of a street with room at the kerb."""
    draw = stage.draw
    for _ in range(20):
        road, right = draw.pick(_sides(stage))
        lane = stage.city.lanes[f"{road.name}:{'f' if right else 'b'}0"]
        path = lanes_path(stage.city, [lane.name], right_m=2.45)
        along = draw.between(2.0, path.length * 0.6)
        place = path.at(along)
        if _is_near(stage, place) and stage.is_free(place, 9.0):
            stage.drive(BICYCLE, [lane.name], path, along, draw.between(3.2, 5.0)).rank = 9
            return


def _stroll(stage: Stage) -> None:
    """Add a pedestrian who walks along a walkway."""
    draw = stage.draw
    for _ in range(10):
        road = draw.pick(list(stage.city.roads.values()))
        kerb = stage.city.kerb(road, draw.chance(0.5), WALKWAY_M * draw.between(0.35, 0.7))
        along = draw.between(0.0, kerb.length * 0.6)
        if _is_near(stage, kerb.at(along)) and stage.is_free(kerb.at(along), 3.0):
            poses = [p.xy for p in kerb.trimmed(along, kerb.length).sampled(2.0)]
            if len(poses) < 10:
                continue
            path = walk_path(poses if draw.chance(0.5) else poses[::-1])
            speed = draw.between(1.0, 1.6)
            actor = Actor(draw.walker(), path, speed_mps=speed, wanted_mps=speed, rank=-1)
            actor.arrives_m = path.length - 1.5
            stage.actors.append(actor)
            return


def _works(stage: Stage) -> None:
    """Add barriers and cones round a work site at a kerb."""
    draw = stage.draw
    for _ in range(30):
        road, right = draw.pick(_sides(stage))
        kerb = stage.city.kerb(road, right, -PARKING_M / 2.0 - SHOULDER_M / 2.0)
        along = draw.between(16.0, kerb.length - 24.0)
        places = [kerb.at(along + d) for d in (0.0, 3.0, 6.0, 9.0)]
        if _is_near(stage, places[0]) and all(stage.is_free(p, 6.0) for p in places):
            stage.stand(BARRIER, places[0].ahead(0.0, -0.1))
            stage.stand(BARRIER, places[3].ahead(0.0, -0.1))
            for place in places[1:3]:
                stage.stand(CONE, place.ahead(0.0, 0.7))
            return
