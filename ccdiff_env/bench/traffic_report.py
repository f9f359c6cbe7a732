"""Report of the traffic benchmark: figures by method, K and T, and their differences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench import intervals
from ccdiff_env.bench.intervals import (
    RESAMPLES,
    are_few,
    brackets,
    grouped,
    mean_interval,
    scene_means,
)
from ccdiff_env.bench.methods import METHODS, REORDERED, label_of
from ccdiff_env.bench.plots import Points, plot_front, plot_lines
from ccdiff_env.metrics import comfort_distance, generational_distance, scores
from ccdiff_env.system.table import Block, Column, Figure, Table, TableRows

Rows = Sequence[Mapping[str, Any]]
#: Figures of an episode whose means over scenes are reported; docs/evaluation.md defines them.
_MEANS = (
    "scr", "scr_new", "scr_controlled", "scr_by_controlled", "collision_rate", "orr", "orr_box",
    "orr_reference_impl", "fde", "fde_controlled", "hard_acceleration", "hard_jerk", "sor",
    "moved_m",
)  # fmt: skip
#: Comfort distances, of histograms that are summed over scenes, x 100.
_COMFORT = {
    "cfd": "comfort",
    "cfd_end_bins": "comfort_end_bins",
    "cfd_reference_impl": "comfort_reference_impl",
}
FIGURES = (*_MEANS, *_COMFORT)  #: Figures of a condition.
#: Figures that scenes without a road do not have.
NEED_ROAD = ("orr", "orr_box", "orr_reference_impl")
UNGUIDED = "_unguided"


class Condition(NamedTuple):
    """What was played: method, K as tables write it, seconds between plans, SHA-256 of weights
    that are not the shipped ones.
    """

    method: str
    k: str
    replan_s: float
    own_weights: str = ""

    @property
    def cells(self) -> list[Any]:
        """Label, K and seconds between plans."""
        return [label_of(self.method, self.own_weights), self.k, f"{self.replan_s:g}"]


Played = Mapping[Condition, Rows]  #: Episodes of each condition, "0" among the K.
Found = Mapping[Condition, Mapping[str, Figure]]  #: Figures of each by name.


def conditions(episodes: Iterable[Mapping[str, Any]]) -> dict[Condition, Rows]:
    """Return episodes by condition: by method as they come, then by K, then by T."""
    by = grouped(episodes, "method", "k", "replan_steps")
    methods = list(dict.fromkeys(method for method, _, _ in by))
    order = sorted(by, key=lambda c: (methods.index(c[0]), np.inf if c[1] is None else c[1], c[2]))
    return {
        Condition(
            method,
            "Full" if k is None else str(k),
            steps / 10,
            by[method, k, steps][0].get("own_weights", ""),
        ): by[method, k, steps]
        for method, k, steps in order
    }


def floor(played: Played) -> Rows:
    """Return the episodes in which all replay the log, the reference of the comfort distance."""
    return next(rows for c, rows in played.items() if c.k == "0")


def summarise(played: Played) -> dict[Condition, dict[str, Figure]]:
    """Return all figures of every condition, with 95 % intervals over scenes."""
    log = floor(played)
    return {
        c: {name: mean_interval(rows, name) for name in _MEANS}
        | {name: _with_interval(_cfd(rows, log, name), rows) for name in _COMFORT}
        for c, rows in played.items()
    }


def _cfd(rows: Rows, log: Rows, name: str) -> npt.NDArray[np.float64]:
    """A comfort distance of all scenes, then of resamples: as many, the same of method and log."""
    stacked, reference = (_histograms(part, _COMFORT[name]) for part in (rows, log))
    scenes = [scene for scene in stacked if scene in reference]
    count = len(scenes)
    of = [np.array([by_scene[scene] for scene in scenes]) for by_scene in (stacked, reference)]
    found = [
        comfort_distance(*(part[chosen].mean(axis=0) for part in of)).cfd
        for chosen in _draws(count)
    ]
    return 100.0 * np.array(found)


def _histograms(rows: Rows, name: str) -> dict[Any, npt.NDArray[np.float64]]:
    """Histograms of each scene, means over its rows."""
    by_scene = grouped([{"scene": i, **row} for i, row in enumerate(rows)], "scene")
    return {scene: np.mean([row[name] for row in of], axis=0) for (scene,), of in by_scene.items()}


def _draws(count: int) -> npt.NDArray[np.int64]:
    """All scenes of so many, then resamples of them, [1 + resamples, count]."""
    drawn = np.random.default_rng(0).integers(count, size=(RESAMPLES, count))
    return np.concatenate([np.arange(count)[None], drawn])


def _with_interval(draws: npt.NDArray[np.float64], rows: Rows) -> Figure:
    ends = (np.nan, np.nan) if are_few(rows) else intervals.interval(draws[1:])
    return (float(draws[0]), *ends)


def with_scores(found: Found) -> dict[Condition, tuple[float, float]]:
    """CS and RS of every condition but the floor, over the bounds of them all."""
    chosen = [c for c in found if c.k != "0"]
    if not chosen:
        return {}
    names = ("scr", "orr", "fde", "cfd")
    scr, orr, fde, cfd = ([found[c][name][0] for c in chosen] for name in names)
    cs, rs = scores(scr=scr, orr=orr, fde=fde, cfd=cfd)
    return {c: (float(a), float(b)) for c, a, b in zip(chosen, cs, rs, strict=True)}


def figures_table(played: Played, found: Found) -> Table:
    """Return all figures of every condition."""
    relative = with_scores(found)
    names = ("method", "K", "replan_s", "own_weights", "scenes", *FIGURES, "cs", "rs")
    rows: TableRows = [
        [
            *c,
            len(grouped(played[c], "scene")),
            *figures.values(),
            *relative.get(c, (None, None)),
        ]
        for c, figures in found.items()
    ]
    return Table(names, rows)


#: Figures that a reader sees.
_SHOWN = (
    Column("scr", "SCR"),
    Column("scr_controlled", "SCR new, controlled"),
    Column("scr_by_controlled", "SCR by controlled"),
    Column("orr", "ORR", "%"),
    Column("fde", "FDE", "m"),
    Column("cfd", "CFD"),
    Column("cfd_end_bins", "CFD, end bins"),
    Column("hard_acceleration", "hard accel.", "%"),
    Column("hard_jerk", "hard jerk", "%"),
    Column("sor", "SOR"),
    Column("moved_m", "moved at 2 s", "m"),
)


def _known(figures: Mapping[str, Figure], columns: Iterable[Column]) -> list[Figure | None]:
    """Cells of figures; nothing where a method has none."""
    return [
        figures[c.name] if c.name in NEED_ROAD or np.isfinite(figures[c.name][0]) else None
        for c in columns
    ]


def tables(played: Played, found: Found) -> list[Block]:
    """Return the floor, and a row for each condition."""
    relative = with_scores(found)
    rows: TableRows = []
    for c, figures in found.items():
        label = f"Floor: {c.cells[0].replace('Log', 'log')}" if c.k == "0" else c.cells[0]
        pair = relative.get(c, (None, None))
        rows.append([label, *c.cells[1:], *pair, *_known(figures, _SHOWN)])
    heads = ("method", "K", "T s", Column("CS"), Column("RS"), *_SHOWN)
    return [Table(heads, rows), f"{brackets(played.values())} CS, RS: bounds over this table."]


def plot(found: Found, path: Path) -> Path | None:
    """Draw control against realism: a line for each method, a point for each K, larger with it."""
    points: dict[str, list[tuple[float, float, float]]] = {}
    labels = {c.method: c.cells[0] for c in found}
    for c, pair in with_scores(found).items():
        if np.isfinite(pair).all():
            points.setdefault(c.method, []).append((*pair, _size(c.k)))
    titles = (
        "CS: control, collisions reached; larger marks: more vehicles K",
        "RS: realism, nearness to the log",
    )
    return plot_front(points, labels, titles, path)


def _size(k: str) -> float:
    return 12.0 if k == "Full" else float(k)


# methods against one another

#: Figures that are compared.
COMPARED = [replace(c, sign="+") for c in _SHOWN if c.name not in ("sor", "moved_m")]


def difference(one: Rows, other: Rows, log: Rows, name: str) -> Figure:
    """Return one less the other in a figure, and the paired bootstrap interval over scenes."""
    if name in _COMFORT:
        return _with_interval(_cfd(one, log, name) - _cfd(other, log, name), one)
    mine, theirs = scene_means(one, name), scene_means(other, name)
    pairs = [mine[scene] - theirs[scene] for scene in mine if scene in theirs]
    return intervals.difference(np.array(pairs))[0]


def comparison(played: Played, found: Found) -> list[Block]:
    """Return paired differences to CCDiff, and distances to the Pareto front.

    CCDiff is the one of equal training where it was played (``ccdiff_equal``), else the shipped.
    """
    equal = any(c.method == "ccdiff_equal" for c in played)
    blocks = _against(played, "ccdiff_equal" if equal else "ccdiff")
    if not any(map(are_few, played.values())):
        blocks += _distances(found)
    return blocks or ["One method alone."]


def _against(played: Played, base: str) -> list[Block]:
    """Paired differences of all methods to one; those without guidance to it without guidance."""
    rows: TableRows = []
    at = {c[:3]: c for c in played}
    own = next((c.own_weights for c in played if c.method == base), "")
    for c, episodes in played.items():
        other = base + UNGUIDED if c.method.endswith(UNGUIDED) else base
        reference = at.get((other, c.k, c.replan_s))
        if reference is None or c.method == other or c.method not in METHODS:
            continue
        less = {
            column.name: difference(episodes, played[reference], floor(played), column.name)
            for column in COMPARED
        }
        rows.append([*c.cells, *_known(less, COMPARED)])
    if not rows:
        return []
    return [
        Table(["method", "K", "T s", *COMPARED], rows, f"Less {label_of(base, own)}"),
        f"Means over scenes, same scenes and vehicles. {brackets(played.values())} "
        "Methods without guidance are compared with its form without guidance.",
    ]


# rankings

#: Figures in which rankings are compared with a random one.
_RANKED = tuple(Column(name, sign="+") for name in ("scr_controlled", "scr_by_controlled", "fde"))
_MANY = 5  #: Moving vehicles of a scene with many to choose from.


def rankings(played: Played) -> Table:
    """Return each ranking less a random one, in scenes where more vehicles move than K are guided,
    and in those with many of them.
    """
    rows: TableRows = []
    others = {"ccdiff", *REORDERED} - {"ccdiff_random"}
    for c, episodes in played.items():
        random = played.get(c._replace(method="ccdiff_random"))
        if random is None or c.k == "Full" or c.method not in others:
            continue
        for least in sorted({int(c.k) + 1, _MANY}):
            if some := [row for row in episodes if row["num_moving"] >= least]:
                less = [difference(some, random, floor(played), f.name) for f in _RANKED]
                rows.append([*c[:3], least, len(some), *less])
    return Table(("method", "K", "replan_s", "moving", "scenes", *_RANKED), rows)


# methods at equal SCR

#: Figures at equal SCR.
_MATCHED = tuple(
    replace(column, interval=True)
    for column in (
        *_SHOWN,
        Column("orr_box", "ORR of boxes", "%"),
        Column("fde_controlled", "FDE of controlled", "m"),
    )
    if column.name not in ("scr", "scr_controlled", "orr", "sor")
)


def at_equal_scr(played: Played, targets: Sequence[float]) -> Table:
    """Return figures of methods at the same SCR (new, controlled), each also less the first one's.

    Methods were played at several criticalities: figures lie on the line between the first two of
    them whose SCR enclose the target, in every resample anew. A method without such two has no row.
    """
    log, sweeps = floor(played), dict[Condition, list[tuple[float, Condition]]]()
    for c in played:
        if (found := METHODS.without_strength(c.method)) is not None:
            stem, strength = found
            sweeps.setdefault(c._replace(method=stem), []).append((strength, c))
    names = ("scr_controlled", *(column.name for column in _MATCHED))
    drawn = {
        c: {n: np.array([_resampled(played[o], log, n) for _, o in sorted(of)]) for n in names}
        for c, of in sweeps.items()
    }
    base = next((c.method for c in drawn), "")
    rows: TableRows = []
    for target in targets:
        at = {c: _crossing(figures, target) for c, figures in drawn.items()}
        for c, figures in at.items():
            other = at.get(c._replace(method=base)) if c.method != base else None
            for less, of in (("", {}), (base, other)):
                if of is not None and np.isfinite(figures["fde"][0]):
                    less_by = [figures[m.name] - of.get(m.name, 0.0) for m in _MATCHED]
                    rows.append([f"{target:g}", *c, less, *map(_ends, less_by)])
    return Table(("at_scr", "method", "K", "replan_s", "own_weights", "less", *_MATCHED), rows)


def plot_at_equal_scr(matched: Table, path: Path) -> Path | None:
    """Draw FDE and CFD of methods at the same SCR: a line for each method and K, whose markers grow
    with K.
    """
    heads = [column.name for column in matched.columns]
    rows = [dict(zip(heads, row, strict=True)) for row in matched.rows]
    several = len({row["K"] for row in rows}) > 1
    panels = {}
    for name, title in (("fde", "FDE, m"), ("cfd", "CFD")):
        lines: dict[str, tuple[str, float, Points]] = {}
        for (method, k), of in grouped((r for r in rows if not r["less"]), "method", "K").items():
            label = label_of(method, of[0]["own_weights"]) + f", K {k}" * several
            size = 4.0 + 0.6 * _size(k) * several
            points = [(float(row["at_scr"]), row[name]) for row in of]
            lines[f"{method} {k}"] = label, size, points
        panels[title] = lines
    return plot_lines(panels, "SCR, new contacts of controlled vehicles", path)


def _resampled(rows: Rows, log: Rows, name: str) -> npt.NDArray[np.float64]:
    """A figure of all scenes, then of the resamples, [1 + resamples]."""
    if name in _COMFORT:
        return _cfd(rows, log, name)
    means, scenes = scene_means(rows, name), _histograms(rows, "comfort")
    values = np.array([means.get(scene, np.nan) for scene in scenes])[_draws(len(scenes))]
    known = np.isfinite(values)
    counts = known.sum(axis=1)
    sums = np.where(known, values, 0.0).sum(axis=1)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def _crossing(
    figures: Mapping[str, npt.NDArray[np.float64]], target: float
) -> dict[str, npt.NDArray[np.float64]]:
    """Figures [criticalities, draws] where SCR first passes a target, by draw; NaN where it never
    does.
    """
    scr = figures["scr_controlled"]
    low, high = scr[:-1], scr[1:]
    encloses = (low <= target) & (target <= high) & (low < high)
    at, column = encloses.argmax(axis=0), np.arange(scr.shape[1])
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (target - low[at, column]) / (high - low)[at, column]
        found = {
            name: values[at, column] + share * (values[at + 1, column] - values[at, column])
            for name, values in figures.items()
        }
    return {name: np.where(encloses.any(axis=0), values, np.nan) for name, values in found.items()}


def _ends(draws: npt.NDArray[np.float64]) -> Figure:
    return (float(draws[0]), *intervals.interval(draws[1:]))


def _distances(found: Found) -> list[Block]:
    """GD and IGD to the Pareto front of control and realism, of methods that have every K."""
    relative = with_scores(found)
    if not relative:
        return []
    first_s = min(c.replan_s for c in relative)
    of: dict[str, list[tuple[float, float]]] = {}
    for c, pair in relative.items():
        if c.replan_s == first_s:
            of.setdefault(c.cells[0], []).append(pair)
    most = max(map(len, of.values()))
    whole = {label: points for label, points in of.items() if len(points) == most}
    points = np.array(list(whole.values()))
    if len(whole) < 2 or not np.isfinite(points).all():  # no road, no realism
        return []
    gd, igd = generational_distance(cs=points[..., 0], rs=points[..., 1])
    rows: TableRows = [
        [label, *map(float, figures)]
        for label, *figures in zip(whole, *points.mean(axis=1).T, gd, igd, strict=True)
    ]
    return [
        Table(
            ["method", *map(Column, ("CS", "RS", "GD", "IGD"))],
            rows,
            "Distance to the Pareto front of control and realism",
        ),
        f"Means over {most} values of K; less is better for GD and IGD.",
    ]
