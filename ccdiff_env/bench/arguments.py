"""Arguments that benchmarks share, and the run folder that they name."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from ccdiff_env.bench.jobs import Job, processor_seconds, results, run_jobs
from ccdiff_env.bench.page import write_report_page
from ccdiff_env.bench.provenance import made_with, scene_hashes, sha256_of, source_digest
from ccdiff_env.bench.replays import make_replays
from ccdiff_env.bench.scenes import scenes_of, source_title
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.models import weight_files
from ccdiff_env.scenes.arguments import add_scene_arguments, place_from
from ccdiff_env.scenes.sources import coverage
from ccdiff_env.system.files import parsed_object, read_text, reading, write_aside
from ccdiff_env.system.terminal import counted, say, say_page
from ccdiff_env.system.version import __version__
from ccdiff_env.traffic import NETWORKS

__all__ = [
    "Run",
    "add_device",
    "add_methods",
    "add_replays",
    "add_run_arguments",
    "add_traffic",
    "add_weights",
    "counts",
    "replan_steps",
    "seeds_of",
]

K = TypeVar("K", bound=Hashable)
#: Arguments of jobs that name who drives, perhaps by a file.
_DRIVE = ("planner", "generator", "ego", "method", "traffic", "start")
#: Replays that a report shows with images.
MAX_IMAGES = 8


class _Names:
    """Keys of a table of this package, imported when they are printed."""

    def __init__(self, table: str) -> None:
        self._table = table

    def __str__(self) -> str:
        module, _, name = self._table.partition(":")
        return ", ".join(getattr(importlib.import_module(f"ccdiff_env.{module}"), name))


class Listed(argparse.Action):
    """Stores a value; its help lists the names of a table, ``"module:table"``."""

    def __init__(self, *args: Any, names: str, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.names = _Names(names)
        self.help = f"{self.help}, of: %(names)s"

    def __call__(self, parser: object, namespace: argparse.Namespace, values: Any, *_: Any) -> None:
        """Store the value."""
        setattr(namespace, self.dest, values)


#: Tables of names for :class:`Listed`.
METHODS, TRAFFIC = "bench.methods:METHODS", "bench.planners:TRAFFIC"
PLANNERS = (
    "constant_velocity, idm, lane_idm, replay, pdm, pdm_ccdiff, arbiter, diffusion, ccdiff, ego, "
    "ego_replay, imitation, pdm_open, module:name of a class or function, module:name?option=value "
    "with options, nuplan:package.module.Class of a planner of nuPlan, files of this package "
    "(.safetensors) or of stable-baselines3 (.zip, which runs the code in it: trust whoever made "
    "it)"
)


def add_run_arguments(parser: argparse.ArgumentParser, *, several_seeds: bool = False) -> None:
    """Add what every resumable benchmark takes: scenes, run folder, seed or seeds, backend."""
    add_scene_arguments(parser, "test")
    parser.add_argument("--out", required=True, type=Path, help="run folder; a run goes on there")
    if several_seeds:
        parser.add_argument("--seeds", help="of the episodes, comma-separated (default: 0,1,2)")
    else:
        parser.add_argument("--seed", type=int, default=0, help="seed of the episodes")
    parser.add_argument(
        "--backend", choices=["local", "ray"], default="local", help="where jobs run"
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=1,
        help=f"processes of the local backend; this machine has {os.cpu_count()} processors",
    )
    add_device(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    there = parser.add_mutually_exclusive_group()
    there.add_argument(
        "--resume", action="store_true", help="refuse to begin anew: there must be a run in --out"
    )
    there.add_argument(
        "--overwrite", action="store_true", help="delete the run in --out, and begin anew"
    )
    parser.add_argument("--open", action="store_true", help="open the report in the browser")


def add_traffic(
    parser: argparse.ArgumentParser, default: str | None, what: str = "the others"
) -> argparse.Action:
    """Add who drives the others, kinds of traffic by name; returns the argument."""
    return parser.add_argument(
        "--traffic",
        action=Listed,
        names=TRAFFIC,
        default=default,
        help=f"{what}, comma-separated",
    )


def add_device(parser: argparse.ArgumentParser) -> None:
    """Add where networks run."""
    parser.add_argument(
        "--device",
        default="cpu",
        help="where networks of traffic run: cpu, cuda, or cuda:N (with torch)",
    )


def add_methods(parser: argparse.ArgumentParser, default: str) -> None:
    """Add which methods of traffic are compared."""
    parser.add_argument(
        "--methods", action=Listed, names=METHODS, default=default, help="comma-separated"
    )


def add_replays(parser: argparse.ArgumentParser, which: str) -> None:
    """Add how many replays are made."""
    parser.add_argument(
        "--replays", type=int, default=0, metavar="N", help=f"write replay pages of the N {which}"
    )


def add_weights(parser: argparse.ArgumentParser) -> None:
    """Add weights of one's own."""
    parser.add_argument(
        "--weights",
        action="append",
        metavar="NETWORK=FILE",
        help="weights of ccdiff-env train; may be given more than once (default: the shipped ones)",
    )


