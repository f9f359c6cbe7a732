"""Plots of the benchmarks, in light and dark pages."""

from __future__ import annotations

import html
import io
import itertools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ccdiff_env.bench.intervals import mean_interval
from ccdiff_env.system.files import write_aside
from ccdiff_env.view.render import THEMES, all_colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Colour, a name of images, and marker of planners and traffic; no hue tells them apart alone.
LOOKS = {
    "ccdiff": ("ccdiff", "o"),
    "swift": ("ccdiff", "s"),
    "tokens": ("network", "s"),
    "ego": ("ego", "o"),
    "idm": ("idm", "^"),
    "lane_idm": ("idm", "v"),
    "pdm": ("other", "D"),
    "replay": ("replay", "X"),
    "constant_velocity": ("constant_velocity", "P"),
}
#: Colours of others; orange is kept for attacks.
REST = ("external", "network", "other", "constant_velocity", "idm", "ccdiff")
MARKERS = "*p<>hdosv^DXP"
#: Places of a line, and their figures with intervals.
Points = Sequence[tuple[float, tuple[float, float, float]]]
THIN: Any = {"elinewidth": 1, "capsize": 2.5}  #: Of whiskers.
#: Lines behind the plots, on light and on dark ground.
FAINT = ("#d5dae1", "#39434f")


def looks(names: Iterable[str]) -> list[tuple[str, str]]:
    """Return colour (``#rrggbb`` on light ground) and marker of each of some names.

    What is of one family, as ``ccdiff_careful`` and ``ccdiff-2``, has one colour.
    """
    families = {name: LOOKS.get(name) or LOOKS.get(re.split("[_-]", name)[0]) for name in names}
    used, light = {of[0] for of in families.values() if of}, colours()
    rest = itertools.cycle([colour for colour in REST if colour not in used] or REST)
    found: list[tuple[str, str]] = []
    for of in families.values():
        look = of or (next(rest), MARKERS[0])
        free = (m for m in MARKERS if (look[0], m) not in found)
        found.append(look if look not in found else (look[0], next(free, look[1])))
    return [(light[colour][0], marker) for colour, marker in found]


def colours() -> dict[str, tuple[str, str]]:
    """Return colours by name, as images and pages have them, on light and on dark ground."""
    light, dark = (all_colours(theme) for theme in THEMES)
    found = {
        name: (f"#{bytes(light[name]).hex()}", f"#{bytes(dark[name]).hex()}") for name in light
    }
    # text is black where Matplotlib writes it
    return found | {"faint": FAINT, "ink": ("#000000", found["ink"][1])}


def new_plot(width: float, height: float, **options: Any) -> tuple[Figure, Axes]:
    """Return an empty plot of so many inches."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "ccdiff-env"})
    mpl.rcParams["text.parse_math"] = False  # names may have dollars
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(width, height), layout="constrained", **options)
    for one in np.ravel(axes):
        one.spines[["top", "right"]].set_visible(False)
    return figure, axes


def themed_svg(figure: Figure, alt: str = "") -> str:
    """Return a plot as SVG that has its colours by the reader's ground."""
    file, rules = io.StringIO(), ["", ""]
    figure.savefig(file, format="svg", transparent=True, metadata={"Date": None})
    text = file.getvalue()
    for name, pair in colours().items():
        if pair[0] in text or name == "ink":
            text = text.replace(pair[0], f"var(--{name.replace(' ', '-')})")
            rules = [
                rule + f"--{name.replace(' ', '-')}:{tint};"
                for rule, tint in zip(rules, pair, strict=True)
            ]
    style = f"svg{{{rules[0]}}}text{{fill:var(--ink)}}"
    style += f"@media screen and (prefers-color-scheme:dark){{svg{{{rules[1]}}}}}"
    named = f'role="img" aria-label="{html.escape(alt)}" ' if alt else ""
    return re.sub(r"<svg ([^>]*)>", rf"<svg {named}\1><style>{style}</style>", text, count=1)


def save_plot(figure: Figure, path: Path) -> Path:
    """Write a plot as vectors: PDF for papers, SVG for pages, which has the reader's ground.

    Returns:
        Path: That of the SVG; the name of ``path``, whatever its suffix.
    """
    from matplotlib import pyplot as plt

    figure.savefig(path.with_suffix(".pdf"), metadata={"CreationDate": None})
    drawn = path.with_suffix(".svg")
    write_aside(drawn, themed_svg(figure))
    plt.close(figure)
    return drawn


