"""Planners against traffic: every planner in every traffic, scored as nuPlan's closed loop does.

The score of a scene is a product of what must not happen and a weighted mean of the rest (nuPlan,
closed-loop non-reactive and reactive challenges):

    score = no_at_fault_collision x on_road x makes_progress x right_way
            x (5 ttc + 5 progress + 4 speed_limit + 2 comfort) / 16

Weights, bounds, the world and the panel of traffic stand in the file of the protocol, see
:mod:`ccdiff_env.bench.protocol`.

Differs from nuPlan: progress is measured along the logged route up to its goal, comfort is the
share of steps within the limits, a collision with a static obstacle counts as any other, and half
points are not given. ``on_road`` has the tolerance of its ``drivable_area_compliance``
(``max_violation_threshold``, 0.3 m), of the drivable area alone.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.adversary_policy import REPLAN_STEPS, AdversaryPolicy
from ccdiff_env.bench.jobs import Job
from ccdiff_env.bench.methods import NamedDrivers, on_device
from ccdiff_env.bench.nuplan_score import nuplan_score
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.provenance import scene_hashes, source_digest
from ccdiff_env.bench.scenes import chunks, scene_names, scenes_of
from ccdiff_env.bench.tape import Tape
from ccdiff_env.errors import ConfigError, UnknownNameError
from ccdiff_env.policies.planners import Ego, ego_driver
from ccdiff_env.record.episode import begin, recorders_of
from ccdiff_env.record.episode import play as played
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import SceneSet
from ccdiff_env.system.files import file_name
from ccdiff_env.traffic import EGOS, NETWORKS, driver_titles
from ccdiff_env.view.captions import planner_title

__all__ = [
    "TRAFFIC",
    "Traffic",
    "drive",
    "evaluate",
    "is_privileged",
    "planner_jobs",
    "planner_score",
    "play",
]

_SCORE = PROTOCOL.fields["score"]
HISTORY_STEPS: int = PROTOCOL.fields["world"]["history_steps"]
#: Scenes that share a batch of the network.
CHUNK: int = PROTOCOL.fields["batch"]
#: Limits of comfort: acceleration forwards, braking, sideways (m/s²), jerk (m/s³), as nuPlan's.
COMFORT: Mapping[str, tuple[float, float]] = {k: (a, b) for k, (a, b) in _SCORE["comfort"].items()}
TTC_BOUND_S: float = _SCORE["least_ttc_s"]
#: Drivers of the world that know where the log goes, and how fast.
READ_THE_LOG = ("replay", "idm")


@dataclass(frozen=True)
class Traffic:
    """Traffic to test planners in.

    ``draws``: how often a scenario set draws a scene at most, until the ego collides; everywhere
    else it is drawn once. ``adversary_policy``: file of a policy that says who is turned on the
    ego, see :class:`~ccdiff_env.bench.adversary_policy.AdversaryPolicy`. ``policies``: drivers of
    its own, see :class:`~ccdiff_env.WorldConfig`.
    """

    label: str
    driver: str
    ccdiff: Mapping[str, Any] = field(default_factory=dict)
    draws: int = 1
    adversary_policy: str | None = None
    policies: Mapping[str, Any] = field(default_factory=dict)


_TITLES = driver_titles()


#: Options of CCDiff that have names of their own, and their titles.
_FORMS: dict[str, tuple[dict[str, Any], str]] = {
    "avoidable": ({"avoidable_only": True}, "avoidable only"),
    "one-step": ({"denoising_steps": 1}, "one step"),
    "routes": ({"follow_route": True}, "routes"),
    "routes-one-step": ({"follow_route": True, "denoising_steps": 1}, "routes, one step"),
}


def _critical(level: float, driver: str = "ccdiff", form: str | None = None) -> Traffic:
    options = {"criticality": level, "num_samples": 1}
    label = f"{_TITLES[driver]}, criticality {level:g}"
    if form is None:
        return Traffic(label, driver, options)
    chosen, title = _FORMS[form]
    return Traffic(f"{label}, {title}", driver, {**options, **chosen})


def _named(label: str, name: str) -> Traffic:
    kind, _, path = name.partition(":")
    if kind != "adversary":
        return Traffic(label, name)
    options = {"criticality": 1.0, "num_samples": 1, "replan_steps": REPLAN_STEPS}
    return Traffic(f"CCDiff, chosen by {Path(path).stem}", "ccdiff", options, adversary_policy=path)


TRAFFIC: dict[str, Traffic] = NamedDrivers(
    _named,
    {
        "replay": Traffic("Log replay", "replay"),
        "idm-calm": Traffic("IDM, calm", "calm"),
        "idm": Traffic("IDM", "idm"),
        "idm-hasty": Traffic("IDM, hasty", "hasty"),
        EGOS: Traffic("Trained egos", EGOS),
        **{
            name: Traffic(f"{_TITLES[name]}, no guidance", name, {"num_samples": 1})
            for name in NETWORKS
        },
        **{f"ccdiff-{level:g}": _critical(level) for level in (0.25, 0.5)},
        **{f"{name}-{c:g}": _critical(c, name) for c in (1.0, 2.0) for name in NETWORKS},
        **{
            f"ccdiff-{level:g}-{form}": _critical(level, form=form)
            for level in (1.0, 2.0)
            for form in _FORMS
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
TRAFFIC.update({n: replace(TRAFFIC[n], **own) for n, own in PROTOCOL.fields["traffic"].items()})


def planner_jobs(
    source: str,
    planners: Sequence[str],
    traffic: Sequence[str],
    *,
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
    by_nuplan: bool = False,
) -> list[Job]:
    """Return the jobs of a planner benchmark: planners x traffic x chunks of the scenes.

    Parameters
    ----------
    source
        The scenes, a text of :func:`ccdiff_env.load`.
    planners
        ``constant_velocity``, ``idm``, ``replay``, ``ccdiff``, a name of
        :data:`~ccdiff_env.policies.planners.BUILT_IN`, a policy of
        :mod:`ccdiff_env.policies` by name, the path of one (``.safetensors``) or of a policy saved
        by stable-baselines3 (``.zip``), or ``module:name`` of a function or class, see
        :func:`play`, or ``nuplan:package.module.Class`` of a planner of nuPlan.
    traffic
        Names of :data:`TRAFFIC`; ``module:Class`` of a model of one's own; ``adversary:FILE`` of a
        policy that ``bench selection`` trained.
    seed
        Seed of the episodes.
    options
        Further fields of :class:`~ccdiff_env.config.WorldConfig`, such as what policies observe.
    by_nuplan
        Whether nuPlan's own score is taken, too, see :mod:`ccdiff_env.bench.nuplan_score`.
    """
    for name in traffic:
        if name not in TRAFFIC:
            raise UnknownNameError(f"no traffic {name!r}, there are {', '.join(TRAFFIC)}")
    for planner in planners:
        PROTOCOL.world(ego_driver(planner)[1], planner, scenes_of(source)[0].dt)
    privileged = {planner: is_privileged(planner) for planner in planners}
    parts = chunks(scene_names(source), CHUNK)
    drives = {(p, t): _sources(p, t) for p in planners for t in traffic}
    return [
        Job(
            f"{file_name(planner)}-{file_name(name)}-{seed}-{i:03d}",
            f"{__name__}:evaluate",
            {
                "source": source,
                "names": names,
                "planner": planner,
                "traffic": name,
                "seed": seed,
                "sources": drives[planner, name],
                **({"options": dict(options)} if options else {}),
                **({"by_nuplan": True} if by_nuplan else {}),
            },
            {
                "protocol": PROTOCOL.sha256,
                "scenes": scene_hashes(source, names),
                "privileged": privileged[planner],
            },
            f"{planner_title(planner)} in {TRAFFIC[name].label}",
        )
        for planner in planners
        for name in traffic
        for i, names in enumerate(parts)
    ]


def is_privileged(planner: str) -> bool:
    """Return whether a planner uses what a vehicle cannot know."""
    driver, seat = ego_driver(planner)
    return driver in READ_THE_LOG if seat is None else seat.privileged


def _sources(planner: str, traffic: str) -> dict[str, str | None]:
    """Digests of what drives, where it is no part of the package."""
    return {"planner": source_digest(planner), "traffic": source_digest(traffic)}


def evaluate(
    *,
    source: str,
    names: Sequence[str],
    planner: str,
    traffic: str,
    seed: int,
    sources: Mapping[str, str | None] | None = None,
    options: Mapping[str, Any] | None = None,
    by_nuplan: bool = False,
    device: str = "cpu",
) -> list[dict[str, Any]]:
    """Drive scenes with a planner: one dictionary of metrics and the score per scene.

    Raises
    ------
    ConfigError
        If the planner, or the model of traffic, is no more what ``sources`` are digests of.
    MissingFeatureError
        With ``by_nuplan``, if there is no nuplan-devkit.
    """
    rows, _ = evaluate_recorded(
        source=source,
        names=names,
        planner=planner,
        traffic=traffic,
        seed=seed,
        record=(),
        sources=sources,
        options=options,
        by_nuplan=by_nuplan,
        device=device,
    )
    return rows


def with_log(
    rows: Sequence[dict[str, Any]], source: str, names: Sequence[str]
) -> list[dict[str, Any]]:
    """Return rows that say whether the logged driver scores 0 in the scene: ``log_fails``."""
    fails = _log_fails(source, tuple(names))
    return [{**row, "log_fails": row["scene"] in fails} for row in rows]


@lru_cache(maxsize=64)
def _log_fails(source: str, names: tuple[str, ...]) -> frozenset[str]:
    rows = play(scenes_of(source, names), "replay", TRAFFIC["replay"])
    return frozenset(row["scene"] for row in rows if row["score"] == 0.0)


def evaluate_recorded(
    *,
    source: str,
    names: Sequence[str],
    planner: str,
    traffic: str,
    seed: int,
    record: Collection[str],
    sources: Mapping[str, str | None] | None = None,
    options: Mapping[str, Any] | None = None,
    by_nuplan: bool = False,
    device: str = "cpu",
) -> tuple[list[dict[str, Any]], dict[str, Rollout]]:
    """Do the same as :func:`evaluate`, and record some scenes; raises as it does."""
    _check_sources(planner, traffic, sources)
    scenes = scenes_of(source, names)
    rows, rollouts = drive(
        scenes,
        planner,
        on_device(TRAFFIC[traffic], device),
        seed=seed,
        options=options,
        record=names if by_nuplan else record,
    )
    if by_nuplan:
        steps = PROTOCOL.fields["world"]["horizon_steps"]
        for row in rows:
            row["nuplan_score"] = nuplan_score(rollouts[row["scene"]], steps)["score"]
    chosen = {name: rollout for name, rollout in rollouts.items() if name in record}
    return with_log(rows, source, names), chosen


def _check_sources(planner: str, traffic: str, sources: Mapping[str, str | None] | None) -> None:
    if sources is not None and dict(sources) != _sources(planner, traffic):
        raise ConfigError(f"{planner} or {traffic} has changed since the run began: start it again")


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
        As in :func:`planner_jobs`; see :class:`~ccdiff_env.policies.planners.Planner`. A policy
        that was trained with other dynamics, observations or decision steps is driven with those.
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
        Figures and score of each scene, see :func:`planner_score`; its actions and its digest, see
        :class:`~ccdiff_env.bench.tape.Tape`.
    dict
        The recorded episodes by name of the scene.
    """
    driver, seat = ego_driver(planner)
    who = driver if seat is None else seat.name
    config = PROTOCOL.world(seat, who, scenes[0].dt).with_options(
        **(options or {}),
        policies=dict(traffic.policies),
        traffic=traffic.driver,
        driver=driver,
        ccdiff=dict(traffic.ccdiff),
    )
    worlds = begin(scenes, config, seed)
    if seat is not None:
        seat.begin(worlds)
    path = traffic.adversary_policy
    adversary_policy = None if path is None else AdversaryPolicy(worlds, path)
    nothing = np.zeros((len(scenes), worlds.native.action_width), np.float32)

    def act(obs: npt.NDArray[np.float32], running: npt.NDArray[np.bool_]) -> npt.NDArray[Any]:
        actions = nothing if seat is None else seat(obs, running)
        if adversary_policy is not None:
            adversary_policy.choose(running)
        return actions

    names = worlds.column_names
    recorders = recorders_of(worlds, record, planner=who)
    tapes = [Tape(worlds, i, driver) for i in range(len(scenes))]
    columns: list[list[npt.NDArray[np.float32]]] = [[] for _ in scenes]
    metrics: list[npt.NDArray[np.float64] | None] = [None for _ in scenes]
    off_m = [0.0 if scene.has_road else None for scene in scenes]
    off_road = names.index("off_road")
    for running, actions, out in played(worlds, act, recorders=recorders):
        if adversary_policy is not None:
            adversary_policy.step(running)
        for i in np.flatnonzero(running).tolist():
            columns[i].append(out.columns[i, 0].copy())
            tapes[i].step(actions[i, 0], columns[i][-1])
            if columns[i][-1][off_road]:
                off_m[i] = max(off_m[i] or 0.0, worlds.native.off_road_m(i)[0])
            if out.done[i]:
                metrics[i] = worlds.native.ended_metrics([i])[0, 0]
    found = [
        {
            "scene": scene.name,
            "seed": seed,
            **planner_score(
                dict(zip(worlds.metric_names, m.tolist(), strict=True)),
                {name: np.array([row[i] for row in f]) for i, name in enumerate(names)},
                config.speed_limit_mps,
                off,
            ),
            **tape.entries(),
        }
        for scene, m, f, off, tape in zip(scenes, metrics, columns, off_m, tapes, strict=True)
        if m is not None
    ]
    return found, {scenes[i].name: recorder.rollout() for i, recorder in recorders.items()}


