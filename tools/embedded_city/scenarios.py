"""The kinds of scene of the embedded set: who is on the builder, and what makes it one of its kind.

Each function puts the ego first and then the others that the kind is about;
:func:`tools.embedded_city.scenes` adds background actors. Numbers are sampled for each scene.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tools.embedded_city.paths import lanes_path
from tools.embedded_city.scenario_builder import EGO_KIND, FOREVER_S, ScenarioBuilder
from tools.embedded_city.traffic import Braking

Lanes = tuple[str, ...]


def _lanes(text: str) -> list[Lanes]:
    """Return pairs of lanes, each written ``from>to``."""
    return [tuple(pair.split(">")) for pair in text.split()]


def _oncoming(builder: ScenarioBuilder, approach: str) -> Lanes:
    """Return the lane opposite to an approach and the one straight on from it."""
    city = builder.city
    junction = next(c.road for c in map(city.lanes.__getitem__, city.lanes[approach].outgoing))
    straight = [c for c in city.lanes.values() if c.road == junction and c.turn == "straight"]
    ahead = next(c for c in straight if c.incoming == [approach]).outgoing[0].split(":")[0]
    lanes = [
        (c.incoming[0], c.outgoing[0]) for c in straight if c.incoming[0].startswith(ahead + ":")
    ]
    return builder.draw.pick(lanes)


LEFT_TURNS = _lanes("""
    avenue-1:f0>ring-northwest:b0 avenue-2:b0>ring-southwest:f0 avenue-3:f0>parade-north:f0
    avenue-4:b0>parade-south:b0 parade-south:f0>avenue-3:b0 parade-north:b0>avenue-4:f0
    avenue-5:f0>ring-northeast:f0 parade-north:f0>ring-north:f0 ring-southwest:f0>parade-south:f0
    ring-south:f0>stem-east:f0 avenue-2:f0>stem-west:b0 avenue-5:b0>stem-east:b0
""")


def left_turn(builder: ScenarioBuilder) -> None:
    """Let the ego turn left through oncoming traffic, at times behind another who does."""
    draw = builder.draw
    lanes = draw.pick(LEFT_TURNS)
    junction = builder.city.lanes["{}>{}".format(*lanes)].road
    if junction in builder.green:
        builder.green[junction] = (lanes[0].split(":")[0], FOREVER_S)
    speed, before = draw.between(7.5, 10.0), draw.between(48.0, 66.0)
    builder.through(lanes, before, speed, kind=EGO_KIND)
    if draw.chance(0.75):
        builder.through(lanes, before - draw.between(15.0, 19.0), speed)
    arrival = before / speed - draw.between(0.5, 1.5)
    for _ in range(draw.whole(1, 3)):
        oncoming = draw.between(8.0, 10.5)
        builder.through(_oncoming(builder, lanes[0]), arrival * oncoming, oncoming)
        arrival += draw.between(1.7, 2.6)


TEES = [
    (lanes, main)
    for lanes, *main in map(
        _lanes,
        """
    stem-west:f0>avenue-3:f0 avenue-2:f0>avenue-3:f0 avenue-3:b0>avenue-2:b0 avenue-3:b1>avenue-2:b1
    stem-west:f1>avenue-2:b1 avenue-3:b1>avenue-2:b1 avenue-2:f1>avenue-3:f1
    stem-west:b0>ring-northwest:f0 ring-north:f0>ring-northwest:f0 ring-northwest:b0>ring-north:b0
    stem-west:b0>ring-north:b0 ring-north:f0>ring-northwest:f0 ring-northwest:b0>ring-north:b0
    stem-east:b0>ring-southeast:f0 ring-south:f0>ring-southeast:f0 ring-southeast:b0>ring-south:b0
    stem-east:b0>ring-south:b0 ring-south:f0>ring-southeast:f0 ring-southeast:b0>ring-south:b0
    parade-south:b0>ring-south:f0 ring-southwest:f0>ring-south:f0 ring-south:b0>ring-southwest:b0
    """.strip().splitlines(),
    )
]
"""From a stem, and others on the main road."""


def tee_crossing(builder: ScenarioBuilder) -> None:
    """Let the ego join or cross the main road from the stem of a T-junction."""
    draw = builder.draw
    lanes, main = draw.pick(TEES)
    speed, before = draw.between(7.0, 9.5), draw.between(45.0, 62.0)
    builder.through(lanes, before, speed, kind=EGO_KIND)
    arrival = before / speed - draw.between(0.0, 1.5)
    for i in range(draw.whole(3, 5)):
        cross = draw.between(8.0, 10.5)
        builder.through(main[i % len(main)], arrival * cross, cross)
        arrival += draw.between(0.8, 1.7)


CUT_IN_ROADS = ["parade-south:f", "parade-south:b", "parade-north:f", "parade-north:b"]


def cut_in(builder: ScenarioBuilder) -> None:
    """Let a neighbour change into the ego's lane, close ahead, and slow down."""
    draw = builder.draw
    road, own = draw.pick(CUT_IN_ROADS), draw.whole(0, 1)
    mine, other = f"{road}{own}", f"{road}{1 - own}"
    speed = draw.between(9.5, 12.0)
    length = builder.city.lanes[mine].curve.length
    before = length - draw.between(8.0, 14.0)
    builder.through((mine,), before, speed, kind=EGO_KIND)
    start = length - before + draw.between(10.0, 13.0)
    at = start + speed * draw.between(2.6, 4.0)
    way = [other, *builder.way([mine], 0.0, 190.0)]
    path = lanes_path(builder.city, way, changes={other: (at, draw.between(18.0, 24.0))})
    cutter = builder.drive(draw.car(), way, path, start, speed)
    cutter.cuts_in = True
    cutter.slower = (draw.between(4.5, 6.0), speed * draw.between(0.3, 0.5))
    if draw.chance(0.6):
        builder.through((mine,), before - draw.between(42.0, 50.0), speed * 0.95)


