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

#: Colour, a name of images, and marker of planners; no hue tells them apart alone.
LOOKS = {
    "ego": ("ego", "o"),
    "idm": ("idm", "^"),
    "lane_idm": ("idm", "v"),
    "pdm": ("other", "D"),
    "replay": ("replay", "X"),
    "constant_velocity": ("constant_velocity", "P"),
}
#: Likewise of others; orange is kept for attacks.
REST = [
    (name, marker)
    for marker in "*p<>"
    for name in ("external", "constant_velocity", "network", "other", "ccdiff", "replay", "idm")
]
#: Lines behind the plots, on light and on dark ground.
FAINT = ("#d5dae1", "#39434f")


def looks(names: Iterable[str]) -> list[tuple[str, str]]:
    """Return colour (``#rrggbb`` on light ground) and marker of each of some names."""
    rest, light = itertools.cycle(REST), colours()
    found = [LOOKS.get(name) or next(rest) for name in names]
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
    style += f"@media(prefers-color-scheme:dark){{svg{{{rules[1]}}}}}"
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
    if not _drawn():
        return None
    figure, axes = new_plot(5.6, 3.8)
    aside = np.linspace(-0.015, 0.015, len(planners)) if len(planners) > 1 else [0.0]
    ends = []
    for planner, (color, marker), by in zip(planners, looks(planners), aside, strict=True):
        means = np.array([mean_interval(found[planner, n], "score") for n in names])
        whiskers = np.nan_to_num(np.abs(means[:, 1:] - means[:, :1]).T)
        x = np.array([level[n] for n in names]) + by
        axes.errorbar(
            x, means[:, 0], yerr=whiskers, color=color, marker=marker, markersize=5, elinewidth=1,
            capsize=2.5,
        )  # fmt: skip
        ends.append((means[-1, 0], x[-1], label(planner), color))
    name_ends(axes, ends)
    axes.set_xticks([level[n] for n in names])
    axes.set_xlabel("criticality of the CCDiff traffic")
    axes.set_ylabel("score")
    axes.set_ylim(0, 1.02)
    axes.grid(color=FAINT[0])
    return save_plot(figure, path)


def plot_dots(
    found: Mapping[str, Sequence[Mapping[str, Any]]],
    figures: Mapping[str, str],
    floor: str | None,
    path: Path,
) -> Path | None:
    """Draw figures of methods as dots with 95 % intervals, side by side, the best of the first one
    on top, against a line where the method ``floor`` is, as the log.

    ``found`` are episodes by label, ``figures`` titles by name.
    """
    if not _drawn():
        return None
    order = sorted(found, key=lambda label: mean_interval(found[label], next(iter(figures)))[0])
    high = 0.9 + 0.34 * len(order)
    panels: Any
    figure, panels = new_plot(3.1 * len(figures) + 2.0, high, ncols=len(figures), sharey=True)
    for axes, (name, title) in zip(np.ravel(panels), figures.items(), strict=True):
        means = np.array([mean_interval(found[label], name) for label in order])
        whiskers = np.nan_to_num(np.abs(means[:, 1:] - means[:, :1]).T)
        axes.errorbar(
            means[:, 0], np.arange(len(order)), xerr=whiskers, fmt="o",
            color=colours()["ccdiff"][0],
            markersize=5, elinewidth=1, capsize=2.5,
        )  # fmt: skip
        if floor in found:
            axes.axvline(
                mean_interval(found[str(floor)], name)[0],
                color=colours()["replay"][0],
                lw=1,
                ls="--",
            )
        axes.set_yticks(range(len(order)), order)
        axes.set_xlabel(f"{title} (dashed: the log)" if floor in found else title)
        axes.grid(color=FAINT[0], axis="x")
    return save_plot(figure, path)


def plot_ranks(found: Mapping[str, Mapping[str, Sequence[float]]], path: Path) -> Path | None:
    """Draw rank histograms: a row of bars for each label, a panel for each moment, and a line where
    a calibrated model's are.
    """
    if not found or not _drawn():
        return None
    moments = list(next(iter(found.values())))
    panels: Any
    figure, panels = new_plot(
        1.7 * len(moments) + 1.6, 0.95 * len(found) + 0.5, nrows=len(found), ncols=len(moments),
        sharex=True, sharey=True, squeeze=False,
    )  # fmt: skip
    for number, (row, (label, by_moment)) in enumerate(zip(panels, found.items(), strict=True)):
        for axes, (moment, shares) in zip(row, by_moment.items(), strict=True):
            axes.bar(range(len(shares)), shares, width=0.9, color=colours()["ccdiff"][0])
            axes.axhline(1.0 / len(shares), color=colours()["replay"][0], lw=1, ls="--")
            axes.set_xticks([])
            if number == 0:
                axes.set_title(moment, fontsize=9)
        row[0].set_ylabel(label, rotation=0, ha="right", va="center", fontsize=8)
    return save_plot(figure, path)


def plot_front(
    points: Mapping[str, Sequence[tuple[float, float, float, str]]],
    titles: tuple[str, str],
    path: Path,
) -> Path | None:
    """Draw methods by two figures, up and to the right better: x, y, size and its name each, joined
    by a line for each label.
    """
    if not points or not _drawn():
        return None
    figure, axes = new_plot(6.2, 4.2)
    ends = []
    for (label, of), (color, marker) in zip(points.items(), looks(points), strict=True):
        x, y, sizes, _ = zip(*of, strict=True)
        axes.plot(x, y, color=color, lw=0.8, alpha=0.6)
        axes.scatter(x, y, s=[14.0 + 9.0 * size for size in sizes], color=color, marker=marker)
        ends.append((y[-1], x[-1], label, color))
    axes.set_xlabel(titles[0])
    axes.set_ylabel(titles[1])
    axes.grid(color=FAINT[0])
    span = np.diff(axes.get_ylim())[0]
    name_ends(axes, ends, gap=0.05 * span, aside=0.02 * np.diff(axes.get_xlim())[0], fontsize=8)
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
    gap: float = 0.045,
    aside: float = 0.03,
    fontsize: float = 9,
) -> None:
    """Write names at the ends (y, x, name, colour) of lines, each below the one above it."""
    last = np.inf
    for y, x, name, colour in sorted(ends, reverse=True):
        last = min(y, last - gap)
        axes.annotate(
            name, (x, y), xytext=(x + aside, last), color=colour, fontsize=fontsize, va="center",
            annotation_clip=False,
        )  # fmt: skip
