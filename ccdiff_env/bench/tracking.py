"""Tracking: the log driven through each model of motion, and what the model alone does to it.

Every vehicle that is logged throughout the episode gets at each step the action that leads from
where it is to its next logged state, see
:meth:`~ccdiff_env.envs.single.CcdiffEnv.expert_action`. No policy that copies the log in these
actions does better. What the model cannot do (limits, sideways motion) adds up to an error, and
may bring a vehicle into a contact, or a corner of it off the road, that the log does not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.intervals import brackets, mean_interval
from ccdiff_env.bench.jobs import Job
from ccdiff_env.bench.planners import CHUNK, HISTORY_STEPS
from ccdiff_env.bench.scenes import chunks, scene_names, scenes_of
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import UnknownNameError
from ccdiff_env.record.episode import begin, play
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.system.files import write_aside
from ccdiff_env.system.table import Column, Table, TableRows, document

__all__ = ["MODELS", "evaluate", "tracking_jobs", "write_tracking"]

#: Models of motion that can be inverted.
MODELS = ("unicycle", "bicycle", "delta_pose")


def tracking_jobs(source: str, models: Sequence[str] = MODELS) -> list[Job]:
    """Return the jobs: models of motion x chunks of the scenes.

    Parameters
    ----------
    source
        The scenes, a text of :func:`ccdiff_env.load`.
    models
        Names of :data:`MODELS`.
    """
    for name in models:
        if name not in MODELS:
            raise UnknownNameError(f"no model {name!r}, there are {', '.join(MODELS)}")
    return [
        Job(
            f"{model}-{i:03d}",
            f"{__name__}:evaluate",
            {"source": source, "names": names, "model": model},
        )
        for model in models
        for i, names in enumerate(chunks(scene_names(source), CHUNK))
    ]


def evaluate(*, source: str, names: Sequence[str], model: str) -> list[dict[str, Any]]:
    """Drive the log of scenes through a model of motion: one dictionary for each vehicle.

    ``error_m``: distance from the log at the end; ``worst_m``: the largest; ``collision``,
    ``off_road``: whether the vehicle gets into a contact, or a corner off the road, and does not
    where it is replayed.
    """
    return [row for scene in scenes_of(source, names) for row in _track(scene, model)]


def _track(scene: Scene, model: str) -> list[dict[str, Any]]:
    steps = min(WorldConfig().horizon_steps, scene.num_steps - HISTORY_STEPS - 1)
    logged = slice(HISTORY_STEPS, HISTORY_STEPS + steps + 1)
    valid = np.asarray(scene.tracks()["valid"])[:, logged].all(axis=1)
    ids = tuple(
        name
        for name, kind, there in zip(scene.agent_ids, scene.agent_types, valid, strict=True)
        if kind == "vehicle" and there
    )
    if not ids:
        return []
    driven, replayed = _drive(scene, ids, steps, model), _drive(scene, ids, steps, None)
    return [
        {
            "scene": scene.name,
            "agent": name,
            "error_m": float(driven["log_distance"][-1, i]),
            "worst_m": float(driven["log_distance"][:, i].max()),
            **{
                k: bool(driven[k][:, i].any() and not replayed[k][:, i].any())
                if k == "collision" or scene.has_road
                else None
                for k in ("collision", "off_road")
            },
        }
        for i, name in enumerate(ids)
    ]


def _drive(scene: Scene, ids: tuple[str, ...], steps: int, model: str | None) -> dict[str, Any]:
    """Figures [T, C] of vehicles that follow their log by actions, or are replayed."""
    config = WorldConfig().with_options(
        history_steps=HISTORY_STEPS,
        horizon_steps=steps,
        controlled=ids,
        num_slots=len(ids),
        driver="replay" if model is None else "external",
        dynamics={model or "unicycle": {}},
        on_collision="ignore",
        on_off_road="ignore",
        terminate_at_goal=False,
        autoreset="disabled",
        dt_s=scene.dt,
    )
    worlds = begin(SceneSet([scene]), config, 0)
    native = worlds.native
    played = play(worlds, lambda *_: native.expert_actions(0)[:, : native.action_width], most=steps)
    columns = [step.out.columns[0].copy() for step in played]
    names = worlds.column_names
    return {
        name: np.array(columns)[..., names.index(name)]
        for name in ("log_distance", "collision", "off_road")
    }


def write_tracking(found: Mapping[str, Sequence[Mapping[str, Any]]], folder: Path) -> None:
    """Write ``table.md``: errors and consequences of each model of motion, over vehicles."""
    shares = [Column(f"{name} %", factor=100.0) for name in ("new contact", "leaves the road")]
    errors = ("error at the end, m: p50", "p95", "largest, m: p95")
    rows: TableRows = []
    for model, of in found.items():
        end, worst = ([row[k] for row in of] for k in ("error_m", "worst_m"))
        figures = [float(np.percentile(*x)) for x in ((end, 50), (end, 95), (worst, 95))]
        hits = [mean_interval(of, name) for name in ("collision", "off_road")]
        rows.append([model, len(of), *figures, *hits])
    table = Table(["dynamics", "vehicles", *map(Column, errors), *shares], rows)
    note = f"Shares of vehicles, less what the replayed log has. {brackets(found.values())}"
    write_aside(folder / "table.md", document(table, note))
