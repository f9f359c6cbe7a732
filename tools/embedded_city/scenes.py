"""The scenes of the embedded set: each is staged, simulated and checked, and drawn again until it
passes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

from tools.embedded_city.background_actors import add_background_actors
from tools.embedded_city.checks import (
    KEY_FRAME_S,
    DrivableArea,
    Track,
    constant_velocity_end,
    first_off_road,
    first_overlap,
)
from tools.embedded_city.city import City
from tools.embedded_city.curves import Pose
from tools.embedded_city.scenario_builder import Draw, ScenarioBuilder
from tools.embedded_city.scenarios import KINDS, ScenarioKind
from tools.embedded_city.traffic import DT_S, Actor, Simulation

MOST_ACTORS = 20
GAP_M = 13.0
"""Room that a driver of the background finds at its start."""
DURATION_S = 18.0
SEEN_M = 80.0
"""Actors are annotated from when they first come this near to the ego until they last were."""
ROOM_M = 0.3
"""Boxes keep at least about this distance."""
NUM_TRIES = 400
FIRST_DRAWS = """
    left-turn-00:2 left-turn-01:2 left-turn-03:2 left-turn-05:5 tee-crossing-00:4
    tee-crossing-01:3 tee-crossing-02:4 cut-in-00:3 cut-in-01:3 cut-in-03:1 cut-in-04:4 queue-00:1
    queue-01:1 double-left-00:1 merge-in-00:4 merge-in-01:2 merge-in-03:8 pedestrians-00:23
    pedestrians-01:16 pedestrians-02:12 pedestrians-03:21
"""
"""Draws that pass, of the shipped set; those before are known to fail: to skip them saves time."""


@dataclass(frozen=True)
class Recipe:
    """What makes a set: its seed, the draws that pass, and its number of scenes."""

    seed: str
    first_draws: Mapping[str, int]
    num_scenes: int | None = None
    """Scenes of a split ``city``, spread over the kinds; by default ``train`` and ``val`` of each
    kind."""


SHIPPED = Recipe(
    "ccdiff-town-1",
    {name: int(draw) for name, _, draw in (part.partition(":") for part in FIRST_DRAWS.split())},
)
CITY = Recipe("ccdiff-city-1", {}, 200)


@dataclass(frozen=True)
class LoggedScene:
    """A finished scene; the first track is the ego."""

    name: str
    split: str
    kind: ScenarioKind
    tracks: list[Track]


def build_scenes(city: City, recipe: Recipe = SHIPPED) -> Iterator[LoggedScene]:
    """Yield all scenes of the set."""
    area = DrivableArea(city)
    for name, split, kind in _listed(recipe.num_scenes):
        yield LoggedScene(name, split, kind, _tracks(city, area, kind, name, recipe))


def _listed(num_scenes: int | None) -> Iterator[tuple[str, str, ScenarioKind]]:
    """Yield name, split and kind of all scenes."""
    for i, kind in enumerate(KINDS):
        if num_scenes is None:
            for number in range(kind.train + kind.val):
                split = "train" if number < kind.train else "val"
                yield f"{kind.name}-{number:02d}", split, kind
        else:
            for number in range(len(range(i, num_scenes, len(KINDS)))):
                yield f"{kind.name}-{number:03d}", "city", kind


def _tracks(
    city: City, area: DrivableArea, kind: ScenarioKind, name: str, recipe: Recipe
) -> list[Track]:
    """Return the tracks of the first draw that passes all checks."""
    for number in range(recipe.first_draws.get(name, 0), NUM_TRIES):
        draw = Draw(f"{recipe.seed}/{name}/{number}")
        builder = ScenarioBuilder(city, draw)
        kind.build(builder)
        if any(not _is_apart(builder, i) for i in range(len(builder.actors))):
            continue
        add_background_actors(builder, draw.whole(MOST_ACTORS - 7, MOST_ACTORS), GAP_M)
        Simulation(builder.actors).run(DURATION_S)
        if not fault(tracks := _logged(builder.actors), area, kind.hardest_mps2):
            return tracks
    raise RuntimeError(f"no draw of {name} passed the checks")


def _is_apart(builder: ScenarioBuilder, index: int) -> bool:
    """Return whether an actor starts clear of those staged before it."""
    me = builder.actors[index]
    if me.kind.is_walker or me.path is None:
        return True
    place = me.path.at(me.along_m)
    for other in builder.actors[:index]:
        if other.path is None or other.kind.is_walker:
            continue
        there = other.path.at(other.along_m)
        across = abs(
            math.sin(place.yaw) * (there.x - place.x) - math.cos(place.yaw) * (there.y - place.y)
        )
        if (
            across < 2.5
            and math.dist(place.xy, there.xy) < (me.kind.length + other.kind.length) / 2.0 + 1.8
        ):
            return False
    return True


def _logged(actors: list[Actor]) -> list[Track]:
    """Return key frames of the ego and of all who come near it."""
    every = round(KEY_FRAME_S / DT_S)
    ego = actors[0].poses[::every]
    out: list[Track] = []
    for number, actor in enumerate(actors):
        poses = actor.poses[::every]
        seen = [
            i
            for i, (p, e) in enumerate(zip(poses, ego, strict=True))
            if p is not None and e is not None and math.dist(p.xy, e.xy) < SEEN_M
        ]
        if len(seen) < 4 and number > 0:
            continue
        part = [rounded(p) for p in poses[seen[0] : seen[-1] + 1] if p is not None]
        out.append(Track(f"{number:02d}", actor.kind, seen[0], part, actor.is_parked))
    return out


def rounded(pose: Pose) -> Pose:
    """Return a pose as it is written."""
    return Pose(round(pose.x, 3), round(pose.y, 3), round(pose.yaw, 5))


def fault(tracks: list[Track], area: DrivableArea, hardest_mps2: float) -> str:
    """Return what is wrong with a scene, empty if it may go into the set."""
    ego = tracks[0]
    if len(ego.poses) != round(DURATION_S / KEY_FRAME_S) + 1:
        return "the ego leaves the city"
    if not 6 <= len(tracks) <= MOST_ACTORS:
        return "too few or too many actors"
    if math.dist(ego.poses[0].xy, ego.poses[-1].xy) < 36.0:
        return "the ego goes nowhere"
    speeds = [math.dist(a.xy, b.xy) / KEY_FRAME_S for a, b in pairwise(ego.poses)]
    if max(a - b for a, b in pairwise(speeds)) > hardest_mps2 * KEY_FRAME_S:
        return "the ego brakes too hard"
    if max(speeds[-12:]) < 0.5:
        return "the ego is stuck"
    if constant_velocity_end(tracks, area) is None:
        return "keeping the velocity is no mistake"
    return first_overlap(tracks, DURATION_S, ROOM_M) or first_off_road(tracks, area)
