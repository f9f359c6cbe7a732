"""Charts of the docs as SVG, from `docs/results`: dots and whiskers, on light and on dark ground.

``python -m tools.charts`` writes ``docs/charts``; ``python -m tools.results`` does so, too.
"""

from __future__ import annotations

import html
import io
import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ccdiff_env.bench.plots import name_ends, new_plot
from tools.pages import ROOT, kept

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Plot

CHARTS = ROOT / "docs" / "charts"
WIDTH = 6.67  #: Inches, of 72 pixels.
#: Colours of Okabe and Ito, that of light and that of dark ground.
COLOURS = {
    "blue": ("#0072b2", "#56b4e9"),
    "orange": ("#c26a00", "#e69f00"),
    "green": ("#00795a", "#2fcf9f"),
    "purple": ("#a6487f", "#cc79a7"),
    "grey": ("#5c6672", "#a5b0bc"),
    "faint": ("#d5dae1", "#39434f"),
    "ink": ("#000000", "#e8edf3"),
}

#: A value and the ends of its interval; nan where there is none.
Figure = tuple[float, float, float]
Look = tuple[str, str]  #: Colour and marker.


class Series(NamedTuple):
    """Figures under one name, with their places and look."""

    name: str
    look: Look
    places: Sequence[float]
    figures: Sequence[Figure]


def _begun(title: str, axes: Axes) -> None:
    axes.set_title(title, loc="left", fontsize=13, fontweight="bold")
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0, labelsize=11.5)
    axes.grid(color=COLOURS["faint"][0])
    axes.set_axisbelow(True)


def _svg(plot: Plot, alt: str) -> str:
    """Return a plot as SVG that has its colours by the reader's ground."""
    file = io.StringIO()
    plot.savefig(file, format="svg", transparent=True, metadata={"Date": None})
    text, rules = file.getvalue(), ["", ""]
    for name, pair in COLOURS.items():
        text = text.replace(pair[0], f"var(--{name})")
        rules = [rule + f"--{name}:{tint};" for rule, tint in zip(rules, pair, strict=True)]
    style = f"svg{{{rules[0]}}}text{{fill:var(--ink)}}"
    style += f"@media(prefers-color-scheme:dark){{svg{{{rules[1]}}}}}"
    named = f'role="img" aria-label="{html.escape(alt)}"'
    return re.sub(r"<svg ([^>]*)>", rf"<svg {named} \1><style>{style}</style>", text, count=1)


def _drawn(axes: Axes, look: Look, **options: Any) -> None:
    """Dots and whiskers; of intervals that are nan, none."""
    for side in ("xerr", "yerr"):
        if side in options:
            options[side] = np.nan_to_num(np.abs(options[side]))
    colour, marker = look
    axes.errorbar(color=COLOURS[colour][0], marker=marker, markersize=7, **options)


def rows_chart(
    title: str,
    rows: Sequence[tuple[str, Figure, Look]],
    ticks: Sequence[float],
    log: float,
) -> str:
    """Return a chart with a dot and a whisker in each row: name, figure, look.

    The first and the last of ``ticks`` are the ends; ``log`` is the figure of the log.
    """
    plot, axes = new_plot(WIDTH, 0.9 + 0.38 * len(rows))
    _begun(title, axes)
    for y, (_, (value, low, high), look) in enumerate(rows):
        _drawn(axes, look, x=value, y=y, xerr=[[low - value], [high - value]])
        beside = axes.get_yaxis_transform()
        axes.text(1.02, y, f"{value:.3f}", transform=beside, fontsize=13, va="center")
    axes.set_yticks(range(len(rows)), [name for name, *_ in rows], fontsize=13)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.set_xticks(ticks)
    axes.set_xlim(ticks[0], ticks[-1])
    axes.axvline(log, linestyle="--", color=COLOURS["grey"][0])
    above = axes.get_xaxis_transform()
    axes.text(log, 1.0, "log", transform=above, fontsize=11.5, ha="center")
    said = "; ".join(f"{name} {figure[0]:.3f}" for name, figure, _ in rows)
    return _svg(plot, f"{title}: {said}")


