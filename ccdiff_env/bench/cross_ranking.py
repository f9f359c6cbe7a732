"""Sets of several kinds of traffic: which of them is hardest, which planner stands them best."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ccdiff_env.bench.planner_report import short_name
from ccdiff_env.system.files import read_text, reading

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

    def mean(rows: list[dict[str, str]], figure: str) -> str:
        return f"{np.mean([float(row[figure]) for row in rows]):.2f}" if rows else ""

    lines = [
        "| traffic | made against | scenarios | collision | at fault | avoidable | C(tau) | "
        "FDE m | CFD | other planners collide | s per scene |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in sorted(made, key=lambda row: -share(row, "avoidable")):
        others = [
            cell
            for cell in tested
            if (cell["traffic"], cell["generator"]) == (row["traffic"], row["generator"])
            and cell["planner"] != row["generator"]
        ]
        figures = [f"{share(row, name):.2f}" for name in ("collision", "at_fault", "avoidable")]
        for name, digits in (("realism_cost", 2), ("fde_m", 1), ("cfd", 1)):
            figures.append(_number(row[name], digits))
        lines.append(
            f"| [{row['traffic']}]({folders[row['traffic']].name}/report.html) | "
            f"{short_name(row['generator'])} | {row['scenarios']} | {' | '.join(figures)} | "
            f"{mean(others, 'collision')} | {_number(row['seconds'], 2)} |"
        )
    lines += [
        "",
        "Shares of all scenarios. C(tau), FDE and CFD are of the vehicles that the traffic drives. "
        "In a set the others do as recorded. Seconds of a processor are those for "
        "playing a scene and the search for plans that avoid its collision.",
        "",
        "| planner | score | collision | at fault | reacting: score | reacting: collision |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    ordered = []
    for planner in planners:
        cells = [row for row in tested if row["planner"] == planner]
        sets = [row for row in cells if row["generator"] not in (REACTING, planner)]
        reacting = [row for row in cells if row["generator"] == REACTING]
        figures = [mean(sets, name) for name in ("score", "collision", "at_fault")]
        figures += [mean(reacting, name) for name in ("score", "collision")]
        ordered.append((figures[0], f"| {short_name(planner)} | {' | '.join(figures)} |"))
    lines += [line for _, line in sorted(ordered, key=lambda pair: pair[0], reverse=True)]
    lines += ["", "Means over the sets made against other egos; reacting: in live traffic."]
    return "\n".join(lines) + "\n"


def _number(text: str, digits: int) -> str:
    value = float(text)
    return f"{value:.{digits}f}" if np.isfinite(value) else ""
