"""Planners against traffic: every planner in every traffic, scored as nuPlan's closed loop does.

The score of a scene is a product of what must not happen and a weighted mean of the rest (nuPlan,
closed-loop non-reactive and reactive challenges):

    score = no_at_fault_collision x on_road x makes_progress x right_way
            x (5 ttc + 5 progress + 4 speed_limit + 2 comfort) / 16

Differs from nuPlan: progress is measured along the logged route up to its goal, comfort is the
share of steps within the limits, a collision with a static obstacle counts as any other, and half
points are not given.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.adversary_policy import REPLAN_STEPS, AdversaryPolicy
from ccdiff_env.bench.jobs import Job
from ccdiff_env.bench.methods import NamedDrivers
from ccdiff_env.bench.pdm import PdmPlanner
from ccdiff_env.bench.scenes import chunks, scene_names, scenes_of
from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.worlds import Worlds
from ccdiff_env.errors import UnknownNameError, renamed
from ccdiff_env.files import file_name
from ccdiff_env.planners import Ego, Seat, ego_driver
from ccdiff_env.recorder import Recorder
from ccdiff_env.rollout import Rollout
from ccdiff_env.scenes import SceneSet
from ccdiff_env.traffic import NETWORKS, driver_titles

__all__ = ["TRAFFIC", "Traffic", "drive", "evaluate", "planner_jobs", "planner_score", "play"]

HISTORY_STEPS = 30
#: Scenes that share a batch of the network.
CHUNK = 12
#: Limits of comfort: acceleration forwards, braking, sideways (m/s²), jerk (m/s³), as nuPlan's.
COMFORT = {
    "acceleration": (-4.05, 2.40),
    "lateral_acceleration": (-4.89, 4.89),
    "jerk": (-8.37, 8.37),
}
#: Least share of the route for "makes progress".
LEAST_PROGRESS = 0.2
TTC_BOUND_S = 0.95


@dataclass(frozen=True)
class Traffic:
    """Traffic to test planners in.

    ``draws``: how often a scenario set draws a scene at most, until the ego collides; everywhere
    else it is drawn once. ``adversary_policy``: file of a policy that says who is turned on the
    ego, see :class:`~ccdiff_env.bench.adversary_policy.AdversaryPolicy`.
    """

    label: str
    driver: str
    ccdiff: Mapping[str, Any] = field(default_factory=dict)
    draws: int = 1
    adversary_policy: str | None = None


_TITLES = driver_titles()


def _critical(level: float, driver: str = "ccdiff", *, avoidable_only: bool = False) -> Traffic:
    options = {"criticality": level, "num_samples": 1}
    label = f"{_TITLES[driver]}, criticality {level:g}"
    if not avoidable_only:
        return Traffic(label, driver, options)
    return Traffic(f"{label}, avoidable only", driver, {**options, "avoidable_only": True})


def _named(label: str, name: str) -> Traffic:
    kind, _, path = name.partition(":")
    if renamed("traffic", kind, {"chooser": "adversary"}) != "adversary":
        return Traffic(label, name)
    options = {"criticality": 1.0, "num_samples": 1, "replan_steps": REPLAN_STEPS}
    return Traffic(f"CCDiff, chosen by {Path(path).stem}", "ccdiff", options, adversary_policy=path)


TRAFFIC: dict[str, Traffic] = NamedDrivers(
    _named,
    {
        "replay": Traffic("Log replay", "replay"),
        "idm": Traffic("IDM", "idm"),
        **{
            name: Traffic(f"{_TITLES[name]}, no guidance", name, {"num_samples": 1})
            for name in NETWORKS
        },
        **{f"ccdiff-{level:g}": _critical(level) for level in (0.25, 0.5, 1.0, 2.0)},
        **{f"{name}-1": _critical(1.0, name) for name in NETWORKS},
        **{
            f"ccdiff-{level:g}-avoidable": _critical(level, avoidable_only=True)
            for level in (1.0, 2.0)
        },
        # one vehicle at a time, found by the causal ranking or by time to contact
        **{
            f"ccdiff-1-k1{suffix}": Traffic(
                f"CCDiff, criticality 1, K = 1, {found}",
                "ccdiff",
                {"criticality": 1.0, "num_samples": 1, "num_guided": 1, "ranking": ranking},
            )
            for suffix, found, ranking in (
                ("", "causal ranking", "cliques"),
                ("-ttc", "by time to contact", "ttc"),
            )
        },
        "ccdiff-redrawn": Traffic(
            "CCDiff, no guidance, drawn up to 16 times", "ccdiff", {"num_samples": 1}, draws=16
        ),
    },
)


def planner_jobs(
    source: str,
    planners: Sequence[str],
    traffic: Sequence[str],
    *,
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
) -> list[Job]:
    """Return the jobs of a planner benchmark: planners x traffic x chunks of the scenes.

    Parameters
    ----------
    source
        The scenes, a text of :func:`ccdiff_env.load`.
    planners
        ``constant_velocity``, ``idm``, ``replay``, ``ccdiff``, ``pdm``, a policy of
        :mod:`ccdiff_env.policies` by name, the path of one (``.safetensors``) or of a policy saved
        by stable-baselines3 (``.zip``), or ``module:name`` of a function or class, see
        :func:`play`.
    traffic
        Names of :data:`TRAFFIC`; ``module:Class`` of a model of one's own; ``adversary:FILE`` of a
        policy that ``bench selection`` trained.
    seed
        Seed of the episodes.
    options
        Further fields of :class:`~ccdiff_env.config.WorldConfig`, such as what policies observe.
    """
    for name in traffic:
        if name not in TRAFFIC:
            raise UnknownNameError(f"no traffic {name!r}, there are {', '.join(TRAFFIC)}")
    parts = chunks(scene_names(source), CHUNK)
    return [
        Job(
            f"{p:02d}-{file_name(name, '')}-{seed}-{i:03d}",
            f"{__name__}:evaluate",
            {
                "source": source,
                "names": names,
                "planner": planner,
                "traffic": name,
                "seed": seed,
                **({"options": dict(options)} if options else {}),
            },
        )
        for p, planner in enumerate(planners)
        for name in traffic
        for i, names in enumerate(parts)
    ]


def evaluate(
    *,
    source: str,
    names: Sequence[str],
    planner: str,
    traffic: str,
    seed: int,
    options: Mapping[str, Any] | None = None,
) -> list[dict[str, Any]]:
    """Drive scenes with a planner: one dictionary of metrics and the score per scene."""
    return play(scenes_of(source, names), planner, TRAFFIC[traffic], seed=seed, options=options)


def evaluate_recorded(
    *,
    source: str,
    names: Sequence[str],
    planner: str,
    traffic: str,
    seed: int,
    record: Collection[str],
) -> tuple[list[dict[str, Any]], dict[str, Rollout]]:
    """Do the same as :func:`evaluate`, and record some scenes."""
    return drive(scenes_of(source, names), planner, TRAFFIC[traffic], seed=seed, record=record)


def _seat(planner: Ego) -> tuple[str, Seat | None]:
    """Return the driver of the ego's slot, and who makes its actions."""
    return ("external", Seat(PdmPlanner, "pdm")) if planner == "pdm" else ego_driver(planner)