def lines_chart(title: str, across: str, series: Sequence[Series], ticks: Sequence[float]) -> str:
    """Return a chart of lines with whiskers, named at their ends.

    ``across`` is what places are; the first and the last of ``ticks`` are the ends of figures.
    """
    plot, axes = new_plot(WIDTH, 3.8)
    _begun(title, axes)
    wide = max(place for one in series for place in one.places)
    ends = []
    for k, (name, look, places, figures) in enumerate(series):
        value, low, high = np.array(figures).T
        # whiskers stand side by side
        aside = 0.01 * wide * (k - (len(series) - 1) / 2) if np.isfinite(low).any() else 0.0
        at = np.array(places) + aside
        _drawn(axes, look, x=at, y=value, yerr=[low - value, high - value])
        ends.append((value[-1], places[-1], name, COLOURS[look[0]][0]))
    name_ends(axes, ends, gap=0.08 * ticks[-1], aside=0.03 * wide, fontsize=13)
    axes.set_yticks(ticks)
    axes.set_ylim(ticks[0], ticks[-1])
    axes.set_xlabel(across, fontsize=11.5)
    written = {one.name: ", ".join(f"{f[0]:.0f}" for f in one.figures) for one in series}
    return _svg(plot, f"{title}: {'; '.join(map(' '.join, written.items()))}")


def _figure(row: Mapping[str, Any], column: str, factor: float = 1.0) -> Figure:
    value, less, more = (math.nan if v is None else factor * v for v in row[column])
    return value, less, more


#: Methods of the chart of realism: what they are called, and their look.
REALISM = {
    "swift": ("swift", ("green", "s")),
    "tokens_routes_careful": ("tokens, routes, care", ("green", "s")),
    "ccdiff_routes_careful": ("CCDiff, routes, care", ("blue", "o")),
    "ccdiff_careful": ("CCDiff, care", ("blue", "o")),
    "idm": ("IDM", ("orange", "^")),
    "ccdiff_one_sample": ("CCDiff", ("blue", "o")),
    "constant_velocity": ("constant velocity", ("grey", "^")),
}
#: Planners of the dial likewise.
DIAL = {
    "lane_idm": ("IDM on lanes", ("orange", "^")),
    "pdm": ("PDM-Closed", ("purple", "D")),
    "ego": ("trained ego", ("blue", "o")),
}
LEVELS = {"ccdiff": 0.0, "ccdiff-0.5": 0.5, "ccdiff-1": 1.0, "ccdiff-1.5": 1.5, "ccdiff-2": 2.0}


def realism() -> str:
    """Return the chart of realism."""
    rows = {row["method"]: row for row in kept("realism")["rows"]}
    shown = [
        (title, _figure(rows[name], "realism"), look) for name, (title, look) in REALISM.items()
    ]
    shown.sort(key=lambda row: -row[1][0])
    log = _figure(rows["replay"], "realism")[0]
    return rows_chart("realism, 93 scenes", shown, (0.4, 0.5, 0.6, 0.7, 0.8), log)


def learning() -> str:
    """Return the chart of learning: mean, least and most of the seeds, and rules."""
    ego, *rules = kept("expectations")["rows"]
    places = [point[1] for point in ego["curve"]]
    figures = [
        (100 * point[2], 100 * low, 100 * high)
        for point, (low, high) in zip(ego["curve"], ego["spread"], strict=True)
    ]
    series = [Series(ego["title"], ("blue", "o"), places, figures)]
    for row, look in zip(rules, (("green", "_"), ("orange", "_"), ("purple", "_")), strict=True):
        level = (row["success"], math.nan, math.nan)
        series.append(Series(row["title"], look, [0.0, places[-1]], [level, level]))
    title = "success in the test episodes of the example, %"
    return lines_chart(title, "seconds of one core", series, (0, 25, 50, 75, 100))


def dial() -> str:
    """Return the chart of the dial."""
    run = kept("dial_planners")
    rows = {(row["planner"], row["traffic"]): row for row in run["rows"]}
    figures = {
        name: [_figure(rows[name, traffic], "collision", 100) for traffic in LEVELS]
        for name in DIAL
    }
    series = [Series(*DIAL[name], [*LEVELS.values()], of) for name, of in figures.items()]
    title = f"collisions of the planner, % of {run['scenes'].split()[0]} scenes, 95 % intervals"
    across = "criticality of the CCDiff traffic"
    return lines_chart(title, across, series, (0, 10, 20, 30, 40, 50))


#: Charts by name of their file.
MADE = {"realism": realism, "learning": learning, "dial": dial}


def write() -> None:
    """Write all charts."""
    CHARTS.mkdir(exist_ok=True)
    for name, chart in MADE.items():
        (CHARTS / f"{name}.svg").write_text(chart(), encoding="utf-8")


if __name__ == "__main__":
    write()