BRAKING_LANES = """
    parade-south:f0 parade-south:f1 parade-north:b0 parade-north:b1 parade-north:f1
    ring-southwest:f0 ring-southwest:b0 ring-northeast:f0 ring-northwest:f0 ring-southeast:b0
    stem-west:f0 stem-east:b0
""".split()


def hard_brake(builder: ScenarioBuilder) -> None:
    """Let the driver ahead of the ego stop as hard as it can, stand for a while and go on."""
    draw = builder.draw
    lane = draw.pick(BRAKING_LANES)
    speed = draw.between(9.0, 12.0)
    before = builder.city.lanes[lane].curve.length - draw.between(8.0, 25.0)
    builder.through((lane,), before, speed, kind=EGO_KIND)
    gap = draw.between(19.0, 25.0)
    leader = builder.through((lane,), before - gap, speed)
    leader.braking = Braking(draw.between(3.3, 5.5), draw.between(2.0, 4.0), draw.between(4.5, 6.0))
    if draw.chance(0.5):
        builder.through((lane,), before + draw.between(22.0, 26.0), speed)


QUEUES = """
    avenue-3:f0 avenue-3:f1 avenue-4:b0 avenue-4:b1 parade-south:f0 parade-south:f1
    parade-north:b0 parade-north:b1 avenue-5:f0 avenue-5:f1 avenue-6:b0 ring-northeast:b0
""".split()


def queue(builder: ScenarioBuilder) -> None:
    """Let the ego arrive at the tail of a queue at a red light that turns green later on."""
    draw = builder.draw
    lane = draw.pick(QUEUES)
    road = lane.split(":")[0]
    junction = builder.city.lanes[builder.city.lanes[lane].outgoing[0]].road
    arms = [a.road.name for a in builder.city.arms[junction]]
    builder.green[junction] = (arms[(arms.index(road) + 1) % len(arms)], draw.between(6.0, 9.0))
    speed = draw.between(8.5, 11.0)
    builder.through((lane,), draw.between(62.0, 80.0), speed, kind=EGO_KIND)
    for name in (lane, lane[:-1] + ("1" if lane.endswith("0") else "0")):
        if name not in builder.city.lanes:
            continue
        back = 4.5
        for _ in range(draw.whole(2, 3)):
            kind = draw.car()
            waiting = builder.through((name,), back + kind.length / 2.0, 0.0, kind=kind)
            waiting.wanted_mps = draw.between(8.5, 10.5)
            back += kind.length + draw.between(2.0, 2.8)


DOUBLE_LEFTS: list[tuple[str, str, list[Lanes]]] = [
    ("stem-west:f", "avenue-3:f", [("avenue-3:b0", "avenue-2:b0"), ("avenue-2:f0", "avenue-3:f0")]),
    ("stem-east:f", "avenue-4:b", [("avenue-4:f0", "avenue-5:f0"), ("avenue-5:b1", "avenue-4:b1")]),
]


def double_left(builder: ScenarioBuilder) -> None:
    """Let the ego and a neighbour turn left side by side from two left-turn lanes."""
    draw = builder.draw
    stem, target, main = draw.pick(DOUBLE_LEFTS)
    own = draw.whole(0, 1)
    speed, before = draw.between(7.0, 9.0), draw.between(42.0, 58.0)
    builder.through((f"{stem}{own}", f"{target}{own}"), before, speed, kind=EGO_KIND)
    beside = 1 - own
    builder.through(
        (f"{stem}{beside}", f"{target}{beside}"), before + draw.between(-6.0, 7.0), speed
    )
    builder.through(
        (f"{stem}{beside}", f"{target}{beside}"), before + draw.between(16.0, 24.0), speed
    )
    arrival = before / speed - draw.between(0.0, 1.5)
    for lanes in main[: draw.whole(1, 2)]:
        builder.through(lanes, arrival * 9.0, draw.between(8.0, 9.5))
        arrival += draw.between(0.5, 1.5)


MERGES = _lanes("avenue-6:f>exit-east:f0 avenue-1:b>entry-west:b0 parade-top:f>exit-north:f0")


