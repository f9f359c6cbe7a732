"""Examples of guided traffic to look at: scenes of the traffic benchmark with links to replays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.tables import Condition

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
    lines = []
    for condition in dict.fromkeys(c for c, _ in chosen):
        lines += [
            f"### {METHODS[condition.method].label}, K = {condition.k}, a plan every "
            f"{condition.replan_steps / 10:g} s",
            "",
            "| scene | new collision | C(tau) | shift sigmas | FDE m | off the road % |",
            "|---|---|---|---|---|---|",
        ]
        for c, row in chosen:
            if c != condition:
                continue
            cost, shift = (
                "" if row[name] is None else f"{row[name]:.2f}"
                for name in ("realism_cost", "shift_sigmas")
            )
            fde = "" if row["fde_m"] is None else f"{row['fde_m']:.1f}"
            road = "n/a" if row["off_road"] is None else f"{100 * row['off_road']:.1f}"
            hit = "yes" if row["collision"]["controlled_new"] else "no"
            scene = f"[{row['scene']}]({pages[c, row['scene']]})"
            lines.append(f"| {scene} | {hit} | {cost} | {shift} | {fde} | {road} |")
        lines.append("")
    return "\n".join(lines) + "\n"
