"""Cross-evaluation: scenario sets made against some egos, every planner driven in all of them.

In a set the others do as recorded, whatever the planner does; beside that, every planner meets
traffic that reacts to it, with the same scenes and seed.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from ccdiff_env.bench.intervals import grouped
from ccdiff_env.bench.jobs import Job
from ccdiff_env.bench.planners import CHUNK, TRAFFIC, Traffic, drive, planner_jobs, window_of
from ccdiff_env.bench.scenario_sets import (
    OPTIONS,
    Scenario,
    ScenarioSet,
    load_scenario_set,
    write_manifest,
)
from ccdiff_env.bench.scenes import chunks, scene_names
from ccdiff_env.errors import ConfigError, UnknownNameError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import SceneSet
from ccdiff_env.system.version import __version__

RECORDED = Traffic("as recorded", "replay")  #: Traffic that does as recorded in a set.

Rows = list[dict[str, Any]]


def set_folders(generators: Sequence[str], folder: Path) -> dict[str, Path]:
    """Return the folder of the set of each generator.

    Raises:
        ConfigError: If two generators would share one.
    """
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
) -> list[Job]:
    """Return the jobs that make scenario sets: generators x chunks of the scenes.

    ``folders`` are those of the generators' sets, on a disc that all workers see.
    """
    if traffic not in TRAFFIC:
        raise UnknownNameError(f"no traffic {traffic!r}, there are {', '.join(TRAFFIC)}")
    if window_of(source) is not None:
        raise ConfigError(f"scenario sets need scenes of 131 steps, {source} has shorter ones")
    parts = chunks(scene_names(source), CHUNK)
    return [
        Job(
            f"make-{g:02d}-{i:03d}",
            "ccdiff_env.bench.scenario_sets:generate",
            {
                "source": source,
                "names": names,
                "generator": generator,
                "traffic": traffic,
                "seed": seed,
                "folder": str(folder),
                "num_plans": num_plans,
            },
        )
        for g, (generator, folder) in enumerate(folders.items())
        for i, names in enumerate(parts)
    ]


def write_sets(
    jobs: Sequence[Job], by_name: Mapping[str, Any], *, weights: str
) -> dict[str, ScenarioSet]:
    """Write the manifests of finished :func:`generation_jobs`; return the sets by generator.

    ``by_name`` are results of the jobs, ``weights`` the SHA-256 of those that drove.
    """
    sets = {}
    done = grouped([{**job.arguments, "job": job.name} for job in jobs], "generator")
    for (generator,), of in done.items():
        made, traffic = of[0], TRAFFIC[of[0]["traffic"]]
        rows = [row for job in of for row in by_name[job["job"]]]
        settings = {"num_plans": made["num_plans"], "draws": 1, **OPTIONS}
        path = write_manifest(
            ScenarioSet(
                folder=Path(made["folder"]),
                generator=generator,
                traffic=made["traffic"],
                seed=made["seed"],
                weights=weights,
                source=made["source"],
                settings={"ccdiff": dict(traffic.ccdiff), **settings},
                scenarios=tuple(Scenario(**row["scenario"]) for row in rows),
                version=__version__,
            )
        )
        sets[generator] = load_scenario_set(path)
    return sets


def cross_jobs(
    sets: Mapping[str, ScenarioSet], planners: Sequence[str], *, seed: int = 0
) -> list[Job]:
    """Return the jobs that drive every planner in every set and in traffic that reacts to it.

    The latter are those of :func:`~ccdiff_env.bench.planners.planner_jobs`.
    """
    recorded = [
        Job(
            f"set-{g:02d}-{p:02d}-{i:03d}",
            f"{__name__}:evaluate_in_set",
            {
                "folder": str(made.folder),
                "files": {s.scene: s.sha256 for s in part},
                "generator": generator,
                "planner": planner,
                "seed": seed,
            },
        )
        for g, (generator, made) in enumerate(sets.items())
        for p, planner in enumerate(planners)
        for i, part in enumerate(
            made.scenarios[k : k + CHUNK] for k in range(0, len(made.scenarios), CHUNK)
        )
    ]
    first = next(iter(sets.values()))
    return recorded + planner_jobs(first.source, planners, [first.traffic], seed=seed)


def evaluate_in_set(
    *,
    folder: str,
    files: Mapping[str, str],
    generator: str,
    planner: str,
    seed: int,
    device: str = "cpu",
    record: Collection[str] = (),
) -> tuple[Rows, dict[str, Rollout]]:
    """Drive scenarios of a set with a planner, and record some.

    Args:
        folder, files, generator: Folder of the set, SHA-256 of its episodes by scene, the ego that
            it was made against.
        planner, seed, record: As in :func:`ccdiff_env.bench.planners.drive`, whose results follow.
        device: Not used, as no network drives; benchmarks pass it to all jobs.

    Raises:
        ConfigError: If the set has changed.
    """
    found = load_scenario_set(folder)
    if found.generator != generator or any(found.find(s).sha256 != h for s, h in files.items()):
        raise ConfigError(f"the set is not the one that was asked for: {folder}")
    scenes = SceneSet([found.scene(scene) for scene in files])
    return drive(scenes, planner, RECORDED, seed=seed, record=record)
