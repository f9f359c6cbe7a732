"""The paper's experiments: who drives K vehicles of each scene, and what comes of it.

The protocol is that of the released evaluation (reference.md#closed-loop-evaluation): an episode
starts at step 31 of the log with the vehicles that are there then and lasts 10 s; nobody enters
later, vehicles vanish with their log, contacts and departures from the road have no consequence.
The K vehicles of the control set are driven by the method, all others replay the log.

Differs from the paper: control sets are found at the start of the episode from the logged history,
by the same ranking for every method, and filled up by nearness, not at random
(reference.md#other-rankings). They hold moving vehicles only.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any
from urllib.parse import quote

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.episode import Episode, logged, measure, off_road, relations
from ccdiff_env.bench.jobs import Job
from ccdiff_env.bench.methods import METHODS, OWN_RANKINGS, REORDERED, Method, on_device
from ccdiff_env.bench.scenes import chunks, scene_names, scenes_of
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import UnknownNameError
from ccdiff_env.metrics import Motion, causal
from ccdiff_env.record.episode import begin, play, recorders_of
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.traffic import NETWORKS, PAPER_PROTOCOL, SWIFT, TrafficPlan

#: Step of the log at which an episode starts (released: ``history_num_frames + 1``).
START_STEP: int = PAPER_PROTOCOL["history_steps"]
HORIZON_STEPS: int = PAPER_PROTOCOL["horizon_steps"]
#: Scenes that share a batch of the network: fixed, so that results do not depend on the workers.
CHUNK = 12
_PLANNERS = {*NETWORKS} - {SWIFT}  #: Drivers whose plans may be made at other times.
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
) -> list[Job]:
    """Return the jobs of a traffic benchmark: methods x K x replan period x chunks of the scenes.

    The floor, K = 0, is always among them. What cannot differ is not played twice: other periods of
    methods that do not plan, and all vehicles by another ranking than that of ``ccdiff``, where
    that one is asked for.

    Args:
        num_controlled: Numbers of controlled vehicles K; ``None`` is all.
        replan_controlled: Those K at which all periods are played, the first one alone at the
            others; all K for ``None``.
        weights: Weight files by driver, in place of the shipped ones.

    Raises:
        UnknownNameError: For a method that does not exist.
    """
    for name in methods:
        if name not in METHODS:
            raise UnknownNameError(f"no method {name!r}, there are {', '.join(METHODS)}")
    names = scene_names(source)
    conditions: list[tuple[str, int | None, int]] = [("replay", 0, 5)]
    for method in (m for m in methods if m != "replay"):
        for k in num_controlled:
            if k is None and method in REORDERED and "ccdiff" in methods:
                continue
            every = METHODS[method].driver in _PLANNERS and k in (replan_controlled or (k,))
            conditions += [(method, k, n) for n in (replan_steps if every else replan_steps[:1])]
    return [
        Job(
            f"{quote(method, safe=':')}-K{'Full' if k is None else k}-T{n}-{i:03d}",
            f"{__name__}:evaluate",
            {
                "source": source,
                "names": part,
                "method": method,
                "num_controlled": k,
                "replan_steps": n,
                "seed": seed,
                **({"weights": dict(weights)} if weights else {}),
            },
        )
        for method, k, n in conditions
        for i, part in enumerate(chunks(names, CHUNK))
    ]


def _vehicles(scene: Scene) -> npt.NDArray[np.int64]:
    """Vehicles that are there, and on the road, at the start; the ego in any case (as released)."""
    there = scene.tracks()["valid"][:, START_STEP] & (np.array(scene.agent_types) == "vehicle")
    agents = np.flatnonzero(there)
    start = logged(scene, agents, slice(START_STEP, START_STEP + 1))
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
    standing ones last.
    """
    agents = _vehicles(scene)
    velocity = scene.tracks()["velocity"][agents, START_STEP]
    moving = np.linalg.norm(velocity, axis=-1) > STATIONARY_MPS
    ttc, distance = relations(scene, agents, START_STEP)
    ranked = causal.rank(
        ranking,  # type: ignore[arg-type]
        top_k=len(agents),
        valid=np.ones(len(agents), bool),
        ttc=ttc,
        distance=distance,
        seed=seed,
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
    options: Mapping[str, Any] | None = None,
    record: Collection[str] = (),
    explain: bool = False,
) -> list[Episode]:
    """Play every scene once, all in one batch.

    K vehicles are driven by the method, all for ``None``; 0 replays the log. Networks plan every
    ``replan_steps``. Neither ``record`` (names of scenes) nor ``explain`` (whether guided plans say
    how their gradients agree) changes the episodes.
    """
    # the control set is named below, so that everybody else replays the log by its driver
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
        ccdiff["background_driver"] = "replay"
    # only guidance has gradients to tell of
    ccdiff["explain"] = explain and ccdiff["criticality"] > 0.0
    if method.driver == SWIFT:
        ccdiff = method.options()
    config = WorldConfig().with_options(
        **{
            **PAPER_PROTOCOL,
            "traffic": method.driver,
            "driver": "replay",
            "autoreset": "disabled",
            "dt_s": scenes[0].dt,
            "ccdiff": ccdiff if method.driver in NETWORKS else {},
            **(options or {}),
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
        native.assign(i, np.flatnonzero(kinds).tolist(), "replay")
        if chosen[i]:
            native.assign(i, chosen[i], driver)
        if method.driver in NETWORKS and not own:
            native.override_plan(i, guided=chosen[i][: method.num_guided], criticality=None)
    states = [[native.states(i)] for i in everyone]
    plans: list[list[TrafficPlan]] = [[] for _ in everyone]
    recorders = recorders_of(worlds, record, method=method.label)
    for step, (_, _, out) in enumerate(play(worlds, recorders=recorders, most=HORIZON_STEPS)):
        for i in everyone:
            states[i].append(native.states(i))
            due = method.driver in NETWORKS and step % config.ccdiff.replan_steps == 0
            plan = worlds.explain(i) if due else None
            if plan is not None and plan.made_at == step:
                plans[i].append(plan)
        if out.done.any():
            break
    if own:
        chosen = [p[0].agents[p[0].follows_plan].tolist() if p else [] for p in plans]
    found = [_episode(scenes[i], chosen[i], states[i], plans[i]) for i in everyone]
    for i, recorder in recorders.items():
        found[i].recorded = recorder.rollout()
    return found


def _episode(
    scene: Scene, chosen: Sequence[int], states: Sequence[Any], plans: list[TrafficPlan]
) -> Episode:
    agents = _vehicles(scene)
    stacked = {
        name: np.stack([s[name] for s in states], axis=1)[agents]
        for name in ("position", "heading", "active", "elevation_m")
        if name in states[0]
    }
    return Episode(
        scene=scene,
        agents=agents,
        chosen=list(chosen),
        controlled=np.isin(agents, chosen),
        start_step=START_STEP,
        motion=Motion(
            stacked["position"],
            stacked["heading"],
            scene.sizes[agents][:, :2],
            stacked["active"],
            dt_s=scene.dt,
            elevation_m=stacked.get("elevation_m"),
        ),
        log=logged(scene, agents, slice(START_STEP, START_STEP + len(states))),
        position=stacked["position"],
        heading=stacked["heading"],
        plans=plans,
    )


def evaluate(
    *,
    source: str,
    names: Sequence[str],
    method: str,
    num_controlled: int | None,
    replan_steps: int,
    seed: int,
    weights: Mapping[str, str] | None = None,
    device: str = "cpu",
    record: Collection[str] = (),
) -> tuple[list[dict[str, Any]], dict[str, Rollout]]:
    """Play scenes and measure them: one dictionary per scene, see docs/evaluation.md.

    Returned beside them are the episodes of the scenes to ``record``, by name.
    """
    played = episodes(
        scenes_of(source, names),
        on_device(METHODS[method].with_weights(weights or {}), device),
        num_controlled=num_controlled,
        replan_steps=replan_steps,
        seed=seed,
        record=record,
        explain=True,
    )
    rows = [measure(episode, replan_steps) for episode in played]
    return rows, {e.scene.name: e.recorded for e in played if e.recorded is not None}
