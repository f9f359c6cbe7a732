"""Export of scenes as ScenarioNet scenario descriptions.

The description holds global coordinates, tracks, lanes with their successors, lines and crossings
under ScenarioNet's own names. What the format has no place for (the drivable area with its holes,
stop lines, car parks, the frame's origin) stands in ``metadata["ccdiff_env"]``, which other tools
pass over and :func:`ccdiff_env.load_scenarionet` reads back.
"""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.errors import DatasetError
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.scenario_lights import write_lights
from ccdiff_env.scenes.scene_types import OWN_LAYERS, Lane, Polygon
from ccdiff_env.system.files import write_aside

F64 = npt.NDArray[np.float64]

VERSION = "0.1"  #: Version of the description's layout that is written.
_TYPES = {
    "vehicle": "VEHICLE",
    "pedestrian": "PEDESTRIAN",
    "cyclist": "CYCLIST",
    "motorcycle": "CYCLIST",
    "static": "TRAFFIC_BARRIER",
}


def _track(scene: Scene, agent_idx: int, tracks: Any, origin: F64) -> dict[str, Any]:
    """One agent; entries that are not valid are zero."""
    valid = tracks["valid"][agent_idx]
    num_steps = len(valid)
    length, width, height = (float(v) for v in scene.sizes[agent_idx])
    position = np.zeros((num_steps, 3))
    position[valid, :2] = tracks["position"][agent_idx][valid].astype(np.float64) + origin
    if "elevation_m" in tracks:  # of the ground, below the middle of the box
        position[valid, 2] = tracks["elevation_m"][agent_idx][valid] + 0.5 * height
    heading = tracks["heading"][agent_idx].astype(np.float64)
    wrapped = np.where(valid, np.arctan2(np.sin(heading), np.cos(heading)), 0.0)
    kind, agent_id = scene.agent_types[agent_idx], scene.agent_ids[agent_idx]
    return {
        "type": _TYPES[kind],
        "state": {
            "position": position,
            "heading": wrapped,
            "velocity": tracks["velocity"][agent_idx].astype(np.float64),
            "valid": valid.copy(),
            "length": np.full(num_steps, length),
            "width": np.full(num_steps, width),
            "height": np.full(num_steps, height),
        },
        "metadata": {
            "type": scene.agent_categories[agent_idx],
            "kind": kind,
            "object_id": agent_id,
            "track_length": num_steps,
            "dataset": "ccdiff_env",
        },
    }


def _ring(polygon: Polygon, origin: F64) -> F64:
    return polygon["exterior"].astype(np.float64) + origin


def _lane(lane: Lane, lanes: list[Lane], origin: F64) -> dict[str, Any]:
    street = lane["kind"] == "lane"
    line = lane["centreline"].astype(np.float64) + origin
    if "elevation_m" in lane:
        line = np.column_stack([line, lane["elevation_m"]])
    feature: dict[str, Any] = {
        "type": "LANE_SURFACE_STREET" if street else "LANE_SURFACE_UNSTRUCTURE",
        "polyline": line,
        "entry_lanes": [lanes[i]["id"] for i in lane["predecessors"]],
        "exit_lanes": [lanes[i]["id"] for i in lane["successors"]],
        "left_neighbor": [],
        "right_neighbor": [],
    }
    if len(lane["polygon"]["exterior"]) >= 3:
        feature["polygon"] = _ring(lane["polygon"], origin)
    if lane["speed_limit_mps"] is not None:
        feature["speed_limit_kmh"] = lane["speed_limit_mps"] * 3.6
    return feature


def _features(scene: Scene, origin: F64) -> dict[str, dict[str, Any]]:
    layers = scene.map_layers()
    lanes = layers.get("lanes", [])
    features = {lane["id"]: _lane(lane, lanes, origin) for lane in lanes}
    if len(features) < len(lanes):
        raise DatasetError(
            f"scene {scene.name!r}: lanes share an id, by which ScenarioNet tells them"
        )
    for name, kind in (
        ("road_dividers", "ROAD_LINE_SOLID_SINGLE_YELLOW"),
        ("lane_dividers", "ROAD_LINE_BROKEN_SINGLE_WHITE"),
    ):
        for i, line in enumerate(layers.get(name, [])):  # type: ignore[arg-type, var-annotated]
            points = line.astype(np.float64) + origin
            features[f"{name}_{i}"] = {"type": kind, "polyline": points}
    for i, polygon in enumerate(layers.get("ped_crossings", [])):
        features[f"ped_crossings_{i}"] = {"type": "CROSSWALK", "polygon": _ring(polygon, origin)}
    for i, polygon in enumerate(layers.get("drivable_area", [])):
        for j, ring in enumerate([polygon["exterior"], *polygon["holes"]]):
            closed = np.concatenate([ring, ring[:1]]).astype(np.float64) + origin
            key = f"drivable_area_{i}_{j}"
            features[key] = {"type": "ROAD_EDGE_BOUNDARY", "polyline": closed}
    return features


def scenario_dict(scene: Scene) -> dict[str, Any]:
    """Return a scene as a scenario description: plain containers and numpy arrays."""
    origin = np.array(scene.origin)
    tracks = scene.tracks()
    ids = scene.agent_ids
    layers: dict[str, Any] = dict(scene.map_layers())
    heights = {"elevation_m": layers.get("elevation_m", {})} if "elevation_m" in tracks else {}
    sdc_id = "ego" if "ego" in ids else ids[0]
    return {
        "id": scene.token or scene.name,
        "version": VERSION,
        "length": scene.num_steps,
        "tracks": {agent_id: _track(scene, i, tracks, origin) for i, agent_id in enumerate(ids)},
        "dynamic_map_states": write_lights(layers.get("lights", []), layers["lanes"], origin),
        "map_features": _features(scene, origin),
        "metadata": {
            "ts": np.arange(scene.num_steps) * scene.dt,
            "sample_rate": scene.dt,
            "coordinate": "right-handed",
            "metadrive_processed": False,
            "dataset": "ccdiff_env",
            "scenario_id": scene.name,
            "scenario_token": scene.token,
            "source_file": scene.source,
            "map": scene.location,
            "sdc_id": sdc_id,
            "ccdiff_env": {
                "origin": list(scene.origin),
                **{name: layers.get(name, []) for name in OWN_LAYERS},
                **heights,
            },
        },
    }


def write_scenario(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene as a scenario description file."""
    # protocol 4: what ScenarioNet's own files have, and every Python since 3.4 reads
    write_aside(Path(path), pickle.dumps(scenario_dict(scene), protocol=4))
