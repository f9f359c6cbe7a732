"""What happened in one scene of the traffic benchmark, and what is measured on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.metrics import Motion, OffRoad, causal, speed_limit
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene
from ccdiff_env.traffic import TrafficPlan

PAST_STEPS = 30  #: Logged steps that rankings look at, the present one left out.


def relations(
    scene: Scene, agents: npt.NDArray[np.int64], step: int
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return normalised times to contact and distances of A agents in the log up to a step.

    Both are [T, A, A], in [0, 1].
    """
    tracks = scene.tracks()
    past = slice(step - PAST_STEPS, step + 1)
    position, heading, velocity, valid = (
        tracks[name][agents, past].swapaxes(0, 1)
        for name in ("position", "heading", "velocity", "valid")
    )
    speed = velocity[..., 0] * np.cos(heading) + velocity[..., 1] * np.sin(heading)
    heights = tracks["elevation_m"][agents, past].T if "elevation_m" in tracks else None
    sizes = scene.sizes[agents][:, :2]
    return (
        causal.ttc(position, heading, speed, sizes, valid, elevation_m=heights),
        causal.distance(position, valid, elevation_m=heights, normalised=True),
    )


@dataclass
class Episode:
    """What happened in one scene: vehicles that were there at the start, A of them."""

    scene: Scene
    agents: npt.NDArray[np.int64]
    chosen: list[int]  #: The control set by falling importance, indices in the scene.
    controlled: npt.NDArray[np.bool_]  #: Whether each of the A vehicles is in it.
    motion: Motion
    log: Motion
    position: npt.NDArray[np.float32]
    heading: npt.NDArray[np.float32]
    plans: list[TrafficPlan]
    start_step: int  #: Step of the log at which it starts.
    recorded: Rollout | None = None


def logged(scene: Scene, agents: npt.NDArray[np.int64], steps: slice) -> Motion:
    """Return the logged motion of agents over some steps."""
    tracks = scene.tracks()
    position, heading, valid = (
        tracks[name][agents, steps] for name in ("position", "heading", "valid")
    )
    return Motion(
        position,
        heading,
        scene.sizes[agents][:, :2],
        valid,
        dt_s=scene.dt,
        elevation_m=tracks["elevation_m"][agents, steps] if "elevation_m" in tracks else None,
    )


def driven(rollout: Rollout, agents: npt.NDArray[np.int64]) -> Motion:
    """Return the recorded motion of agents."""
    return Motion(
        rollout.position[agents],
        rollout.heading[agents],
        rollout.scene.sizes[agents][:, :2],
        rollout.valid[agents],
        dt_s=rollout.dt_s,
        elevation_m=None if rollout.elevation_m is None else rollout.elevation_m[agents],
    )


def drivable(scene: Scene) -> list[tuple[Any, Any]]:
    """Return the drivable area as polygons: exterior and holes."""
    return [(p["exterior"], p["holes"]) for p in scene.map_layers()["drivable_area"]]


def off_road(scene: Scene, motion: Motion, replan_steps: int = 5) -> OffRoad | None:
    """Test a motion against the drivable area; ``None`` where the scene has no road."""
    if not scene.has_road:
        return None
    heights = scene.map_layers().get("elevation_m", {}).get("drivable_area")
    return motion.off_road(drivable(scene), replan_steps=replan_steps, elevation_m=heights)


def measure(episode: Episode, replan_steps: int = 5) -> dict[str, Any]:
    """Return the figures of one episode, all of them finite or ``None``."""
    motion, log, controlled = episode.motion, episode.log, episode.controlled
    found = motion.collisions(controlled=controlled, log=log)
    road = off_road(episode.scene, motion, replan_steps)
    displacement = motion.displacement(log)
    ade, fde = displacement.mean()
    fde_controlled = displacement.mean(controlled)[1] if controlled.any() else np.nan
    tracks = episode.scene.tracks()
    speed = np.linalg.norm(tracks["velocity"][episode.agents], axis=-1)
    limit = speed_limit(np.where(tracks["valid"][episode.agents], speed, np.nan))
    known = bool(np.isfinite(limit))
    cost, shift = (
        [getattr(p, name)[p.guided] for p in episode.plans if p.guided.any()]
        for name in ("realism_cost", "shift_sigmas")
    )
    return {
        "scene": episode.scene.name,
        "num_agents": len(episode.agents),
        "num_controlled": int(controlled.sum()),
        "collision": {v: bool(found.any(v)) for v in found.agents},
        "collision_rate": {v: float(rate) for v, rate in found.agent_rate.items()},
        "off_road": road and road.centroid_rate,
        "off_road_box": road and road.box_rate,
        "off_road_reference_impl": road and road.reference_impl_rate,
        "ade_m": _number(ade),
        "fde_m": _number(fde),
        "fde_controlled_m": _number(fde_controlled),
        "comfort": motion.comfort().tolist(),
        "comfort_reference_impl": motion.comfort(axes="reference_impl").tolist(),
        "over_speed": known and bool(motion.over_speed(limit, counted=controlled).any()),
        "min_ttc_s": _number(motion.min_ttc().min() if len(episode.agents) else np.nan),
        "realism_cost": _number(np.concatenate(cost).mean() if cost else np.nan),
        "shift_sigmas": _number(np.concatenate(shift).mean() if shift else np.nan),
        "conflict_share": _number(_conflict_share(episode.plans)),
    }


def _conflict_share(plans: list[TrafficPlan]) -> float:
    """Share of the denoising steps and samples in which the gradients of realism and guidance
    oppose, mean over guided vehicles that have a gradient and over plans; NaN without any.
    """
    shares = [
        p.conflict_share[p.guided & (p.realism_cosine != 0.0)]
        for p in plans
        if p.realism_cosine is not None and p.conflict_share is not None
    ]
    found = np.concatenate(shares) if shares else np.zeros(0)
    return float(found.mean()) if found.size else np.nan


def _number(value: Any) -> float | None:
    number = float(value)
    return number if np.isfinite(number) else None