def play(
    scenes: SceneSet,
    planner: Ego,
    traffic: Traffic,
    *,
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
) -> list[dict[str, Any]]:
    """Drive every scene once, all in one batch: metrics and score of each, see :func:`drive`."""
    return drive(scenes, planner, traffic, seed=seed, options=options)[0]


def drive(
    scenes: SceneSet,
    planner: Ego,
    traffic: Traffic,
    *,
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
    record: Collection[str] = (),
) -> tuple[list[dict[str, Any]], dict[str, Rollout]]:
    """Drive every scene once, all in one batch, and record some of the episodes.

    Recording changes nothing: an episode is the same with it and without.

    Parameters
    ----------
    scenes
        The scenes.
    planner
        As in :func:`planner_jobs`; see :class:`~ccdiff_env.planners.Planner`. A policy that was
        trained with other dynamics, observations or decision steps is driven with those.
    traffic
        Who drives the others.
    seed
        Seed of every episode.
    options
        Further fields of :class:`~ccdiff_env.config.WorldConfig`.
    record
        Names of the scenes to record.

    Returns
    -------
    list of dict
        Figures and score of each scene, see :func:`planner_score`.
    dict
        The recorded episodes by name of the scene.
    """
    driver, seat = _seat(planner)
    config = WorldConfig() if seat is None else seat.config
    config = config.with_options(**(options or {}))
    config = config.with_options(
        decision_steps=1,
        history_steps=HISTORY_STEPS,
        traffic=traffic.driver,
        driver=driver,
        ccdiff=dict(traffic.ccdiff),
        autoreset="disabled",
        on_collision="stop",
        on_off_road="ignore",
        dt_s=scenes[0].dt,
    )
    worlds = Worlds(scenes, config, num_worlds=len(scenes), num_threads=1)
    native, out = worlds.native, worlds.arrays()
    native.reset([seed] * len(scenes), list(range(len(scenes))), None, out)
    nothing = np.zeros((len(scenes), native.action_width), np.float32)
    if seat is not None:
        seat.begin(worlds)
    path = traffic.adversary_policy
    adversary_policy = None if path is None else AdversaryPolicy(worlds, path)
    names = worlds.column_names
    recorders = {
        i: Recorder(worlds, world_idx=i, planner=driver if seat is None else seat.name)
        for i, scene in enumerate(scenes)
        if scene.name in record
    }
    for recorder in recorders.values():
        recorder.start()
    columns: list[list[npt.NDArray[np.float32]]] = [[] for _ in scenes]
    metrics: list[npt.NDArray[np.float64] | None] = [None for _ in scenes]
    running = np.ones(len(scenes), np.bool_)
    while running.any():
        actions = nothing if seat is None else seat(out.obs[:, 0], running)
        if adversary_policy is not None:
            adversary_policy.choose(running)
        native.step(actions.astype(np.float32).reshape(len(scenes), 1, -1), out, running)
        if adversary_policy is not None:
            adversary_policy.step(running)
        for i in np.flatnonzero(running).tolist():
            columns[i].append(out.columns[i, 0].copy())
            if i in recorders:
                recorders[i].step()
            if out.done[i]:
                metrics[i] = native.ended_metrics([i])[0, 0]
        running &= ~out.done
    rows = [
        {
            "scene": scene.name,
            **planner_score(
                dict(zip(worlds.metric_names, m.tolist(), strict=True)),
                {name: np.array([row[i] for row in f]) for i, name in enumerate(names)},
                config.speed_limit_mps,
                road=scene.has_road,
            ),
        }
        for scene, m, f in zip(scenes, metrics, columns, strict=True)
        if m is not None
    ]
    return rows, {scenes[i].name: recorder.rollout() for i, recorder in recorders.items()}


