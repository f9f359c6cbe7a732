"""Arguments that benchmarks share."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.planners import TRAFFIC
from ccdiff_env.errors import ConfigError
from ccdiff_env.planners.built_in import EGO_HELP
from ccdiff_env.scenes.arguments import add_scene_arguments

T = TypeVar("T")
#: Help of an option that names planners.
PLANNERS = f"comma-separated, of: {EGO_HELP.partition('of: ')[2]}"


def add_run_arguments(parser: argparse.ArgumentParser, *, several_seeds: bool = False) -> None:
    """Add what every resumable benchmark takes: scenes, run folder, seed or seeds, backend."""
    add_scene_arguments(parser, "test")
    parser.add_argument("--out", required=True, type=Path, help="run folder; resumes a run in it")
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
    parser.add_argument(
        "--device",
        default="cpu",
        help="where networks of traffic run: cpu, cuda, or cuda:N (with torch)",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    there = parser.add_mutually_exclusive_group()
    there.add_argument(
        "--resume", action="store_true", help="refuse to start where --out holds no run"
    )
    there.add_argument("--overwrite", action="store_true", help="delete the run in --out first")
    parser.add_argument("--open", action="store_true", help="open the report in the browser")


def add_traffic(
    parser: argparse.ArgumentParser, default: str | None, what: str, more: str = ""
) -> None:
    """Add who drives the others, kinds of traffic by name."""
    names = ", ".join(TRAFFIC)
    parser.add_argument("--traffic", default=default, help=f"{what}, of: {names}{more}")


def add_methods(parser: argparse.ArgumentParser, default: str, more: str = "") -> None:
    """Add which methods of traffic are compared."""
    text = f"comma-separated{more}, of: {', '.join(METHODS)}"
    parser.add_argument("--methods", default=default, help=text)


def add_replays(parser: argparse.ArgumentParser, which: str) -> None:
    """Add how many replays are made."""
    parser.add_argument(
        "--replays", type=int, default=0, metavar="N", help=f"write replay pages of the N {which}"
    )


def add_weights(parser: argparse.ArgumentParser) -> None:
    """Add custom weights."""
    parser.add_argument(
        "--weights",
        action="append",
        metavar="NETWORK=FILE",
        help="weights of ccdiff-env train; may be given more than once (default: the shipped ones)",
    )


def seeds_of(text: str) -> list[int]:
    """Return seeds, each once."""
    return list(dict.fromkeys(_listed("--seeds", text, int, "integers")))


def counts(text: str) -> list[int | None]:
    """Return values of K; ``None`` for Full."""
    return _listed("--k", text, lambda k: None if k == "Full" else int(k), "numbers and Full")


def replan_steps(text: str) -> list[int]:
    """Return steps between plans from their seconds T."""
    return _listed("--t", text, lambda t: round(10 * float(t)), "seconds")


def _listed(option: str, text: str, one: Callable[[str], T], what: str) -> list[T]:
    try:
        return [one(part) for part in text.split(",")]
    except (ValueError, OverflowError):
        raise ConfigError(f"{option} is {text!r}, expected {what}, comma-separated") from None
