"""The paper's experiments: who drives K vehicles of each scene, and what comes of it.

The protocol is that of the released evaluation (reference.md#closed-loop-evaluation): an episode
starts at step 31 of the log with the vehicles that are there then and lasts 10 s, in scenes of
9.1 s as those of planners (:data:`.SHORT_WINDOW`); nobody enters later, vehicles vanish with their
log, contacts and departures from the road have no consequence.
The K vehicles of the control set are driven by the method, all others replay the log.

Differs from the paper: control sets are found at the start of the episode from the logged history,
by the same ranking for every method, and filled up by nearness, not at random
(reference.md#other-rankings). They hold moving vehicles only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.jobs import Job, chunk_jobs
from ccdiff_env.bench.methods import (
    METHODS,
    OTHERS,
    OWN_RANKINGS,
    REORDERED,
    Method,
    on_device,
    plan_steps,
    resolved,
)
from ccdiff_env.bench.planners import SHORT_WINDOW
from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError
from ccdiff_env.metrics import Motion, OffRoad, causal, speed_limit
from ccdiff_env.record.episode import begin, play, recorders_of
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.system.files import file_name
from ccdiff_env.system.settings import sha256
from ccdiff_env.traffic import NETWORKS, PAPER_PROTOCOL, SWIFT, TrafficPlan

#: Step of the log at which an episode starts (released: ``history_num_frames + 1``), and its steps.
PAPER_WINDOW: dict[str, int] = {name: PAPER_PROTOCOL[name] for name in SHORT_WINDOW}
STEP_S: float = WorldConfig().dt_s
#: Scenes that share a batch of the network: fixed, so that results do not depend on the workers.
CHUNK = 12
_PLANNERS = {*NETWORKS} - {SWIFT}  #: Drivers whose plans may be made at other times.
PAST_STEPS = 30  #: Logged steps that rankings look at, the present one left out.
RANDOM_DRAWS = 3  #: Seeds that a random ranking is drawn and played with.
STATIONARY_MPS = 0.5  #: Speed below which a logged vehicle counts as standing, m/s.


def traffic_jobs(
    source: str,
    methods: Sequence[str],
    *,
    num_controlled: Sequence[int | None] = (1, 2, 3, 4, 5, 10, None),
    replan_steps: Sequence[int] = (5,),
    replan_controlled: Sequence[int | None] | None = None,
    weights: Mapping[str, str] | None = None,
    seed: int = 0,
    strengths: Sequence[float] = (),
    keep: str | None = None,
    others: str = OTHERS[0],
) -> list[Job]:
    """Return the jobs of a traffic benchmark: methods x K x replan period x chunks of the scenes.

    With ``strengths``, guided methods are played at those criticalities, not at their own.

    The floor, K = 0, is always among them; K = ``None`` is all vehicles. All periods are played at
    the K of ``replan_controlled`` (all by default), the first one alone at the others. What cannot
    differ is not played twice: other periods of methods that do not plan, and all vehicles by
    another ranking than that of ``ccdiff``, where that one is asked for.
    """
    window_of(source)
    asked = [k for k in (*num_controlled, *(replan_controlled or ())) if k is not None]
    for what, least, values in (("K", 0, asked), ("T in steps", 1, replan_steps)):
        if any(value < least for value in values):
            raise ConfigError(f"{what} is {min(values)}, expected at least {least}")
    conditions: list[tuple[str, int | None, int]] = [(others, 0, 5)]
    guided = {name for name in methods if strengths and METHODS[name].ccdiff.get("criticality")}
    methods = [
        own
        for name in methods
        for own in (
            [METHODS.with_strength(name, x) for x in strengths] if name in guided else [name]
        )
    ]
    for method in (m for m in methods if m != "replay"):
        if (played := METHODS[method]).driver in _PLANNERS:
            most = plan_steps(played.with_weights(weights or {}))
            if (steps := max(replan_steps)) > most:
                raise ConfigError(
                    f"--t is {steps * STEP_S:g}, expected at most {most * STEP_S:g} s, as long as "
                    f"the plans of {method}"
                )
        for k in num_controlled:
            if k is None and method in REORDERED and "ccdiff" in methods:
                continue
            every = METHODS[method].driver in _PLANNERS and k in (replan_controlled or (k,))
            conditions += [(method, k, n) for n in (replan_steps if every else replan_steps[:1])]
    given: dict[str, Any] = {"seed": seed, **({"weights": dict(weights)} if weights else {})}
    given |= {"keep": keep} if keep is not None else {}
    given |= {"others": others} if others != OTHERS[0] else {}
    return [
        job
        for method, k, n in conditions
        for job in chunk_jobs(
            f"{quote(method, safe=':')}-K{'Full' if k is None else k}-T{n}",
            f"{__name__}:evaluate",
            source, CHUNK, method=method, num_controlled=k, replan_steps=n, **given,
        )
    ]  # fmt: skip


def window(scene: Scene) -> dict[str, int]:
    """Return the steps of a scene before its episode and those that it lasts."""
    return PAPER_WINDOW if scene.num_steps >= sum(PAPER_WINDOW.values()) else SHORT_WINDOW


def window_of(source: str) -> dict[str, int] | None:
    """Return the window that all scenes have, ``None`` where it is the paper's.

    Raises:
        ConfigError: If a scene has another one, is too short or has other steps; names it.
    """
    scenes, most = scenes_of(source), sum(PAPER_WINDOW.values())
    wanted, cut = window(first := scenes[0]), scenes.window
    if cut is not None and cut.steps(first.dt) != tuple(wanted.values()):
        raise ConfigError(
            f"{source}: windows of {cut.window_s:g} s cannot be played, expected "
            "window_s=10&history_s=3 or window_s=8&history_s=1"
        )
    least = sum(SHORT_WINDOW.values()) + 1
    for scene in scenes:
        short = scene.num_steps < least or abs(scene.dt - STEP_S) > 1e-3
        if short or window(scene) is not wanted:
            raise ConfigError(
                f"scene {scene.name!r} has {scene.num_steps} steps of {scene.dt:g} s, expected at "
                f"least {most} of {STEP_S:g} s, or {least} to {most - 1} in every scene"
            )
    return None if wanted is PAPER_WINDOW else wanted


def _vehicles(scene: Scene) -> npt.NDArray[np.int64]:
    """Vehicles that are there, and on the road, at the start; the ego in any case (as released)."""
    step = window(scene)["history_steps"]
    there = scene.tracks()["valid"][:, step] & (np.array(scene.agent_types) == "vehicle")
    agents = np.flatnonzero(there)
    start = motion_of(scene, scene.tracks(), agents, slice(step, step + 1))
    road = off_road(scene, start)
    if road is None:
        return agents
    on_road = ~road.centroid[:, 0]
    kept: npt.NDArray[np.int64] = agents[on_road | (np.array(scene.agent_ids)[agents] == "ego")]
    return kept


def control_set(scene: Scene, ranking: str, top_k: int | None, seed: int = 0) -> list[int]:
    """Return the first K moving vehicles of a ranking at the start of the episode.

    A short ranking is filled up by time to contact, then distance. Vehicles that stand at the start
    never move in CCDiff traffic: all rankings pass them over. ``None`` is all vehicles, the
    standing ones last. A random ranking is drawn by the scene's content and the seed.
    """
    agents, step = _vehicles(scene), window(scene)["history_steps"]
    velocity = scene.tracks()["velocity"][agents, step]
    moving = np.linalg.norm(velocity, axis=-1) > STATIONARY_MPS
    ttc, distance = relations(scene, agents, step)
    ranked = causal.rank(
        ranking,  # type: ignore[arg-type]
        top_k=len(agents),
        valid=np.ones(len(agents), bool),
        ttc=ttc,
        distance=distance,
        seed=int(sha256(f"{scene.hash} {seed}")[:16], 16),
    )
    movers = [int(agents[i]) for i in ranked.agents if moving[i]]
    if top_k is not None:
        return movers[:top_k]
    return movers + [int(agents[i]) for i in ranked.agents if not moving[i]]


def episodes(
    scenes: SceneSet,
    method: Method,
    *,
    num_controlled: int | None,
    replan_steps: int = 5,
    seed: int = 0,
    others: str = OTHERS[0],
) -> list[Episode]:
    """Play every scene once, all in one batch.

    K vehicles are driven by the method, all for ``None``, the rest by ``others``. Networks plan
    every ``replan_steps``.
    """
    method = resolved(method)
    # the control set is named below, so that everybody else is driven by the others' driver
    ccdiff = {
        **PAPER_PROTOCOL["ccdiff"],
        "background_driver": "ccdiff",
        "criticality": 0.0,
        "num_samples": 1,
        "replan_steps": replan_steps,
        **method.options(),
    }
    own = method.ranking in OWN_RANKINGS and num_controlled != 0
    if own:
        ccdiff |= {"ranking": method.ranking, "num_guided": num_controlled}
        ccdiff["background_driver"] = others
    if method.driver == SWIFT:
        ccdiff = method.options()
    config = WorldConfig().with_options(
        **{
            **PAPER_PROTOCOL,
            **window(scenes[0]),
            "traffic": method.driver,
            "driver": "replay",
            "autoreset": "disabled",
            "dt_s": scenes[0].dt,
            "ccdiff": ccdiff if method.driver in NETWORKS else {},
        }
    )
    # a model given by its path drives under a name
    driver = config.traffic if isinstance(config.traffic, str) else method.driver
    worlds = begin(scenes, config, seed)
    native = worlds.native
    everyone = range(len(scenes))
    chosen = [
        _vehicles(scene).tolist()
        if own
        else control_set(scene, method.ranking, num_controlled, seed)
        for scene in scenes
    ]
    for i in everyone:
        kinds = np.array(scenes[i].agent_types) == "vehicle"
        native.assign(i, np.flatnonzero(kinds).tolist(), others)
        if chosen[i]:
            native.assign(i, chosen[i], driver)
        if method.driver in NETWORKS and not own:
            native.override_plan(i, guided=chosen[i], criticality=None)
    recorders = recorders_of(worlds, scenes.names)
    for _ in play(worlds, recorders=recorders, most=window(scenes[0])["horizon_steps"]):
        pass
    rollouts = [recorder.rollout() for recorder in recorders.values()]
    if own:
        first = (rollout.plans[:1] for rollout in rollouts)
        chosen = [plan[0].agents[plan[0].follows_plan].tolist() if plan else [] for plan in first]
    return [Episode.of(rollout, some) for rollout, some in zip(rollouts, chosen, strict=True)]


def evaluate(
    *,
    source: str,
    names: Sequence[str],
    method: str,
    num_controlled: int | None,
    replan_steps: int,
    seed: int,
    weights: Mapping[str, str] | None = None,
    keep: str | None = None,
    device: str = "cpu",
    others: str = OTHERS[0],
) -> list[dict[str, Any]]:
    """Play scenes and measure them: one dictionary per scene, see docs/evaluation.md.

    With a random ranking there is one per scene and seed: :data:`RANDOM_DRAWS` of them, from
    ``seed`` on. ``keep`` as for :func:`kept_rollouts`.
    """
    METHODS.add(weights or {})
    chosen = on_device(METHODS[method].with_weights(weights or {}), device)
    draws = RANDOM_DRAWS if chosen.ranking == "random" else 1
    condition = f"{method}-K{num_controlled}-T{replan_steps}"
    return [
        {
            **measure(episode, replan_steps),
            "seed": drawn,
            **kept_rollouts(keep, condition, {drawn: episode}),
        }
        for drawn in range(seed, seed + draws)
        for episode in episodes(
            scenes_of(source, names),
            chosen,
            num_controlled=num_controlled,
            replan_steps=replan_steps,
            seed=drawn,
            others=others,
        )
    ]


def motion_hash(rollout: Rollout) -> str:
    """Return the SHA-256 of who was where, which does not depend on who compressed the file."""
    arrays = (rollout.position, rollout.heading, rollout.velocity, rollout.valid, rollout.drivers)
    return sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays))


def kept_rollouts(
    keep: str | None, condition: str, played: Mapping[int, Episode]
) -> dict[str, list[str]]:
    """Save the rollouts of a scene, by seed, in the folder ``keep``: ``kept`` are their names.

    ``""`` saves none, ``kept`` are hashes of who was where; ``None`` says nothing.
    """
    if keep is None:
        return {}
    rollouts = {seed: episode.rollout for seed, episode in played.items() if episode.rollout}
    if not keep:
        return {"kept": [motion_hash(rollout) for rollout in rollouts.values()]}
    folder, names = Path(keep), list[str]()
    for seed, rollout in rollouts.items():
        names.append(file_name(f"{condition}-{rollout.scene.name}-{seed}", ".npz"))
        rollout.save(folder / names[-1])
    return {"kept": names}


def relations(
    scene: Scene, agents: npt.NDArray[np.int64], step: int
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return normalised times to contact and distances of A agents in the log up to a step.

    Both are [T, A, A], in [0, 1].
    """
    tracks = scene.tracks()
    past = slice(max(step - PAST_STEPS, 0), step + 1)
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


