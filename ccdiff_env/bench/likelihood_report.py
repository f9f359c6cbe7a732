"""Report of the realism benchmark: likelihoods of the log by feature and group."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.intervals import FEW, are_few, brackets, cell, mean_interval
from ccdiff_env.bench.likelihood import FEATURES, GROUPS
from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.plots import colours_of, new_plot, save_plot
from ccdiff_env.files import write_aside, writing

__all__ = ["write_likelihoods"]

_COLUMNS = (*GROUPS, *FEATURES, "ade_m", "min_ade_m")


def write_likelihoods(
    found: Mapping[str, Sequence[Mapping[str, Any]]], folder: Path, *, num_samples: int
) -> None:
    """Write ``table.md``, ``likelihoods.csv`` and ``likelihoods.png``.

    Parameters
    ----------
    found
        Rows per scene of every method, see
        :func:`ccdiff_env.bench.likelihood.scene_likelihoods`.
    folder
        Where to.
    num_samples
        Episodes per scene and method, which the likelihoods depend on.
    """
    figures = {
        method: {name: mean_interval(rows, name) for name in _COLUMNS}
        for method, rows in found.items()
    }
    with writing(folder / "likelihoods.csv") as file:
        writer = csv.writer(file)
        ends = [f"{name}{end}" for name in _COLUMNS for end in ("", "_low", "_high")]
        writer.writerow(["method", "scenes", *ends])
        for method, by_name in figures.items():
            writer.writerow([method, len(found[method]), *(v for f in by_name.values() for v in f)])
    groups = ["| method | " + " | ".join(GROUPS) + f" | ADE m | min ADE m of {num_samples} |"]
    groups.append("|---|" + "---|" * (len(GROUPS) + 2))
    parts = ["| method | " + " | ".join(n.replace("_", " ") for n in FEATURES) + " |"]
    parts.append("|---|" + "---|" * len(FEATURES))
    for method, by_name in figures.items():
        label = METHODS[method].label if method in METHODS else method
        cells = [cell(by_name[n], 3) for n in GROUPS]
        cells += [cell(by_name[n]) for n in ("ade_m", "min_ade_m")]
        groups.append(f"| {label} | " + " | ".join(cells) + " |")
        means = [cell((by_name[n][0], np.nan, np.nan), 3) for n in FEATURES]
        parts.append(f"| {label} | " + " | ".join(means) + " |")
    note = (
        f"Means over scenes. {brackets(found.values())} {num_samples} episodes per "
        "scene and method: figures from another number cannot be compared."
    )
    few = any(map(are_few, found.values()))
    text = [FEW if few else _verdict(figures), "", *groups, "", *parts, "", note]
    write_aside(folder / "table.md", "\n".join(text) + "\n")
    _plot(figures, folder / "likelihoods.png")


def _verdict(figures: Mapping[str, Mapping[str, tuple[float, float, float]]]) -> str:
    """Say which method gives the log most likelihood, the log itself left out."""
    label = {m: METHODS[m].label if m in METHODS else m for m in figures}
    total = {
        m: float(np.nanmean([by_name[g][0] for g in GROUPS]))
        for m, by_name in figures.items()
        if m != "replay"
    }
    if not total:
        return "Only the log was measured."
    best = max(total, key=lambda m: total[m])
    known = {g: [m for m in total if np.isfinite(figures[m][g][0])] for g in GROUPS}
    leads = {g: max((figures[m][g][0], m) for m in of) for g, of in known.items() if of}
    parts = ", ".join(f"{g}: {label[m]} ({value:.3f})" for g, (value, m) in leads.items())
    return f"{label[best]} is most likely over all ({total[best]:.3f}). First by group: {parts}."


def _plot(figures: Mapping[str, Mapping[str, tuple[float, float, float]]], path: Path) -> None:
    figure, axes = new_plot(7, 4.2)
    colours = colours_of(figures)
    width = 0.8 / len(figures)
    places = np.arange(len(GROUPS))
    for i, (method, by_name) in enumerate(figures.items()):
        value, low, high = np.array([by_name[name] for name in GROUPS]).T
        axes.bar(
            places + (i - 0.5 * (len(figures) - 1)) * width,
            value,
            width,
            color=colours[method],
            yerr=[value - low, high - value],
            label=METHODS[method].label if method in METHODS else method,
            error_kw={"linewidth": 1, "ecolor": "#000000"},
        )
    axes.set_xticks(places, list(GROUPS))
    axes.set_ylabel("likelihood of the log")
    axes.set_ylim(0, 1)
    axes.grid(axis="y", alpha=0.3)
    axes.legend(fontsize=8, loc="upper left", framealpha=0)
    save_plot(figure, path)
