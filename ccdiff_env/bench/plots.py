"""Plots of the traffic benchmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.tables import Condition, Figures
from ccdiff_env.bench.traffic import METHODS
from ccdiff_env.metrics import scores

__all__ = ["plot_scores"]


def plot_scores(table: Mapping[Condition, Figures], path: Path) -> None:
    """Draw controllability against realism, every condition a point, with the Pareto front.

    Numbers of vehicles K at the shortest time between plans are joined by a line, longer times at
    one K by a dotted one.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    chosen = [c for c in table if c.num_controlled != 0]
    named = {n: [table[c].value[n] for c in chosen] for n in ("scr", "orr", "fde", "cfd")}
    cs, rs = scores(**named)  # type: ignore[arg-type]
    at = {c: (float(rs[i]), float(cs[i])) for i, c in enumerate(chosen)}
    figure, axes = plt.subplots(figsize=(7, 5.2), layout="constrained")
    for k, method in enumerate(dict.fromkeys(c.method for c in chosen)):
        label = METHODS[method].label if method in METHODS else method
        for j, (line, names) in enumerate(_lines([c for c in chosen if c.method == method])):
            points = np.array([at[c] for c in line])
            style: dict[str, Any] = {"color": f"C{k % 10}", "linewidth": 1, "markersize": 4.5}
            if j == 0:
                axes.plot(*points.T, "o-", label=label, **style)
            else:
                axes.plot(*points.T, "o:", markerfacecolor="none", **style)
            for point, name in zip(points, names, strict=True):
                axes.annotate(
                    name,
                    point,
                    textcoords="offset points",
                    xytext=(4, 3),
                    fontsize=6,
                    color=style["color"],
                )
    front = sorted(p for p in at.values() if not any(_dominates(other, p) for other in at.values()))
    axes.plot(*np.array(front).T, "k--", linewidth=1, label="Pareto front")
    axes.set_xlabel("realism score RS")
    axes.set_ylabel("controllability score CS")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _lines(rows: Sequence[Condition]) -> list[tuple[list[Condition], list[str]]]:
    """Lines of one method: K at the shortest time between plans, then times at each K."""
    shortest = min(c.replan_steps for c in rows)
    by_k = sorted(
        (c for c in rows if c.replan_steps == shortest),
        key=lambda c: np.inf if c.num_controlled is None else c.num_controlled,
    )
    found = [(by_k, [c.k for c in by_k])]
    for first in by_k:
        line = sorted(
            (c for c in rows if c.num_controlled == first.num_controlled),
            key=lambda c: c.replan_steps,
        )
        if len(line) > 1:
            found.append((line, ["", *(f"{c.replan_steps / 10:g} s" for c in line[1:])]))
    return found


def _dominates(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return one != other and one[0] >= other[0] and one[1] >= other[1]
