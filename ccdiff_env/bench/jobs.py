"""Jobs whose results go to a run folder: resumable, on this machine or on a Ray cluster."""

from __future__ import annotations

import importlib
import json
import os
import random
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from ccdiff_env.bench.ray import results_of_tasks
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.system.files import parsed_object, read_text, reading, write_aside
from ccdiff_env.system.processes import results_of_processes
from ccdiff_env.system.progress import shown

Backend = Literal["local", "ray"]
#: What results may follow from and mostly do not: a protocol fixes the hashes of weights, too.
INDIRECT = ("package", "weights", "protocol")
#: Arguments that tell jobs of a kind apart.
PLACES = ("names", "files", "lists", "seed")


def use_one_thread() -> None:
    """Have torch compute on one thread in this process, whether it is loaded or will be."""
    torch = sys.modules.get("torch")
    if torch is None:
        # read when torch is imported, which only some networks do
        os.environ["OMP_NUM_THREADS"] = "1"
    else:
        torch.set_num_threads(1)


@dataclass(frozen=True)
class Job:
    """A function of this package and what it is called with.

    ``function`` is ``"module:function"``; it takes ``arguments``, returns what JSON can hold, and
    depends on nothing else. ``name`` is the file of its result, without ``.json``. ``made_from``
    are hashes of what else the result follows from: where one differs, the job is done again, or,
    of :data:`INDIRECT`, one of its kind.
    """

    name: str
    function: str
    arguments: Mapping[str, Any]
    made_from: Mapping[str, Any] = field(default_factory=dict)

    def description(self) -> dict[str, Any]:
        """Return all that decides the result, as JSON has it."""
        whole = {
            "function": self.function, "arguments": self.arguments, "made_from": self.made_from,
        }  # fmt: skip
        found: dict[str, Any] = json.loads(json.dumps(whole, default=dict))
        return found

    def run(self) -> Any:
        """Do the work."""
        use_one_thread()
        module, name = self.function.split(":")
        function: Callable[..., Any] = getattr(importlib.import_module(module), name)
        return function(**self.arguments)


def _run(job: Job) -> tuple[str, Any, float]:
    start = time.process_time()
    found = job.run()
    return job.name, found, time.process_time() - start


def run_jobs(
    jobs: Sequence[Job],
    folder: Path,
    *,
    backend: Backend = "local",
    workers: int = 1,
    progress: bool = True,
) -> None:
    """Do the jobs whose results are not in the folder yet, or were made from something else.

    Each result is written to ``<name>.json`` once it is there, so that a killed run resumes.
    Results do not depend on the backend or the number of workers. Where only :data:`INDIRECT`
    have changed, one job of each planner and traffic, drawn by chance, is done again: if its
    result is the same bit for bit, the others are kept. Lines on stderr say what has changed.

    Args:
        backend: ``"local"``: processes of this machine, one works in this one; ``"ray"``: tasks of
            the Ray cluster that this process belongs to, where jobs of a lost worker run again.
    """
    if workers < 1:
        raise ConfigError(f"workers is {workers}, expected at least 1")
    if len({job.name for job in jobs}) != len(jobs):
        raise ConfigError("jobs: two of the same name")
    folder.mkdir(parents=True, exist_ok=True)
    known: dict[str, Any] = {job.name: _known(job, folder) for job in jobs}
    stale = {job.name: said for job in jobs if (said := _changed(job, known[job.name]))}
    groups: dict[str, list[Job]] = {}
    for job in random.sample(jobs, len(jobs)):
        if job.name in stale and not _changed(job, known[job.name], but=INDIRECT):
            groups.setdefault(_group(job), []).append(job)
    others_of = {sample.name: others for sample, *others in groups.values()}
    left = [job for job in jobs if known[job.name] is None or job.name in stale]

    def do(some: Sequence[Job]) -> None:
        again = [job.name for job in some if job.name in stale]
        if again:
            are = "result is" if len(again) == 1 else "results are"
            changed = f"{again[0]}: {stale[again[0]]}"
            print(f"{len(again)} {are} made again, as of {changed}", file=sys.stderr)
        by_name = {job.name: job for job in some}
        found = results_of_tasks(_run, some) if backend == "ray" else _local(some, workers)
        if progress:
            found = shown(found, what="jobs", total=len(jobs), done=len(jobs) - len(left))
        for name, result, seconds in found:
            left.remove(by_name[name])
            same = json.loads(json.dumps(result)) == (known[name] or {}).get("result")
            # settled before the sample is written: a run that is stopped asks no other one
            for job in others_of.get(name, ()):
                path, then = folder / f"{job.name}.json", known[job.name]
                if same:
                    left.remove(job)
                    with reading("result", path):
                        _write(job, folder, then["result"], float(then["seconds"]))
                else:
                    path.unlink()
            _write(by_name[name], folder, result, seconds)

    if groups:
        count = len(left)
        do([sample for sample, *_ in groups.values()])
        if kept := count - len(left) - len(groups):
            print(f"{kept} results are kept: samples came out the same", file=sys.stderr)
    do(left.copy())


