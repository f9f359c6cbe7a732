"""Replay pages of benchmarked episodes: played again as they were, with a recorder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from ccdiff_env.bench.jobs import Job
from ccdiff_env.record.counterfactual import with_rescue
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.system.files import file_name
from ccdiff_env.view import address, write_page
from ccdiff_env.view.outcome import LEAD_S, outcome

Pages = Mapping[tuple[str, str], str]  #: Addresses of pages by the names of job and scene.


def make_replays(wanted: Iterable[tuple[Job, str]], folder: Path) -> Pages:
    """Play scenes of finished jobs again; return the addresses of their pages in the run folder.

    Functions of the jobs take the names of the scenes to ``record`` too, and return rows and
    rollouts by scene; a whole batch is played, as it was.
    """
    scenes: dict[str, tuple[Job, list[str]]] = {}
    for job, scene in wanted:
        scenes.setdefault(job.name, (job, []))[1].append(scene)
    pages = {}
    for job, some in scenes.values():
        _, rollouts = job.call(record=some)
        for scene in dict.fromkeys(some):
            rollouts[scene] = with_rescue(rollouts[scene])
            path = folder / "replays" / file_name(f"{job.name}-{scene}", ".html")
            pages[job.name, scene] = write_replay(rollouts[scene], path)
    return pages


def write_replay(rollout: Rollout, path: Path) -> str:
    """Write the page of an episode; returns its address from the folder above.

    It opens two seconds before what matters, see :class:`~ccdiff_env.view.outcome.Outcome`, and
    follows who it is about.
    """
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
