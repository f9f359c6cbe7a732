"""What the maps of scenes say of places: how far the road's edge is, and which lane an agent is on.

Every function takes one scene, or several with the scene of each place: ``world`` [M], as
:class:`~ccdiff_env.traffic.TrafficBatch` has it. Positions and headings are those of the scene's
frame. Where roads pass over each other, ``elevation_m`` [M] says on which level the places are;
without it all levels are one map. What is derived from a map is made at the first call and kept
with the scene.

Examples:
    >>> import ccdiff_env
    >>> from ccdiff_env.scenes import map_queries
    >>> scene = ccdiff_env.embedded_scenes("val")[0]
    >>> log = scene.tracks()
    >>> there = log["valid"][:, 30]
    >>> position = log["position"][there, 30]
    >>> bool(map_queries.road_distance(scene, position)[0] > 0)
    True
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env._native import Scene
from ccdiff_env.errors import ConfigError, ShapeError
from ccdiff_env.system.fields import documented, shapes

__all__ = ["LaneAhead", "lane_ahead", "road_distance"]

F32 = npt.NDArray[np.float32]
I64 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]


@documented
@dataclass(frozen=True, eq=False, kw_only=True)
class LaneAhead:
    """The lanes of M agents, and the way along them in the agents' frames; zero where not valid."""

    position_m: F32  #: Places on the way, from the nearest point of the lane on, m, [M, P, 2].
    valid: Bool  #: Whether the lanes go so far, [M, P].
    #: Index of the lane in ``scene.map_layers()["lanes"]``, -1 without one in reach, [M].
    lane: I64
    lateral_m: F32  #: Offset of the agent from the lane's centre line, left positive, m, [M].
    heading_error_rad: F32  #: Heading of the agent minus that of the lane, rad, [M].
    __repr__ = shapes


def _floats(name: str, values: Any, shape: tuple[int | None, ...]) -> F32:
    """Values as contiguous float32 of a shape, in which ``None`` is any length."""
    try:
        array = np.ascontiguousarray(values, np.float32)
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{name}: {error}, expected an array") from None
    fits = len(array.shape) == len(shape)
    if not fits or any(n not in (None, m) for m, n in zip(array.shape, shape, strict=True)):
        expected = ", ".join("M" if n is None else str(n) for n in shape)
        raise ShapeError(f"{name} has shape {array.shape}, expected [{expected}]")
    return array


def _worlds(scenes: Scene | Sequence[Scene], world: Any, count: int) -> tuple[list[Scene], I64]:
    """The scenes as a list, and the scene of each of ``count`` places."""
    listed = [scenes] if isinstance(scenes, Scene) else list(scenes)
    if not listed or not all(isinstance(scene, Scene) for scene in listed):
        raise ConfigError("scenes must be a Scene or a sequence of them")
    if world is None:
        if len(listed) > 1:
            raise ConfigError(f"world is None, expected the number of one of {len(listed)} scenes")
        return listed, np.zeros(count, np.int64)
    numbers = np.asarray(world)
    if numbers.shape != (count,) or numbers.dtype.kind not in "iu":
        raise ShapeError(
            f"world has shape {numbers.shape} and dtype {numbers.dtype}, "
            f"expected {count} integers, one for each place"
        )
    return listed, np.ascontiguousarray(numbers, np.int64)


def _placed(
    scenes: Scene | Sequence[Scene], position_m: Any, heading_rad: Any, elevation_m: Any, world: Any
) -> tuple[list[Scene], I64, F32, F32, F32]:
    """The scenes, the scene of each place, positions, headings and elevations."""
    position = _floats("position_m", position_m, (None, 2))
    heading = _floats("heading_rad", heading_rad, (len(position),))
    level = np.zeros(0, np.float32)
    if elevation_m is not None:
        level = _floats("elevation_m", elevation_m, (len(position),))
    return (*_worlds(scenes, world, len(position)), position, heading, level)


def road_distance(
    scenes: Scene | Sequence[Scene], position_m: Any, *, elevation_m: Any = None, world: Any = None
) -> F32:
    """Return the distances [M] of places to the edge of the road, m, positive on the road.

    The road is what ``off_road`` goes by: the union of the drivable areas, else of the lanes'
    surfaces. It ends where the map was cut out.

    Args:
        scenes: One scene, or several.
        position_m: Places, scene frame, m, [M, 2].
        elevation_m: Elevations of the places [M], m: the road of their levels alone.
        world: Scene of each place, index of ``scenes``, [M]; left out for one scene.

    Raises:
        ShapeError: If an array has another shape.
        ConfigError: If a number is not finite.
        SceneError: If a scene has no road.
    """
    position = _floats("position_m", position_m, (None, 2))
    heading = np.zeros(len(position), np.float32)
    return _native.map_road_distance(_placed(scenes, position, heading, elevation_m, world))


def lane_ahead(
    scenes: Scene | Sequence[Scene],
    position_m: Any,
    heading_rad: Any,
    *,
    points: int = 41,
    spacing_m: float = 2.0,
    reach_m: float = 5.0,
    elevation_m: Any = None,
    world: Any = None,
) -> LaneAhead:
    """Return the lanes that agents are on, and the way along them, in the agents' frames.

    An agent's lane is the nearest one that leads where the agent heads, to 90 degrees. The way
    follows it, then the first of its successors, and so on.

    Args:
        scenes: One scene, or several.
        position_m, heading_rad: Poses of the agents, scene frame, [M, 2] m and [M] rad.
        points: Places on the way P, 1 to 10000.
        spacing_m: Distance from one place to the next, m.
        reach_m: Lanes farther than this are not looked at, m, at most 10.
        elevation_m: Elevations of the agents [M], m: lanes of their levels alone.
        world: Scene of each agent, index of ``scenes``, [M]; left out for one scene.

    Raises:
        ShapeError: If an array has another shape.
        ConfigError: If a number is not finite, or out of its range.
        UnknownNameError: If there is no scene of that number.
    """
    places = _placed(scenes, position_m, heading_rad, elevation_m, world)
    for name, value, most in (("spacing_m", spacing_m, 1000.0), ("reach_m", reach_m, 10.0)):
        if not isinstance(value, (int, float)) or not 0.0 < value <= most:
            raise ConfigError(f"{name} is {value!r}, expected a number above 0, at most {most:g}")
    if not isinstance(points, (int, np.integer)) or not 1 <= points <= 10_000:
        raise ConfigError(f"points is {points!r}, expected an integer from 1 to 10000")
    way, valid, lane, lateral, error = _native.map_lane_ahead(places, points, spacing_m, reach_m)
    return LaneAhead(
        position_m=way, valid=valid, lane=lane, lateral_m=lateral, heading_error_rad=error
    )
