"""Jobs whose results go to a run folder: resumable, by one process or several."""

from __future__ import annotations

import importlib
import json
import os
import random
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from ccdiff_env.bench.scenes import chunks, scenes_of
from ccdiff_env.errors import ConfigError
from ccdiff_env.system.files import parse_object, read_text, reading, write_aside
from ccdiff_env.system.processes import results_of_processes
from ccdiff_env.system.progress import shown
from ccdiff_env.system.settings import first_change

_DIGEST = re.compile("[0-9a-f]{32,}")


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


def chunk_jobs(
    name: str,
    function: str,
    source: str,
    size: int,
    *,
    shuffle: int | None = None,
    **arguments: Any,
) -> list[Job]:
    """Return a job for each chunk of the scenes of a source; it gets their ``names``.

    They come in the order of the source, or in one that a seed draws, ``shuffle``.
    """
    names = list(scenes_of(source).names)
    if shuffle is not None:
        random.Random(shuffle).shuffle(names)
    return [
        Job(f"{name}-{i:03d}", function, {"source": source, "names": part, **arguments})
        for i, part in enumerate(chunks(names, size))
    ]


def _run(job: Job) -> tuple[str, Any, float]:
    start = time.process_time()
    found = job.call()
    result = found[0] if isinstance(found, tuple) else found
    return job.name, result, time.process_time() - start


def run_jobs(
    jobs: Sequence[Job],
    folder: Path,
    *,
    workers: int = 1,
    progress: bool = True,
) -> dict[str, Any]:
    """Do the jobs whose results are not in the folder yet, or were made from something else.

    Each result is written to ``<name>.json`` once it is there, so that a killed run resumes.
    Results do not depend on the number of ``workers``, which are processes; one works in this one.
    One line on stderr says what has changed since results were made.

    Returns:
        dict: The results of all jobs by name, as JSON has them.

    Raises:
        DatasetError: If a result in the folder is damaged.
    """
    if workers < 1:
        raise ConfigError(f"workers is {workers}, expected at least 1")
    by_name = {job.name: job for job in jobs}
    if len(by_name) != len(jobs):
        raise ConfigError("jobs: two have the same name")
    done: dict[str, Any] = {}
    stale: list[str] = []
    for job in jobs:
        path = folder / f"{job.name}.json"
        if path.exists():
            with reading("result", path):
                known = parse_object(read_text(path))
                if changed := _changed(known, job.description()):
                    stale.append(f"{job.name} because {changed}")
                else:
                    done[job.name] = known["result"]
    if stale:
        are = "result is" if len(stale) == 1 else "results are"
        print(f"{len(stale)} {are} made again, {stale[0]}", file=sys.stderr)
    open_jobs = [job for job in jobs if job.name not in done]
    made: Iterator[tuple[str, Any, float]] = map(_run, open_jobs)
    if workers > 1:
        made = results_of_processes(_run, open_jobs, workers)
    if progress:
        made = shown(made, what="jobs", total=len(jobs), done=len(done))
    for name, result, seconds in made:
        entry = {**by_name[name].description(), "result": result, "seconds": round(seconds, 3)}
        text = json.dumps(entry, allow_nan=False)
        write_aside(folder / f"{name}.json", text)
        done[name] = json.loads(text)["result"]
    return done


def _changed(then: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    """Say in what two descriptions of a job differ first, by names in words."""
    changed = first_change(*map(_decides, (then, now)))
    if changed is None:
        return None
    name, old, new = changed
    if any(isinstance(value, str) and _DIGEST.fullmatch(value) for value in (old, new)):
        return f"{name} {'is new' if old is None else 'is gone' if new is None else 'has changed'}"
    return f"{name} was {old!s:.60}, now {new!s:.60}"


def _decides(entry: Mapping[str, Any]) -> dict[str, Any]:
    """What decides a result."""
    parts = (entry.get(part) for part in ("arguments", "made_from"))
    given = (part.items() for part in parts if isinstance(part, dict))  # damaged otherwise
    return {"function": entry.get("function"), **dict(chain.from_iterable(given))}