def merge_in(builder: ScenarioBuilder) -> None:
    """Let the ego merge from a lane that ends into one that others drive on."""
    draw = builder.draw
    road, after = draw.pick(MERGES)
    speed = draw.between(7.5, 9.0)
    before = draw.between(48.0, 66.0)
    ego = builder.through((f"{road}1", after), before, speed, kind=EGO_KIND)
    ego.rank = 9
    place = before + draw.between(-14.0, -6.0)
    for _ in range(draw.whole(2, 4)):
        other = builder.through((f"{road}0", after), place, speed * draw.between(0.95, 1.05))
        other.rank = 0
        place += draw.between(13.0, 24.0)
    if draw.chance(0.5):
        builder.through((f"{road}1", after), before - draw.between(16.0, 22.0), speed).rank = 8


CURVES: list[tuple[str, float]] = [
    ("ring-southwest:f0", 8.0),
    ("ring-southwest:b0", 50.0),
    ("ring-northeast:f0", 20.0),
    ("ring-northeast:b0", 20.0),
    ("ring-northwest:f0", 30.0),
    ("ring-northwest:b0", 15.0),
    ("ring-southeast:f0", 15.0),
    ("ring-southeast:b0", 8.0),
    ("stem-west:f0", 8.0),
    ("stem-east:b0", 8.0),
]


def free_curve(builder: ScenarioBuilder) -> None:
    """Let the ego follow a winding road by itself, with traffic the other way."""
    draw = builder.draw
    lane, start = draw.pick(CURVES)
    speed = draw.between(8.5, 11.5)
    before = builder.city.lanes[lane].curve.length - start - draw.between(0.0, 15.0)
    builder.through((lane,), before, speed, kind=EGO_KIND)
    back = lane.split(":")[0] + (":b0" if ":f" in lane else ":f0")
    length = builder.city.lanes[back].curve.length
    for _ in range(draw.whole(2, 3)):
        builder.through((back,), length * draw.between(0.2, 0.95), draw.between(8.0, 10.5))


WALKED = _lanes("""
    avenue-1:f1>avenue-2:f1 avenue-2:b1>avenue-1:b1 avenue-2:b0>avenue-1:b0
    ring-southwest:b0>ring-northwest:b0 ring-northwest:f0>ring-southwest:f0
    ring-southwest:f0>ring-south:f0 ring-south:f0>ring-southeast:f0
    ring-southeast:b0>ring-south:b0 parade-north:f1>parade-top:f1 ring-north:b0>ring-northeast:b0
    ring-northeast:f0>ring-north:f0
""")


def pedestrians(builder: ScenarioBuilder) -> None:
    """Let pedestrians walk over a crossing that the ego comes to."""
    draw = builder.draw
    lanes = draw.pick(WALKED)
    speed = draw.between(7.5, 10.0)
    room = builder.city.lanes[lanes[0]].curve.length - 6.0
    before = min(draw.between(48.0, 68.0), room)
    builder.through(lanes, before, speed, kind=EGO_KIND)
    connector = builder.city.lanes[f"{lanes[0]}>{lanes[1]}"]
    road = lanes[0].split(":")[0]
    crossing = next(
        c for c in builder.city.crossings if (c.junction, c.road) == (connector.road, road)
    )
    meets = before / speed
    back = draw.chance(0.5)
    for _ in range(draw.whole(2, 4)):
        pace = draw.between(1.1, 1.6)
        departs = meets + draw.between(-4.2, -1.8)
        builder.walk_over(crossing, departs, pace, back=back if draw.chance(0.7) else not back)
    others = [
        c for c in builder.city.crossings if c.junction == connector.road and c is not crossing
    ]
    for _ in range(draw.whole(1, 2)):
        builder.walk_over(
            draw.pick(others), meets + draw.between(-3.0, 3.0), draw.between(1.1, 1.5)
        )


@dataclass(frozen=True)
class ScenarioKind:
    """A kind of scene and how many the set has."""

    name: str
    description: str
    build: Callable[[ScenarioBuilder], None]
    train: int
    val: int
    hardest_mps2: float = 4.2
    """The hardest braking of the ego between key frames that such a scene may show."""


KINDS = (
    ScenarioKind("left-turn", "unprotected left turn through oncoming traffic", left_turn, 4, 2),
    ScenarioKind("tee-crossing", "cross traffic at a T-junction", tee_crossing, 4, 1),
    ScenarioKind("cut-in", "a neighbour cuts in and slows down", cut_in, 3, 2, 6.0),
    ScenarioKind("hard-brake", "the driver ahead brakes to a stop", hard_brake, 3, 2, 6.0),
    ScenarioKind("queue", "a queue at a red light before an intersection", queue, 3, 1),
    ScenarioKind("double-left", "adjacent left-turn lanes", double_left, 3, 1),
    ScenarioKind("merge-in", "a lane ends and merges into another", merge_in, 3, 1),
    ScenarioKind("free-curve", "a free road with curves", free_curve, 3, 1),
    ScenarioKind("pedestrians", "pedestrians on a crossing", pedestrians, 3, 1, 6.0),
)
