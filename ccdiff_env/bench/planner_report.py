"""Report of the planner benchmark: table, robustness curve, worst scenes."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.intervals import FEW, are_few, brackets, cell, mean_interval
from ccdiff_env.bench.planners import TRAFFIC
from ccdiff_env.bench.plots import colours_of, new_plot, save_plot
from ccdiff_env.files import write_aside, writing

__all__ = [
    "short_name",
    "summary",
    "verdict",
    "worst_scenes",
    "worst_table",
    "write_report",
]

Row = Mapping[str, Any]
#: Rows of one planner in one traffic: planner, traffic -> one dictionary per scene.
Results = Mapping[tuple[str, str], Sequence[Row]]

_PARTS = (
    "score",
    "no_at_fault_collision",
    "collision",
    "on_road",
    "progress",
    "ttc",
    "comfort",
    "speed_limit",
    "success",
)
_REASONS = {
    "no_at_fault_collision": "collision at fault",
    "on_road": "off the road",
    "makes_progress": "no progress",
    "right_way": "wrong way",
    "ttc": "close call",
}


def write_report(
    found: Results,
    folder: Path,
    *,
    worst: int = 10,
    pages: Mapping[tuple[str, str, str], str] | None = None,
) -> None:
    """Write ``scores.csv``, ``table.md``, ``robustness.png`` and ``worst.md``.

    Parameters
    ----------
    found
        Rows per scene of every planner in every traffic.
    folder
        Where to.
    worst
        Scenes to list per planner.
    pages
        Addresses of replays by planner, traffic and scene.
    """
    planners = list(dict.fromkeys(p for p, _ in found))
    traffic = list(dict.fromkeys(t for _, t in found))
    with writing(folder / "scores.csv") as file:
        writer = csv.writer(file)
        writer.writerow(["planner", "traffic", "scene", *_PARTS, "min_ttc_s"])
        for (planner, name), rows in found.items():
            for row in rows:
                parts = [row[part] for part in (*_PARTS, "min_ttc_s")]
                writer.writerow([planner, name, row["scene"], *parts])
    lines = [verdict(found, planners, traffic), "", *summary(found, planners, traffic), ""]
    for name in traffic:
        lines += [f"### Traffic: {TRAFFIC[name].label}", ""]
        lines += ["| planner | " + " | ".join(p.replace("_", " ") for p in _PARTS) + " |"]
        lines += ["|---|" + "---|" * len(_PARTS)]
        for planner in planners:
            cells = []
            for part in _PARTS:
                mean, *bounds = mean_interval(found[planner, name], part)
                low, high = bounds if part == "score" else (np.nan, np.nan)
                cells.append(cell((mean, low, high)))
            lines.append(f"| {short_name(planner)} | " + " | ".join(cells) + " |")
        lines.append("")
    best = "" if any(map(are_few, found.values())) else " Emphasised: best of its traffic."
    lines.append(f"Means over scenes. {brackets(found.values())}{best}")
    write_aside(folder / "table.md", "\n".join(lines) + "\n")
    write_aside(folder / "worst.md", worst_table(found, worst, pages or {}))
    _plot(found, planners, traffic, folder / "robustness.png")


def short_name(planner: str) -> str:
    """Return the name of a planner in tables: of a file, its name without the suffix."""
    return Path(planner).stem if planner.endswith(".zip") else planner


def worst_scenes(found: Results, planner: str, count: int) -> list[tuple[str, Row]]:
    """Return the scenes in which a planner scores least: traffic and row, the worst first.

    Each scene stands once, with the traffic that is worst. Ties go to the smaller least time to
    contact.
    """
    rows = [(name, row) for (p, name), part in found.items() if p == planner for row in part]
    rows.sort(key=lambda r: (r[1]["score"], r[1]["min_ttc_s"], r[0], r[1]["scene"]))
    seen: dict[str, tuple[str, Row]] = {}
    for name, row in rows:
        seen.setdefault(row["scene"], (name, row))
    return list(seen.values())[:count]


def worst_table(
    found: Results, count: int, pages: Mapping[tuple[str, str, str], str], traffic: str = "traffic"
) -> str:
    """Return the worst scenes of every planner in Markdown.

    Parameters
    ----------
    found
        Rows per scene of every planner in every traffic.
    count
        Scenes per planner.
    pages
        Addresses of replays by planner, traffic and scene.
    traffic
        Heading of the traffic's column.
    """
    lines = []
    for planner in dict.fromkeys(p for p, _ in found):
        lines += [
            f"### {short_name(planner)}",
            "",
            f"| scene | {traffic} | score | why |",
            "|---|---|---|---|",
        ]
        for name, row in worst_scenes(found, planner, count):
            why = [
                text for part, text in _REASONS.items() if row[part] is not None and row[part] < 1.0
            ]
            if row["collision"] and row["no_at_fault_collision"]:
                why.insert(0, "collision, not at fault")
            page = pages.get((planner, name, row["scene"]))
            scene = row["scene"] if page is None else f"[{row['scene']}]({page})"
            lines.append(f"| {scene} | {name} | {row['score']:.2f} | {', '.join(why)} |")
        lines.append("")
    return "\n".join(lines) + "\n"


def _plot(found: Results, planners: Sequence[str], traffic: Sequence[str], path: Path) -> None:
    level = {n: float(TRAFFIC[n].ccdiff.get("criticality", 0.0)) for n in traffic}
    names = sorted((n for n in traffic if TRAFFIC[n].driver == "ccdiff"), key=lambda n: level[n])
    if len(names) < 2:
        return
    figure, axes = new_plot(7, 4.2)
    x = [level[n] for n in names]
    for planner, colour in colours_of(planners).items():
        means = np.array([mean_interval(found[planner, n], "score") for n in names])
        axes.plot(x, means[:, 0], "o-", label=short_name(planner), color=colour)
        axes.fill_between(x, means[:, 1], means[:, 2], alpha=0.12, color=colour, linewidth=0)
    axes.set_xlabel("criticality of the CCDiff traffic")
    axes.set_ylabel("score")
    axes.set_ylim(0, 1)
    axes.grid(alpha=0.3)
    axes.legend(framealpha=0)
    save_plot(figure, path)


def verdict(found: Results, planners: Sequence[str], traffic: Sequence[str]) -> str:
    """Say in two sentences who is best, and where planners break."""
    if any(map(are_few, found.values())):
        return FEW
    mean = {key: mean_interval(rows, "score") for key, rows in found.items()}
    label = {name: TRAFFIC[name].label for name in traffic}
    sentences = []
    over_all = {p: float(np.mean([mean[p, t][0] for t in traffic])) for p in planners}
    best, *rest = sorted(planners, key=lambda p: -over_all[p])
    if rest:
        first = [t for t in traffic if all(mean[best, t][0] >= mean[p, t][0] for p in rest)]
        where = (
            "in all traffic" if len(first) == len(traffic) else f"in {len(first)} of {len(traffic)}"
        )
        text = f"{short_name(best)} is best over all ({over_all[best]:.2f}), first {where}"
        near = [
            short_name(p) for p in rest if all(mean[p, t][2] >= mean[best, t][1] for t in traffic)
        ]
        if near:
            text += f"; the intervals overlap with those of {' and '.join(near)} everywhere"
        sentences.append(text)
    drops = []
    for planner in planners:
        top = max(traffic, key=lambda t: mean[planner, t][0])
        low = min(traffic, key=lambda t: mean[planner, t][0])
        drops.append((mean[planner, top][0] - mean[planner, low][0], planner, top, low))
    drop, planner, top, low = max(drops)
    if drop >= 0.005:
        sentences.append(
            f"{short_name(planner)} breaks most: from {mean[planner, top][0]:.2f} ({label[top]}) "
            f"to {mean[planner, low][0]:.2f} ({label[low]})"
        )
    count = len(next(iter(found.values())))
    return ". ".join([*sentences, f"{count} scenes"]) + "."


def summary(found: Results, planners: Sequence[str], traffic: Sequence[str]) -> list[str]:
    """Return the lines of a matrix of planners and traffic, the best of each emphasised."""
    mean = {key: mean_interval(rows, "score") for key, rows in found.items()}
    lines = ["| score | " + " | ".join(TRAFFIC[t].label for t in traffic) + " | mean |"]
    lines.append("|---|" + "---:|" * (len(traffic) + 1))
    top = {t: max(round(mean[p, t][0], 2) for p in planners) for t in traffic}
    some = not any(map(are_few, found.values()))
    order = sorted(planners, key=lambda p: -float(np.mean([mean[p, t][0] for t in traffic])))
    for planner in order:
        cells = []
        for name in traffic:
            text = cell(mean[planner, name])
            best = some and len(planners) > 1 and round(mean[planner, name][0], 2) == top[name]
            cells.append(f"**{text}**" if best else text)
        cells.append(f"{np.mean([mean[planner, t][0] for t in traffic]):.2f}")
        lines.append(f"| {short_name(planner)} | " + " | ".join(cells) + " |")
    return lines