@dataclass(frozen=True)
class Episode:
    """What happened in one scene: vehicles that were there at the start, A of them."""

    scene: Scene
    agents: npt.NDArray[np.int64]
    chosen: list[int]  #: The control set by falling importance, indices in the scene.
    controlled: npt.NDArray[np.bool_]  #: Whether each of the A vehicles is in it.
    motion: Motion
    log: Motion
    plans: tuple[TrafficPlan, ...]
    rollout: Rollout | None = None  #: The recording.

    @classmethod
    def of(cls, rollout: Rollout, chosen: list[int]) -> Episode:
        """Return what a recording shows of a control set."""
        agents = _vehicles(rollout.scene)
        both = motions(rollout, agents)
        return cls(
            rollout.scene, agents, chosen, np.isin(agents, chosen), *both, rollout.plans, rollout
        )


def motions(rollout: Rollout, agents: npt.NDArray[np.int64]) -> tuple[Motion, Motion]:
    """Return the motion of agents in a recording, and that of the log at the same steps."""
    scene, start = rollout.scene, rollout.start_step
    log = motion_of(scene, scene.tracks(), agents, slice(start, start + rollout.num_steps))
    return motion_of(scene, rollout.tracks(), agents), log


def motion_of(
    scene: Scene,
    tracks: Mapping[str, Any],
    agents: npt.NDArray[np.int64],
    steps: slice = slice(None),
) -> Motion:
    """Return the motion of agents over some steps of tracks: those of the scene, or recorded."""
    some = {name: array[agents, steps] for name, array in tracks.items()}
    return Motion(
        some["position"],
        some["heading"],
        scene.sizes[agents][:, :2],
        some["valid"],
        dt_s=scene.dt,
        elevation_m=some.get("elevation_m"),
    )


