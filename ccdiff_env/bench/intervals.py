"""Figures of episodes: means over scenes with bootstrap intervals, paired differences, p values.

Benchmarks have one row per episode, a dictionary with its keys (``scene``, ``planner``, ``traffic``
and the like) beside its figures. Rows of one scene, as of several seeds, are averaged first: scenes
are what is resampled.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.system.table import Figure, Table, TableRows

F64 = npt.NDArray[np.float64]
LEAST_SCENES = 10  #: Fewest scenes for an interval, a test or a verdict.
#: What reports say in place of them.
FEW = f"Fewer than {LEAST_SCENES} scenes: no interval and no verdict."
BRACKETS = "Brackets: 95 % bootstrap intervals over scenes."
RESAMPLES, PERMUTATIONS = 1000, 10_000

Row = Mapping[str, Any]
Rows = Sequence[Row]


def _scene(row: Row, index: int) -> Any:
    """The scene of a row; one without a name is a scene of its own."""
    return row.get("scene", index)


def are_few(rows: Iterable[Row]) -> bool:
    """Return whether rows are of too few scenes for intervals."""
    return len({_scene(row, i) for i, row in enumerate(rows)}) < LEAST_SCENES


def brackets(groups: Iterable[Rows]) -> str:
    """Return the note below tables: what brackets are, or why there are none."""
    return FEW if any(map(are_few, groups)) else BRACKETS


def column(rows: Rows, name: str) -> F64:
    """Return a figure of rows [R]; NaN where it is ``None`` or absent."""
    values = [row.get(name) for row in rows]
    return np.array([np.nan if value is None else value for value in values], np.float64)


def scene_means(rows: Rows, name: str) -> dict[Any, float]:
    """Return the mean of a figure over the rows of each scene, sorted by scene.

    Scenes without a known value are left out.
    """
    found: dict[Any, list[float]] = {}
    for i, (row, value) in enumerate(zip(rows, column(rows, name).tolist(), strict=True)):
        if np.isfinite(value):
            found.setdefault(_scene(row, i), []).append(value)
    return {scene: float(np.mean(found[scene])) for scene in sorted(found)}


def mean_interval(rows: Rows, name: str) -> Figure:
    """Return the mean of a figure over scenes, where it is known, and its 95 % bootstrap interval.

    NaN for a figure that no row has, and for the interval of few scenes.
    """
    return mean_of(np.array(list(scene_means(rows, name).values())))


def difference(pairs: F64) -> tuple[Figure, float]:
    """Return the mean of paired differences by scene [S] with its interval, and its p."""
    few = len(pairs) < LEAST_SCENES
    return mean_of(pairs), np.nan if few else permutation_p(pairs)


def significance(p: float, level: float) -> str:
    """Return what tables say of a p; nothing where it is unknown."""
    return "" if np.isnan(p) else "not significant" if p >= level else "significant"


def mean_of(values: F64) -> Figure:
    """Return the mean of values by scene [S] and its interval, as :func:`mean_interval`."""
    if len(values) < LEAST_SCENES:
        return (float(values.mean()) if len(values) else np.nan), np.nan, np.nan
    rng = np.random.default_rng(0)
    drawn = values[rng.integers(len(values), size=(RESAMPLES, len(values)))].mean(axis=1)
    return (float(values.mean()), *interval(drawn))


def interval(draws: F64) -> tuple[float, float]:
    """Return the 95 % interval of the draws of a bootstrap [R]; NaN without a finite one."""
    if not np.isfinite(draws).any():
        return np.nan, np.nan
    low, high = np.nanpercentile(draws, [2.5, 97.5])
    return float(low), float(high)


def permutation_p(pairs: F64) -> float:
    """Return the two-sided p of a mean difference [S] by the permutation test of signs."""
    signs = _signs(len(pairs))
    least = abs(pairs.sum()) - 1e-12 * np.abs(pairs).sum()  # ties in spite of rounding
    return float((1 + (np.abs(signs @ pairs) >= least).sum()) / (1 + len(signs)))


@lru_cache(maxsize=2)
def _signs(count: int) -> F64:
    """Signs of a permutation test [permutations, count]."""
    return np.random.default_rng(0).choice([-1.0, 1.0], size=(PERMUTATIONS, count))


def grouped(rows: Iterable[Row], *keys: str) -> dict[tuple[Any, ...], list[Row]]:
    """Return rows by their values of some keys, in the order in which these first occur."""
    found: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return found


def figures(rows: Iterable[Row], keys: Sequence[str], names: Sequence[str]) -> Table:
    """Return a row per group of episodes: its keys, its number of scenes, means with intervals."""
    found: TableRows = []
    for key, of in grouped(rows, *keys).items():
        scenes = len({_scene(row, i) for i, row in enumerate(of)})
        found.append([*key, scenes, *(mean_interval(of, name) for name in names)])
    return Table([*keys, "scenes", *names], found)
