"""A bridge over a road, and a ramp from one to the other, in GPUDrive's JSON."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from gpudrive_scene import road_user, save, scene

STEPS = 91
DT_S = 0.1
BRIDGE_M = 8.0  #: Height of the bridge over the road below, metres.

Place = Callable[[float], tuple[float, float, float]]


def vehicle(number: int, place: Place, *, heading: float = 0.0) -> dict[str, Any]:
    """A car at ``place`` (x, y and elevation of the ground by time), heading along its way."""
    size = (4.6, 2.0, 1.6)
    ground = [place(step * DT_S) for step in range(STEPS)]
    at = np.add(ground, [0.0, 0.0, 0.5 * size[2]])
    velocity = np.gradient(at[:, :2], DT_S, axis=0)
    moves = np.hypot(*velocity.T) > 0.1
    headings = np.where(moves, np.arctan2(velocity[:, 1], velocity[:, 0]), heading)
    return road_user(number, at, headings, velocity, size=size)


def on_bridge(x: float, speed: float = 10.0, y: float = 0.0) -> Place:
    """Eastwards over the bridge from x on."""
    return lambda t: (x + speed * t, y, BRIDGE_M)


def below(y: float, speed: float = 10.0, x: float = 40.0) -> Place:
    """Northwards on the road below the bridge from y on."""
    return lambda t: (x, y + speed * t, 0.0)


def ramp_height(x: float) -> float:
    """Elevation of the bridge's road at x: it comes down to the ground from 100 m on, 6 % steep."""
    return BRIDGE_M - min(max(0.06 * (x - 100.0), 0.0), BRIDGE_M)


def _road(kind: str, element: int, number: int, points: list[tuple[float, float, float]]) -> Any:
    geometry = [{"x": x, "y": y, "z": z} for x, y, z in points]
    return {"type": kind, "map_element_id": element, "id": number, "geometry": geometry}


def roads() -> list[dict[str, Any]]:
    """A road of 12 m over the bridge and down the ramp, and one of 12 m below the bridge."""
    east = [(float(x), ramp_height(x)) for x in range(-60, 321, 4)]
    north = [float(y) for y in range(-80, 81, 4)]
    return [
        _road("road_edge", 15, 1, [(x, -6.0, z) for x, z in east]),
        _road("road_edge", 15, 2, [(x, 6.0, z) for x, z in reversed(east)]),
        _road("lane", 2, 3, [(x, 0.0, z) for x, z in east]),
        _road("road_edge", 15, 4, [(46.0, y, 0.0) for y in north]),
        _road("road_edge", 15, 5, [(34.0, y, 0.0) for y in reversed(north)]),
        _road("lane", 2, 6, [(40.0, y, 0.0) for y in north]),
        _road("road_line", 11, 7, [(40.0, y, 0.0) for y in north]),
    ]


def write(path: Path, objects: list[dict[str, Any]], **replaced: Any) -> Path:
    """Write a scene of these objects, the first one the ego."""
    metadata = {"sdc_track_index": 0, "objects_of_interest": [], "tracks_to_predict": []}
    made = {"objects": objects, "roads": roads(), "metadata": metadata}
    return save(path, {**scene(), **made, **replaced})
