"""Planners of nuPlan in the seats of worlds: history and map in, poses of their controller out."""

from __future__ import annotations

from collections import deque
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from nuplan.common.actor_state.ego_state import EgoState
from nuplan.common.actor_state.state_representation import StateSE2, TimePoint
from nuplan.planning.simulation.controller.motion_model.kinematic_bicycle import (
    KinematicBicycleModel,
)
from nuplan.planning.simulation.history.simulation_history_buffer import SimulationHistoryBuffer
from nuplan.planning.simulation.observation.observation_type import DetectionsTracks
from nuplan.planning.simulation.planner.abstract_planner import PlannerInitialization, PlannerInput
from nuplan.planning.simulation.simulation_time_controller.simulation_iteration import (
    SimulationIteration,
)

from ccdiff_env.errors import raised_by
from ccdiff_env.interop.nuplan.roads import Centreline, wrap
from ccdiff_env.interop.nuplan.scene_map import SceneMap
from ccdiff_env.interop.nuplan.settings import Settings, made_of, of_devkit
from ccdiff_env.interop.nuplan.states import SceneStates
from ccdiff_env.worlds import Worlds
from ccdiff_env.worlds.worlds_view import behind

#: Seconds of the history, and samples that nuPlan's simulation has beyond: the present and one.
_HISTORY_S, _HISTORY_MORE = 2.0, 2
_FOLLOWED_M = 0.02  #: How far the world may have put the ego from where the controller did, m.


class Drive:
    """One episode of one world: what a planner is given, and what follows from its trajectory."""

    def __init__(self, worlds: Worlds, world_idx: int, scene_map: SceneMap) -> None:
        self._native, self._world = worlds.native, world_idx
        status = self._native.status(world_idx)
        scene = worlds.scenes[status.scene_idx]
        slot = self._native.slot_agents(world_idx)[0]
        told = self._native.route(world_idx, 0)
        assert slot is not None and told is not None  # noqa: PT018
        self._dt_us = round(worlds.config.dt_s * 1e6)
        self._states = SceneStates(scene, slot)
        route, goal = told
        found, blocks = scene_map.along(route)
        line = Centreline(route)
        heading = line.heading_at(line.project(*goal))
        #: What a planner is told at the beginning.
        self.initialization = PlannerInitialization(
            blocks, StateSE2(*(float(v) for v in goal), heading), found
        )
        most = round(_HISTORY_S / worlds.config.dt_s) + _HISTORY_MORE
        self._egos: deque[EgoState] = deque(maxlen=most)
        self._seen: deque[DetectionsTracks] = deque(maxlen=most)
        self._add_past(scene.tracks(), status.step_idx - status.elapsed_steps)
        self._led_to: EgoState | None = None
        lqr = of_devkit("simulation/ego_controller/tracker/lqr_tracker")
        self._controller = made_of({**lqr, "vehicle": self._states.vehicle}, "lqr_tracker")
        self._bicycle = KinematicBicycleModel(self._states.vehicle)

    def _add_past(self, log: Any, start: int) -> None:
        """Add the states of the log that come before the episode's first step."""
        assert self._egos.maxlen is not None
        first = max(start - self._egos.maxlen + 1, 0)
        past = {name: array[:, first:start] for name, array in log.items()}
        for k, ego in self._states.drive(past, 1e-6 * self._dt_us, first):
            now = {name: array[:, k] for name, array in past.items()}
            self._egos.append(ego)
            self._seen.append(self._states.tracks(now, now["valid"], ego.time_us))

    def input(self) -> PlannerInput:
        """Return what a planner is given at the present step."""
        status, now = self._native.status(self._world), self._native.states(self._world)
        at_us, ego = status.step_idx * self._dt_us, self._states.ego
        while self._egos and self._egos[-1].time_us >= at_us:  # asked again, or restored
            self._egos.pop()
            self._seen.pop()
        motion = float(now["acceleration"][ego]), float(now["yaw_rate"][ego])
        here = self._states.ego_state(now, *motion, at_us)
        led = self._led_to
        # the controller's own state, where the world followed it, knows the wheels, too
        if led is not None and led.time_us == at_us:
            here = led if here.center.distance_to(led.center) < _FOLLOWED_M else here
        self._egos.append(here)
        self._seen.append(self._states.tracks(now, now["active"], at_us))
        past = deque(self._egos), deque(self._seen)  # a planner may keep what it is given
        history = SimulationHistoryBuffer(*past, 1e-6 * self._dt_us)
        step = SimulationIteration(TimePoint(at_us), status.elapsed_steps)
        lights = self.initialization.map_api.traffic_lights(status.step_idx, at_us)
        return PlannerInput(step, history, lights)

    def follow(self, given: PlannerInput, trajectory: Any) -> npt.NDArray[np.float64]:
        """Return how nuPlan's controller goes on along a trajectory, for one step of the world.

        Ways of the box's centre forwards and to the left, m, and the turn, rad, [3].
        """
        here, now = given.history.current_state[0], given.iteration
        after = SimulationIteration(TimePoint(now.time_us + self._dt_us), now.index + 1)
        wanted = self._controller.track_trajectory(now, after, here, trajectory)
        there = self._bicycle.propagate_state(here, wanted, TimePoint(self._dt_us))
        self._led_to = there
        (dx, dy), heading = there.center.array - here.center.array, here.center.heading
        cos, sin = np.cos(heading), np.sin(heading)
        turn = wrap(there.center.heading - heading)
        return np.array([dx * cos + dy * sin, dy * cos - dx * sin, turn])


