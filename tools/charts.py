"""Charts of the docs as SVG, from `docs/results`: dots and whiskers, on light and on dark ground.

``python -m tools.charts`` writes ``docs/charts``, as ``python -m tools.results`` does; with the
folder of a run of examples/train_ego_sb3.py, its curve.
"""

from __future__ import annotations

import argparse
import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ccdiff_env.bench.plots import FAINT, LOOKS, colours, name_ends, new_plot, themed_svg
from ccdiff_env.view.captions import LOG_TITLES, PLANNER_TITLES
from tools.pages import ROOT, kept

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CHARTS = ROOT / "docs" / "charts"
WIDTH = 6.67  #: Inches, of 72 pixels.
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
    axes.grid(color=FAINT[0])
    axes.set_axisbelow(True)


def _drawn(axes: Axes, look: Look, **options: Any) -> None:
    """Dots and whiskers; of intervals that are nan, none."""
    for side in ("xerr", "yerr"):
        if side in options:
            options[side] = np.nan_to_num(np.abs(options[side]))
    colour, marker = look
    options |= {"linestyle": "-" if marker else "--"}
    axes.errorbar(color=colours()[colour][0], marker=marker, markersize=7, **options)


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
    axes.axvline(log, linestyle="--", color=colours()["replay"][0])
    above = axes.get_xaxis_transform()
    axes.text(log, 1.0, "log", transform=above, fontsize=11.5, ha="center")
    said = "; ".join(f"{name} {figure[0]:.3f}" for name, figure, _ in rows)
    return themed_svg(plot, f"{title}: {said}")


def lines_chart(
    title: str,
    across: str,
    series: Sequence[Series],
    ticks: Sequence[float],
    stills: Mapping[float, Any] | None = None,
) -> str:
    """Return a chart of lines with whiskers, named at their ends.

    ``across`` is what places are; the first and the last of ``ticks`` are the ends of figures;
    ``stills`` are images below places. Series without a marker are dashed, those without a name a
    part of the one before.
    """
    rows = {"nrows": 2, "height_ratios": (3.8, 1.4)} if stills else {}
    found: Any
    plot, found = new_plot(WIDTH, 5.2 if stills else 3.8, **rows)
    axes, *below = np.ravel(found)
    _begun(title, axes)
    wide = max(place for one in series for place in one.places)
    ends = []
    for k, (name, look, places, figures) in enumerate(series):
        value, low, high = np.array(figures).T
        # whiskers stand side by side
        aside = 0.01 * wide * (k - (len(series) - 1) / 2) if np.isfinite(low).any() else 0.0
        at = np.array(places) + aside
        _drawn(axes, look, x=at, y=value, yerr=[low - value, high - value])
        if name:
            ends.append((value[-1], places[-1], name, colours()[look[0]][0]))
    name_ends(axes, ends, gap=0.08 * ticks[-1], aside=0.03 * wide, fontsize=13)
    axes.set_yticks(ticks)
    axes.set_ylim(ticks[0], ticks[-1])
    axes.set_xlabel(across, fontsize=11.5)
    for strip in below:
        axes.set_xticks(sorted({place for one in series for place in one.places}))
        for place, image in (stills or {}).items():
            box = (place - 0.23 * wide, place + 0.23 * wide, 0.0, 1.0)
            strip.imshow(image, extent=box, aspect="auto")
        for one in (axes, strip):
            one.set_xlim(-wide / 4, 1.25 * wide)
        strip.axis("off")
    written = {one.name: ", ".join(f"{f[0]:.0f}" for f in one.figures) for one in series}
    return themed_svg(plot, f"{title}: {'; '.join(map(' '.join, written.items()))}")


def _figure(row: Mapping[str, Any], column: str, factor: float = 1.0) -> Figure:
    value, less, more = (math.nan if v is None else factor * v for v in row[column])
    return value, less, more


#: Methods of the chart of realism: what they are called, and their look.
REALISM = {
    "swift": ("swift", ("ccdiff", "s")),
    "tokens_routes_careful": ("tokens, routes, care", ("network", "s")),
    "ccdiff_routes_careful": ("CCDiff, routes, care", ("ccdiff", "o")),
    "ccdiff_careful": ("CCDiff, care", ("ccdiff", "o")),
    "idm": ("IDM", LOOKS["idm"]),
    "ccdiff_one_sample": ("CCDiff", ("ccdiff", "o")),
    "constant_velocity": ("constant velocity", LOOKS["constant_velocity"]),
}
#: Planners of the dial likewise.
DIAL = {
    "lane_idm": ("IDM on lanes", LOOKS["lane_idm"]),
    "pdm": ("PDM-Closed", LOOKS["pdm"]),
    "ego": ("trained ego", LOOKS["ego"]),
}
FAULTLESS = "no_at_fault_collision"  #: 1 where the planner is to blame for no collision.
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
    levels = {row["title"]: row["success"] for row in rules}
    title = "success in the test episodes of the example, %"
    return learning_chart(title, Series(ego["title"], LOOKS["ego"], places, figures), levels)


