"""Replay pages of benchmarked episodes: played again as they were, with a recorder."""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ccdiff_env.bench.jobs import Job, results, run_jobs
from ccdiff_env.errors import DatasetError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.system.files import file_name, reading
from ccdiff_env.view import address, write_page
from ccdiff_env.view.outcome import LEAD_S, outcome

__all__ = ["make_replays", "play_again", "write_replay"]

#: Folder of the pages in a run folder.
FOLDER = "replays"
K = TypeVar("K", bound=Hashable)


def make_replays(
    wanted: Mapping[K, tuple[Job, str]], folder: Path, **run: Any
) -> tuple[dict[K, str], list[K]]:
    """Play scenes of finished jobs again and write pages of them.

    The function of a job is ``<name>``; ``<name>_recorded`` beside it takes the names of the scenes
    to ``record`` too, and returns rows and rollouts by scene.

    Returns
    -------
    dict
        Addresses of the pages from the run folder, by key of ``wanted`` (job and scene).
    list
        Keys of the episodes that are not what the job had reported: networks round differently on
        other machines.
    """
    scenes: dict[str, list[str]] = {}
    jobs: dict[str, Job] = {}
    for job, scene in wanted.values():
        jobs[job.name] = job
        if scene not in scenes.setdefault(job.name, []):
            scenes[job.name].append(scene)
    again = {name: _again(job, sorted(scenes[name]), folder) for name, job in jobs.items()}
    run_jobs(list(again.values()), folder / "raw", **run)
    found = results(list(again.values()), folder / "raw")
    before = results(list(jobs.values()), folder / "raw")
    pages, changed = {}, []
    for key, (job, scene) in wanted.items():
        entry = found[again[job.name].name]
        pages[key] = _page_of(entry, job.name, scene, folder)
        now, then = (
            [r for r in rows if r["scene"] == scene] for rows in (entry["rows"], before[job.name])
        )
        if now != then:
            changed.append(key)
    return pages, changed


def _page_of(entry: Any, prefix: str, scene: str, folder: Path) -> str:
    """Address of a page in a result; that of another file would lead elsewhere."""
    with reading("pages of replays", folder / "raw"):
        page = str(entry["pages"][scene])
        if page.partition("#")[0] != f"{FOLDER}/{file_name(f'{prefix}-{scene}', '.html')}":
            raise DatasetError(f"the page of {scene!r} is {page[:80]!r}")
        return page


def _again(job: Job, scenes: Sequence[str], folder: Path) -> Job:
    digest = hashlib.sha256("\n".join(scenes).encode()).hexdigest()[:8]
    arguments = {
        "function": f"{job.function}_recorded",
        "arguments": dict(job.arguments),
        "scenes": list(scenes),
        "folder": str((folder / FOLDER).resolve()),
        "prefix": job.name,
    }
    name = f"replay-{job.name}-{digest}"
    return Job(name, f"{__name__}:play_again", arguments, job.made_from)


def play_again(
    *,
    function: str,
    arguments: Mapping[str, Any],
    scenes: Sequence[str],
    folder: str,
    prefix: str,
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
