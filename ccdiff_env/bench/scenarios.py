"""Scenario sets: episodes that critical traffic made against one ego, and every planner in them.

A set is a folder of recorded episodes (:class:`~ccdiff_env.Rollout`) of one ego, the generator. In
it the others do as recorded, whatever the planner does; beside that, every planner meets traffic
that reacts to it, with the same scenes and seed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.jobs import Job, chunk_jobs
from ccdiff_env.bench.methods import on_device
from ccdiff_env.bench.planners import CHUNK, TRAFFIC, Traffic, drive, planner_jobs, window_of
from ccdiff_env.bench.provenance import sha256_of
from ccdiff_env.bench.scenes import chunks, scenes_of
from ccdiff_env.bench.traffic import guidance_cost, motion_hash, motions
from ccdiff_env.errors import ConfigError, DatasetError
from ccdiff_env.record.counterfactual import rollout_avoidability
from ccdiff_env.record.rollout import Rollout, as_scene
from ccdiff_env.scenes import SceneSet
from ccdiff_env.system.files import file_name, reading
from ccdiff_env.system.settings import sha256

RECORDED = Traffic("as recorded", "replay")  #: Traffic that does as recorded in a set.
#: Episodes go on to the end of the horizon, so that slower egos meet the same traffic.
OPTIONS: Mapping[str, Any] = {"terminate_at_goal": False}

Rows = Sequence[Mapping[str, Any]]


def set_folders(generators: Sequence[str], folder: Path) -> dict[str, Path]:
    """Return the folder of each generator's set; refuses two generators of one name."""
    stems = [Path(g).stem if g.endswith(".zip") else g for g in generators]
    names = [re.sub(r"[^\w.-]+", "-", stem) for stem in stems]
    if len(set(names)) != len(names):
        raise ConfigError(f"generators {', '.join(generators)}: two of the same name")
    return {g: (folder / n).resolve() for g, n in zip(generators, names, strict=True)}


def generation_jobs(
    source: str,
    folders: Mapping[str, Path],
    *,
    traffic: str = "ccdiff-1",
    seed: int = 0,
    num_plans: int = 128,
    weights: Mapping[str, str] | None = None,
) -> list[Job]:
    """Return the jobs that make sets: generators, with their folders, x chunks of the scenes."""
    given: dict[str, Any] = {"traffic": traffic, "seed": seed, "num_plans": num_plans}
    if TRAFFIC[traffic].weights_of(weights or {}):
        given["weights"] = dict(weights or {})
    if window_of(source) is not None:
        raise ConfigError(f"scenario sets need 131 steps of 0.1 s, not those of {source}")
    function = f"{__name__}:generate"
    return [
        job
        for g, (generator, folder) in enumerate(folders.items())
        for job in chunk_jobs(
            f"make-{g:02d}", function, source, CHUNK,
            generator=generator, folder=str(folder), **given,
        )
    ]  # fmt: skip


def generate(
    *,
    source: str,
    names: Sequence[str],
    generator: str,
    traffic: str,
    seed: int,
    folder: str,
    num_plans: int,
    weights: Mapping[str, str] | None = None,
    device: str = "cpu",
) -> list[dict[str, Any]]:
    """Record episodes of a generator and save them: a row per scene.

    A row has the hash of the scene, the SHA-256 of the file and that of who was where, which does
    not depend on who compressed it; the first collision of the ego, also after its goal, and
    whether one of ``num_plans`` ego plans avoids it, the others doing as recorded; and
    :func:`realism`.
    """
    TRAFFIC.add(weights or {})
    drivers = on_device(TRAFFIC[traffic].with_weights(weights or {}), device)
    scenes = scenes_of(source, names)
    _, rollouts = drive(scenes, generator, drivers, seed=seed, options=OPTIONS, record=names)
    place, found = Path(folder), []
    for scene in scenes:
        rollout, file = rollouts[scene.name], file_name(scene.name, ".npz")
        rollout.save(place / file)
        hits = rollout.collisions("ego")
        verdict = rollout_avoidability(rollout, num_samples=num_plans) if hits else None
        first = hits[0] if hits else None
        found.append(
            {
                "scene": scene.name,
                "scene_hash": scene.hash,
                "motion_hash": motion_hash(rollout),
                "file": file,
                "sha256": sha256_of(place / file),
                "collision": bool(hits),
                "time_s": first and round(first.step * rollout.dt_s, 3),
                "at_fault": any(event.at_fault for event in hits),
                "avoidable": verdict is None or verdict.avoidable,
                "avoid_by": verdict.plan.words if verdict and verdict.plan else "",
                **realism(rollout),
            }
        )
    return found