def off_road(scene: Scene, motion: Motion, replan_steps: int = 5) -> OffRoad | None:
    """Test a motion against the drivable area; ``None`` where the scene has no road."""
    if not scene.has_road:
        return None
    layers = scene.map_layers()
    polygons = [(area["exterior"], area["holes"]) for area in layers["drivable_area"]]
    heights = layers.get("elevation_m", {}).get("drivable_area")
    return motion.off_road(polygons, replan_steps=replan_steps, elevation_m=heights)


def measure(episode: Episode, replan_steps: int = 5) -> dict[str, Any]:
    """Return the figures of one episode, all of them finite or ``None``."""
    motion, log, controlled = episode.motion, episode.log, episode.controlled
    found = motion.collisions(controlled=controlled, log=log)
    road = off_road(episode.scene, motion, replan_steps)
    displacement = motion.displacement(log)
    ade, fde = displacement.mean()
    fde_controlled = displacement.mean(controlled)[1] if controlled.any() else np.nan
    hard, jerky = motion.harsh(counted=controlled)
    tracks = episode.scene.tracks()
    speed = np.linalg.norm(tracks["velocity"][episode.agents], axis=-1)
    start = window(episode.scene)["history_steps"]
    limit = speed_limit(np.where(tracks["valid"][episode.agents], speed, np.nan))
    known = bool(np.isfinite(limit))
    return {
        "scene": episode.scene.name,
        "num_agents": len(episode.agents),
        "num_moving": int((speed[:, start] > STATIONARY_MPS).sum()),
        "num_controlled": int(controlled.sum()),
        "scr": found.any(),
        "scr_new": found.any("new"),
        "scr_controlled": found.any("controlled_new"),
        "scr_by_controlled": found.any("by_controlled"),
        "collision_rate": found.agent_rate["new"],
        "orr": road and 100.0 * road.centroid_rate,
        "orr_box": road and 100.0 * road.box_rate,
        "orr_reference_impl": road and 100.0 * road.reference_impl_rate,
        "ade": _number(ade),
        "fde": _number(fde),
        "fde_controlled": _number(fde_controlled),
        "comfort": motion.comfort().tolist(),
        "comfort_end_bins": motion.comfort(end_bins=True).tolist(),
        "comfort_reference_impl": motion.comfort(axes="reference_impl").tolist(),
        "hard_acceleration": _number(100.0 * hard),
        "hard_jerk": _number(100.0 * jerky),
        "sor": known and bool(motion.over_speed(limit, counted=controlled).any()),
        "min_ttc_s": _number(motion.min_ttc().min() if len(episode.agents) else np.nan),
        **guidance_cost(episode.plans),
    }


def guidance_cost(plans: Sequence[TrafficPlan]) -> dict[str, float | None]:
    """Return how far guidance moved plans by 2 s, ``moved_m``: mean over the guided plans of
    vehicles, ``None`` without any.
    """
    arrays = [plan.moved_m[plan.guided] for plan in plans if plan.moved_m is not None]
    values = np.concatenate([*arrays, np.zeros(0)])
    return {"moved_m": _number(values.mean() if len(values) else np.nan)}


def _number(value: Any) -> float | None:
    number = float(value)
    return number if np.isfinite(number) else None