def _write(job: Job, folder: Path, result: Any, seconds: float) -> None:
    entry = {**job.description(), "result": result, "seconds": round(seconds, 3)}
    write_aside(folder / f"{job.name}.json", json.dumps(entry, allow_nan=False))


def _group(job: Job) -> str:
    """What a result shares with others: all that decides it, but for scenes and seed."""
    return json.dumps([job.function, *(a for a in job.arguments.items() if a[0] not in PLACES)])


def _local(jobs: Sequence[Job], workers: int) -> Iterator[tuple[str, Any, float]]:
    if workers == 1:
        for job in jobs:
            yield _run(job)
        return
    yield from results_of_processes(_run, jobs, workers)


def results(jobs: Sequence[Job], folder: Path) -> dict[str, Any]:
    """Return the results of jobs by name.

    Raises:
        DatasetError: If one is missing or damaged, or was made from something else.
    """
    return {job.name: _entry(job, folder, "result") for job in jobs}


def processor_seconds(jobs: Sequence[Job], folder: Path) -> dict[str, float]:
    """Return the time of a processor that each finished job took, by name; raises as results."""
    return {job.name: float(_entry(job, folder, "seconds")) for job in jobs}


def _entry(job: Job, folder: Path, field: str) -> Any:
    known, path = _known(job, folder), folder / f"{job.name}.json"
    if known is None:
        raise DatasetNotFoundError(f"no result at {path}")
    if changed := _changed(job, known):
        raise DatasetError(f"the result is of something else ({changed}): {path}")
    with reading("result", path):
        return known[field]


def _known(job: Job, folder: Path) -> dict[str, Any] | None:
    """Return what there is of a job."""
    path = folder / f"{job.name}.json"
    if not path.exists():
        return None
    with reading("result", path):
        return parsed_object(read_text(path))


def _changed(job: Job, known: Any, but: Sequence[str] = ()) -> str | None:
    """Say what has changed since the result of a job was made, if there is one."""
    if known is None:
        return None
    now = job.description()
    then = {name: known.get(name) for name in now}
    if isinstance(then["made_from"], dict):
        now["made_from"] |= {name: then["made_from"].get(name) for name in but}
    return _difference("", then, now)


def _difference(path: str, then: Any, now: Any) -> str | None:
    """Say in words where two JSON values first differ."""
    if isinstance(then, dict) and isinstance(now, dict):
        for name in dict.fromkeys([*now, *then]):
            found = _difference(f"{path} {name}", then.get(name), now.get(name))
            if found:
                return found
        return None
    if then == now:
        return None
    words = path.removeprefix(" arguments").removeprefix(" made_from").strip()
    return f"{words} was {_short(then)}, now {_short(now)}"


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    if len(text) in (32, 64) and not set(text) - set("0123456789abcdef"):
        return text[:12]
    return text if len(text) <= 60 else text[:57] + "..."
