"""The embedded scenes as tables of the official nuScenes schema.

Tokens are readable numbers instead of hashes (table, scene, track, key frame), which keeps the
shipped file small.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ccdiff_env._native import EGO_AXLE_TO_CENTRE_M
from tools.embedded_city.checks import KEY_FRAME_S, Track
from tools.embedded_city.curves import Pose, wrap
from tools.embedded_city.layout import LOCATION
from tools.embedded_city.scenes import LoggedScene

Record = dict[str, Any]

#: Columns of the tables.
COLUMNS = {
    "category": "token name description",
    "attribute": "token name description",
    "visibility": "token level description",
    "instance": "token category_token nbr_annotations first_annotation_token last_annotation_token",
    "sensor": "token channel modality",
    "calibrated_sensor": "token sensor_token translation rotation camera_intrinsic",
    "ego_pose": "token timestamp rotation translation",
    "log": "token logfile vehicle date_captured location",
    "scene": "token log_token nbr_samples first_sample_token last_sample_token name description",
    "sample": "token timestamp scene_token prev next",
    "sample_data": "token sample_token ego_pose_token calibrated_sensor_token timestamp fileformat "
    "is_key_frame height width filename prev next",
    "sample_annotation": "token sample_token instance_token visibility_token attribute_tokens "
    "translation size rotation prev next num_lidar_pts num_radar_pts",
    "map": "token log_tokens category filename",
}
TABLES = list(COLUMNS)
CATEGORIES = """
    human.pedestrian.adult human.pedestrian.child vehicle.car vehicle.motorcycle vehicle.bicycle
    vehicle.bus.rigid vehicle.truck vehicle.construction movable_object.barrier
    movable_object.trafficcone
""".split()
ATTRIBUTES = """
    vehicle.moving vehicle.stopped vehicle.parked cycle.with_rider cycle.without_rider
    pedestrian.sitting_lying_down pedestrian.standing pedestrian.moving
