"""What planners need of places that nobody has taken yet, and how a trajectory becomes actions.

All places are in the scene's frame, where no other is said: x, y in metres, heading in radians.
Functions take the worlds that a planner was made with.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import (
    ActionConfig,
    AssistedLimits,
    BicycleLimits,
    DeltaPoseLimits,
    UnicycleLimits,
)
from ccdiff_env.errors import ActionError, ConfigError, expect_shape
from ccdiff_env.scenes import map_queries
from ccdiff_env.worlds import Worlds
from ccdiff_env.worlds.worlds_view import behind

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
FRAMES = ("scene", "ego")  #: Frames of trajectories.
#: A trajectory begins within this distance of the vehicle, and what it drives until the first pose.
NEAR_M = 5.0


def _level(worlds: Any, world_idx: int, count: int) -> tuple[Any, F32 | None]:
    """The scene; where it has levels, the elevation of who is driven for each of some places."""
    native = worlds.native
    scene = behind(worlds.scenes[native.status(world_idx).scene_idx])
    elevation_m = native.states(world_idx).get("elevation_m")
    agent = native.slot_agents(world_idx)[0]
    if elevation_m is None or agent is None:
        return scene, None
    return scene, np.full(count, elevation_m[agent], np.float32)


def road_distance(worlds: Any, world_idx: int, points: npt.ArrayLike) -> F32:
    """Return distances [M] of points [M, 2] to the road's edge, m, negative off the road.

    The road, as the lanes of :func:`lane_ahead`, is that of the driven vehicle's level.

    Raises:
        SceneError: If the map has no road.
    """
    at = np.asarray(points, np.float32)
    scene, elevation_m = _level(worlds, world_idx, len(at))
    return map_queries.road_distance(scene, at, elevation_m=elevation_m)


def lane_ahead(
    worlds: Any, world_idx: int, poses: npt.ArrayLike, **options: Any
) -> map_queries.LaneAhead:
    """Return the lanes of poses [M, 3]: offset, heading error and the way ahead in their frames.

    ``options`` are those of :func:`ccdiff_env.scenes.map_queries.lane_ahead`.
    """
    at = np.asarray(poses, np.float32)
    scene, level = _level(worlds, world_idx, len(at))
    return map_queries.lane_ahead(scene, at[:, :2], at[:, 2], **{"elevation_m": level, **options})


def overlap(boxes: npt.ArrayLike, others: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Return whether boxes [..., 5] and others [..., 5] share a point (separating axes).

    Args:
        boxes, others: x, y, heading, length, width; the leading axes are broadcast.

    Raises:
        ShapeError: If the last axis is another.
    """
    for name, array in (("boxes", boxes), ("others", others)):
        shape = np.shape(array)
        expect_shape(name, np.asarray(array), (*shape[:-1], 5))
    a, b = np.broadcast_arrays(np.asarray(boxes, np.float64), np.asarray(others, np.float64))
    offset, turn = b[..., :2] - a[..., :2], b[..., 2] - a[..., 2]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    meets = np.ones(a.shape[:-1], np.bool_)
    for own, other in ((a, b), (b, a)):
        c, s = np.cos(own[..., 2]), np.sin(own[..., 2])
        along = np.abs(offset[..., 0] * c + offset[..., 1] * s)
        across = np.abs(offset[..., 1] * c - offset[..., 0] * s)
        meets &= 2 * along <= own[..., 3] + cos * other[..., 3] + sin * other[..., 4]
        meets &= 2 * across <= own[..., 4] + sin * other[..., 3] + cos * other[..., 4]
    return meets


