"""Plots of the traffic benchmark."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ccdiff_env.bench.tables import Condition, Figures
from ccdiff_env.bench.traffic import METHODS
from ccdiff_env.metrics import scores

__all__ = ["plot_scores"]


def plot_scores(table: Mapping[Condition, Figures], path: Path) -> None:
    """Draw controllability against realism, every condition a point, with the Pareto front."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    chosen = [c for c in table if c.num_controlled != 0]
    named = {n: [table[c].value[n] for c in chosen] for n in ("scr", "orr", "fde", "cfd")}
    cs, rs = scores(**named)  # type: ignore[arg-type]
    figure, axes = plt.subplots(figsize=(7, 5.2), layout="constrained")
    for method in dict.fromkeys(c.method for c in chosen):
        rows = [i for i, c in enumerate(chosen) if c.method == method]
        label = METHODS[method].label if method in METHODS else method
        (line,) = axes.plot(rs[rows], cs[rows], "o-", label=label, linewidth=1, markersize=5)
        for i in rows:
            axes.annotate(
                chosen[i].k,
                (rs[i], cs[i]),
                textcoords="offset points",
                xytext=(4, 3),
                fontsize=7,
                color=line.get_color(),
            )
    front = [
        i
        for i in range(len(chosen))
        if not any(
            cs[j] >= cs[i] and rs[j] >= rs[i] and (cs[j] > cs[i] or rs[j] > rs[i])
            for j in range(len(chosen))
        )
    ]
    front.sort(key=lambda i: float(rs[i]))
    axes.plot(np.array(rs)[front], np.array(cs)[front], "k--", linewidth=1, label="Pareto front")
    axes.set_xlabel("realism score RS")
    axes.set_ylabel("controllability score CS")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)
