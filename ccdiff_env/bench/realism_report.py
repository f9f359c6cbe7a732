"""Report of the realism benchmark: likelihoods of the log by group and feature, calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ccdiff_env.bench.intervals import brackets, mean_interval
from ccdiff_env.bench.likelihood import FEATURES, GROUPS, RANK_BINS, RANK_SECONDS
from ccdiff_env.bench.methods import label_of
from ccdiff_env.system.table import Block, Column, Figure, Table, TableRows

_SHARED = ("realism", *GROUPS)  #: Figures that are read against those of the log replayed.
_PLAIN = (
    Column("own_realism", digits=3, interval=False),
    Column("own_kinematic", digits=3, interval=False),
    Column("ade_m", "ADE m"),
    Column("min_ade_m", "min ADE m"),
    Column("scr", "SCR"),
    Column("orr", "off road", "%", factor=100.0),
    Column("processor_s", "processor s", digits=3, interval=False),
)
COLUMNS = (*_SHARED, *FEATURES, *(column.name for column in _PLAIN))  #: All figures of a method.


def tables(
    found: Mapping[str, Sequence[Mapping[str, Any]]], num_samples: int
) -> dict[str, list[Block]]:
    """Return the parts of the report from rows per scene of every method."""
    figures = {
        method: {name: mean_interval(rows, name) for name in COLUMNS}
        for method, rows in found.items()
    }
    ceiling = {name: figure[0] for name, figure in figures.get("replay", {}).items()}
    groups = Table(
        ["method", *map(_head, _SHARED), *_PLAIN],
        [
            [
                label_of(method),
                *(_shared(by_name[n], ceiling.get(n)) for n in _SHARED),
                *(by_name[column.name] for column in _PLAIN),
            ]
            for method, by_name in figures.items()
        ],
    )
    parts = Table(
        ["method", *map(_head, FEATURES)],
        [
            [label_of(method), *(_shared(by_name[n], ceiling.get(n)) for n in FEATURES)]
            for method, by_name in figures.items()
        ],
        "By feature",
    )
    note = (
        f"{brackets(found.values())} Of {num_samples} episodes per scene and method: figures from "
        "another number cannot be compared. In parentheses: share of what the log replayed gets. "
        "Own: a sample in the place of the log, the ceiling of a calibrated model."
    )
    return {"Likelihood of the log": [groups, note, parts], "Calibration": _ranks(found)}


def _head(name: str) -> str:
    return name.replace("_half_s", ", 0.5 s").replace("_", " ")


def _shared(figure: Figure, ceiling: float | None) -> str:
    """A likelihood, its interval and its share of the log's."""
    text = Column("", digits=3).text(figure)
    if not ceiling or not np.isfinite(ceiling) or not np.isfinite(figure[0]):
        return text
    return f"{text} ({100.0 * figure[0] / ceiling:.0f} %)"


def _ranks(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[Block]:
    """Where the logged speed lies among the samples; nothing without samples."""
    fifths = [f"{100 * k // RANK_BINS} to {100 * (k + 1) // RANK_BINS} %" for k in range(RANK_BINS)]
    rows: TableRows = []
    for method, of in found.items():
        for seconds in RANK_SECONDS:
            masses = [row[f"ranks_{seconds}s"] for row in of if row.get(f"ranks_{seconds}s")]
            total = np.sum(masses, axis=0) if masses else np.zeros(RANK_BINS)
            if total.sum() == 0.0:
                continue
            shares = (total / total.sum()).tolist()
            off = 100.0 * max(abs(share * RANK_BINS - 1.0) for share in shares)
            rows.append([label_of(method), str(seconds), *shares, off])
    head = "Rank of the logged speed among the samples': a calibrated model has 0.20 in each fifth."
    columns = [*map(Column, fifths), Column("rank-histogram error", unit="%", digits=0)]
    return [head, Table(["method", "after s", *columns], rows)] if rows else []
