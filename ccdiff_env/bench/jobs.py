"""Jobs whose results go to a run folder: resumable, by one process or several."""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ccdiff_env.bench.scenes import chunks, scene_names
from ccdiff_env.errors import ConfigError, DatasetError
from ccdiff_env.system.files import parsed_object, read_text, reading, write_aside
from ccdiff_env.system.processes import results_of_processes
from ccdiff_env.system.progress import shown


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
    depends on nothing else. What it returns beside that in a tuple, as recorded episodes, is
    dropped. ``name`` is the file of its result, without ``.json``. ``made_from``
    are hashes of what else the result follows from: where one differs, the job is done again.
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

    def call(self, **more: Any) -> Any:
        """Return what the function does, of ``more`` arguments beside those of the job."""
        use_one_thread()
        module, name = self.function.split(":")
        function: Callable[..., Any] = getattr(importlib.import_module(module), name)
        return function(**self.arguments, **more)

    def run(self) -> Any:
        """Do the work."""
        found = self.call()
        return found[0] if isinstance(found, tuple) else found


def chunk_jobs(name: str, function: str, source: str, size: int, **arguments: Any) -> list[Job]:
    """Return a job for each chunk of the scenes of a source; it gets their ``names``."""
    return [
        Job(f"{name}-{i:03d}", function, {"source": source, "names": part, **arguments})
        for i, part in enumerate(chunks(scene_names(source), size))
    ]


def _run(job: Job) -> tuple[str, Any, float]:
    start = time.process_time()
    found = job.run()
    return job.name, found, time.process_time() - start


def run_jobs(
    jobs: Sequence[Job],
    folder: Path,
    *,
    workers: int = 1,
    progress: bool = True,
) -> None:
    """Do the jobs whose results are not in the folder yet, or were made from something else.

    Each result is written to ``<name>.json`` once it is there, so that a killed run resumes.
    Results do not depend on the number of ``workers``, which are processes; one works in this one.
    One line on stderr says what has changed since results were made.
    """
    if workers < 1:
        raise ConfigError(f"workers is {workers}, expected at least 1")
    if len({job.name for job in jobs}) != len(jobs):
        raise ConfigError("jobs: two have the same name")
    folder.mkdir(parents=True, exist_ok=True)
    stale = {job.name: changed for job in jobs if (changed := _changed(job, folder))}
    if stale:
        first, changed = next(iter(stale.items()))
        are = "result is" if len(stale) == 1 else "results are"
        print(f"{len(stale)} {are} made again, {first} because of: {changed}", file=sys.stderr)
    done = {job.name for job in jobs if (folder / f"{job.name}.json").exists()} - set(stale)
    open_jobs = [job for job in jobs if job.name not in done]
    by_name = {job.name: job for job in jobs}
    found: Iterator[tuple[str, Any, float]] = map(_run, open_jobs)
    if workers > 1:
        found = results_of_processes(_run, open_jobs, workers)
    if progress:
        found = shown(found, what="jobs", total=len(jobs), done=len(done))
    for name, result, seconds in found:
        entry = {**by_name[name].description(), "result": result, "seconds": round(seconds, 3)}
        write_aside(folder / f"{name}.json", json.dumps(entry, allow_nan=False))


def results(jobs: Sequence[Job], folder: Path) -> dict[str, Any]:
    """Return the results of jobs by name.

    Raises:
        DatasetError: If one is missing or damaged, or was made from something else.
    """
    return {job.name: _result(job, folder) for job in jobs}


def _result(job: Job, folder: Path) -> Any:
    changed = _changed(job, folder)
    if changed:
        raise DatasetError(f"made from something else ({changed}): {folder / job.name}.json")
    path = folder / f"{job.name}.json"
    with reading("result", path):
        return parsed_object(read_text(path))["result"]


def _changed(job: Job, folder: Path) -> str | None:
    """Say what has changed since the result of a job was made, if there is one."""
    path = folder / f"{job.name}.json"
    if not path.exists():
        return None
    with reading("result", path):
        known = parsed_object(read_text(path))
    then, now = _flat(known), _flat(job.description())
    for name in dict.fromkeys([*now, *then]):
        if then.get(name) != now.get(name):
            return f"{name} was {_short(then.get(name))}, now {_short(now.get(name))}"
    return None


def _flat(entry: Mapping[str, Any]) -> dict[str, Any]:
    """What decides a result, by names in words; mappings within by theirs."""
    found = {"function": entry.get("function")}
    for part in ("arguments", "made_from"):
        given = entry.get(part)
        given = given if isinstance(given, dict) else {}  # of a damaged file
        for name, value in given.items():
            inner = value.items() if isinstance(value, dict) else [("", value)]
            found |= {f"{name} {key}".rstrip(): one for key, one in inner}
    return found


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    if len(text) in (32, 64) and not set(text) - set("0123456789abcdef"):
        return text[:12]
    return text if len(text) <= 60 else text[:57] + "..."
