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

TABLES = """
    category attribute visibility instance sensor calibrated_sensor ego_pose log scene sample
    sample_data sample_annotation map
""".split()
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
        out[table] = [
            {"token": token(table, i), "name": n, "description": ""} for i, n in enumerate(names)
        ]
    out["visibility"] = [
        {"token": str(i + 1), "level": level, "description": ""}
        for i, level in enumerate(VISIBILITIES)
    ]
    out["sensor"] = [{"token": token("sensor"), "channel": "LIDAR_TOP", "modality": "lidar"}]
    out["calibrated_sensor"] = [
        {
            "token": token("calibrated_sensor"),
            "sensor_token": token("sensor"),
            "translation": [0.0, 0.0, 0.0],
            "rotation": [1.0, 0.0, 0.0, 0.0],
            "camera_intrinsic": [],
        }
    ]
    out["log"] = [
        {
            "token": token("log"),
            "logfile": "",
            "vehicle": "",
            "date_captured": "2020-09-13",
            "location": LOCATION,
        }
    ]
    out["map"] = [
        {
            "token": token("map"),
            "log_tokens": [token("log")],
            "category": "semantic_prior",
            "filename": f"maps/{LOCATION}.png",
        }
    ]
    for number, scene in enumerate(scenes):
        _add_scene(out, number, scene)
        for track_number, track in enumerate(scene.tracks[1:]):
            _add_track(out, number, track_number, track)
    return out


def _chain(table: str, keys: Sequence[tuple[int, ...]], index: int) -> Record:
    """Return the links of a record in a chain."""
    return {
        "prev": token(table, *keys[index - 1]) if index > 0 else "",
        "next": token(table, *keys[index + 1]) if index + 1 < len(keys) else "",
    }


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
    keys = [(number, frame) for frame in range(len(scene.tracks[0].poses))]
    out["scene"].append(
        {
            "token": token("scene", number),
            "log_token": token("log"),
            "nbr_samples": len(scene.tracks[0].poses),
            "first_sample_token": token("sample", *keys[0]),
            "last_sample_token": token("sample", *keys[-1]),
            "name": scene.name,
            "description": scene.kind.description,
        }
    )
    for frame, (key, pose) in enumerate(zip(keys, scene.tracks[0].poses, strict=True)):
        time = {"timestamp": _timestamp_us(number, frame)}
        sample = {"token": token("sample", *key), **time, "scene_token": token("scene", number)}
        out["sample"].append({**sample, **_chain("sample", keys, frame)})
        rotation = _rotation(pose.yaw)
        out["ego_pose"].append(
            {
                "token": token("ego_pose", *key),
                **time,
                "rotation": rotation,
                "translation": _rear_axle(pose, rotation),
            }
        )
        out["sample_data"].append(
            {
                "token": token("sample_data", *key),
                "sample_token": token("sample", *key),
                "ego_pose_token": token("ego_pose", *key),
                "calibrated_sensor_token": token("calibrated_sensor"),
                **time,
                "fileformat": "pcd",
                "is_key_frame": True,
                "height": 0,
                "width": 0,
                "filename": f"samples/LIDAR_TOP/{scene.name}_{frame:02d}.pcd.bin",
                **_chain("sample_data", keys, frame),
            }
        )


def _add_track(out: dict[str, list[Record]], scene: int, number: int, track: Track) -> None:
    keys = [(scene, number, track.first + i) for i in range(len(track.poses))]
    instance = token("instance", scene, number)
    out["instance"].append(
        {
            "token": instance,
            "category_token": token("category", CATEGORIES.index(track.kind.category)),
            "nbr_annotations": len(keys),
            "first_annotation_token": token("sample_annotation", *keys[0]),
            "last_annotation_token": token("sample_annotation", *keys[-1]),
        }
    )
    kind = track.kind
    for i, (key, pose) in enumerate(zip(keys, track.poses, strict=True)):
        attribute = _attribute(track, i)
        out["sample_annotation"].append(
            {
                "token": token("sample_annotation", *key),
                "sample_token": token("sample", scene, key[2]),
                "instance_token": instance,
                "visibility_token": "4",
                "attribute_tokens": [token("attribute", ATTRIBUTES.index(attribute))]
                if attribute
                else [],
                "translation": [pose.x, pose.y, round(kind.height / 2.0, 3)],
                "size": [kind.width, kind.length, kind.height],
                "rotation": _rotation(pose.yaw),
                **_chain("sample_annotation", keys, i),
                "num_lidar_pts": 20,
                "num_radar_pts": 0,
            }
        )


def _attribute(track: Track, index: int) -> str:
    """Return the attribute of a track at one of its key frames, empty for obstacles."""
    category = track.kind.category
    if category in ("vehicle.bicycle", "vehicle.motorcycle"):
        return "cycle.with_rider"
    is_moving = _speed_mps(track.poses, index) > MOVING_MPS
    if track.kind.is_walker:
        return "pedestrian.moving" if is_moving else "pedestrian.standing"
    if track.kind.is_driven:
        return (
            "vehicle.parked"
            if track.is_parked
            else "vehicle.moving"
            if is_moving
            else "vehicle.stopped"
        )
    return ""


def _speed_mps(poses: Sequence[Pose], index: int) -> float:
    a, b = poses[max(index - 1, 0)], poses[min(index + 1, len(poses) - 1)]
    return math.dist(a.xy, b.xy) / (
        KEY_FRAME_S * max(1, min(index + 1, len(poses) - 1) - max(index - 1, 0))
    )
