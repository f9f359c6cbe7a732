"""Traffic lights in ScenarioNet descriptions, read and written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.scenes.scenario_fields import F64, ScenarioFields
from ccdiff_env.scenes.scene_types import LIGHT_STATES, Lane, Light

#: Parts of the names that data sets give to what a light shows.
_SHOWN = (("RED", "red"), ("STOP", "red"), ("YELLOW", "yellow"), ("CAUTION", "yellow"),
          ("GREEN", "green"), ("GO", "green"))  # fmt: skip


def light_state(name: object) -> int:
    """Return the number in :data:`LIGHT_STATES` of a data set's name of a state."""
    shown = str(name).upper()
    return LIGHT_STATES.index(next((state for part, state in _SHOWN if part in shown), "unknown"))


def read_lights(source: ScenarioFields, lanes: Sequence[Lane], origin: F64) -> list[Light]:
    """Return the lights of a description's lanes; those of lanes that are not there are noted."""
    index = {lane["id"]: i for i, lane in enumerate(lanes)}
    num_steps, lights = source.data["length"], list[Light]()
    for key, light in source.mapping(
        source.data.get("dynamic_map_states", {}), "dynamic_map_states"
    ).items():
        where = f"dynamic_map_states[{source.text(key, 'a key of dynamic_map_states')!r}]"
        light = source.mapping(light, where)
        lane = source.text(light.get("lane", key), f"{where}.lane")
        state = source.mapping(light.get("state"), f"{where}.state")
        names = source.items(state.get("object_state"), f"{where}.state.object_state")
        if lane not in index:
            source.notes.append(f"a light of lane {lane}, which is not there")
            continue
        if len(names) != num_steps:
            raise source.fault(f"length of {where}.state.object_state", len(names), f"{num_steps}")
        made: Light = {
            "lane": index[lane],
            "states": np.array([light_state(name) for name in names], np.uint8),
        }
        metadata = light.get("metadata")
        own = metadata.get("stop_line") if isinstance(metadata, dict) else None
        if own is not None:
            points = source.array(own, f"{where}.metadata.stop_line", columns=2)
        else:
            points = np.atleast_2d(_stop_point(source, light, where))
        if len(points) in (1, 2):
            made["stop_line"] = (points[:, :2] - origin).astype(np.float32)
        lights.append(made)
    return lights


def _stop_point(source: ScenarioFields, light: Mapping[str, Any], where: str) -> F64:
    """The stop point [1, 2], of the first step that has one; nothing where none is told."""
    point = light.get("stop_point")
    if point is None:
        return np.zeros((0, 2))
    rows = bool(len(np.shape(point[0]))) if isinstance(point, (list, tuple)) and point else False
    rows |= isinstance(point, np.ndarray) and point.ndim > 1
    found = source.array(point, f"{where}.stop_point", columns=2 if rows else None)
    found = np.atleast_2d(found)[:, :2]
    return np.asarray(found[np.isfinite(found).all(axis=1) & found.any(axis=1)][:1])


def write_lights(
    lights: Sequence[Light], lanes: Sequence[Lane], origin: npt.NDArray[np.float64]
) -> dict[str, dict[str, Any]]:
    """Return lights as ``dynamic_map_states`` has them; several of one lane have numbers."""
    written: dict[str, dict[str, Any]] = {}
    for i, light in enumerate(lights):
        lane = lanes[light["lane"]]["id"]
        line = light["stop_line"].astype(np.float64) + origin
        names = [f"TRAFFIC_LIGHT_{LIGHT_STATES[state].upper()}" for state in light["states"]]
        written[lane if lane not in written else f"{lane}_{i}"] = {
            "type": "TRAFFIC_LIGHT",
            "lane": lane,
            "state": {"object_state": names},
            "stop_point": np.append(line.mean(axis=0), 0.0),
            "metadata": {"stop_line": line, "track_length": len(names), "dataset": "ccdiff_env"},
        }
    return written
