"""Run folders of resumable benchmarks: settings, jobs, episodes, replays, and the report."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ccdiff_env.bench.jobs import Job, run_jobs
from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.page import write_report_page
from ccdiff_env.bench.planners import TRAFFIC, window_title
from ccdiff_env.bench.provenance import made_with, scene_hashes, sha256_of, source_digest
from ccdiff_env.bench.replays import Pages, make_replays
from ccdiff_env.bench.scenes import scenes_of, source_title
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.models import weight_files
from ccdiff_env.scenes import is_lone_ego
from ccdiff_env.scenes.arguments import place_from
from ccdiff_env.scenes.sources import coverage
from ccdiff_env.system.files import reading, write_aside
from ccdiff_env.system.settings import kept_settings, write_settings
from ccdiff_env.system.table import Block, Table, document, latex_tables
from ccdiff_env.system.terminal import counted, say, say_page
from ccdiff_env.system.version import __version__
from ccdiff_env.traffic import NETWORKS

#: Arguments of jobs that name who drives, perhaps by a file.
_DRIVE = ("planner", "generator", "method", "traffic")
#: Fields of an episode that are no part of a table: its job, and what repeats it.
_HIDDEN = ("job", "actions", "action")


class Run:
    """A run folder of a resumable benchmark.

    ``args`` are those of :func:`~ccdiff_env.bench.cli.add_run_arguments`, ``settings`` what else
    decides the results, ``seeds`` where there are several. A folder belongs to one choice of all of
    it: a :class:`ConfigError` refuses others. Results that another package, other weights or
    another file of a planner made are made again.
    """

    def __init__(self, args: argparse.Namespace, benchmark: str, **settings: Any) -> None:
        place, self._benchmark = place_from(args), benchmark
        self.source = str(place)  #: Text of the scenes, and how many of its split there are.
        scenes = scenes_of(self.source)
        if all(map(is_lone_ego, scenes)):
            raise ConfigError(
                f"scenes {self.source}: nobody but the ego is in any of the {len(scenes)}, where "
                "every drive is safe; a test split has no annotations"
            )
        self.coverage = coverage(place, scenes.names)
        if place.window is not None:
            print(self.coverage)
        self._window = ""  #: What titles say of the window.
        self.folder: Path = args.out
        files = weight_files()  #: SHA-256 of the shipped weights.
        self.weights = sha256_of(*(f for f in files if f.stem.endswith("_fast")))
        seeds = {"seed": args.seed} if hasattr(args, "seed") else {"seeds": settings.pop("seeds")}
        self._line = f"seed {', '.join(str(s) for s in seeds.get('seeds', [seeds.get('seed')]))}"
        self._options = {"workers": args.workers, "progress": not args.quiet}
        self._device: str = args.device
        self._open = bool(args.open)
        self._start = time.perf_counter()
        #: Weight files by name, of a network in place of the shipped ones.
        self.own_weights = weights_from(getattr(args, "weights", None) or [])
        given = {"benchmark": benchmark, "source": self.source, **seeds, **settings}
        given["coverage"] = self.coverage
        self._own = {name: sha256_of(Path(file)) for name, file in self.own_weights.items()}
        given["own_weights"] = self._own
        self._made_with = made_with()
        self._digests: dict[str, str | None] = {}
        self._jobs: dict[str, Job] = {}
        self._begun = False
        facts = {"weights": self.weights, "made_with": self._made_with}
        self._facts = {**kept_settings(self.folder / "run.json", given), **given, **facts}

    def _begin(self) -> None:
        """Write what the run is, now that work begins: what is refused before leaves no folder."""
        self._begun = True
        write_settings(self.folder / "run.json", self._facts)

    def tell_window(self, window: Mapping[str, int] | None) -> None:
        """Say which steps episodes have, in titles, too, where these are not the usual ones."""
        self._window = window_title(window)
        if window is not None:
            self.note(window=window)
            print(f"{self._benchmark}{self._window}")

    def note(self, **facts: Any) -> None:
        """Write into ``run.json`` what the results were made from; refuses nothing."""
        self._facts |= facts
        if self._begun:
            self._begin()

    def _date(self, job: Job) -> Job:
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

    def episodes(self, jobs: Sequence[Job], *keys: str, **names: str) -> list[dict[str, Any]]:
        """Do the jobs, whose results are lists of episodes; return all of them in one list.

        Each episode gets its ``job``, whose arguments ``keys``, and further ones by other names.
        """
        dated = [self._date(job) for job in jobs]
        self._begin()
        self._jobs |= {job.name: job for job in dated}
        given = {**{key: key for key in keys}, **names}
        by_name, found = run_jobs(dated, self.folder / "raw", **self._options), []
        for job in jobs:
            rows = by_name[job.name]
            with reading("result", self.folder / "raw" / f"{job.name}.json"):
                if not (rows and all(row.keys() for row in rows)):
                    raise DatasetError("no rows of figures")
            of_job = {name: job.arguments.get(key) for name, key in given.items()}
            of_job["job"] = job.name
            if (method := job.arguments.get("method")) is not None:
                of_job["own_weights"] = METHODS[method].weights_of(self._own) or ""
            elif self._own and (traffic := job.arguments.get("traffic")) is not None:
                of_job["own_weights"] = TRAFFIC[traffic].weights_of(self._own) or ""
            found += [{**of_job, **row} for row in rows]
        return found

    def replays(self, rows: Iterable[Mapping[str, Any]]) -> Pages:
        """Write replay pages of episodes; return their addresses from the run folder."""
        return make_replays(((self._jobs[r["job"]], r["scene"]) for r in rows), self.folder)

    def report(
        self,
        title: str,
        parts: Mapping[str, Sequence[Block]],
        episodes: Iterable[Mapping[str, Any]],
        files: Mapping[str, Table],
        *plots: Path | None,
        folded: bool = False,
    ) -> int:
        """Write all files of the report, say its first part, and return the exit status.

        ``files`` are further tables by file name; with ``folded`` the page opens with the plots.
        """
        if not self._begun:
            self._begin()
        texts = {head: document(*blocks) for head, blocks in parts.items()}
        first, *rest = texts.items()
        sections = [first[1], *(f"## {head}\n\n{text}" for head, text in rest if text.strip())]
        write_aside(self.folder / "table.md", "\n".join(sections))
        of_paper = {head: of for head, of in parts.items() if not head.startswith("Worst")}
        write_aside(self.folder / "table.tex", latex_tables(of_paper, self._benchmark))
        for name, table in {"episodes.csv": episodes_table(episodes), **files}.items():
            table.write_csv(self.folder / name)
        page = self.folder / "report.html"
        own = [f"own {network} {digest[:12]}" for network, digest in self._own.items()]
        facts = (
            source_title(self.source, self.coverage),
            self._line,
            f"weights {', '.join([*own, self.weights[:12]])}",
            f"ccdiff-env {__version__}",
            time.strftime("%Y-%m-%d"),
        )
        write_report_page(
            page,
            title=f"{title}{self._window}",
            line=" · ".join(facts),
            plots=[plot for plot in plots if plot is not None],
            parts=texts,
            command=shlex.join(["ccdiff-env", *sys.argv[1:]]),
            folded=folded,
        )
        found, more, _ = first[1].partition("\n### ")
        say(found)
        if more:
            print(f"figure by figure: {self.folder / 'table.md'}")
        seconds = time.perf_counter() - self._start
        print(f"{counted(len(self._jobs), 'job')} in {seconds:.0f} s; report:")
        say_page(page, open_it=self._open)
        return 0


def episodes_table(rows: Iterable[Mapping[str, Any]]) -> Table:
    """Return a row per episode, its keys and figures, without lists and tapes."""
    flat = [
        {
            name: float(value) if isinstance(value, bool) else value
            for name, value in row.items()
            if name not in _HIDDEN and not isinstance(value, (list, tuple))
        }
        for row in rows
    ]
    heads = list(dict.fromkeys(name for row in flat for name in row))
    return Table(heads, [[row.get(name) for name in heads] for row in flat])


def add_weights(parser: argparse._ActionsContainer) -> None:
    """Add custom weights."""
    parser.add_argument(
        "--weights",
        action="append",
        metavar="NAME=FILE",
        help="weights of ccdiff-env train: mine=FILE adds the methods mine, mine_careful and so "
        "on, and the traffic mine-1; under the name of a network they replace it; may be given "
        "more than once (default: the shipped ones)",
    )


def weights_from(given: Sequence[str]) -> dict[str, str]:
    """Return weight files by name, which ``--weights`` gives, and let methods and traffic be called
    by these names.
    """
    found: dict[str, str] = {}
    for text in given:
        network, _, file = text.partition("=")
        if not network.isidentifier() or network in found or not file:
            raise ConfigError(
                f"--weights is {text!r}, expected NAME=FILE, each name once: of a network "
                f"({', '.join(NETWORKS)}), whose weights it replaces, or one of your own"
            )
        if not Path(file).is_file():
            raise DatasetNotFoundError(f"no weights for {network}: {file}")
        found[network] = str(Path(file).resolve())
    METHODS.add(found)
    TRAFFIC.add(found)
    return found
