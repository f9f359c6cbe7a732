"""Logs in py123d's Arrow form: nuPlan, Waymo, Argoverse 2, nuScenes, KITTI-360, PandaSet, CARLA.

py123d (https://github.com/kesai-labs/py123d) converts these data sets; its own reader reads the
form here. Each part of a log becomes a scenario description, which the reader of ScenarioNet's
files takes on.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env._native import Scene
from ccdiff_env.errors import DatasetError, DatasetNotFoundError, MissingFeatureError
from ccdiff_env.scenes import SceneSet, expect_limit, warn_of_lone_egos, warn_without_road
from ccdiff_env.scenes.load_report import LoadReport, SceneReport
from ccdiff_env.scenes.scenario_fields import F64, ScenarioFields
from ccdiff_env.scenes.windows import Windows
from ccdiff_env.system.files import reading

__all__ = ["load_py123d"]

_INSTALL = "pip install 'ccdiff-env[py123d]'"
_BESIDE = 4.5  #: How far frames beside a window shape its curves, in frames.
_MAP_MARGIN_M = 60.0  #: How far the map reaches beyond the box round all tracks.
#: Kinds of py123d's own labels, and those that the name of a data set's label tells better.
_KINDS = {
    "VEHICLE": "vehicle", "TRAIN": "vehicle", "TWO_WHEELER": "cyclist", "PERSON": "pedestrian",
    "ANIMAL": "pedestrian", "TRAFFIC_SIGN": "static", "TRAFFIC_CONE": "static",
    "BARRIER": "static", "GENERIC_OBJECT": "static",
}  # fmt: skip
_NAMED = {"MOTORCYCL": "motorcycle", "CYCLIST": "cyclist", "RIDER": "cyclist",
          "STROLLER": "pedestrian", "WHEELCHAIR": "pedestrian"}  # fmt: skip
#: Data sets whose surfaces beside lanes are the whole road, and those whose edges have it left.
_WHOLE, _EDGES = ("nuscenes", "av2"), ("wod",)
_SIZE = {"length": 6, "width": 7, "height": 8}  #: Columns of the rows of tracks.
#: Layers of surfaces, and the types that descriptions have for them.
_SURFACES = (("CROSSWALK", "CROSSWALK"), ("WALKWAY", "ROAD_EDGE_SIDEWALK"),
             ("STOP_ZONE", "STOP_LINE"), ("CARPARK", "CARPARK"))  # fmt: skip


def load_py123d(
    path: str | os.PathLike[str],
    *,
    dt: float = 0.1,
    window_s: float | None = None,
    stride_s: float | None = None,
    history_s: float | None = None,
    limit: int | None = None,
    names: Sequence[str] | None = None,
) -> SceneSet:
    """Load logs that py123d has converted.

    Places follow cubic splines through the frames of the log, at their timestamps; velocities are
    the log's own, those of the spline where it has none. The road is the drivable area of nuScenes
    and Argoverse; Waymo's is made from its edges, others' from all surfaces of the map. A light's
    stop line lies where the lane that it controls begins.

    Args:
        path: A log, or a folder that is searched for them: py123d's data root, its ``logs``, a
            split. Maps of cities lie in the ``maps`` beside ``logs``.
        dt: Seconds between steps.
        window_s, stride_s, history_s: Cut every log as in :func:`ccdiff_env.load`; whole logs are
            scenes without.
        limit: Only so many scenes, the first ones.
        names: Only scenes of these names.

    Returns:
        SceneSet: The scenes in the order of the folders, and ``.report``; the recording car is
            ``"ego"`` and comes first.

    Raises:
        MissingFeatureError: Without py123d.
        DatasetNotFoundError: No log there.
        DatasetError: A log is damaged, or breaks a rule; names it.
    """
    try:
        api = import_module("py123d.api.scene.arrow.arrow_scene_api")
    except ImportError as error:
        raise MissingFeatureError(f"logs of py123d need it, and {error}: {_INSTALL}") from error
    expect_limit(limit)
    window = None if window_s is None else Windows(window_s, stride_s, history_s)
    started, folder = time.perf_counter(), Path(path)
    with reading("logs", folder):
        logs = sorted({file.parent for file in folder.rglob("sync.arrow")})
    if not logs:
        raise DatasetNotFoundError(f"no log of py123d, a folder with sync.arrow, at {folder}")
    scenes, reports, empty = list[Scene](), list[SceneReport](), list[str]()
    for log in logs:
        maps = next((up / "maps" for up in log.parents if (up / "maps").is_dir()), None)
        try:
            for scene, report in _read(api.ArrowSceneAPI(log, maps_root=maps), dt, window, names):
                if len(scenes) == limit:
                    break
                if scene is None:
                    empty.append(report.name)
                else:
                    scenes.append(scene)
                    reports.append(report)
        except (
            ArithmeticError,
            AssertionError,
            LookupError,
            OSError,
            TypeError,
            ValueError,
        ) as error:
            if isinstance(error, DatasetError):
                raise
            raise DatasetError(f"py123d's log {log}: {error}") from error
    if not scenes and names is None:
        raise DatasetError(f"no scene with agents in {len(logs)} logs of {folder}")
    found = SceneSet(
        scenes,
        LoadReport(
            dataroot=os.fspath(folder),
            version="py123d",
            scenes=tuple(reports),
            empty=tuple(empty),
            seconds=time.perf_counter() - started,
        ),
        window,
    )
    warn_without_road(found)
    warn_of_lone_egos(found)
    return found


def _read(
    log: Any, dt: float, window: Windows | None, names: Sequence[str] | None
) -> Iterator[tuple[Scene | None, SceneReport]]:
    """Read the parts of a log: scene and report of each."""
    # imported here: descriptions are not needed to import the package
    from ccdiff_env.scenes.scenarionet import read_description

    times = np.array([stamp.time_us for stamp in log.get_all_iteration_timestamps()]) / 1e6
    if not (len(times) > 1 and (np.diff(times) > 0).all()):
        raise ValueError("expected two frames or more, at times that increase")
    num_steps = 1 + int((times[-1] - times[0]) / dt + 0.1)
    parts = {log.log_name: (0, num_steps)}
    if window is not None:
        parts = window.cut(log.log_name, num_steps, dt)
    for name, (first, last) in parts.items():
        if names is None or name in names:
            source = _description(log, name, times, times[0] + dt * np.arange(first, last), dt)
            yield read_description(source, ego_reference="centre")


def _description(log: Any, name: str, times: F64, grid: F64, dt: float) -> ScenarioFields:
    """Describe a part of a log, with states at the times ``grid``."""
    # some frames beside a window, too, through which curves enter and leave it
    beside_s = _BESIDE * float(np.median(np.diff(times)))
    frames = np.flatnonzero((times > grid[0] - beside_s) & (times < grid[-1] + beside_s))
    source = ScenarioFields(Path(log.log_name), {}, form="py123d")
    tracks = _tracks(log, times, frames, grid, dt, source.dropped)
    api = log.get_map_api()
    features: dict[str, dict[str, Any]] = {}
    if api is None:
        source.notes.append("no map: py123d found none of the log, nor of its city in maps")
    else:
        states = [track["state"] for track in tracks.values()]
        places = np.concatenate(
            [s["position"][s["valid"], :2] for s in states] or [np.zeros((1, 2))]
        )
        features = _features(api, log.dataset, places)
        for track in tracks.values() if not api.map_has_z else ():
            track["state"]["position"] = track["state"]["position"][:, :2]
    source.data = {
        "id": name,
        "length": len(grid),
        "tracks": tracks,
        "dynamic_map_states": _lights(log, times[frames], frames, grid),
        "map_features": features,
        "metadata": {
            "ts": dt * np.arange(len(grid)),
            "dataset": log.dataset,
            "scenario_token": str(log.scene_uuid),
            "map": log.location,
            "sdc_id": "ego" if "ego" in tracks else None,
        },
    }
    return source


def _tracks(
    log: Any, times: F64, frames: npt.NDArray[np.int64], grid: F64, dt: float, dropped: Counter[str]
) -> dict[str, dict[str, Any]]:
    """Read the agents of frames, by their ids."""
    boxes: dict[str, dict[float, tuple[float, ...]]] = {}  # x, y, z, yaw, velocity, size, by time
    kinds: dict[str, tuple[str, str]] = {}
    unknown: dict[str, str] = {}
    for frame in map(int, frames):
        ego = log.get_ego_state_se3_at_iteration(frame)
        seen = [] if ego is None else [("ego", ("vehicle", "ego"), ego.box_detection_se3)]
        for box in log.get_box_detections_se3_at_iteration(frame) or ():
            key, label = box.attributes.track_token, box.attributes.label.name
            usual = box.attributes.default_label.name
            kind = _KINDS.get(usual)
            if kind != "static":
                kind = next((k for part, k in _NAMED.items() if part in label), kind)
            if kind is not None:
                seen.append((key, (kind, label.lower()), box))
            elif usual != "EGO":
                unknown[key] = label.lower()
        for key, kind_of, box in seen:
            solid, velocity = box.bounding_box_se3, box.velocity_2d
            pose, size = solid.center_se3, (solid.length, solid.width, solid.height)
            moves = (np.nan, np.nan) if velocity is None else (velocity.x, velocity.y)
            kinds.setdefault(key, kind_of)
            row = (pose.x, pose.y, pose.z, pose.yaw, *moves, *size)
            if boxes.setdefault(key, {}).setdefault(float(times[frame]), row) is not row:
                raise ValueError(f"track {key!r} is twice in frame {frame}")
    dropped.update(f"{category}: unknown type" for category in unknown.values())
    usual_s = float(np.median(np.diff(times)))
    states = {
        key: _states(np.array(list(rows)), np.array(list(rows.values())), grid, dt, usual_s)
        for key, rows in boxes.items()
    }
    return {
        key: {
            "type": "OTHER",
            "state": state,
            "metadata": {"kind": kinds[key][0], "type": kinds[key][1]},
        }
        for key, state in states.items()
        if state["valid"].any()
    }


def _states(times: F64, rows: F64, grid: F64, dt: float, usual_s: float) -> dict[str, Any]:
    """States of a track at the times ``grid`` from its rows [K, 9] at ``times``."""
    interpolate = import_module("scipy.interpolate")  # py123d brings it

    if not np.isfinite(np.delete(rows, (4, 5), axis=1)).all():
        raise ValueError("a box is not finite")
    rows[:, 3] = np.unwrap(rows[:, 3])
    stands = np.linalg.norm(rows[-1, :2] - rows[0, :2]) < 1
    told = np.isfinite(rows[:, 4:6]).all() and (stands or rows[:, 4:6].any())
    made, valid = np.zeros((len(grid), 6)), np.zeros(len(grid), bool)
    for run in np.split(np.arange(len(times)), np.flatnonzero(np.diff(times) > 1.5 * usual_s) + 1):
        start_s, end_s = times[run[0]] - 0.1 * dt, times[run[-1]] + 0.1 * dt
        there = (grid > start_s) & (grid < end_s)
        valid |= there
        if len(run) > 1:
            curve = interpolate.CubicSpline(times[run], rows[run, :4], bc_type="natural")
            made[there, :4], made[there, 4:] = curve(grid[there]), curve(grid[there], 1)[:, :2]
        else:
            made[there, :4] = rows[run[0], :4]
        for i in (4, 5) if told else ():
            made[there, i] = np.interp(grid[there], times[run], rows[run, i])
    return {
        "position": made[:, :3],
        "heading": made[:, 3],
        "velocity": made[:, 4:],
        "valid": valid,
        **{name: np.full(len(grid), np.median(rows[:, i])) for name, i in _SIZE.items()},
    }


def _lights(
    log: Any, times: F64, frames: npt.NDArray[np.int64], grid: F64
) -> dict[str, dict[str, Any]]:
    """Read the lights of lanes: at each step what the last frame showed."""
    shown = [log.get_traffic_light_detections_at_iteration(int(frame)) or () for frame in frames]
    lights: dict[str, dict[str, Any]] = {}
    for step, k in enumerate(np.maximum(np.searchsorted(times, grid + 1e-3) - 1, 0)):
        for seen in shown[k]:
            none = {"state": {"object_state": ["UNKNOWN"] * len(grid)}}
            light = lights.setdefault(str(seen.lane_id), none)
            light["state"]["object_state"][step] = seen.status.name
    return lights


def _features(api: Any, dataset: str, places: F64) -> dict[str, dict[str, Any]]:
    """Describe the map round places [N, 2], cut where it ends."""
    shapely = import_module("shapely")
    crop = shapely.box(*places.min(axis=0) - _MAP_MARGIN_M, *places.max(axis=0) + _MAP_MARGIN_M)
    layers = {layer.name: layer for layer in api.get_available_map_layers()}
    found = api.query(crop, list(layers.values()), predicate="intersects")
    of = {name: list(found.get(layer, ())) for name, layer in layers.items()}
    inside = {g.object_id for g in of.get("LANE_GROUP", ()) if g.intersection_id is not None}
    features: dict[str, dict[str, Any]] = {}
    for lane in of.get("LANE", ()):
        if lane.lane_type.name != "BIKE_LANE":
            street = lane.lane_group_id not in inside
            limit = lane.speed_limit_mps
            features[str(lane.object_id)] = {
                "type": "LANE_SURFACE_STREET" if street else "LANE_SURFACE_UNSTRUCTURE",
                "polyline": lane.centerline.array,
                "polygon": np.asarray(lane.shapely_polygon.exterior.coords)[:, :2],
                "entry_lanes": list(map(str, lane.predecessor_ids)),
                "exit_lanes": list(map(str, lane.successor_ids)),
                "speed_limit_kmh": None if limit is None else 3.6 * limit,
            }
    for line in of.get("ROAD_LINE", ()):
        if (kind := line.road_line_type.name) != "NONE":
            key = f"line {line.object_id}"
            features[key] = {"type": f"ROAD_LINE_{kind}", "polyline": line.polyline.array}
    types = list(_SURFACES)
    if dataset.startswith(_EDGES):
        types.append(("GENERIC_DRIVABLE", "DRIVEWAY"))
        for edge in of.get("ROAD_EDGE", ()):
            key = f"edge {edge.object_id}"
            features[key] = {"type": "ROAD_EDGE_BOUNDARY", "polyline": edge.polyline.array}
    elif dataset.startswith(_WHOLE):
        types.append(("GENERIC_DRIVABLE", "DRIVABLE_AREA"))
    else:
        road = ("LANE_GROUP", "INTERSECTION", "CARPARK", "GENERIC_DRIVABLE")
        types += [(layer, "DRIVEWAY") for layer in road]
    for layer, kind in types:
        for thing in of.get(layer, ()):
            heights = thing.outline.array[:, 2:].mean(axis=0)
            parts = shapely.intersection(shapely.make_valid(thing.shapely_polygon), crop)
            for i, part in enumerate(shapely.get_parts(parts)):
                if part.geom_type == "Polygon" and part.area > 0:
                    rings = [
                        np.asarray(ring.coords)[:-1, :2]
                        for ring in (part.exterior, *part.interiors)
                    ]
                    outer = np.column_stack([rings[0], np.tile(heights, (len(rings[0]), 1))])
                    key = f"{kind} {layer} {thing.object_id} {i}"
                    features[key] = {"type": kind, "polygon": outer, "holes": rings[1:]}
    return features
