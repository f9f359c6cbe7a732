"""Report of the traffic benchmark: figures by method, K and T, and their differences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.intervals import BRACKETS, FEW, LEAST_SCENES, RESAMPLES, column, interval
from ccdiff_env.bench.methods import METHODS, label_of
from ccdiff_env.metrics import comfort_distance, generational_distance, scores
from ccdiff_env.system.table import Block, Column, Figure, Table, TableRows

Row = Mapping[str, Any]
Rows = Sequence[Row]
F64 = npt.NDArray[np.float64]
#: Means over scenes by name: fields of an episode, factor.
_MEANS: dict[str, tuple[str, float]] = {
    "scr": ("collision.all", 1.0),
    "scr_new": ("collision.new", 1.0),
    "scr_controlled": ("collision.controlled_new", 1.0),
    "collision_rate": ("collision_rate.new", 1.0),
    "orr": ("off_road", 100.0),
    "orr_box": ("off_road_box", 100.0),
    "orr_reference_impl": ("off_road_reference_impl", 100.0),
    "fde": ("fde_m", 1.0),
    "fde_controlled": ("fde_controlled_m", 1.0),
    "sor": ("over_speed", 1.0),
    "realism_cost": ("realism_cost", 1.0),
    "shift_sigmas": ("shift_sigmas", 1.0),
    "conflict_share": ("conflict_share", 1.0),
}
#: Comfort distances, of histograms that are summed over scenes, x 100.
_COMFORT = {"cfd": "comfort", "cfd_reference_impl": "comfort_reference_impl"}
FIGURES = (*_MEANS, *_COMFORT)  #: Figures of a condition; docs/evaluation.md defines them.
#: Figures that scenes without a road do not have.
NEED_ROAD = ("orr", "orr_box", "orr_reference_impl")
UNGUIDED = "_unguided"


@dataclass(frozen=True, order=True)
class Condition:
    """What was played: method, K (``None``: all), steps between plans."""

    method: str
    num_controlled: int | None
    replan_steps: int

    @property
    def k(self) -> str:
        """K as tables write it."""
        return "Full" if self.num_controlled is None else str(self.num_controlled)

    @property
    def order(self) -> float:
        """K, infinite for all."""
        return np.inf if self.num_controlled is None else self.num_controlled

    @property
    def cells(self) -> list[Any]:
        """Label, K and seconds between plans."""
        return [label_of(self.method), self.k, f"{self.replan_steps / 10:g}"]


@dataclass(frozen=True)
class Figures:
    """Figures of a condition by name: value, and the 95 % interval of a bootstrap over scenes.

    ``draws`` are the values in the resamples, ``[R]`` each: conditions of the same scenes and seed
    are resampled alike, so that differences of their draws are paired. Of few scenes intervals and
    draws are NaN.
    """

    num_scenes: int
    value: Mapping[str, float]
    draws: Mapping[str, F64] = field(repr=False, compare=False)

    def figure(self, name: str) -> Figure:
        """Return a value with its interval."""
        return (self.value[name], *interval(self.draws[name]))


def conditions(rows: Iterable[Row]) -> dict[Condition, list[Row]]:
    """Return episodes by condition: by method as they come, then by K, then by T."""
    found: dict[Condition, list[Row]] = {}
    for row in rows:
        c = Condition(row["method"], row["k"], row["replan_steps"])
        found.setdefault(c, []).append(row)
    methods = list(dict.fromkeys(c.method for c in found))
    by = sorted(found, key=lambda c: (methods.index(c.method), c.order, c.replan_steps))
    return {c: found[c] for c in by}


def summarise(rows: Rows, log: Rows, *, seed: int = 0) -> Figures:
    """Return the figures of one condition from its episodes.

    The ``log`` replayed in the same scenes is the reference of the comfort distance.
    """

    def of(path: str, factor: float) -> F64:
        name, _, inner = path.partition(".")
        return factor * column([row[name] for row in rows] if inner else rows, inner or name)

    table = np.stack([of(*entry) for entry in _MEANS.values()], axis=1)
    histograms = {
        name: (np.array([r[key] for r in rows]), np.array([r[key] for r in log]).mean(axis=0))
        for name, key in _COMFORT.items()
    }

    def figures(chosen: npt.NDArray[np.int64]) -> list[float]:
        part = table[chosen]
        counts = np.isfinite(part).sum(axis=0)
        means = np.where(counts > 0, np.nansum(part, axis=0) / np.maximum(counts, 1), np.nan)
        comfort = [
            100 * comfort_distance(stacked[chosen].mean(axis=0), reference).cfd
            for stacked, reference in histograms.values()
        ]
        return [*means.tolist(), *comfort]

    value, count = figures(np.arange(len(rows))), len(rows)
    rng = np.random.default_rng(seed)
    drawn = np.array([figures(rng.integers(count, size=count)) for _ in range(RESAMPLES)]).T
    if count < LEAST_SCENES:
        drawn = np.full_like(drawn, np.nan)
    both = (dict(zip(FIGURES, of_all, strict=True)) for of_all in (value, drawn))
    return Figures(count, next(both), next(both))


Summary = Mapping[Condition, Figures]


def with_scores(table: Summary) -> dict[Condition, tuple[float, float]]:
    """CS and RS of every condition but the floor, over the bounds of them all."""
    chosen = [c for c in table if c.num_controlled != 0]
    if not chosen:
        return {}
    names = ("scr", "orr", "fde", "cfd")
    scr, orr, fde, cfd = ([table[c].value[name] for c in chosen] for name in names)
    cs, rs = scores(scr=scr, orr=orr, fde=fde, cfd=cfd)
    return {c: (float(a), float(b)) for c, a, b in zip(chosen, cs, rs, strict=True)}


def _few(table: Summary) -> bool:
    return any(figures.num_scenes < LEAST_SCENES for figures in table.values())


def figures_table(table: Summary) -> Table:
    """Return all figures of every condition."""
    relative = with_scores(table)
    names = ("method", "K", "replan_s", "scenes", *FIGURES, "cs", "rs")
    rows: TableRows = []
    for c, f in table.items():
        figures = [f.figure(name) for name in FIGURES]
        rows.append(
            [
                c.method,
                c.k,
                c.replan_steps / 10,
                f.num_scenes,
                *figures,
                *relative.get(c, (None, None)),
            ]
        )
    return Table(names, rows)


#: Figures that a reader sees.
_SHOWN = (
    Column("scr", "SCR"),
    Column("scr_controlled", "SCR new, controlled"),
    Column("orr", "ORR", "%"),
    Column("fde", "FDE", "m"),
    Column("cfd", "CFD"),
    Column("sor", "SOR"),
    Column("realism_cost", "C(tau)"),
    Column("shift_sigmas", "shift sigmas"),
    Column("conflict_share", "gradients in conflict"),
)


def tables(table: Summary) -> list[Block]:
    """Return the floor, and a row for each condition."""
    relative = with_scores(table)
    rows: TableRows = []
    for c, f in table.items():
        pair = relative.get(c, (None, None))
        label = "Floor: log replay" if c.num_controlled == 0 else c.cells[0]
        figures = [f.figure(column.name) for column in _SHOWN]
        known = [x if np.isfinite(x[0]) or column.name in NEED_ROAD else None
                 for x, column in zip(figures, _SHOWN, strict=True)]  # fmt: skip
        rows.append([label, *c.cells[1:], *pair, *known])
    note = FEW if _few(table) else BRACKETS
    heads = ("method", "K", "T s", Column("CS"), Column("RS"), *_SHOWN)
    return [Table(heads, rows), f"{note} CS, RS: bounds over this table."]


# methods against one another

#: Figures that are compared.
COMPARED = {
    column.name: replace(column, sign="+")
    for column in _SHOWN
    if column.name not in ("sor", "shift_sigmas", "conflict_share")
}


def difference(one: Figures, other: Figures, name: str) -> Figure:
    """Return one less the other in a figure, and the paired bootstrap interval over scenes."""
    return (one.value[name] - other.value[name], *interval(one.draws[name] - other.draws[name]))


def comparison(table: Summary) -> list[Block]:
    """Return paired differences to CCDiff, and distances to the Pareto front.

    CCDiff is the one of equal training where it was played (``ccdiff_equal``), else the shipped.
    """
    equal = any(c.method == "ccdiff_equal" for c in table)
    base = "ccdiff_equal" if equal else "ccdiff"
    blocks = _against(table, base) + ([] if _few(table) else _distances(table))
    return blocks or ["One method alone."]


def _against(table: Summary, base: str) -> list[Block]:
    """Paired differences of all methods to one; those without guidance to it without guidance."""
    rows: TableRows = []
    for c, figures in table.items():
        other = base + UNGUIDED if c.method.endswith(UNGUIDED) else base
        reference = table.get(Condition(other, c.num_controlled, c.replan_steps))
        if reference is None or c.method == other or c.method not in METHODS:
            continue
        found = {name: difference(figures, reference, name) for name in COMPARED}
        cells = [f if n in NEED_ROAD or np.isfinite(f[0]) else None for n, f in found.items()]
        rows.append([*c.cells, *cells])
    if not rows:
        return []
    note = FEW if _few(table) else "95 % intervals of the paired bootstrap."
    return [
        Table(["method", "K", "T s", *COMPARED.values()], rows, f"Less {METHODS[base].label}"),
        f"Means over scenes, same scenes and vehicles; {note} "
        "Methods without guidance: less the same without guidance.",
    ]


def _distances(table: Summary) -> list[Block]:
    """GD and IGD to the Pareto front of control and realism, of methods that have every K."""
    relative = with_scores(table)
    if not relative:
        return []
    steps = min(c.replan_steps for c in relative)
    of: dict[str, list[tuple[float, float]]] = {}
    for c, pair in relative.items():
        if c.replan_steps == steps:
            of.setdefault(c.method, []).append(pair)
    most = max(map(len, of.values()))
    whole = {method: points for method, points in of.items() if len(points) == most}
    points = np.array(list(whole.values()))
    if len(whole) < 2 or not np.isfinite(points).all():  # no road, no realism
        return []
    gd, igd = generational_distance(cs=points[..., 0], rs=points[..., 1])
    rows: TableRows = [
        [label_of(method), *map(float, figures)]
        for method, *figures in zip(whole, *points.mean(axis=1).T, gd, igd, strict=True)
    ]
    return [
        Table(
            ["method", *map(Column, ("CS", "RS", "GD", "IGD"))],
            rows,
            "Distance to the Pareto front of control and realism",
        ),
        f"Means over {most} values of K; less is better for GD and IGD.",
    ]
