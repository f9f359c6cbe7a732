"""What kind of driving a scene asks for: tags that its log and map tell, and those of a file."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.planners import usual_window
from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.errors import ConfigError, UnknownNameError, hint_of
from ccdiff_env.scenes import Scene, map_queries
from ccdiff_env.system.files import read_text, reading

Bool = npt.NDArray[np.bool_]
TURN_RAD = np.deg2rad(45.0)  #: Heading that the ego's log gains or loses in a turn, at least.
STAND_MPS, STAND_S = 0.3, 1.0  #: Who is slower for so long has stopped.
FOLLOW_S, FOLLOW_M, BESIDE_M = 3.0, 30.0, 1.75  #: Time behind a leader so near, so little aside.
HIGH_MPS = 12.0  #: Least top speed of a scene of high speed.
SHIFT_M = 1.0  #: Least offsets from the centre lines of two lanes between which it changes.
STRAIGHT_RAD = np.deg2rad(20.0)  #: Most between the headings of ego and lane, or leader.

#: Tags by name; ``city`` is a column of its own.
TAGS = {
    "turn": "the heading changes by 45° or more",
    "stop": "slower than 0.3 m/s for a second",
    "following": "3 s behind a vehicle less than 30 m ahead",
    "lane change": "from one lane to its neighbour, by the centre lines",
    "crossing": "through connectors of an intersection",
    "high speed": "12 m/s or more",
}


def scene_tags(scene: Scene, first: int, last: int) -> list[str]:
    """Return the tags, of :data:`TAGS`, of what a scene's ego does in its log from one step to
    another.
    """
    tracks, ego = scene.tracks(), scene.agent_ids.index("ego")
    steps = slice(first, last + 1)
    there = tracks["valid"][ego, steps]
    position, heading = (tracks[n][ego, steps][there] for n in ("position", "heading"))
    if len(position) < 2:
        return []
    speed = np.linalg.norm(tracks["velocity"][ego, steps][there], axis=-1)
    turn = np.unwrap(heading.astype(np.float64))
    found = {
        "turn": np.ptp(turn) >= TURN_RAD,
        "stop": _longest(speed < STAND_MPS) * scene.dt >= STAND_S,
        "following": _led(scene, ego, steps)[there].sum() * scene.dt >= FOLLOW_S,
        "high speed": speed.max() >= HIGH_MPS,
    }
    lanes = scene.map_layers().get("lanes", [])
    if lanes:
        lane = map_queries.lane_ahead(scene, position, heading)
        on = lane.lane >= 0
        kinds = np.array([one["kind"] for one in lanes])
        found["crossing"] = bool((kinds[lane.lane[on]] == "connector").any())
        aside = lane.lateral_m[on]
        straight = np.abs(lane.heading_error_rad[on]) < STRAIGHT_RAD
        jumps = (np.diff(lane.lane[on]) != 0) & (aside[1:] * aside[:-1] < 0) & straight[1:]
        over = np.minimum(np.abs(aside[1:]), np.abs(aside[:-1])) >= SHIFT_M
        found["lane change"] = bool((jumps & over).any())
    return [tag for tag in TAGS if found.get(tag)]


def tags_of(
    source: str, window: Mapping[str, int] | None, more: Path | None = None
) -> dict[str, list[str]]:
    """Return city and tags of the scenes of a source by name, of the steps that are driven in a
    window (:func:`.window_of`), with those of a file, ``more``.
    """
    scenes = scenes_of(source)
    own = {} if more is None else read_tags(more, scenes.names)
    found = {}
    for scene in scenes:
        steps = window or usual_window(scene)
        first = steps["history_steps"]
        tags = scene_tags(scene, first, first + steps["horizon_steps"])
        found[scene.name] = [scene.location, *dict.fromkeys([*tags, *own.get(scene.name, ())])]
    return found


def _longest(holds: Bool) -> int:
    """Return the length of the longest run of true values."""
    ends = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(int), [0]])))
    return int((ends[1::2] - ends[::2]).max(initial=0))


def _led(scene: Scene, ego: int, steps: slice) -> Bool:
    """Return at which steps a vehicle drives ahead of the ego in its direction."""
    tracks = scene.tracks()
    others = np.array(scene.agent_types) == "vehicle"
    others[ego] = False
    at, yaw = tracks["position"][:, steps], tracks["heading"][:, steps]
    away = at[others] - at[ego]
    cos, sin = np.cos(yaw[ego]), np.sin(yaw[ego])
    ahead = away[..., 0] * cos + away[..., 1] * sin
    aside = away[..., 1] * cos - away[..., 0] * sin
    alike = np.cos(yaw[others] - yaw[ego]) > np.cos(STRAIGHT_RAD)
    near = (ahead > 0.0) & (ahead < FOLLOW_M) & (np.abs(aside) < BESIDE_M)
    moves = np.linalg.norm(tracks["velocity"][ego, steps], axis=-1) > STAND_MPS
    found: Bool = (near & alike & tracks["valid"][others, steps]).any(axis=0) & moves
    return found


def read_tags(path: Path, scenes: Sequence[str]) -> Mapping[str, list[str]]:
    """Return the tags of scenes that a CSV with the columns ``scene`` and ``tag`` gives.

    Raises:
        ConfigError: If a column is missing.
        UnknownNameError: If it names a scene that is not there.
    """
    found: dict[str, list[str]] = {}
    with reading("tags", path):
        for row in csv.DictReader(read_text(path).splitlines()):
            scene, tag = row.get("scene"), row.get("tag")
            if not scene or not tag:
                raise ConfigError(f"{path}: the row {row}, expected columns scene and tag")
            if scene not in scenes:
                raise UnknownNameError(f"{path}: no scene {scene!r}; {hint_of(scene, scenes)}")
            found.setdefault(scene, []).append(tag)
    return found