def planner_score(
    metrics: Mapping[str, float],
    columns: Mapping[str, npt.NDArray[np.float32]],
    limit_mps: float,
    off_road_m: float | None = 0.0,
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
    off_road_m
        How far a corner ever was off the road; ``None`` where the scene has none.
    """
    calm = np.ones(len(columns["speed"]), bool)
    for name, (low, high) in COMFORT.items():
        calm &= (columns[name] >= low) & (columns[name] <= high)
    over = np.maximum(columns["speed"] - limit_mps, 0.0)
    parts: dict[str, float | None] = {
        "no_at_fault_collision": 1.0 - metrics["at_fault"],
        "on_road": None if off_road_m is None else float(off_road_m < _SCORE["off_road_m"]),
        "makes_progress": float(metrics["route_completion"] >= _SCORE["least_progress"]),
        "right_way": 1.0 - metrics["wrong_way"],
        "ttc": float(np.min(columns["ttc"]) >= TTC_BOUND_S),
        "progress": metrics["route_completion"],
        "speed_limit": float(max(0.0, 1.0 - over.mean() / _SCORE["excess_mps"])),
        "comfort": float(calm.mean()),
    }
    return {
        **parts,
        "collision": metrics["collision"],
        "success": metrics["is_success"],
        "min_ttc_s": metrics["min_ttc"],
        "score": score_of(parts),
    }


def score_of(parts: Mapping[str, float | None]) -> float:
    """Return the score that the parts of an episode make; a gate that is not known stays open."""
    weights: Mapping[str, float] = _SCORE["weights"]
    known = {name: value for name, value in parts.items() if value is not None}
    product = float(np.prod([known.get(gate, 1.0) for gate in _SCORE["gates"]]))
    return product * (sum(w * known[name] for name, w in weights.items()) / sum(weights.values()))
