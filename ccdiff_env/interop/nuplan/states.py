"""States of agents as nuPlan has them: the ego by its rear axle, the others as tracks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from nuplan.common.actor_state.agent import Agent
from nuplan.common.actor_state.ego_state import EgoState
from nuplan.common.actor_state.oriented_box import OrientedBox
from nuplan.common.actor_state.scene_object import SceneObjectMetadata
from nuplan.common.actor_state.state_representation import StateSE2, StateVector2D, TimePoint
from nuplan.common.actor_state.static_object import StaticObject
from nuplan.common.actor_state.tracked_objects import TrackedObjects
from nuplan.common.actor_state.tracked_objects_types import AGENT_TYPES, TrackedObjectType
from nuplan.common.actor_state.vehicle_parameters import VehicleParameters
from nuplan.planning.simulation.observation.observation_type import DetectionsTracks

from ccdiff_env._native import EGO_AXLE_TO_CENTRE_M, LEVEL_M
from ccdiff_env.interop.nuplan.roads import wrap

#: Shares of the length of nuScenes' Renault Zoe (4.084 m): from the rear axle to the middle of the
#: box, as the loader of nuScenes has it, and from axle to axle (2.588 m). Other egos have the same.
AXLE_TO_CENTRE, WHEEL_BASE = EGO_AXLE_TO_CENTRE_M / 4.084, 2.588 / 4.084
#: From the rear axle to the centre of gravity of nuPlan's own car, as a share of its length.
_COG = 1.67 / 5.176
#: Slowest speed at which the yaw rate says where the wheels point, and their greatest angle, rad.
_ROLLING_MPS, _WHEEL_RAD = 0.3, 1.0
#: What agents are, by their kind, and static objects by their category.
_KINDS = {
    "vehicle": TrackedObjectType.VEHICLE,
    "pedestrian": TrackedObjectType.PEDESTRIAN,
    "cyclist": TrackedObjectType.BICYCLE,
    "motorcycle": TrackedObjectType.BICYCLE,
    "static": TrackedObjectType.GENERIC_OBJECT,
    "movable_object.trafficcone": TrackedObjectType.TRAFFIC_CONE,
    "movable_object.barrier": TrackedObjectType.BARRIER,
}


class SceneStates:
    """Makes states of a scene's agents into those of nuPlan, in the frame of the scene.

    Agents are called by their numbers (the ego's is ``ego``): names would tell the scene.
    """

    def __init__(self, scene: Any, ego: int) -> None:
        self.ego = ego
        self._sizes = np.asarray(scene.sizes, np.float64)
        both = zip(scene.agent_types, scene.agent_categories, strict=True)
        self._kinds = [_KINDS.get(category, _KINDS[kind]) for kind, category in both]
        length, width, height = self._sizes[ego].tolist()
        behind_m = AXLE_TO_CENTRE * length
        #: The ego's measures.
        self.vehicle = VehicleParameters(
            vehicle_name="ego",
            vehicle_type="ccdiff-env",
            width=width,
            front_length=0.5 * length + behind_m,
            rear_length=0.5 * length - behind_m,
            wheel_base=WHEEL_BASE * length,
            cog_position_from_rear_axle=_COG * length,
            height=height,
        )

    def ego_state(
        self,
        states: Mapping[str, Any],
        acceleration_mps2: float,
        yaw_rate_radps: float,
        now_us: int,
    ) -> EgoState:
        """Return the ego's state; its acceleration is that along its heading.

        ``states`` are ``position`` [A, 2] m, ``heading`` [A] rad and ``velocity`` [A, 2] m/s of all
        agents.
        """
        heading = float(states["heading"][self.ego])
        vx, vy = states["velocity"][self.ego].tolist()
        cos, sin = np.cos(heading), np.sin(heading)
        ahead, left = vx * cos + vy * sin, vy * cos - vx * sin
        rolls = abs(ahead) > _ROLLING_MPS
        wheel = np.arctan(self.vehicle.wheel_base * yaw_rate_radps / ahead) if rolls else 0.0
        return EgoState.build_from_center(
            center=StateSE2(*states["position"][self.ego].tolist(), wrap(heading)),
            center_velocity_2d=StateVector2D(ahead, left),
            center_acceleration_2d=StateVector2D(acceleration_mps2, 0.0),
            tire_steering_angle=float(np.clip(wheel, -_WHEEL_RAD, _WHEEL_RAD)),
            time_point=TimePoint(now_us),
            vehicle_parameters=self.vehicle,
            angular_vel=yaw_rate_radps,
        )

    def drive(
        self,
        states: Mapping[str, npt.NDArray[Any]],
        dt_s: float,
        first_step: int = 0,
        acceleration_mps2: npt.NDArray[Any] | None = None,
    ) -> list[tuple[int, EgoState]]:
        """Return the ego's states where it is there, by column.

        ``states`` are those of :meth:`ego_state` over T steps, with ``valid`` [A, T]; the first
        column is that of ``first_step``. Accelerations along the heading [T] are by default those
        of the change of speed.
        """
        valid = states["valid"][self.ego]
        follows = valid & np.append(False, valid[:-1])
        turned = np.diff(states["heading"][self.ego].astype(np.float64), prepend=0.0)
        if acceleration_mps2 is None:
            speed = np.hypot(*states["velocity"][self.ego].astype(np.float64).T)
            acceleration_mps2 = np.where(follows, np.diff(speed, prepend=speed[:1]) / dt_s, 0.0)
        found = []
        for k in np.flatnonzero(valid).tolist():
            now = {name: states[name][:, k] for name in ("position", "heading", "velocity")}
            turn = wrap(turned[k]) / dt_s if follows[k] else 0.0
            at_us = (first_step + k) * round(dt_s * 1e6)
            found.append((k, self.ego_state(now, float(acceleration_mps2[k]), turn, at_us)))
        return found

    def tracks(
        self, states: Mapping[str, Any], active: npt.NDArray[np.bool_], now_us: int
    ) -> DetectionsTracks:
        """Return the tracks of the active agents [A], without the ego.

        With ``elevation_m`` [A] among the states, agents on other levels are left out: nuPlan's
        world is flat.
        """
        if "elevation_m" in states:
            above = states["elevation_m"] - states["elevation_m"][self.ego]
            active = active & (np.abs(above) <= LEVEL_M)
        found: list[Any] = []
        for i in np.flatnonzero(active & (np.arange(len(active)) != self.ego)).tolist():
            place = StateSE2(*states["position"][i].tolist(), wrap(float(states["heading"][i])))
            box = OrientedBox(place, *self._sizes[i])
            data = SceneObjectMetadata(now_us, f"{i}-{now_us}", i, str(i))
            if self._kinds[i] in AGENT_TYPES:
                velocity = StateVector2D(*states["velocity"][i].tolist())
                found.append(Agent(self._kinds[i], box, velocity, data))
            else:
                found.append(StaticObject(self._kinds[i], box, data))
        return DetectionsTracks(TrackedObjects(found))