class Tracker:
    """Turns trajectories into actions of the unicycle: constant acceleration, pure pursuit.

    Args:
        worlds: Worlds of a planner, with continuous actions of the unicycle.
        reach_s: How far ahead the trajectory is aimed at.
        frame: Frame of the poses: ``"scene"``, or ``"ego"``, that of who is driven, x ahead and y
            left.

    Raises:
        ConfigError: For another frame or other dynamics, and for indices of a grid.
    """

    def __init__(self, worlds: Any, reach_s: float = 0.5, *, frame: str = "scene") -> None:
        if frame not in FRAMES:
            raise ConfigError(f"frame is {frame!r}, expected {' or '.join(map(repr, FRAMES))}")
        action = worlds.config.action
        if action.discrete or not isinstance(action.dynamics, UnicycleLimits):
            raise ConfigError("action: a tracker needs continuous actions of the unicycle")
        self._worlds, self._native = worlds, worlds.native
        self._dt_s = worlds.config.dt_s
        self._reach = max(round(reach_s / self._dt_s), 1)
        self._limits, self._frame = action, frame

    def __call__(
        self, trajectories: npt.ArrayLike, near: npt.NDArray[np.bool_] | None = None
    ) -> F32:
        """Return actions [E, 2] that follow trajectories [E, T, 3].

        Pose t is where the first slot shall be after t + 1 steps. Worlds whose slot is
        empty get zeros.

        Args:
            trajectories: Poses x, y (m) and heading (rad).
            near: Worlds [E] whose trajectory must begin near the vehicle: within :data:`NEAR_M` and
                twice what it drives until the first pose at its speed or 10 m/s; none by default.

        Raises:
            ShapeError: For another shape.
            ActionError: If one does not; names the world, both places and what may lie between.
        """
        native, wanted = self._native, np.asarray(trajectories, np.float64)
        steps = max(wanted.shape[1], 1) if wanted.ndim == 3 else 1
        expect_shape("trajectories", wanted, (native.num_worlds, steps, 3))
        actions = np.zeros((native.num_worlds, 2), np.float32)
        aim = min(self._reach, wanted.shape[1])
        limits, time_s = self._limits, aim * self._dt_s
        for i in range(native.num_worlds):
            agent = native.slot_agents(i)[0]
            if agent is None or not native.slot_alive(i)[0]:
                continue
            states = native.states(i)
            heading, speed = float(states["heading"][agent]), float(states["speed"][agent])
            at = np.zeros(2) if self._frame == "ego" else states["position"][agent]
            if near is not None and near[i]:
                self._expect_near(i, wanted[i, 0, :2], np.asarray(at, np.float64), speed)
            ahead, left = wanted[i, aim - 1, :2]
            if self._frame == "scene":
                x, y = wanted[i, aim - 1, :2] - at
                ahead = x * np.cos(heading) + y * np.sin(heading)
                left = y * np.cos(heading) - x * np.sin(heading)
            acceleration = 2.0 * (ahead - speed * time_s) / time_s**2
            yaw_rate = speed * 2.0 * left / max(ahead**2 + left**2, 1.0)
            rises = acceleration > 0
            most = limits.max_acceleration_mps2 if rises else limits.max_deceleration_mps2
            action = acceleration / most, yaw_rate / limits.max_yaw_rate_radps
            actions[i] = np.clip(action, -1.0, 1.0)
        return actions

    def _expect_near(self, world_idx: int, first: F64, at: F64, speed_mps: float) -> None:
        most = NEAR_M + 2.0 * self._dt_s * max(abs(speed_mps), 10.0)
        away = float(np.hypot(*(first - at)))
        if away > most:
            status = self._native.status(world_idx)
            raise ActionError(
                f"world {world_idx} ({self._worlds.scenes[status.scene_idx].name}, step "
                f"{status.elapsed_steps}): the first pose is at {_metres(first)}, "
                f"{away:.1f} m from the vehicle, which is at {_metres(at)} in the frame "
                f"{self._frame!r}; expected at most {most:.1f} m. A planner says which frame "
                'it means: frame = "scene" (the default) or "ego"'
            )


def _metres(point: F64) -> str:
    return f"({point[0]:.1f}, {point[1]:.1f})"


class Steering:
    """Turns an acceleration and a distance from the route into normalised actions.

    Worlds have continuous actions of the unicycle or bicycle in their first slot, or assisted ones,
    where accelerations are changes of IDM's; others are a :class:`ConfigError`.
    """

    def __init__(self, worlds: Worlds) -> None:
        action: ActionConfig = worlds.config.action
        if action.discrete or isinstance(action.dynamics, DeltaPoseLimits):
            raise ConfigError(
                "actions: plans of the ego need continuous actions of the unicycle or bicycle, or "
                "assisted ones"
            )
        self._worlds = worlds
        self._action = action
        self._routes: dict[int, F32] = {}

    def _route(self, world_idx: int) -> F32:
        if world_idx not in self._routes:
            route = self._worlds.native.route(world_idx, 0)
            if route is None:
                raise ConfigError("plans of the ego: the slot is empty")
            self._routes[world_idx] = route[0]
        return self._routes[world_idx]

    def action(
        self, world_idx: int, states: Any, ego: int, acceleration_mps2: float, offset_m: float
    ) -> F32:
        """Return the action [W] that steers towards the shifted route ahead (pure pursuit)."""
        if isinstance(self._action.dynamics, AssistedLimits):
            ranges = self._action.dynamics
            parts = ((acceleration_mps2, ranges.delta_mps2), (offset_m, ranges.offset_m))
            shares = [np.interp(v, (low, 0.0, top), (-1.0, 0.0, 1.0)) for v, (low, top) in parts]
            return np.array(shares, np.float32)
        route = self._route(world_idx)
        at, heading = states["position"][ego], float(states["heading"][ego])
        speed = float(states["speed"][ego])
        reach = max(4.0, 0.8 * speed)
        nearest = int(np.argmin(((route - at) ** 2).sum(axis=1)))
        beyond = np.linalg.norm(route[nearest:] - route[nearest], axis=1) >= reach
        target = nearest + (int(np.argmax(beyond)) if beyond.any() else len(beyond) - 1)
        before = route[max(target - 1, 0)]
        way = route[target] - before if target > 0 else route[min(1, len(route) - 1)] - route[0]
        way = way / max(float(np.linalg.norm(way)), 1e-6)
        goal = route[target] + offset_m * np.array([-way[1], way[0]])
        dx, dy = goal - at
        angle = np.arctan2(dy, dx) - heading
        angle = float(np.arctan2(np.sin(angle), np.cos(angle)))
        curvature = 2.0 * np.sin(angle) / max(float(np.hypot(dx, dy)), 1.0)
        limits = self._action
        rises = acceleration_mps2 > 0
        limit = limits.max_acceleration_mps2 if rises else limits.max_deceleration_mps2
        if isinstance(limits.dynamics, BicycleLimits):
            scene = self._worlds.scenes[self._worlds.native.status(world_idx).scene_idx]
            length = float(scene.sizes[ego, 0])
            wheel = np.arctan(curvature * limits.dynamics.wheelbase_share * length)
            turn = wheel / limits.max_steering_rad
        else:
            turn = curvature * speed / limits.max_yaw_rate_radps
        return np.clip(np.array([acceleration_mps2 / limit, turn]), -1.0, 1.0).astype(np.float32)