def _weights_from(given: Sequence[str]) -> dict[str, str]:
    """Return weight files by network, which ``--weights`` names."""
    found: dict[str, str] = {}
    for text in given:
        network, _, file = text.partition("=")
        if network not in NETWORKS or network in found or not file:
            raise ConfigError(
                f"--weights is {text!r}, expected NETWORK=FILE, once for each of: "
                + ", ".join(NETWORKS)
            )
        if not Path(file).is_file():
            raise DatasetNotFoundError(f"no weights for {network}: {file}")
        found[network] = str(Path(file).resolve())
    return found


class Run:
    """A run folder of a resumable benchmark: its settings, jobs, replays, and report.

    Parameters
    ----------
    args
        Arguments of :func:`add_run_arguments`.
    benchmark
        Its name.
    **settings
        What else decides the results, ``seeds`` where there are several; a folder belongs to one
        choice of all of it, and to the scenes, the seed, and weights of one's own. What changes
        with the package, its weights or a planner's file is done again.

    Raises
    ------
    ConfigError
        If the folder holds a run with other settings.
    """

    def __init__(self, args: argparse.Namespace, benchmark: str, **settings: Any) -> None:
        place = place_from(args)
        #: Text of the scenes, and how many of its split there are.
        self.source = str(place)
        self.coverage = coverage(place, len(scenes_of(self.source)))
        self.folder: Path = args.out
        #: SHA-256 of the shipped weights.
        files = weight_files()
        self.weights = sha256_of(*(f for f in files if f.stem.endswith("_fast")))
        seeds = {"seed": args.seed} if hasattr(args, "seed") else {"seeds": settings.pop("seeds")}
        self._line = f"seed {', '.join(str(s) for s in seeds.get('seeds', [seeds.get('seed')]))}"
        self._options = {
            "backend": args.backend,
            "workers": args.workers,
            "progress": not args.quiet,
        }
        self._device: str = args.device
        self._images: list[tuple[str, str, Path]] = []
        self._open = bool(args.open)
        self._start, self._num_jobs, self._num_changed = time.perf_counter(), 0, 0
        #: Weight files by network, in place of the shipped ones.
        self.own_weights = _weights_from(getattr(args, "weights", None) or [])
        given = {"benchmark": benchmark, "source": self.source, **seeds, **settings}
        given["coverage"] = self.coverage
        given["own_weights"] = {name: sha256_of(Path(f)) for name, f in self.own_weights.items()}
        self._made_with = made_with()
        self._digests: dict[str, str | None] = {}
        self._begun = False
        if getattr(args, "overwrite", False):
            self._delete()
        elif getattr(args, "resume", False) and not (self.folder / "run.json").exists():
            raise DatasetNotFoundError(f"--resume: there is no run in {self.folder}")
        facts = {"weights": self.weights, "made_with": self._made_with}
        self._facts = {**self._agreeing(given), **given, **facts}

    def _delete(self) -> None:
        """Delete the run of the folder; a folder of anything else is left as it is."""
        if not self.folder.exists():
            return
        if not (self.folder / "run.json").is_file():
            raise ConfigError(f"--overwrite deletes runs, but {self.folder} has no run.json")
        shutil.rmtree(self.folder)

    def _begin(self) -> None:
        """Write what the run is, now that work begins: what is refused before leaves no folder."""
        self._begun = True
        self.folder.mkdir(parents=True, exist_ok=True)
        write_aside(self.folder / "run.json", json.dumps(self._facts, indent=1))

    def _agreeing(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Return what ``run.json`` holds; refuse other settings than those."""
        path = self.folder / "run.json"
        with reading("settings of a run", path):
            known = parsed_object(read_text(path)) if path.exists() else {}
        if known:
            known.setdefault("own_weights", {})
        changed = [k for k in settings if k in known and known[k] != settings[k]]
        if changed:
            raise ConfigError(
                f"--out holds a run with other settings: {changed[0]} {known[changed[0]]!r}, now "
                f"{settings[changed[0]]!r}; choose another folder"
            )
        return known

    def note(self, **facts: Any) -> None:
        """Write into ``run.json`` what the results were made from; refuses nothing."""
        self._facts |= facts
        if self._begun:
            self._begin()

    def _dated(self, job: Job) -> Job:
        """Return a job that knows what its result follows from beside its arguments."""
        made_from: dict[str, Any] = {
            "version": self._made_with["version"],
            "package": self._made_with["package"],
            "weights": self.weights,
        }
        given = job.arguments
        if "source" in given:
            made_from["scenes"] = scene_hashes(given["source"], given.get("names"))
        if "sources" not in given:
            found = {given[name]: self._digest(given[name]) for name in _DRIVE if given.get(name)}
            made_from["files"] = {name: digest for name, digest in found.items() if digest}
        if self._device != "cpu":  # results of another device are results of their own
            given = {**given, "device": self._device}
        return replace(job, arguments=given, made_from={**made_from, **job.made_from})

    def _digest(self, name: str) -> str | None:
        if name not in self._digests:
            self._digests[name] = source_digest(name)
        return self._digests[name]

    def results(self, jobs: Sequence[Job], folder: str = "raw") -> dict[str, Any]:
        """Do the jobs whose results are not there yet; return the results of all by name."""
        jobs = [self._dated(job) for job in jobs]
        self._begin()
        run_jobs(jobs, self.folder / folder, **self._options)
        self._num_jobs += len(jobs)
        return results(jobs, self.folder / folder)

    def processor_seconds(self, jobs: Sequence[Job]) -> dict[str, float]:
        """Return the time of a processor that each finished job took, by name."""
        return processor_seconds([self._dated(job) for job in jobs], self.folder / "raw")

    def rows(self, jobs: Sequence[Job], *keys: str) -> dict[tuple[Any, ...], list[Any]]:
        """Do the jobs, whose results are lists; join those whose arguments agree in some keys."""
        found: dict[tuple[Any, ...], list[Any]] = {}
        by_name = self.results(jobs)
        for job in jobs:
            rows = by_name[job.name]
            with reading("result", self.folder / "raw" / f"{job.name}.json"):
                if not (rows and all(row.keys() for row in rows)):
                    raise DatasetError("no rows of figures")
            found.setdefault(tuple(job.arguments.get(k) for k in keys), []).extend(rows)
        return found

    def replays(
        self, wanted: Mapping[K, tuple[Job, str]], title: Callable[[K], str]
    ) -> dict[K, str]:
        """Write replay pages of scenes of jobs; return their addresses from the run folder.

        The report shows the first ones with their titles.
        """
        dated = {key: (self._dated(job), scene) for key, (job, scene) in wanted.items()}
        pages, changed = make_replays(dated, self.folder, **self._options)
        self._num_changed += len(changed)
        for key, address in list(pages.items())[:MAX_IMAGES]:
            image = self.folder / Path(address.partition("#")[0]).with_suffix(".png")
            self._images.append((title(key), address, image))
        return pages

    def write(self, file: str, text: str) -> None:
        """Write a text of the run."""
        if not self._begun:
            self._begin()
        write_aside(self.folder / file, text)

    def report(self, title: str, *, plots: Sequence[str], parts: Mapping[str, str]) -> int:
        """Write the report page, say what there is, and return the exit status.

        Parameters
        ----------
        title
            Heading.
        plots
            Images in the run folder.
        parts
            Headings, and Markdown files in the run folder.
        """
        line = " · ".join(
            [
                source_title(self.source, self.coverage),
                self._line,
                f"weights {self.weights[:12]}",
                f"ccdiff-env {__version__}",
                time.strftime("%Y-%m-%d"),
            ]
        )
        texts = {head: read_text(self.folder / file) for head, file in parts.items()}
        page = self.folder / "report.html"
        images = [self.folder / name for name in plots]
        write_report_page(
            page,
            title=title,
            line=line,
            plots=images,
            parts=texts,
            images=self._images,
            command=shlex.join(["ccdiff-env", *sys.argv[1:]]),
        )
        found, more, _ = read_text(self.folder / "table.md").partition("\n### ")
        say(found)
        if more:
            print(f"figure by figure: {self.folder / 'table.md'}")
        if self._num_changed:
            differ = "replay differs" if self._num_changed == 1 else "replays differ"
            print(
                f"{self._num_changed} {differ} from what was measured "
                "(by another machine or release)"
            )
        seconds = time.perf_counter() - self._start
        print(f"{counted(self._num_jobs, 'job')} in {seconds:.0f} s; report:")
        say_page(page, open_it=self._open)
        return 0


def seeds_of(text: str) -> list[int]:
    """Return seeds, each once."""
    try:
        return list(dict.fromkeys(int(part) for part in text.split(",")))
    except ValueError:
        raise ConfigError(f"--seeds is {text!r}, expected integers, comma-separated") from None


def counts(text: str) -> list[int | None]:
    """Return values of K; ``None`` for Full."""
    try:
        return [None if part == "Full" else int(part) for part in text.split(",")]
    except ValueError:
        raise ConfigError(f"K is {text!r}, expected numbers and Full, comma-separated") from None


def replan_steps(text: str) -> list[int]:
    """Return steps between plans from their seconds T."""
    try:
        return [round(10 * float(part)) for part in text.split(",")]
    except (ValueError, OverflowError):
        raise ConfigError(f"--t is {text!r}, expected seconds, comma-separated") from None
