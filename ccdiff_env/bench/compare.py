"""``ccdiff-env compare``: the planners of two runs, scene by scene."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ccdiff_env.bench.intervals import difference, scene_means
from ccdiff_env.bench.planner_report import short_name
from ccdiff_env.bench.planners import TRAFFIC
from ccdiff_env.bench.record import Record, Result
from ccdiff_env.errors import ConfigError
from ccdiff_env.system.table import Column, Table, TableRows, document
from ccdiff_env.system.terminal import counted, say

__all__ = ["compare"]

#: Scenes that are listed, those that changed most.
LISTED = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("first", type=Path, metavar="RUN", help="run folder or submission")
    parser.add_argument("second", type=Path, metavar="RUN", help="what is compared with it")


def run(args: argparse.Namespace) -> int:
    """Print the comparison."""
    say(compare(Record.read(args.first), Record.read(args.second)))
    return 0


def compare(first: Record, second: Record) -> str:
    """Return the differences of two runs of ``bench planners`` in Markdown, second less first.

    A planner is compared with itself; where each run has one alone, with the other's.

    Raises
    ------
    ConfigError
        If they share no planner, or no traffic and scene.
    DatasetError
        If episodes are missing.
    """
    pairs = _pairs(first, second)
    lines = [f"From {first.path} to {second.path}, paired by scene."]
    notes = {note for one, other in pairs for note in _differing(one, other)}
    lines += [f"Not the same: {', '.join(sorted(notes))}."] if notes else []
    rows: TableRows = []
    changed: TableRows = []
    for one, other in pairs:
        title = short_name(one.planner)
        if other.planner != one.planner:
            title += f", {short_name(other.planner)}"
        for traffic in (t for t in one.rows if t in other.rows):
            before, after = (scene_means(of.rows[traffic], "score") for of in (one, other))
            shared = [scene for scene in before if scene in after]
            if not shared:
                continue
            a, b = (np.array([of[s] for s in shared]) for of in (before, after))
            label = TRAFFIC[traffic].label
            figure, p = difference(b - a)
            means = float(a.mean()), float(b.mean())
            rows.append([title, label, len(shared), *means, figure, None if np.isnan(p) else p])
            scores = zip(shared, a.tolist(), b.tolist(), strict=True)
            changed += [[s, title, label, x, y] for s, x, y in scores if x != y]
    if not rows:
        raise ConfigError(f"{first.path} and {second.path} share no traffic and scene")
    changed.sort(key=lambda row: (-abs(row[4] - row[3]), *row[:3]))  # type: ignore[operator]
    scores_of = (Column("first"), Column("second"))
    columns = [*scores_of, Column("difference", sign="+"), Column("p", digits=4)]
    return document(
        *lines,
        Table(["planner", "traffic", "scenes", *columns], rows),
        f"{counted(len(changed), 'score')} changed.",
        Table(["scene", "planner", "traffic", *scores_of], changed[:LISTED], "Changed most"),
    )


def _pairs(first: Record, second: Record) -> list[tuple[Result, Result]]:
    ones, others = first.results(), second.results()
    if len(ones) == len(others) == 1:
        return [(ones[0], others[0])]
    pairs = [(one, other) for one in ones for other in others if one.planner == other.planner]
    if not pairs:
        names = (", ".join(sorted({result.planner for result in of})) for of in (ones, others))
        raise ConfigError("the runs share no planner: {}; {}".format(*names))
    return pairs


def _differing(one: Result, other: Result) -> list[str]:
    """What the figures follow from that is not the same in both."""
    notes = [] if one.heading == other.heading else [f"{one.heading} | {other.heading}"]
    if one.planner_source != other.planner_source:
        notes.append(f"the source of {short_name(one.planner)}")
    return notes