def plot_robustness(
    found: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]],
    level: Mapping[str, float],
    label: Callable[[str], str],
    path: Path,
) -> Path | None:
    """Draw scores of planners against the criticality of CCDiff traffic, where there are two.

    ``found`` are episodes of every planner in every traffic, ``level`` criticality by traffic of
    CCDiff, ``label`` the title of a planner.
    """
    planners, names = list(dict.fromkeys(p for p, _ in found)), sorted(level, key=level.__getitem__)
    if len(names) < 2:
        return None
    lines = {
        p: (label(p), 5.0, [(level[n], mean_interval(found[p, n], "score")) for n in names])
        for p in planners
    }
    return plot_lines({"score": lines}, "criticality of the CCDiff traffic", path, ends=(0, 1.02))


def plot_lines(
    panels: Mapping[str, Mapping[str, tuple[str, float, Points]]],
    across: str,
    path: Path,
    *,
    ends: tuple[float, float] | None = None,
) -> Path | None:
    """Draw figures side by side: panels by title, from and up to ``ends``, of lines by key, each
    with its name, the size of its markers, and its points.
    """
    if not any(panels.values()) or not _drawn():
        return None
    figure, found = new_plot(5.2 * len(panels), 3.8, ncols=len(panels))
    for axes, (title, lines) in zip(np.ravel(np.array(found)), panels.items(), strict=True):
        if ends is not None:
            axes.set_ylim(ends)
        _draw_lines(axes, lines)
        places = sorted({x for _, _, points in lines.values() for x, _ in points})
        if len(places) < 8:
            axes.set_xticks(places)
        axes.set_xlabel(across)
        axes.set_ylabel(title)
    return save_plot(figure, path)


def _draw_lines(axes: Axes, lines: Mapping[str, tuple[str, float, Points]]) -> None:
    """Draw lines with whiskers, side by side, named at their ends; the first words of their keys
    choose colour and marker.
    """
    kinds = dict.fromkeys(key.partition(" ")[0] for key in lines)
    look = dict(zip(kinds, looks(kinds), strict=True))
    places = [x for _, _, points in lines.values() for x, _ in points]
    aside = 0.008 * np.ptp(places) * np.linspace(-1, 1, len(lines)) if len(lines) > 1 else [0.0]
    ends = []
    for (key, (name, size, points)), by in zip(lines.items(), aside, strict=True):
        color, marker = look[key.partition(" ")[0]]
        means = np.array([figure for _, figure in points])
        whiskers = np.nan_to_num(np.abs(means[:, 1:] - means[:, :1]).T)
        x = np.array([x for x, _ in points]) + by
        axes.errorbar(x, means[:, 0], yerr=whiskers, color=color, marker=marker, ms=size, **THIN)
        ends.append((means[-1, 0], x[-1], name, color))
    axes.grid(color=FAINT[0])
    name_ends(axes, ends)


def plot_dots(
    found: Mapping[str, Sequence[Mapping[str, Any]]],
    labels: Mapping[str, str],
    figures: Mapping[str, str],
    path: Path,
) -> Path | None:
    """Draw figures of methods as dots with 95 % intervals, side by side, the best of the first one
    on top, against a line where the log, ``replay``, is.

    ``found`` are episodes by method, ``labels`` theirs, ``figures`` titles by name.
    """
    if not _drawn():
        return None
    order = sorted(found, key=lambda method: mean_interval(found[method], next(iter(figures)))[0])
    look = dict(zip(found, looks(found), strict=True))
    high = 0.9 + 0.34 * len(order)
    panels: Any
    figure, panels = new_plot(3.1 * len(figures) + 2.0, high, ncols=len(figures), sharey=True)
    for axes, (name, title) in zip(np.ravel(panels), figures.items(), strict=True):
        for y, method in enumerate(order):
            mean, low, high = mean_interval(found[method], name)
            whiskers = np.nan_to_num([[mean - low], [high - mean]])
            color, marker = look[method]
            axes.errorbar(mean, y, xerr=whiskers, color=color, marker=marker, ms=5, **THIN)
        if "replay" in found:
            log = mean_interval(found["replay"], name)[0]
            axes.axvline(log, color=colours()["replay"][0], lw=1, ls="--")
        axes.set_yticks(range(len(order)), [labels[method] for method in order])
        axes.set_xlabel(f"{title} (dashed: the log)" if "replay" in found else title)
        axes.grid(color=FAINT[0], axis="x")
    return save_plot(figure, path)


