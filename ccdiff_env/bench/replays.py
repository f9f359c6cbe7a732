"""Replay pages of benchmarked episodes: played again as they were, with a recorder."""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.jobs import Job, results, run_jobs
from ccdiff_env.errors import DatasetError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.system.files import file_name, reading
from ccdiff_env.view import address, write_page
from ccdiff_env.view.outcome import LEAD_S, outcome

FOLDER = "replays"  #: Folder of the pages in a run folder.
Pages = Mapping[tuple[str, str], str]  #: Addresses of pages by the names of job and scene.


def make_replays(wanted: Iterable[tuple[Job, str]], folder: Path, **run: Any) -> tuple[Pages, int]:
    """Play scenes of finished jobs again and write pages of them.

    Functions of the jobs take the names of the scenes to ``record`` too, and return rows and
    rollouts by scene. Returned are the addresses of the pages from the run folder, and how many
    episodes are not what the job had reported: torch rounds differently on other machines.
    """
    scenes: dict[str, set[str]] = {}
    jobs: dict[str, Job] = {}
    for job, scene in wanted:
        jobs[job.name] = job
        scenes.setdefault(job.name, set()).add(scene)
    again = {name: _again(job, sorted(scenes[name]), folder) for name, job in jobs.items()}
    run_jobs(list(again.values()), folder / "raw", **run)
    found = results([*again.values(), *jobs.values()], folder / "raw")
    pages, changed = {}, 0
    for name, job in again.items():
        with reading("pages of replays", folder / "raw" / f"{job.name}.json"):
            rows = [{r["scene"]: r for r in of} for of in (found[job.name]["rows"], found[name])]
            for scene in scenes[name]:
                page = str(found[job.name]["pages"][scene])
                # that of another file would lead elsewhere
                if page.partition("#")[0] != f"{FOLDER}/{file_name(f'{name}-{scene}', '.html')}":
                    raise DatasetError(f"the page of {scene!r} is {page[:80]!r}")
                pages[name, scene] = page
                changed += rows[0].get(scene) != rows[1].get(scene)
    return pages, changed


def _again(job: Job, scenes: Sequence[str], folder: Path) -> Job:
    digest = hashlib.sha256("\n".join(scenes).encode()).hexdigest()[:8]
    arguments = {
        "function": job.function,
        "arguments": dict(job.arguments),
        "scenes": list(scenes),
        "folder": str((folder / FOLDER).resolve()),
        "prefix": job.name,
    }
    name = f"replay-{job.name}-{digest}"
    return Job(name, f"{__name__}:play_again", arguments, job.made_from)


def play_again(
    *, function: str, arguments: Mapping[str, Any], scenes: Sequence[str], folder: str, prefix: str
) -> dict[str, Any]:
    """Do a job's work once more and write pages of some of its scenes.

    The whole batch is played, so that the episodes are those of the job bit for bit. Returns the
    ``rows`` of the scenes and the addresses of their ``pages``, from the folder above these.
    """
    module, name = function.split(":")
    work: Callable[..., Any] = getattr(importlib.import_module(module), name)
    rows, rollouts = work(**arguments, record=list(scenes))
    pages = {
        scene: write_replay(rollouts[scene], Path(folder) / file_name(f"{prefix}-{scene}", ".html"))
        for scene in scenes
    }
    return {"rows": [row for row in rows if row["scene"] in pages], "pages": pages}


def write_replay(rollout: Rollout, path: Path) -> str:
    """Write the page of an episode; returns its address from the folder above.

    It opens two seconds before what matters, see :class:`~ccdiff_env.view.outcome.Outcome`, and
    follows who it is about.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_page(rollout, path, home=("../report.html", "report"))
    fate = outcome(rollout)
    follow, time_s = None, fate.opening_s
    hits = rollout.collisions("ego") or rollout.collisions()
    if hits:
        follow = hits[0].agent_id
    elif len(rollout.info.get("ttc", ())):
        step = int(np.argmin(rollout.info["ttc"])) + 1
        time_s = max(0.0, step * rollout.dt_s - LEAD_S)
    page = f"{path.parent.name}/{path.name}"
    return address(page, time_s=time_s, follow=follow, play=True)