def learning_chart(title: str, ego: Series, rules: Mapping[str, float]) -> str:
    """Return the chart of an ego that learns, in percent over seconds, beside dashed levels: those
    of IDM and PDM come last, after that of the log.
    """
    series, looks = [ego], (("external", ""), LOOKS["idm"], LOOKS["pdm"])[-len(rules) :]
    for (name, level), (colour, _) in zip(rules.items(), looks, strict=True):
        row = (level, math.nan, math.nan)
        series.append(Series(name, (colour, ""), [0.0, ego.places[-1]], [row, row]))
    return lines_chart(title, "seconds of one core", series, (0, 25, 50, 75, 100))


def dial() -> str:
    """Return the chart of the dial: collisions, dashed those at fault, above one crossing."""
    from matplotlib import pyplot as plt

    run = kept("dial_planners")
    rows = {(row["planner"], row["traffic"]): row for row in run["rows"]}
    series = []
    for name, (title, look) in DIAL.items():
        shown = [rows[name, traffic] for traffic in LEVELS]
        hits = [_figure(row, "collision", 100) for row in shown]
        series.append(Series(title, look, [*LEVELS.values()], hits))
        if all(FAULTLESS in row for row in shown):
            at_fault = [(100.0 - 100.0 * row[FAULTLESS][0], math.nan, math.nan) for row in shown]
            series.append(Series("", (look[0], ""), [*LEVELS.values()], at_fault))
    strip = plt.imread(CHARTS / "crossing.png")
    stills = dict(zip((0.0, 1.0, 2.0), np.split(strip, 3, axis=1), strict=True))
    scenes = run["scenes"].split()[0]
    split = "; dashed: at fault" if len(series) > len(DIAL) else ""
    title = f"collisions of the planner, % of {scenes} scenes{split}"
    across = "criticality of the CCDiff traffic; below, one moment of one crossing"
    return lines_chart(title, across, series, (0, 10, 20, 30, 40, 50), stills)


def matrix() -> str:
    """Return the chart of collisions by the traffic that egos were trained in."""
    run = kept("learning_matrix")
    looks = iter((("idm", "o"), ("ccdiff", "s"), ("replay", "o"), ("ccdiff", "o")))
    tested = {"ccdiff": 0.0, "ccdiff-1-one-step": 1.0, "ccdiff-2-one-step": 2.0}
    series = [
        Series(row["trained"].split(",")[0], next(looks), [*tested.values()],
               [_figure(row["shares"], t, 100) for t in tested])
        for row in run["rows"] if "shares" in row
    ]  # fmt: skip
    title = f"collisions of egos by their training, % of {run['scenes'].split()[0]} scenes"
    return lines_chart(
        title, "criticality of the CCDiff traffic of the test", series, (0, 20, 40, 60)
    )


def data() -> str:
    """Return the chart of success by the number of scenes of the training."""
    run, series = kept("learning_data"), []
    for traffic, look in (("idm", "idm"), ("ccdiff-1-one-step", "ccdiff")):
        figures = [_figure(row["shares"], traffic, 100) for row in run["rows"]]
        places = [float(sum(map(int, re.findall(r"\d+", row["trained"])))) for row in run["rows"]]
        series.append(Series(run["heads"][traffic], (look, "o"), places, figures))
    title = f"success of egos, % of {run['scenes'].split()[0]} scenes that they never drove"
    return lines_chart(title, "scenes of the training", series, (0, 25, 50, 75, 100))


def parts() -> str:
    """Return the chart of success and score without a part of the recipe, with their ranges."""
    shown, (colour, _) = list[tuple[str, Figure, Look]](), LOOKS["ego"]
    for row in kept("learning_parts")["rows"]:
        shown.append((row["part"], _figure(row, "success"), (colour, "o")))
        shown.append(("", _figure(row, "score"), (colour, "s")))
    log = kept("expectations")["rows"][1]["score"][0]
    title = "success (dot) and score (square)"
    return rows_chart(title, shown, (0.6, 0.7, 0.8, 0.9, 1.0), log)


#: Charts by name of their file.
MADE = {
    "realism": realism,
    "learning": learning,
    "learning_parts": parts,
    "dial": dial,
    "learning_matrix": matrix,
    "learning_data": data,
}


def write() -> None:
    """Write all charts."""
    CHARTS.mkdir(exist_ok=True)
    for name, chart in MADE.items():
        (CHARTS / f"{name}.svg").write_text(chart(), encoding="utf-8")


def write_curve(folder: Path) -> Path:
    """Write the curve of a training into its folder, and return the file."""
    kept = json.loads((folder / "curve.json").read_text(encoding="utf-8"))
    _, seconds, shares = zip(*kept["curve"], strict=True)
    figures = [(100.0 * share, math.nan, math.nan) for share in shares]
    levels = {
        title: 100.0 * kept["outcomes"][name][0]
        for name, title in {"idm": LOG_TITLES["idm"], "pdm": PLANNER_TITLES["pdm"]}.items()
    }
    ego = Series(f"your ego {figures[-1][0]:.0f} %", LOOKS["ego"], seconds, figures)
    path = folder / "curve.svg"
    chart = learning_chart("success in episodes of scenes that it never drove, %", ego, levels)
    path.write_text(chart, encoding="utf-8")
    return path


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", nargs="?", type=Path, help="folder of a run, whose curve is drawn")
    args = parser.parse_args()
    print(write_curve(args.run)) if args.run else write()