def realism(rollout: Rollout) -> dict[str, float | None]:
    """Return how far the vehicles that follow plans are from the log, and what guidance cost.

    ``fde_m``: mean distance from the log at the last common step; see :func:`.guidance_cost`.
    """
    moved = {int(agent) for plan in rollout.plans for agent in plan.agents[plan.follows_plan]}
    agents = np.array([i for i in sorted(moved) if rollout.agent_ids[i] != "ego"], np.int64)
    motion, log = motions(rollout, agents)
    fde = motion.displacement(log).mean()[1]
    return {**guidance_cost(rollout.plans), "fde_m": fde if np.isfinite(fde) else None}


def set_digest(made: Job, rows: Rows) -> str:
    """Return the SHA-256 of settings and episodes, which no machine changes."""
    given = made.arguments
    settings = {
        "ccdiff": dict(TRAFFIC[given["traffic"]].ccdiff),
        **{"num_plans": given["num_plans"], "draws": 1, **OPTIONS},
    }
    episodes = [[row[name] for name in ("scene", "scene_hash", "motion_hash")] for row in rows]
    head = [given["generator"], given["traffic"], given["seed"], settings]
    return sha256(json.dumps([*head, episodes], sort_keys=True))


def cross_jobs(
    sets: Mapping[str, Rows], made: Mapping[str, Job], planners: Sequence[str]
) -> list[Job]:
    """Return the jobs that drive every planner in every set and in traffic that reacts to it.

    ``sets`` are what the jobs ``made``, of which one per generator is enough, returned.
    """
    recorded = [
        Job(
            f"set-{g:02d}-{p:02d}-{i:03d}",
            f"{__name__}:evaluate_in_set",
            {
                "folder": made[generator].arguments["folder"],
                "files": {row["file"]: row["sha256"] for row in part},
                "generator": generator,
                "planner": planner,
                "seed": made[generator].arguments["seed"],
            },
        )
        for g, (generator, rows) in enumerate(sets.items())
        for p, planner in enumerate(planners)
        for i, part in enumerate(chunks(rows, CHUNK))
    ]
    first = next(iter(made.values())).arguments
    return recorded + planner_jobs(
        first["source"],
        planners,
        [first["traffic"]],
        seed=first["seed"],
        weights=first.get("weights"),
    )


def evaluate_in_set(
    *,
    folder: str,
    files: Mapping[str, str],
    generator: str,
    planner: str,
    seed: int,
    device: str = "cpu",
    record: Collection[str] = (),
) -> tuple[list[dict[str, Any]], dict[str, Rollout]]:
    """Drive scenarios of a set with a planner, as :func:`.drive`; ``files`` have their SHA-256.

    The ego's own log stays in the scenes, so that route, goal and progress are the same in every
    set. A :class:`DatasetError` refuses episodes that are missing or have changed.
    """
    scenes = []
    for file, digest in files.items():
        path = Path(folder) / file
        with reading("episode of a scenario set", path):
            if sha256_of(path) != digest:
                raise DatasetError("it has changed since the set was made")
        scenes.append(as_scene(Rollout.load(path)))
    return drive(SceneSet(scenes), planner, RECORDED, seed=seed, record=record)
