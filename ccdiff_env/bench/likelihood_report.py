"""Report of the realism benchmark: likelihoods of the log by feature and group."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.intervals import FEW, are_few, brackets, cell, mean_interval
from ccdiff_env.bench.likelihood import FEATURES, GROUPS, RANK_BINS, RANK_SECONDS
from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.plots import colours_of, new_plot, save_plot
from ccdiff_env.system.files import write_aside, writing

__all__ = ["write_likelihoods"]

_SHARED = ("realism", *GROUPS)
_OWN = ("own_realism", "own_kinematic")
_PLAIN = ("ade_m", "min_ade_m", "scr", "orr", "processor_s")
_COLUMNS = (*_SHARED, *_OWN, *FEATURES, *_PLAIN)


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
    ceiling = {name: figure[0] for name, figure in figures.get("replay", {}).items()}
    heads = (*_SHARED, "own realism", "own kinematic", "ADE m", f"min ADE m of {num_samples}")
    groups = _head(*heads, "SCR", "off road %", "processor s")
    parts = _head(*FEATURES)
    for method, by_name in figures.items():
        label = METHODS[method].label if method in METHODS else method
        cells = [_shared(by_name[n], ceiling.get(n)) for n in _SHARED]
        cells += [cell((by_name[n][0], np.nan, np.nan), 3) for n in _OWN]
        cells += [cell(by_name[n]) for n in ("ade_m", "min_ade_m", "scr")]
        mean, low, high = by_name["orr"]
        cells.append(cell((100.0 * mean, 100.0 * low, 100.0 * high)))
        cells.append(cell((by_name["processor_s"][0], np.nan, np.nan), 3))
        groups.append(f"| {label} | " + " | ".join(cells) + " |")
        means = [cell((by_name[n][0], np.nan, np.nan), 3) for n in FEATURES]
        parts.append(f"| {label} | " + " | ".join(means) + " |")
    note = (
        f"Means over scenes. {brackets(found.values())} {num_samples} episodes per "
        "scene and method: figures from another number cannot be compared. In parentheses: share "
        "of what the log replayed gets. Own: a sample in the place of the log, the ceiling of a "
        "calibrated model."
    )
    few = any(map(are_few, found.values()))
    text = [FEW if few else _verdict(figures), "", *groups, "", *parts, "", *_ranks(found), note]
    write_aside(folder / "table.md", "\n".join(text) + "\n")
    _plot(figures, folder / "likelihoods.png")


def _head(*names: str) -> list[str]:
    """First two lines of a table of methods."""
    cells = [name.replace("_half_s", ", 0.5 s").replace("_", " ") for name in names]
    return ["| method | " + " | ".join(cells) + " |", "|---|" + "---|" * len(names)]


def _shared(figure: tuple[float, float, float], ceiling: float | None) -> str:
    """A likelihood, its interval and its share of the log's."""
    text = cell(figure, 3)
    if not ceiling or not np.isfinite(ceiling) or not np.isfinite(figure[0]):
        return text
    return f"{text} ({100.0 * figure[0] / ceiling:.0f} %)"


def _ranks(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[str]:
    """Table of where the logged speed lies among the samples; nothing without samples."""
    fifths = [f"{100 * k // RANK_BINS} to {100 * (k + 1) // RANK_BINS} %" for k in range(RANK_BINS)]
    lines = _head("after s", *fifths, "off flat %")
    before = len(lines)
    for method, rows in found.items():
        label = METHODS[method].label if method in METHODS else method
        for seconds in RANK_SECONDS:
            masses = [row[f"ranks_{seconds}s"] for row in rows if row.get(f"ranks_{seconds}s")]
            total = np.sum(masses, axis=0) if masses else np.zeros(RANK_BINS)
            if total.sum() == 0.0:
                continue
            shares = total / total.sum()
            off = 100.0 * np.abs(shares * RANK_BINS - 1.0).max()
            cells = [f"{seconds}", *(f"{share:.2f}" for share in shares), f"{off:.0f}"]
            lines.append(f"| {label} | " + " | ".join(cells) + " |")
    head = "Logged speed among the samples': a calibrated model has 0.20 in each fifth."
    return [head, "", *lines, ""] if len(lines) > before else []


def _verdict(figures: Mapping[str, Mapping[str, tuple[float, float, float]]]) -> str:
    """Say which method gives the log most likelihood, the log itself left out."""
    label = {m: METHODS[m].label if m in METHODS else m for m in figures}
    total = {m: by_name["realism"][0] for m, by_name in figures.items() if m != "replay"}
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
