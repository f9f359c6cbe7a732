"""Do cliques of the causal graph tell collisions? Correlations over vehicles and over scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.intervals import LEAST_SCENES
from ccdiff_env.bench.methods import label_of
from ccdiff_env.bench.tables import Condition
from ccdiff_env.metrics import pearson
from ccdiff_env.system.files import write_aside
from ccdiff_env.system.table import Table, TableRows, document

__all__ = ["Correlation", "correlations", "write_correlations"]

#: Number of samples, Pearson's r, two-sided p; NaN where one of the two does not vary.
Correlation = tuple[int, float, float]
#: Features: name, title.
FEATURES = {
    "of_vehicle": "vehicles: cliques that hold it",
    "ttc_cliques": "scenes: cliques, times to contact",
    "vehicles": "scenes: vehicles",
    "distance_cliques": "scenes: cliques, distances",
}

Rows = Sequence[Mapping[str, Any]]


def correlations(rows: Rows) -> dict[str, Correlation]:
    """Correlate features of the history with new collisions in the episode.

    Parameters
    ----------
    rows
        One dictionary per scene, see :func:`ccdiff_env.bench.episode.measure`.

    Returns
    -------
    dict
        By name of the feature: ``of_vehicle`` over all vehicles, with whether the vehicle
        collides; the others over scenes, with whether anybody does.
    """
    known = [row for row in rows if "features" in row]
    found = {
        "of_vehicle": _correlate(
            [count for row in known for count in row["features"]["of_vehicle"]],
            [hit for row in known for hit in row["vehicle_collided"]],
        )
    }
    hits = [row["collision"]["new"] for row in known]
    for name in FEATURES:
        if name != "of_vehicle":
            found[name] = _correlate([row["features"][name] for row in known], hits)
    return found


def _correlate(x: Sequence[float], y: Sequence[float]) -> Correlation:
    if len(x) < 3 or len(set(x)) == 1 or len(set(y)) == 1:
        return len(x), np.nan, np.nan
    return (len(x), *pearson(x, y))


def write_correlations(by_condition: Mapping[Condition, Rows], folder: Path) -> None:
    """Write ``correlation.md`` and ``correlation.csv``: every condition but the floor."""
    found = {c: correlations(rows) for c, rows in by_condition.items() if c.num_controlled != 0}
    rows: TableRows = [
        [c.method, c.k, c.replan_steps / 10, name, *values]
        for c, by_feature in found.items()
        for name, values in by_feature.items()
    ]
    columns = ("method", "K", "replan_s", "feature", "count", "r", "p")
    Table(columns, rows).write_csv(folder / "correlation.csv")
    shown = []
    for c, by_feature in found.items():
        some = len(by_condition[c]) >= LEAST_SCENES
        cells = [_cell(by_feature[name], some) for name in FEATURES]
        shown.append([label_of(c.method), c.k, f"{c.replan_steps / 10:g}", *cells])
    note = (
        "Pearson's r of the feature with new collisions, and its p value, which says nothing of "
        f"fewer than {LEAST_SCENES} scenes and is left out there. No cell: one never varies."
    )
    table = Table(["method", "K", "a plan every s", *FEATURES.values()], shown)
    write_aside(folder / "correlation.md", document(table, note))


def _cell(found: Correlation, some: bool) -> str:
    count, r, p = found
    if not np.isfinite(r):
        return ""
    return f"{r:.2f} (p = {p:.1g})" if some else f"{r:.2f} (n = {count})"