def plot_ranks(
    found: Mapping[str, Mapping[str, Sequence[float]]], labels: Mapping[str, str], path: Path
) -> Path | None:
    """Draw rank histograms: a row of bars for each method, a panel for each moment, and a line
    where a calibrated model's are.
    """
    if not found or not _drawn():
        return None
    moments = list(next(iter(found.values())))
    panels: Any
    figure, panels = new_plot(
        1.7 * len(moments) + 1.6, 0.95 * len(found) + 0.5, nrows=len(found), ncols=len(moments),
        sharex=True, sharey=True, squeeze=False,
    )  # fmt: skip
    rows = zip(panels, found.items(), looks(found), strict=True)
    for number, (row, (method, by_moment), (color, _)) in enumerate(rows):
        for axes, (moment, shares) in zip(row, by_moment.items(), strict=True):
            axes.bar(range(len(shares)), shares, width=0.9, color=color)
            axes.axhline(1.0 / len(shares), color=colours()["replay"][0], lw=1, ls="--")
            axes.set_xticks([])
            if number == 0:
                axes.set_title(moment, fontsize=9)
        row[0].set_ylabel(labels[method], rotation=0, ha="right", va="center", fontsize=8)
    across = "share of logged speeds in each fifth of the samples', slowest first"
    figure.supxlabel(across, fontsize=9)
    return save_plot(figure, path)


def plot_densities(
    found: Mapping[str, Mapping[str, Sequence[float]]],
    labels: Mapping[str, str],
    scales: Mapping[str, tuple[str, Sequence[float]]],
    log: Mapping[str, Sequence[float]],
    path: Path,
) -> Path | None:
    """Draw how often values occur, lines of methods over the area of the log.

    ``found`` are shares of bins by figure, of each method, ``log`` the log's, ``scales`` a title
    and the edges of the bins by figure.
    """
    if not found or not _drawn():
        return None
    panels: Any
    figure, panels = new_plot(4.4 * len(scales) + 1.6, 3.4, ncols=len(scales))
    for axes, (name, (title, edges)) in zip(np.ravel(panels), scales.items(), strict=True):
        grey, drawn = colours()["replay"][0], list[str]()
        axes.stairs(log[name], edges, fill=True, color=grey, alpha=0.35, label="the log")
        for (method, shares), (color, _) in zip(found.items(), looks(found), strict=True):
            dash = ("-", "--", ":", "-.")[drawn.count(color) % 4]
            axes.stairs(shares[name], edges, color=color, ls=dash, lw=1.6, label=labels[method])
            drawn.append(color)
        axes.set_xlabel(title)
        axes.set_yticks([])
    named = np.ravel(panels)[0].get_legend_handles_labels()
    figure.legend(*named, loc="outside right upper", frameon=False, fontsize=8)
    return save_plot(figure, path)


def plot_front(
    points: Mapping[str, Sequence[tuple[float, float, float]]],
    labels: Mapping[str, str],
    titles: tuple[str, str],
    path: Path,
) -> Path | None:
    """Draw methods by two figures, up and to the right better: x, y and size each, joined by a
    line for each method.
    """
    if not points or not _drawn():
        return None
    figure, axes = new_plot(6.2, 4.2)
    ends = []
    for (method, of), (color, marker) in zip(points.items(), looks(points), strict=True):
        x, y, sizes = zip(*of, strict=True)
        axes.plot(x, y, color=color, lw=0.8, alpha=0.6)
        area = [14.0 + 9.0 * size for size in sizes]
        axes.scatter(x, y, s=area, color=color, marker=marker, zorder=2)  # on the grid
        ends.append((y[-1], x[-1], labels[method], color))
    axes.set_xlabel(titles[0])
    axes.set_ylabel(titles[1])
    axes.grid(color=FAINT[0])
    name_ends(axes, ends, fontsize=8)
    return save_plot(figure, path)


def _drawn() -> bool:
    """Whether plots can be drawn; says so where they cannot."""
    if find_spec("matplotlib") is None:
        print("no plot: it needs Matplotlib (pip install matplotlib)")
        return False
    return True


def name_ends(
    axes: Axes,
    ends: Sequence[tuple[float, float, str, str]],
    *,
    gap: float | None = None,
    aside: float | None = None,
    fontsize: float = 9,
) -> None:
    """Write names at the ends (y, x, name, colour) of lines, each below the one above it, all of
    them above the axis.
    """
    gap = 0.0055 * fontsize * np.ptp(axes.get_ylim()) if gap is None else gap
    aside = 0.02 * np.ptp(axes.get_xlim()) if aside is None else aside
    last = np.inf
    for above, (y, x, name, colour) in enumerate(sorted(ends, reverse=True), start=1):
        least = axes.get_ylim()[0] + gap * (len(ends) - above + 0.6)
        last = max(min(y, last - gap), least)
        axes.annotate(
            name, (x, y), xytext=(x + aside, last), color=colour, fontsize=fontsize, va="center",
            annotation_clip=False,
        )  # fmt: skip
