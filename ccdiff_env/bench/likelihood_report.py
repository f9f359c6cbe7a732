"""Report of the realism benchmark: likelihoods of the log by feature and group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.intervals import FEW, are_few, brackets, mean_interval
from ccdiff_env.bench.likelihood import FEATURES, GROUPS, RANK_BINS, RANK_SECONDS
from ccdiff_env.bench.methods import label_of
from ccdiff_env.bench.plots import colours_of, new_plot, save_plot
from ccdiff_env.system.files import write_aside
from ccdiff_env.system.table import Block, Column, Figure, Table, TableRows, document

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
    counted: TableRows = [[m, len(found[m]), *by_name.values()] for m, by_name in figures.items()]
    Table(["method", "scenes", *_COLUMNS], counted).write_csv(folder / "likelihoods.csv")
    ceiling = {name: figure[0] for name, figure in figures.get("replay", {}).items()}
    groups = Table(
        [
            *("method", *map(_head, _SHARED)),
            *(Column(name, digits=3, interval=False) for name in _OWN),
            Column("ade_m", "ADE m"),
            Column("min_ade_m", f"min ADE m of {num_samples}"),
            Column("scr", "SCR"),
            Column("orr", "off road", "%", factor=100.0),
            Column("processor_s", "processor s", digits=3, interval=False),
        ],
        [
            [
                label_of(method),
                *(_shared(by_name[n], ceiling.get(n)) for n in _SHARED),
                *(by_name[n] for n in (*_OWN, *_PLAIN)),
            ]
            for method, by_name in figures.items()
        ],
    )
    parts = Table(
        ["method", *(Column(n, _head(n), digits=3, interval=False) for n in FEATURES)],
        [[label_of(m), *(by_name[n] for n in FEATURES)] for m, by_name in figures.items()],
    )
    note = (
        f"Means over scenes. {brackets(found.values())} {num_samples} episodes per "
        "scene and method: figures from another number cannot be compared. In parentheses: share "
        "of what the log replayed gets. Own: a sample in the place of the log, the ceiling of a "
        "calibrated model."
    )
    few = any(map(are_few, found.values()))
    text = FEW if few else _verdict(figures)
    write_aside(folder / "table.md", document(text, groups, parts, *_ranks(found), note))
    _plot(figures, folder / "likelihoods.png")


def _head(name: str) -> str:
    return name.replace("_half_s", ", 0.5 s").replace("_", " ")


def _shared(figure: Figure, ceiling: float | None) -> str:
    """A likelihood, its interval and its share of the log's."""
    text = Column("", digits=3).text(figure)
    if not ceiling or not np.isfinite(ceiling) or not np.isfinite(figure[0]):
        return text
    return f"{text} ({100.0 * figure[0] / ceiling:.0f} %)"


def _ranks(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[Block]:
    """Table of where the logged speed lies among the samples; nothing without samples."""
    fifths = [f"{100 * k // RANK_BINS} to {100 * (k + 1) // RANK_BINS} %" for k in range(RANK_BINS)]
    rows = []
    for method, of in found.items():
        for seconds in RANK_SECONDS:
            masses = [row[f"ranks_{seconds}s"] for row in of if row.get(f"ranks_{seconds}s")]
            total = np.sum(masses, axis=0) if masses else np.zeros(RANK_BINS)
            if total.sum() == 0.0:
                continue
            shares = (total / total.sum()).tolist()
            off = 100.0 * max(abs(share * RANK_BINS - 1.0) for share in shares)
            rows.append([label_of(method), str(seconds), *shares, off])
    head = "Logged speed among the samples': a calibrated model has 0.20 in each fifth."
    columns = [*map(Column, fifths), Column("off flat", unit="%", digits=0)]
    return [head, Table(["method", "after s", *columns], rows)] if rows else []


def _verdict(figures: Mapping[str, Mapping[str, Figure]]) -> str:
    """Say which method gives the log most likelihood, the log itself left out."""
    total = {m: by_name["realism"][0] for m, by_name in figures.items() if m != "replay"}
    if not total:
        return "Only the log was measured."
    best = max(total, key=lambda m: total[m])
    known = {g: [m for m in total if np.isfinite(figures[m][g][0])] for g in GROUPS}
    leads = {g: max((figures[m][g][0], m) for m in of) for g, of in known.items() if of}
    parts = ", ".join(f"{g}: {label_of(m)} ({value:.3f})" for g, (value, m) in leads.items())
    return f"{label_of(best)} is most likely over all ({total[best]:.3f}). First by group: {parts}."


def _plot(figures: Mapping[str, Mapping[str, Figure]], path: Path) -> None:
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
            label=label_of(method),
            error_kw={"linewidth": 1, "ecolor": "#000000"},
        )
    axes.set_xticks(places, list(GROUPS))
    axes.set_ylabel("likelihood of the log")
    axes.set_ylim(0, 1)
    axes.grid(axis="y", alpha=0.3)
    axes.legend(fontsize=8, loc="upper left", framealpha=0)
    save_plot(figure, path)