class NuPlanPlanner:
    """Drives the first slot of every world by a planner of nuPlan, one for each episode.

    Its trajectories are followed by nuPlan's own controller, LQR and a kinematic bicycle with the
    settings of its simulation, whose poses the worlds take as delta-pose actions.
    """

    env_options: ClassVar[dict[str, Any]] = {"dynamics": "delta_pose"}

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        #: Module of the planner's class, and files that it is made of.
        self.module = settings.module
        self.files = [] if settings.file is None else [settings.file]
        settings.make()  # refused here if at all
        self._worlds: Worlds | None = None
        self._drives: dict[int, tuple[Drive, Any]] = {}
        self._maps: dict[int, SceneMap] = {}

    def reset(self, worlds: Any, indices: npt.NDArray[np.int64]) -> None:
        """Forget the episodes of some worlds."""
        now = behind(worlds)
        if now is not self._worlds:
            self._worlds, self._drives, self._maps = now, {}, {}
            bounds = now.native.action_bounds
            self._bounds = np.array([(low, high) for _, low, high in bounds], np.float32)
        for i in indices.tolist():
            self._drives.pop(i, None)

    def __call__(self, obs: object) -> npt.NDArray[np.float32]:
        """Return the actions [E, 3] of all worlds; zeros where no planner drives.

        Raises:
            PolicyError: If the planner raises; names the scene and the step.
        """
        assert self._worlds is not None, "reset comes first"
        native = self._worlds.native
        steps = np.zeros((native.num_worlds, len(self._bounds)), np.float32)
        for i in range(native.num_worlds):
            if native.slot_agents(i)[0] is None or not native.slot_alive(i)[0]:
                continue
            status = native.status(i)
            where = f"{self._worlds.scenes[status.scene_idx].name} at step {status.elapsed_steps}"
            with raised_by(self._settings.name, where):
                drive, planner = self._drives.get(i) or self._begin(i)
                given = drive.input()
                steps[i] = drive.follow(given, planner.compute_trajectory(given))
        # zero means zero, and each side has its own bound
        most = np.where(steps > 0, self._bounds[:, 1], -self._bounds[:, 0])
        return np.clip(steps / most, -1.0, 1.0)  # type: ignore[no-any-return]

    def _begin(self, world_idx: int) -> tuple[Drive, Any]:
        assert self._worlds is not None, "reset comes first"
        idx = self._worlds.native.status(world_idx).scene_idx
        if idx not in self._maps:
            scene = self._worlds.scenes[idx]
            self._maps[idx] = SceneMap(scene.map_layers(), scene.location or "scene")
        drive = Drive(self._worlds, world_idx, self._maps[idx])
        planner = self._settings.make()
        planner.initialize(drive.initialization)
        self._drives[world_idx] = drive, planner
        return drive, planner