def planner_score(
    metrics: Mapping[str, float],
    columns: Mapping[str, npt.NDArray[np.float32]],
    limit_mps: float,
    *,
    road: bool = True,
) -> dict[str, Any]:
    """Return the parts of the score of one episode, each in [0, 1], and the score.

    Without a road ``on_road`` is ``None``, and no part of the score.

    Parameters
    ----------
    metrics
        Metrics of the episode by name.
    columns
        Info columns of each step by name, [T].
    limit_mps
        Speed limit.
    road
        Whether the scene has a road, ``Scene.has_road``.
    """
    calm = np.ones(len(columns["speed"]), bool)
    for name, (low, high) in COMFORT.items():
        calm &= (columns[name] >= low) & (columns[name] <= high)
    over = np.maximum(columns["speed"] - limit_mps, 0.0)
    parts: dict[str, float | None] = {
        "no_at_fault_collision": 1.0 - metrics["at_fault"],
        "on_road": 1.0 - metrics["off_road"] if road else None,
        "makes_progress": float(metrics["route_completion"] >= LEAST_PROGRESS),
        "right_way": 1.0 - metrics["wrong_way"],
        "ttc": float(np.min(columns["ttc"]) >= TTC_BOUND_S),
        "progress": metrics["route_completion"],
        "speed_limit": float(max(0.0, 1.0 - over.mean() / 2.23)),
        "comfort": float(calm.mean()),
    }
    musts = ("no_at_fault_collision", "on_road", "makes_progress", "right_way")
    weights = {"ttc": 5, "progress": 5, "speed_limit": 4, "comfort": 2}
    known = {name: value for name, value in parts.items() if value is not None}
    product = float(np.prod([known.get(m, 1.0) for m in musts]))
    mean = sum(w * known[name] for name, w in weights.items()) / sum(weights.values())
    return {
        **parts,
        "collision": metrics["collision"],
        "success": metrics["is_success"],
        "min_ttc_s": metrics["min_ttc"],
        "score": product * mean,
    }
