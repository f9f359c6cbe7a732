"""Means over scenes with their intervals; none of few scenes, and no figure where none is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = [
    "FEW",
    "LEAST_SCENES",
    "are_few",
    "brackets",
    "column",
    "mean_interval",
    "spread",
]

#: Scenes below which nothing is said of chance: no interval, no test, no verdict.
LEAST_SCENES = 10
#: The reason, where one of them would stand.
FEW = f"Fewer than {LEAST_SCENES} scenes: no interval and no verdict."
RESAMPLES = 1000

Rows = Sequence[Mapping[str, Any]]


def are_few(rows: Iterable[Mapping[str, Any]]) -> bool:
    """Return whether rows are of too few scenes for intervals; one without ``scene`` is one."""
    return len({row.get("scene", i) for i, row in enumerate(rows)}) < LEAST_SCENES


def brackets(groups: Iterable[Rows]) -> str:
    """Return what stands below tables: what brackets are, or why there are none."""
    return FEW if any(map(are_few, groups)) else "Brackets: 95 % bootstrap intervals."


def column(rows: Rows, name: str) -> npt.NDArray[np.float64]:
    """Return a figure of rows [R]; NaN where it is ``None`` or absent."""
    values = [row.get(name) for row in rows]
    return np.array([np.nan if value is None else value for value in values], np.float64)


def mean_interval(rows: Rows, name: str) -> tuple[float, float, float]:
    """Return the mean of a figure over scenes, where it is known, and its 95 % bootstrap interval.

    NaN for a figure that no row has, and for the interval of few scenes.
    """
    values = column(rows, name)
    known = np.isfinite(values)
    values = values[known]
    if not len(values):
        return np.nan, np.nan, np.nan
    if are_few(row for row, there in zip(rows, known, strict=True) if there):
        return float(values.mean()), np.nan, np.nan
    rng = np.random.default_rng(0)
    drawn = values[rng.integers(len(values), size=(RESAMPLES, len(values)))].mean(axis=1)
    low, high = np.percentile(drawn, [2.5, 97.5])
    return float(values.mean()), float(low), float(high)


def spread(values: npt.NDArray[np.float64], digits: int, rows: Rows) -> str:
    """Return the mean of values by seed ± their spread, which is left out of few scenes' rows."""
    if not np.isfinite(values).all():
        return "n/a"
    alone = len(values) < 2 or are_few(rows)
    return f"{values.mean():.{digits}f}" + ("" if alone else f" ± {values.std(ddof=1):.{digits}f}")
