"""Arguments that benchmarks share, and how a run begins and ends."""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ccdiff_env.bench.page import write_report_page
from ccdiff_env.bench.scenes import source_of, source_title
from ccdiff_env.errors import ConfigError
from ccdiff_env.models import shipped_weights

__all__ = [
    "add_replays",
    "add_run_arguments",
    "add_scene_arguments",
    "begin",
    "close",
    "run_options",
    "source_from",
]


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Add which scenes are played."""
    parser.add_argument("--dataroot", help="folder of nuScenes; the embedded scenes without it")
    parser.add_argument("--version", default="v1.0-trainval", help="folder of the tables")
    parser.add_argument("--split", help="split (ccdiff100; of the embedded scenes: val)")
    parser.add_argument("--limit", type=int, help="only so many scenes, the first ones")


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what every resumable benchmark takes: scenes, run folder, backend."""
    add_scene_arguments(parser)
    parser.add_argument("--out", required=True, type=Path, help="run folder; a run goes on there")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--backend", choices=["local", "ray"], default="local")
    parser.add_argument("--workers", type=int, default=1, help="processes of the local backend")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def source_from(args: argparse.Namespace) -> dict[str, Any]:
    """Return the description of the scenes that the arguments name."""
    default = "val" if args.dataroot is None else "ccdiff100"
    return source_of(
        dataroot=args.dataroot,
        version=args.version,
        split=args.split or default,
        limit=args.limit,
    )


def begin(args: argparse.Namespace, settings: dict[str, Any]) -> str:
    """Make the run folder, or check that it belongs to the same run, by settings and weights.

    Returns the SHA-256 of the weights.
    """
    weights = hashlib.sha256(shipped_weights().read_bytes()).hexdigest()
    settings = {**settings, "weights": weights}
    known = {}
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / "run.json"
    if path.exists():
        known = json.loads(path.read_text(encoding="utf-8"))
        changed = [k for k in settings if k in known and known[k] != settings[k]]
        if changed:
            raise ConfigError(
                f"--out holds a run with another {changed[0]}: {known[changed[0]]!r}, now "
                f"{settings[changed[0]]!r}; choose another folder"
            )
    path.write_text(json.dumps({**known, **settings}, indent=1), encoding="utf-8")
    return weights


def add_replays(parser: argparse.ArgumentParser, which: str) -> None:
    """Add how many replays are made."""
    parser.add_argument(
        "--replays", type=int, default=0, metavar="N", help=f"write replay pages of the N {which}"
    )


def run_options(args: argparse.Namespace) -> dict[str, Any]:
    """Return what :func:`~ccdiff_env.bench.jobs.run_jobs` is told."""
    return {"backend": args.backend, "workers": args.workers, "progress": not args.quiet}


def close(
    args: argparse.Namespace,
    *,
    title: str,
    weights: str,
    plots: Sequence[str],
    parts: Mapping[str, str],
    changed: int,
    num_jobs: int,
    seconds: float,
) -> int:
    """Write the report page of a run, and say what there is."""
    line = f"{source_title(source_from(args))} · seed {args.seed} · weights {weights[:12]}"
    texts = {head: (args.out / file).read_text(encoding="utf-8") for head, file in parts.items()}
    page = args.out / "report.html"
    write_report_page(
        page, title=title, line=line, plots=[args.out / name for name in plots], parts=texts
    )
    print((args.out / "table.md").read_text(encoding="utf-8"))
    if changed:
        print(f"{changed} replays differ from what was measured (by another machine or release)")
    print(f"{num_jobs} jobs in {seconds:.0f} s; report: {page}")
    return 0
