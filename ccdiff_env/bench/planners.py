"""Planners against traffic: every planner in every traffic, scored as nuPlan's closed loop does.

The score is that of :mod:`ccdiff_env.bench.planner_score`; the world and the panel of traffic stand
in the file of the protocol, see :mod:`ccdiff_env.bench.protocol`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.jobs import Job, chunk_jobs
from ccdiff_env.bench.methods import FORMS, Drivers, NamedDrivers, on_device, resolved
from ccdiff_env.bench.nuplan_score import nuplan_score
from ccdiff_env.bench.planner_score import ROW, Judge
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.provenance import source_digest
from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.bench.tape import Tape
from ccdiff_env.envs.selection import DEFAULT_CCDIFF
from ccdiff_env.errors import ConfigError, PolicyError
from ccdiff_env.planners.built_in import Ego, ego_driver
from ccdiff_env.record.episode import begin, play, recorders_of
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.scenes.windows import Windows
from ccdiff_env.system.files import file_name
from ccdiff_env.system.named_objects import named_object, title_of
from ccdiff_env.traffic import EGOS, NETWORKS, driver_titles
from ccdiff_env.worlds.policy_file import LEARNED

#: Steps before an episode, and those that it lasts at most, in scenes of 9.1 s as Waymo's.
SHORT_WINDOW = {"history_steps": 10, "horizon_steps": 80}
_USUAL_WINDOW = {name: PROTOCOL.fields["world"][name] for name in SHORT_WINDOW}
CHUNK: int = PROTOCOL.fields["batch"]  #: Scenes that share a batch of the network.
#: Drivers of the world that know where the log goes, and how fast.
READ_THE_LOG = ("replay", "idm")


@dataclass(frozen=True)
class Traffic(Drivers):
    """Traffic to test planners in; ``named_drivers`` as in :class:`~ccdiff_env.WorldConfig`."""

    named_drivers: Mapping[str, Any] = field(default_factory=dict)


_TITLES = driver_titles()


def _critical(level: float, driver: str = "ccdiff", form: str = "") -> Traffic:
    _, title, options = FORMS[form]
    label = f"{_TITLES[driver]}, criticality {level:g}{title}"
    return Traffic(label, driver, {"criticality": level, "num_samples": 1, **options})


def _named(label: str, name: str) -> Traffic:
    kind, _, policy = name.partition(":")
    if kind != "adversary":
        return Traffic(label, name)
    options = {**DEFAULT_CCDIFF, "num_samples": 1, "adversary_policy": policy}
    return Traffic(f"CCDiff, chosen by {Path(policy).stem}", "ccdiff", options)


TRAFFIC: NamedDrivers[Traffic] = NamedDrivers(
    "traffic",
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
        **{f"ccdiff-{c:g}": _critical(c) for c in (0.25, 0.5, 1.5)},
        **{f"{name}-{c:g}": _critical(c, name) for c in (1.0, 2.0) for name in NETWORKS},
        **{
            f"ccdiff-{c:g}{form.replace('_', '-')}": _critical(c, form=form)
            for c in (1.0, 2.0)
            for form in sorted(FORMS)
        },
        "ccdiff-1-learned": replace(
            _named("", f"adversary:{LEARNED}"), label="CCDiff, a learned adversary"
        ),
    },
)
for _name, _own in PROTOCOL.fields["traffic"].items():
    # the file of the protocol is fixed by its hash, and calls named drivers policies
    TRAFFIC[_name] = replace(
        TRAFFIC[_name], **{{"policies": "named_drivers"}.get(k, k): v for k, v in _own.items()}
    )


#: Traffic by name, for the help.
TRAFFIC_HELP = (
    f"replay, idm-calm, idm, idm-hasty, {EGOS}, a network ({', '.join(NETWORKS)}), which -1 or -2 "
    "make critical; ccdiff also at -0.25, -0.5, -1.5, with -one-step, -routes after -1 "
    "or -2, and as ccdiff-1-learned; module:name of yours (docs/own_traffic.md); each with options "
    "as NAME?option=value&option=value"
)


def window_of(
    source: str, history_steps: int | None = None, horizon_steps: int | None = None
) -> dict[str, int] | None:
    """Return the steps of the log before an episode and the most that it lasts.

    By default they are those of the protocol (3 s and 10 s), for which ``None`` is returned; where
    a scene is too short for these, but has the 9.1 s of Waymo's, all scenes have 1 s and 8 s.
    Windows of logs have what they were cut for.

    Raises:
        ConfigError: If a scene is shorter than that, or than what is asked for; names it.
    """
    scenes = scenes_of(source)
    shortest = min(scenes, key=lambda scene: scene.num_steps)
    window = usual_window(shortest, scenes.window)
    asked = {"history_steps": history_steps, "horizon_steps": horizon_steps}
    window |= {name: steps for name, steps in asked.items() if steps is not None}
    if min(window.values()) < 1:
        raise ConfigError(f"{window} asked for, expected at least one step of each")
    if shortest.num_steps <= sum(window.values()):
        raise ConfigError(
            f"scene {shortest.name!r} has {shortest.num_steps} steps, expected at least "
            f"{sum(window.values()) + 1}: {window['history_steps']} of history, the present one "
            f"and {window['horizon_steps']} to drive; see --history-steps and --horizon-steps"
        )
    return None if window == _USUAL_WINDOW else window


def window_title(window: Mapping[str, int] | None) -> str:
    """Return what a title adds for a window that is not the usual one."""
    return ", {horizon_steps} steps after {history_steps}".format(**window) if window else ""


def usual_window(scene: Scene, cut: Windows | None = None) -> dict[str, int]:
    """Return the window of a scene and longer ones: what they were cut for, else that of the
    protocol, else of Waymo.
    """
    if cut is not None:
        return dict(zip(SHORT_WINDOW, cut.steps(scene.dt), strict=True))

    def steps(window: Mapping[str, int]) -> dict[str, int]:
        step_s: float = PROTOCOL.fields["world"]["dt_s"]
        return {name: round(count * step_s / scene.dt) for name, count in window.items()}

    usual = steps(_USUAL_WINDOW)
    return usual if scene.num_steps > sum(usual.values()) else steps(SHORT_WINDOW)


def planner_jobs(
    source: str,
    planners: Sequence[str],
    traffic: Sequence[str],
    *,
    seed: int = 0,
    window: Mapping[str, int] | None = None,
    by_nuplan: bool = False,
    metrics: Sequence[str] = (),
    weights: Mapping[str, str] | None = None,
) -> list[Job]:
    """Return the jobs of a planner benchmark: planners x traffic x chunks of the scenes.

    Args:
        planners: Names as in docs/planners.md.
        traffic: Names of :data:`TRAFFIC`; ``module:Class`` of a custom model; ``adversary:FILE`` of
            a choice of adversaries, see examples/train_adversary_selection.py.
        window: As :func:`window_of` returns it.
        by_nuplan: Whether nuPlan's own score is taken, too, see
            :mod:`ccdiff_env.bench.nuplan_score`.
        metrics: Paths of further figures, see :func:`measured`.
        weights: Files of weights by name, of which those that drive matter.

    Scenes are dealt to the chunks in an order that the seed draws: a planner, whose worlds are in
    that of the chunk, does not know a scene by its number.
    """
    own = {
        name: {"weights": dict(weights or {})} if TRAFFIC[name].weights_of(weights or {}) else {}
        for name in traffic
    }
    for planner in planners:
        PROTOCOL.world(ego_driver(planner)[1], planner, scenes_of(source)[0].dt)
    given: dict[str, Any] = {"window": dict(window)} if window else {}
    given |= {"by_nuplan": True} if by_nuplan else {}
    given |= {"metrics": list(metrics)} if metrics else {}
    metric_names(metrics)
    made_from = {
        planner: {"protocol": PROTOCOL.sha256, "privileged": is_privileged(planner)}
        for planner in planners
    }
    return [
        replace(job, made_from=made_from[planner])
        for planner in planners
        for name in traffic
        for job in chunk_jobs(
            f"{file_name(planner)}-{file_name(name)}-{seed}", f"{__name__}:evaluate", source, CHUNK,
            shuffle=seed, planner=planner, traffic=name, seed=seed,
            sources=_sources(planner, name, metrics), **given, **own[name],
        )
    ]  # fmt: skip


def is_privileged(planner: str) -> bool:
    """Return whether a planner uses what a vehicle cannot know."""
    driver, seat = ego_driver(planner)
    return driver in READ_THE_LOG if seat is None else seat.privileged


def _sources(planner: str, traffic: str, metrics: Sequence[str] = ()) -> dict[str, str | None]:
    """Digests of what drives and measures, where it is no part of the package."""
    named = {"planner": planner, "traffic": traffic, **{metric: metric for metric in metrics}}
    return {what: source_digest(name) for what, name in named.items()}


#: Metrics of the package, which need no path.
METRICS = {"avoidable": "ccdiff_env.record.counterfactual:avoidable"}
#: What is asked for and cannot be had, and why.
NO_METRICS = dict.fromkeys(
    ("epdms", "pdms"),
    "NAVSIM scores single plans of 4 s from its own logs, sensors and second stage of synthetic "
    "scenes, none of which are here; the score here is nuPlan's, in closed loop",
)


def metric_name(path: str) -> str:
    """Return the column of a metric given by path."""
    return title_of(path) or path.partition("?")[0].partition(":")[2]


def metric_names(metrics: Sequence[str]) -> list[str]:
    """Return the columns of metrics given by path, ``module:name``: their names, or titles.

    One that is taken is a :class:`ConfigError`, as a path that leads to nothing is.
    """
    found: list[str] = []
    for path in metrics:
        if (why := NO_METRICS.get(path.lower())) is not None:
            raise ConfigError(f"metric {path!r} cannot be had: {why}")
        if ":" not in path or not callable(named_object(path, "metric")):
            expected = "module:function of a rollout, or avoidable"
            raise ConfigError(f"metric {path!r}: expected {expected}")
        name = metric_name(path)
        if not name.isidentifier() or name in (*found, *ROW):
            raise ConfigError(f"metric {path!r}: the column {name!r} is taken or no name")
        found.append(name)
    return found


def measured(metrics: Sequence[str], rollout: Rollout) -> dict[str, float | None]:
    """Return further figures of an episode: what functions of a rollout, by path, return.

    ``None`` for one that is not finite. What a function raises, or returns beside a number, is a
    :class:`PolicyError` that names it and the scene.
    """
    found: dict[str, float | None] = {}
    where = f"(in {rollout.scene.name} of {rollout.meta.get('planner')})"
    for path, name in zip(metrics, metric_names(metrics), strict=True):
        try:
            answer = named_object(path, "metric")(rollout)
        except Exception as error:
            said = f"metric {path}: {type(error).__name__}: {error} {where}"
            raise PolicyError(said) from error
        try:
            value = float(answer)
        except (TypeError, ValueError):
            said = f"metric {path} returns {answer!r:.40}, expected a number {where}"
            raise PolicyError(said) from None
        found[name] = value if np.isfinite(value) else None
    return found


def evaluate(
    *,
    source: str,
    names: Sequence[str],
    planner: str,
    traffic: str,
    seed: int,
    sources: Mapping[str, str | None] | None = None,
    window: Mapping[str, int] | None = None,
    by_nuplan: bool = False,
    metrics: Sequence[str] = (),
    weights: Mapping[str, str] | None = None,
    device: str = "cpu",
    record: Collection[str] = (),
) -> tuple[list[dict[str, Any]], dict[str, Rollout]]:
    """Drive scenes with a planner; rows and recorded scenes are those of :func:`drive`.

    Raises:
        ConfigError: If the planner, or the model of traffic, is no longer what ``sources`` are
            digests of.
        MissingFeatureError: With ``by_nuplan``, if there is no nuplan-devkit.
    """
    if sources is not None and dict(sources) != _sources(planner, traffic, metrics):
        changed = " or ".join([planner, traffic, *metrics])
        raise ConfigError(f"{changed} has changed since the run began: start it again")
    scenes = scenes_of(source, names)
    TRAFFIC.add(weights or {})
    rows, rollouts = drive(
        scenes,
        planner,
        on_device(TRAFFIC[traffic].with_weights(weights or {}), device),
        seed=seed,
        options=window,
        record=names if by_nuplan or metrics else record,
    )
    if by_nuplan:
        steps = {**PROTOCOL.fields["world"], **(window or {})}["horizon_steps"]
        for row in rows:
            row["nuplan_score"] = nuplan_score(rollouts[row["scene"]], steps)["score"]
    for row in rows if metrics else ():
        row |= measured(metrics, rollouts[row["scene"]])
    chosen = {name: rollout for name, rollout in rollouts.items() if name in record}
    return rows, chosen


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

    Recording changes nothing. A policy that was trained with other dynamics, observations or
    decision steps is driven with those. ``options`` are further fields of
    :class:`~ccdiff_env.config.WorldConfig`.

    Returns:
        tuple: Figures and score of each scene, see :meth:`.Judge.row`; its actions and its digest,
            see :class:`~ccdiff_env.bench.tape.Tape`; the recorded episodes by name of the scene.
    """
    traffic = resolved(traffic)
    driver, seat = ego_driver(planner)
    who = driver if seat is None else seat.name
    config = PROTOCOL.world(seat, who, scenes[0].dt).with_options(
        **(options or {}),
        named_drivers=dict(traffic.named_drivers),
        traffic=traffic.driver,
        driver=driver,
        ccdiff=dict(traffic.ccdiff),
    )
    worlds = begin(scenes, config, seed)
    if seat is not None:
        seat.begin(worlds)
    recorders = recorders_of(worlds, record, planner=who)
    tapes = [Tape(worlds, i, driver) for i in range(len(scenes))]
    judges = [Judge(worlds, i) for i in range(len(scenes))]
    metrics: list[npt.NDArray[np.float64] | None] = [None for _ in scenes]
    for running, actions, out in play(worlds, seat, recorders=recorders):
        for i in np.flatnonzero(running).tolist():
            tapes[i].step(actions[i, 0], out.columns[i, 0])
            judges[i].step(out.columns[i, 0])
            if out.done[i]:
                metrics[i] = worlds.native.ended_metrics([i])[0, 0]
    found = [
        {
            "scene": scene.name,
            "seed": seed,
            **judge.row(dict(zip(worlds.metric_names, m.tolist(), strict=True))),
            **tape.entries(),
        }
        for scene, m, judge, tape in zip(scenes, metrics, judges, tapes, strict=True)
        if m is not None
    ]
    return found, {scenes[i].name: recorder.rollout() for i, recorder in recorders.items()}
