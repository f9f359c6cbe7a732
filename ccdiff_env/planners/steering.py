"""Actions that follow the route at an acceleration."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import ActionConfig, AssistedLimits, BicycleLimits, DeltaPoseLimits
from ccdiff_env.errors import ConfigError
from ccdiff_env.worlds import Worlds

F32 = npt.NDArray[np.float32]


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
        limit = (
            limits.max_acceleration_mps2 if acceleration_mps2 > 0 else limits.max_deceleration_mps2
        )
        if isinstance(limits.dynamics, BicycleLimits):
            length = float(
                self._worlds.scenes[self._worlds.native.status(world_idx).scene_idx].sizes[ego, 0]
            )
            wheel = np.arctan(curvature * limits.dynamics.wheelbase_share * length)
            turn = wheel / limits.max_steering_rad
        else:
            turn = curvature * speed / limits.max_yaw_rate_radps
        return np.clip(np.array([acceleration_mps2 / limit, turn]), -1.0, 1.0).astype(np.float32)