""".split()
VISIBILITIES = ("v0-40", "v40-60", "v60-80", "v80-100")
FIRST_TIMESTAMP_US = 1_600_000_000_000_000
SCENE_APART_US = 100_000_000
MOVING_MPS = 0.3


def token(table: str, *numbers: int) -> str:
    """Return a token of 32 hexadecimal digits: the table and up to three numbers."""
    padded = (*numbers, 0, 0, 0)[:3]
    return f"{TABLES.index(table) + 1:08x}" + "".join(f"{n:08x}" for n in padded)


def write_tables(scenes: Sequence[LoggedScene]) -> dict[str, list[Record]]:
    """Return the thirteen tables by name."""
    out: dict[str, list[Record]] = {name: [] for name in TABLES}
    for table, names in (("category", CATEGORIES), ("attribute", ATTRIBUTES)):
        for i, name in enumerate(names):
            _add(out, table, token(table, i), name, "")
    for i, level in enumerate(VISIBILITIES):
        _add(out, "visibility", str(i + 1), level, "")
    sensor, log = token("sensor"), token("log")
    _add(out, "sensor", sensor, "LIDAR_TOP", "lidar")
    place = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    _add(out, "calibrated_sensor", token("calibrated_sensor"), sensor, *place, [])
    _add(out, "log", log, "", "", "2020-09-13", LOCATION)
    _add(out, "map", token("map"), [log], "semantic_prior", f"maps/{LOCATION}.png")
    for number, scene in enumerate(scenes):
        _add_scene(out, number, scene)
        for track_number, track in enumerate(scene.tracks[1:]):
            _add_track(out, number, track_number, track)
    return out


def _add(out: dict[str, list[Record]], table: str, *values: Any) -> None:
    out[table].append(dict(zip(COLUMNS[table].split(), values, strict=True)))


def _chain(table: str, keys: Sequence[tuple[int, ...]], index: int) -> tuple[str, str]:
    """Return the tokens before and after a record of a chain."""
    return (
        token(table, *keys[index - 1]) if index > 0 else "",
        token(table, *keys[index + 1]) if index + 1 < len(keys) else "",
    )


def _timestamp_us(scene: int, frame: int) -> int:
    return FIRST_TIMESTAMP_US + scene * SCENE_APART_US + frame * round(KEY_FRAME_S * 1e6)


def _rotation(yaw: float) -> list[float]:
    half = wrap(yaw) / 2.0
    return [round(math.cos(half), 6), 0.0, 0.0, round(math.sin(half), 6)]


def _rear_axle(centre: Pose, rotation: Sequence[float]) -> list[float]:
    """Return the place from which the loader comes to a centre; not rounded, so that it does."""
    w, _, _, z = rotation
    norm = w * w + z * z
    axis = (w * w - z * z, 2.0 * (w * z))
    x, y = (
        at - EGO_AXLE_TO_CENTRE_M * (along / norm)
        for at, along in zip(centre.xy, axis, strict=True)
    )
    return [x, y, 0.0]


def _add_scene(out: dict[str, list[Record]], number: int, scene: LoggedScene) -> None:
    poses, of = scene.tracks[0].poses, token("scene", number)
    keys = [(number, frame) for frame in range(len(poses))]
    ends = token("sample", *keys[0]), token("sample", *keys[-1])
    _add(out, "scene", of, token("log"), len(poses), *ends, scene.name, scene.kind.description)
    for frame, (key, pose) in enumerate(zip(keys, poses, strict=True)):
        time_us = _timestamp_us(number, frame)
        sample, ego_pose = token("sample", *key), token("ego_pose", *key)
        _add(out, "sample", sample, time_us, of, *_chain("sample", keys, frame))
        rotation = _rotation(pose.yaw)
        _add(out, "ego_pose", ego_pose, time_us, rotation, _rear_axle(pose, rotation))
        file = "pcd", True, 0, 0, f"samples/LIDAR_TOP/{scene.name}_{frame:02d}.pcd.bin"
        tokens = token("sample_data", *key), sample, ego_pose, token("calibrated_sensor")
        _add(out, "sample_data", *tokens, time_us, *file, *_chain("sample_data", keys, frame))


def _add_track(out: dict[str, list[Record]], scene: int, number: int, track: Track) -> None:
    keys = [(scene, number, track.first + i) for i in range(len(track.poses))]
    instance, kind = token("instance", scene, number), track.kind
    category = token("category", CATEGORIES.index(kind.category))
    ends = token("sample_annotation", *keys[0]), token("sample_annotation", *keys[-1])
    _add(out, "instance", instance, category, len(keys), *ends)
    size = [kind.width, kind.length, kind.height]
    for i, (key, pose) in enumerate(zip(keys, track.poses, strict=True)):
        name = _attribute(track, i)
        attributes = [token("attribute", ATTRIBUTES.index(name))] if name else []
        tokens = token("sample_annotation", *key), token("sample", scene, key[2]), instance
        box = [pose.x, pose.y, round(kind.height / 2.0, 3)], size, _rotation(pose.yaw)
        chain = _chain("sample_annotation", keys, i)
        _add(out, "sample_annotation", *tokens, "4", attributes, *box, *chain, 20, 0)


def _attribute(track: Track, index: int) -> str:
    """Return the attribute of a track at one of its key frames, empty for obstacles."""
    category = track.kind.category
    if category in ("vehicle.bicycle", "vehicle.motorcycle"):
        return "cycle.with_rider"
    is_moving = _speed_mps(track.poses, index) > MOVING_MPS
    if track.kind.is_walker:
        return "pedestrian.moving" if is_moving else "pedestrian.standing"
    if track.kind.is_driven:
        moves = "moving" if is_moving else "stopped"
        return "vehicle.parked" if track.is_parked else f"vehicle.{moves}"
    return ""


def _speed_mps(poses: Sequence[Pose], index: int) -> float:
    a, b = poses[max(index - 1, 0)], poses[min(index + 1, len(poses) - 1)]
    return math.dist(a.xy, b.xy) / (
        KEY_FRAME_S * max(1, min(index + 1, len(poses) - 1) - max(index - 1, 0))
    )
