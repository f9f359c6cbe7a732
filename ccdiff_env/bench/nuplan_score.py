"""nuPlan's own closed-loop score of recorded episodes, by the metric classes of nuplan-devkit.

As in nuPlan's simulation, the ego's acceleration is that along its heading.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from ccdiff_env.bench.planner_score import score_of
from ccdiff_env.interop.nuplan.devkit import find_devkit
from ccdiff_env.interop.nuplan.settings import made_of, of_devkit
from ccdiff_env.record.rollout import Rollout

#: nuPlan's metrics by the names that their parts of the score have here.
PARTS = {
    "no_at_fault_collision": "no_ego_at_fault_collisions",
    "on_road": "drivable_area_compliance",
    "makes_progress": "ego_is_making_progress",
    "right_way": "driving_direction_compliance",
    "ttc": "time_to_collision_within_bound",
    "progress": "ego_progress_along_expert_route",
    "speed_limit": "speed_limit_compliance",
    "comfort": "ego_is_comfortable",
}


def nuplan_score(rollout: Rollout, expert_steps: int) -> dict[str, float]:
    """Return nuPlan's score of an episode, ``score``, and its parts by names of :data:`PARTS`.

    Gates and weights are those of its ``closed_loop_*_agents_weighted_average.yaml``, which the
    protocol has, too. Progress is compared with ``expert_steps`` of the log, from the episode's
    beginning.

    Raises:
        MissingFeatureError: If there is no nuplan-devkit.
    """
    found = nuplan_metrics(rollout, expert_steps)
    parts = {ours: float(found[theirs].metric_score) for ours, theirs in PARTS.items()}
    return {**parts, "score": score_of(parts)}


def nuplan_metrics(rollout: Rollout, expert_steps: int) -> dict[str, Any]:
    """Return nuPlan's results of an episode by name of the metric, as :func:`nuplan_score`.

    Bounds are those of the devkit's files of settings.
    """
    find_devkit()
    history, expert = _history(rollout, expert_steps)
    metrics, found = _Metrics(), {}
    for name in PARTS.values():
        metrics[name]
    with np.errstate(invalid="ignore"):  # of an ego beside its route, in shapely
        for name, metric in metrics.items():  # those that others ask come before them
            found[name] = metric.compute(history, expert)[0]
    return found


def _history(rollout: Rollout, expert_steps: int) -> tuple[Any, Any]:
    """Return an episode as nuPlan's history, and a scenario that knows the logged drive alone."""
    from nuplan.common.actor_state.state_representation import TimePoint
    from nuplan.planning.simulation.history.simulation_history import (
        SimulationHistory,
        SimulationHistorySample,
    )
    from nuplan.planning.simulation.simulation_time_controller.simulation_iteration import (
        SimulationIteration,
    )

    from ccdiff_env.interop.nuplan.scene_map import SceneMap
    from ccdiff_env.interop.nuplan.states import SceneStates

    scene, start = rollout.scene, rollout.start_step
    states = SceneStates(scene, rollout.agent_ids.index("ego"))
    drive = {name: getattr(rollout, name) for name in ("position", "heading", "velocity", "valid")}
    if rollout.elevation_m is not None:
        drive["elevation_m"] = rollout.elevation_m
    first = rollout.info["acceleration"][:1]
    accelerations = np.concatenate([first, rollout.info["acceleration"]])
    log = scene.tracks()
    now = slice(start, min(start + expert_steps + 1, scene.num_steps))
    logged = {name: log[name][:, now] for name in drive}  # type: ignore[literal-required]
    scene_map = SceneMap(scene.map_layers(), scene.location or "scene")
    samples = [
        SimulationHistorySample(
            SimulationIteration(TimePoint(ego.time_us), step),
            ego,
            None,
            states.tracks(
                {name: array[:, step] for name, array in drive.items()},
                rollout.valid[:, step],
                ego.time_us,
            ),
            scene_map.traffic_lights(start + step, ego.time_us),
        )
        for step, ego in states.drive(drive, rollout.dt_s, start, accelerations)
    ]
    expert = [ego for _, ego in states.drive(logged, rollout.dt_s, start)]
    goal = expert[-1].center
    return SimulationHistory(scene_map, goal, samples), SimpleNamespace(
        get_expert_ego_trajectory=lambda: expert
    )


class _Metrics(dict[str, Any]):
    """nuPlan's metrics, made as they are asked for, each after those that it asks itself."""

    def __missing__(self, name: str) -> Any:
        values = of_devkit(f"common/simulation_metric/*/{name}_statistics")
        asked = values.pop("required_metrics", {})
        others = {key: self[other.removesuffix("_statistics")] for key, other in asked.items()}
        made = self[name] = made_of({**values, **others}, name)
        return made
