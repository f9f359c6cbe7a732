"""Sets of several kinds of traffic: which of them is hardest, which planner stands them best."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ccdiff_env.bench.planner_report import short_name
from ccdiff_env.system.files import read_text, reading
from ccdiff_env.system.table import Column, Table, TableRows, document

__all__ = ["ranking"]

#: How a row of ``cross.csv`` names traffic that reacts to the planner.
REACTING = "reacting"


def ranking(folders: Mapping[str, Path]) -> str:
    """Return two tables in Markdown: generators by what they achieve, planners by what they stand.

    A generator is traffic made against an ego. They are in the order of the episodes with a
    collision that the ego could have avoided; planners in that of their mean score in sets that
    were made against others.

    Parameters
    ----------
    folders
        The run folder of each kind of traffic, beside each other, with ``sets.csv`` and
        ``cross.csv`` (:func:`ccdiff_env.bench.cross_report.write_cross`).
    """
    made, tested = [], []
    for traffic, folder in folders.items():
        with reading("scores of a run", folder):
            rows = csv.DictReader(read_text(folder / "sets.csv").splitlines())
            made += [{**row, "traffic": traffic} for row in rows]
            rows = csv.DictReader(read_text(folder / "cross.csv").splitlines())
            tested += [{**row, "traffic": traffic} for row in rows if row["scenarios"] == "all"]
    planners = list(dict.fromkeys(row["planner"] for row in tested))

    def share(row: Mapping[str, str], count: str) -> float:
        return int(row[count]) / max(int(row["scenarios"]), 1)

    def mean(rows: list[dict[str, str]], figure: str) -> float | None:
        return float(np.mean([float(row[figure]) for row in rows])) if rows else None

    sets: TableRows = []
    for row in sorted(made, key=lambda row: -share(row, "avoidable")):
        others = [
            cell
            for cell in tested
            if (cell["traffic"], cell["generator"]) == (row["traffic"], row["generator"])
            and cell["planner"] != row["generator"]
        ]
        page = f"[{row['traffic']}]({folders[row['traffic']].name}/report.html)"
        shares = [share(row, name) for name in ("collision", "at_fault", "avoidable")]
        figures = [_number(row[name]) for name in ("realism_cost", "fde_m", "cfd")]
        hit, seconds = mean(others, "collision"), _number(row["seconds"])
        generator = short_name(row["generator"])
        sets.append([page, generator, row["scenarios"], *shares, *figures, hit, seconds])
    stood: TableRows = []
    for planner in planners:
        cells = [row for row in tested if row["planner"] == planner]
        against = [row for row in cells if row["generator"] not in (REACTING, planner)]
        reacting = [row for row in cells if row["generator"] == REACTING]
        means = [mean(against, name) for name in ("score", "collision", "at_fault")]
        means += [mean(reacting, name) for name in ("score", "collision")]
        stood.append([short_name(planner), *means])
    achieved = map(Column, ("collision", "at_fault", "avoidable"))
    realism = [Column("C(tau)"), Column("FDE m", digits=1), Column("CFD", digits=1)]
    rest = (Column("other planners collide"), Column("s per scene"))
    scores = map(
        Column, ("score", "collision", "at_fault", "reacting: score", "reacting: collision")
    )
    stood.sort(key=lambda row: -1.0 if row[1] is None else row[1], reverse=True)
    return document(
        Table(["traffic", "made against", "scenarios", *achieved, *realism, *rest], sets),
        "Shares of all scenarios. C(tau), FDE and CFD are of the vehicles that the traffic drives. "
        "In a set the others do as recorded. Seconds of a processor are those for "
        "playing a scene and the search for plans that avoid its collision.",
        Table(["planner", *scores], stood),
        "Means over the sets made against other egos; reacting: in live traffic.",
    )


def _number(text: str) -> float | None:
    """A number of a file; what is not known is empty there, or NaN."""
    value = float(text or "nan")
    return value if np.isfinite(value) else None
