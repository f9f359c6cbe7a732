"""Plots of the benchmarks: one colour per method in all of them, in light and dark pages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ccdiff_env.bench.methods import label_of
from ccdiff_env.bench.tables import Condition, Figures
from ccdiff_env.metrics import scores
from ccdiff_env.system.files import read_text, write_aside
from ccdiff_env.view.page import colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["colours_of", "new_plot", "plot_scores", "save_plot"]

_DRIVERS = colours()["light"]
#: Colours of methods and planners: those of the drivers on replays, but for yellow, which white
#: would swallow. Guided CCDiff has the colour of guided vehicles.
COLOURS = {
    **{name: _DRIVERS[name] for name in ("replay", "constant_velocity")},
    "ccdiff": _DRIVERS["adversary"],
    "ccdiff_unguided": _DRIVERS["ccdiff"],
    "ccdiff_one_sample": "#5cbf9f",
    "idm": "#a89100",
    "lane_idm": "#d1bb3a",
    "pdm": "#3b8fd4",
}
#: For all others, in their order.
MORE = ("#8d6bd1", "#c7593f", "#2aa1b3", "#7d8a2e", "#a9743a", "#d46a8a", "#5f7fa8")


def colours_of(names: Iterable[str]) -> dict[str, str]:
    """Return the colour of each method or planner, ``"#rrggbb"``."""
    listed = list(dict.fromkeys(names))
    others = [name for name in listed if name not in COLOURS]
    more = {name: MORE[i % len(MORE)] for i, name in enumerate(others)}
    return {name: COLOURS.get(name, more.get(name, MORE[0])) for name in listed}


def new_plot(width: float, height: float, **options: Any) -> tuple[Figure, Axes]:
    """Return an empty plot of so many inches."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "ccdiff-env"})
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(width, height), layout="constrained", **options)
    for one in np.ravel(axes):
        one.spines[["top", "right"]].set_visible(False)
    return figure, axes


def save_plot(figure: Figure, path: Path) -> None:
    """Write a plot as PNG, and as SVG beside it whose text has the colour of the page."""
    from matplotlib import pyplot as plt

    figure.savefig(path, dpi=130)
    drawn = path.with_suffix(".svg")
    figure.savefig(drawn, transparent=True, metadata={"Date": None})
    plt.close(figure)
    text = read_text(drawn)
    write_aside(drawn, text.replace("#000000", "currentColor"))


def plot_scores(table: Mapping[Condition, Figures], path: Path) -> None:
    """Draw controllability against realism, every condition a point, with the Pareto front.

    Numbers of vehicles K at the shortest time between plans are joined by a line, longer times at
    one K by a dotted one. The ends of lines have names.
    """
    chosen = [c for c in table if c.num_controlled != 0]
    named = {n: [table[c].value[n] for c in chosen] for n in ("scr", "orr", "fde", "cfd")}
    cs, rs = scores(**named)  # type: ignore[arg-type]
    at = {c: (float(rs[i]), float(cs[i])) for i, c in enumerate(chosen) if np.isfinite(rs[i])}
    chosen = list(at)
    if not chosen:  # no road, no realism
        return
    figure, axes = new_plot(7, 5.2)
    colours = colours_of(c.method for c in chosen)
    for method, colour in colours.items():
        for j, (line, names) in enumerate(_lines([c for c in chosen if c.method == method])):
            points = np.array([at[c] for c in line])
            style: dict[str, Any] = {"color": colour, "linewidth": 1, "markersize": 4.5}
            if j == 0:
                axes.plot(*points.T, "o-", label=label_of(method), **style)
            else:
                axes.plot(*points.T, "o:", markerfacecolor="none", **style)
            ends = {0: (-4, -9), len(line) - 1: (4, 4)}
            for end, offset in ends.items():
                axes.annotate(
                    names[end], points[end], textcoords="offset points", xytext=offset,
                    fontsize=8, color=colour,
                )  # fmt: skip
    front = sorted(p for p in at.values() if not any(_dominates(other, p) for other in at.values()))
    axes.plot(*np.array(front).T, "--", color="#000000", linewidth=1, label="Pareto front")
    axes.set_xlabel("realism score RS")
    axes.set_ylabel("controllability score CS")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, framealpha=0)
    save_plot(figure, path)


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
