"""Examples of guided traffic to look at: scenes of the traffic benchmark with links to replays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.tables import Condition
from ccdiff_env.system.table import Column, Table, document

__all__ = ["choose_examples", "examples_table"]

Row = Mapping[str, Any]


def choose_examples(
    by_condition: Mapping[Condition, Sequence[Row]], count: int
) -> list[tuple[Condition, Row]]:
    """Return scenes of every guided method, at one K and replan period each.

    The condition is the one with K nearest to 5 and the shortest period. Scenes with a new
    collision of a controlled vehicle come first, then those of the least realism cost.
    """
    by_method: dict[str, list[Condition]] = {}
    for condition in by_condition:
        known = METHODS.get(condition.method)
        if known is not None and known.ccdiff.get("criticality", 0.0) > 0.0:
            by_method.setdefault(condition.method, []).append(condition)
    found = []
    for several in by_method.values():
        condition = min(several, key=lambda c: (_distance(c), c.replan_steps))
        rows = sorted(by_condition[condition], key=_order)
        found += [(condition, row) for row in rows[:count]]
    return found


def _distance(condition: Condition) -> float:
    k = condition.num_controlled
    return np.inf if k is None else abs(k - 5)


def _order(row: Row) -> tuple[bool, float, str]:
    cost = row["shift_sigmas"]
    return (
        not row["collision"]["controlled_new"],
        np.inf if cost is None else float(cost),
        str(row["scene"]),
    )


def examples_table(
    chosen: Sequence[tuple[Condition, Row]], pages: Mapping[tuple[Condition, str], str]
) -> str:
    """Return the examples in Markdown, with links to their replays."""
    tables = []
    for condition in dict.fromkeys(c for c, _ in chosen):
        rows = [
            [
                f"[{row['scene']}]({pages[c, row['scene']]})",
                "yes" if row["collision"]["controlled_new"] else "no",
                *(row[name] for name in ("realism_cost", "shift_sigmas", "fde_m")),
                "n/a" if row["off_road"] is None else row["off_road"],
            ]
            for c, row in chosen
            if c == condition
        ]
        columns = [
            Column("realism_cost", "C(tau)"),
            Column("shift_sigmas"),
            Column("fde_m", "FDE m", digits=1),
            Column("off_road", "off the road", "%", digits=1, factor=100.0),
        ]
        label, period = METHODS[condition.method].label, condition.replan_steps / 10
        title = f"{label}, K = {condition.k}, a plan every {period:g} s"
        tables.append(Table(["scene", "new collision", *columns], rows, title))
    return document(*tables)
