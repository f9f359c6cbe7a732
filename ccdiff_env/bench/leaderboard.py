"""``ccdiff-env bench leaderboard``: planners of several runs, recomputed from their raw results."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ccdiff_env.bench.page import write_report_page
from ccdiff_env.bench.planner_report import BASES, Label, comparison, summary, verdict
from ccdiff_env.bench.record import Record, Result
from ccdiff_env.system.table import document, escaped, link
from ccdiff_env.system.terminal import counted


def write_leaderboard(paths: Sequence[Path], out: Path) -> dict[str, str]:
    """Write the page of :func:`leaderboard`, with links to the reports; return the tables."""
    tables = leaderboard([Record.read(path) for path in paths])
    links = [
        link(path.name, Path(os.path.relpath(path / "report.html", out.parent)).as_posix())
        for path in paths
        if (path / "report.html").is_file()
    ]
    line = f"{counted(len(paths), 'run')}; score of nuPlan's closed loop, mean over scenes"
    line += "; figures are as handed in until bench verify has played every episode"
    parts = {**tables, "Reports of the runs": ", ".join(links)}
    write_report_page(out, title="Leaderboard", line=line, plots=[], parts=parts)
    return tables


def leaderboard(records: Sequence[Record]) -> dict[str, str]:
    """Compare the planners of runs of ``bench planners``: heading and Markdown of each table.

    Planners share a table where protocol, scenes (by their hashes), traffic, weights and version
    are the same; without a protocol also seeds and package. A planner that is in several runs is
    named with its run. Planners that are no part of the package are marked where no code is given.

    Raises:
        DatasetError: If episodes of a run are missing.
    """
    groups: dict[str, list[tuple[Record, Result]]] = {}
    for record in records:
        for result in record.results():
            members = groups.setdefault(result.key, [])
            # a run and its own submission hold the same episodes
            twins = (
                i
                for i, (known, other) in enumerate(members)
                if known.path.is_file() != record.path.is_file() and _same(other, result)
            )
            if (twin := next(twins, None)) is None:
                members.append((record, result))
            elif record.code:
                members[twin] = record, result
    tables: dict[str, str] = {}
    for members in groups.values():
        heading = members[0][1].heading
        number = sum(known.partition(" (")[0] == heading for known in tables)
        tables[f"{heading} ({number + 1})" if number else heading] = _table(members)
    return tables


def _same(one: Result, other: Result) -> bool:
    """Return whether two results are of one planner's same episodes, by their digests."""

    def episodes(result: Result) -> set[tuple[Any, ...]]:
        return {
            (traffic, row["scene"], row["seed"], row["digest"])
            for traffic, rows in result.rows.items()
            for row in rows
        }

    same = (one.planner, one.planner_source) == (other.planner, other.planner_source)
    return same and episodes(one) == episodes(other)


def _table(members: Sequence[tuple[Record, Result]]) -> str:
    labels = [record.label(result) for record, result in members]
    named: dict[str, Result] = {}
    for (record, result), label in zip(members, labels, strict=True):
        name = label if labels.count(label) == 1 else f"{label} ({record.path.name})"
        number = sum(known.partition(" #")[0] == name for known in named)
        named[Label(f"{name} #{number + 1}" if number else name)] = result
    traffic = list(members[0][1].rows)
    found = {(name, t): result.rows[t] for name, result in named.items() for t in traffic}
    bases = [name for name, result in named.items() if result.planner in BASES]
    privileged = {name for name, result in named.items() if result.privileged}
    blocks = [verdict(found), *summary(found, privileged)]
    for record, result in members:
        if record.code and result.planner_source is not None:
            blocks.append(
                f"{escaped(record.label(result))}: {link(record.code, record.code)}, source "
                f"{result.planner_source[:8]}, trained on: "
                + escaped(record.training_data or "not said")
            )
    seeds = {name: ", ".join(map(str, result.seeds)) for name, result in named.items()}
    if len({*seeds.values()}) > 1:
        blocks.append("Seeds: " + "; ".join(f"{name} {drawn}" for name, drawn in seeds.items()))
    return document(*blocks, *comparison(found, bases))
