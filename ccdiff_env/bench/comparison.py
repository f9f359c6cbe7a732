"""Methods against one another: paired differences, distance to the best, and the paper's order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from ccdiff_env.bench.intervals import FEW
from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.tables import (
    NEED_ROAD,
    Condition,
    Figures,
    in_order,
    interval,
    of_few,
    with_scores,
)
from ccdiff_env.metrics import generational_distance
from ccdiff_env.system.files import write_aside
from ccdiff_env.system.table import Block, Column, Figure, Table, TableRows, document

__all__ = ["PAPER", "difference", "paper_pairs", "write_comparison"]

#: Figures that are compared.
COMPARED = {
    column.name: column
    for column in (
        Column("scr", "SCR", sign="+"),
        Column("scr_controlled", "SCR new, controlled", sign="+"),
        Column("orr", "ORR", "%", sign="+"),
        Column("fde", "FDE", "m", sign="+"),
        Column("cfd", "CFD", sign="+"),
        Column("realism_cost", "C(tau)", sign="+"),
    )
}
UNGUIDED = "_unguided"

#: K and steps between plans of the columns of the paper's tables 1 and 2; ``None``: all.
PAPER_COLUMNS: tuple[tuple[int | None, int], ...] = (
    *((k, 5) for k in (2, 3, 4, 5, 10, None)),
    *((5, steps) for steps in (10, 20, 30, 40, 50)),
)


def _rows(text: str) -> dict[str, dict[str, tuple[float, ...]]]:
    found: dict[str, dict[str, tuple[float, ...]]] = {}
    for line in text.strip().splitlines():
        method, figure, *values = line.split()
        found.setdefault(method, {})[figure] = tuple(float(v) for v in values)
    return found


#: The paper's figures by method and name, in the order of :data:`PAPER_COLUMNS`.
PAPER: Mapping[str, Mapping[str, tuple[float, ...]]] = _rows("""
simnet     scr   .31   .32   .33   .36   .42   .47   .35   .37   .37   .37   .40
simnet     orr  1.76  2.19  2.62  2.67  2.90  3.17  2.09  3.87  6.16  8.36  9.93
simnet     fde  3.76  4.34  4.98  5.26  6.63  8.03  4.11  3.78  4.90  4.83  3.83
simnet     cfd  2.56  2.95  2.86  3.16  5.00  7.00  4.02  5.03  5.51  5.57  8.04
trafficsim scr   .38   .36   .44   .41   .41   .47   .53   .53   .58   .55   .53
trafficsim orr  2.09  2.25  2.45  2.48  2.66  2.73  3.56  6.36  8.98 10.96 12.21
trafficsim fde  4.25  5.06  5.77  6.23  6.79  7.13  8.32  6.48  8.61  8.66  7.32
trafficsim cfd  7.76  9.53 10.64 10.99 10.96 11.57  5.00 10.06  7.89 10.38  9.90
strive     scr   .49   .49   .53   .53   .56   .54   .49   .41   .41   .39   .38
strive     orr  5.70  6.45  7.13  7.50  8.04  8.53  5.75  4.98  6.64  8.40 10.02
strive     fde  9.01 10.79 12.13 13.00 13.76 14.52 11.48 11.20 14.56 15.00 12.41
strive     cfd  7.72  8.93  9.91 10.67 10.72 11.21  5.60 10.21 11.59 11.32  9.11
bits       scr   .38   .38   .37   .39   .37   .41   .37   .34   .44   .39   .41
bits       orr   .53   .51   .56   .63   .56   .60  1.44  3.68  5.63  7.56  9.39
bits       fde  3.20  3.95  4.42  4.67  5.05  5.35  4.68  4.69  6.10  6.36  5.44
bits       cfd  7.43  8.32  9.15  9.42  9.46 10.23  8.79 10.35 10.75 11.30 11.65
ctg        scr   .43   .42   .46   .42   .44   .46   .41   .44   .49   .52   .49
ctg        orr  1.00  1.04  1.10  1.09  1.12  1.23  1.91  4.58  7.13  9.04 10.71
ctg        fde  5.32  6.18  6.83  7.40  8.10  9.19  7.58  7.91 10.26 10.30  8.27
ctg        cfd  2.37  2.31  2.68  2.59  2.57  3.13  2.68  4.06  2.43  2.80  3.00
ccdiff     scr   .40   .44   .43   .46   .49   .51   .40   .44   .49   .55   .52
ccdiff     orr   .61   .72   .99  1.02  1.80  2.05  2.92  4.52  7.10  9.35 10.51
ccdiff     fde  4.17  5.22  5.99  6.59  7.84  8.26  7.06  5.54  6.86  7.00  5.71
ccdiff     cfd  1.88  1.92  1.93  2.25  2.83  3.47  2.37  4.08  4.25  4.97  6.33
""")


def difference(one: Figures, other: Figures, name: str) -> Figure:
    """Return one less the other in a figure, and the paired bootstrap interval over scenes."""
    low, high = interval(one.draws[name] - other.draws[name])
    return one.value[name] - other.value[name], low, high


def _against(table: Mapping[Condition, Figures], base: str) -> list[Block]:
    """Paired differences of all methods to one; those without guidance to it without guidance."""
    rows: TableRows = []
    for c, figures in table.items():
        other = base + UNGUIDED if c.method.endswith(UNGUIDED) else base
        reference = table.get(Condition(other, c.num_controlled, c.replan_steps))
        if reference is None or c.method == other or c.method not in METHODS:
            continue
        found = {name: difference(figures, reference, name) for name in COMPARED}
        cells = [f if n in NEED_ROAD or np.isfinite(f[0]) else None for n, f in found.items()]
        rows.append([METHODS[c.method].label, c.k, f"{c.replan_steps / 10:g}", *cells])
    if not rows:
        return []
    intervals = FEW if of_few(table) else "95 % intervals of the paired bootstrap."
    return [
        f"### Less {METHODS[base].label}",
        f"Means over scenes, same scenes and vehicles; {intervals} "
        "Methods without guidance: less the same without guidance.",
        Table(["method", "K", "T s", *COMPARED.values()], rows),
    ]


def _distances(table: Mapping[Condition, Figures]) -> list[Block]:
    """GD and IGD to the Pareto front of control and realism, of methods that have every K."""
    relative = with_scores(table, False)
    if not relative:
        return []
    steps = min(c.replan_steps for c in relative)
    of: dict[str, list[tuple[float, float]]] = {}
    for c in in_order(relative):
        if c.replan_steps == steps:
            of.setdefault(c.method, []).append(relative[c])
    most = max(len(points) for points in of.values())
    whole = {method: points for method, points in of.items() if len(points) == most}
    points = np.array(list(whole.values()))
    if len(whole) < 2 or not np.isfinite(points).all():  # no road, no realism
        return []
    gd, igd = generational_distance(cs=points[..., 0], rs=points[..., 1])
    means = zip(whole, *points.mean(axis=1).T, gd, igd, strict=True)
    rows: TableRows = [[METHODS[method].label, *map(float, figures)] for method, *figures in means]
    return [
        "### Distance to the Pareto front of control and realism",
        f"Over {most} numbers of vehicles; less is better for GD and IGD.",
        Table(["method", *map(Column, ("CS", "RS", "GD", "IGD"))], rows),
    ]


def paper_pairs(
    table: Mapping[Condition, Figures], column: tuple[int | None, int], name: str, base: str
) -> tuple[int, int, int, int]:
    """Compare the order of the paper's methods in a figure with the paper's.

    Returns
    -------
    tuple
        Pairs of methods that the paper does not give equal, of them in its order here; pairs
        whose paired interval leaves out zero, of them in its order.
    """
    at = PAPER_COLUMNS.index(column)
    pairs = same = clear = clear_same = 0
    for first, second in combinations(_played(table, column, base).items(), 2):
        (one, figures), (two, others) = first, second
        theirs = PAPER[one][name][at] - PAPER[two][name][at]
        value, low, high = difference(figures, others, name)
        if theirs == 0.0 or not np.isfinite(value):
            continue
        agrees = value * theirs > 0.0
        is_clear = low > 0.0 or high < 0.0
        pairs, same = pairs + 1, same + agrees
        clear, clear_same = clear + is_clear, clear_same + (is_clear and agrees)
    return pairs, same, clear, clear_same


def _played(
    table: Mapping[Condition, Figures], column: tuple[int | None, int], base: str
) -> dict[str, Figures]:
    """The paper's methods that were played in a column; CCDiff by the name of ours."""
    found = {
        name: table.get(Condition(base if name == "ccdiff" else name, *column)) for name in PAPER
    }
    return {name: figures for name, figures in found.items() if figures is not None}


def _beside(table: Mapping[Condition, Figures], base: str) -> list[Block]:
    """Our figures beside the paper's, and whether their order is the same."""
    blocks: list[Block] = []
    names = ("scr", "orr", "fde", "cfd")
    for at, column in enumerate(PAPER_COLUMNS):
        played = _played(table, column, base)
        if len(played) < 2:
            continue
        plain = Column("")
        rows = [
            [
                METHODS[base if method == "ccdiff" else method].label,
                *(f"{plain.text(f.value[n])}, {PAPER[method][n][at]:.2f}" for n in names),
            ]
            for method, f in played.items()
        ]
        counts = [paper_pairs(table, column, name, base) for name in names]
        rows += [
            ["pairs in the paper's order", *(f"{c[1]} of {c[0]}" for c in counts)],
            [
                "of those that differ clearly (interval without 0)",
                *(f"{c[3]} of {c[2]}" for c in counts),
            ],
        ]
        blocks += [
            f"### Beside the paper, K = {column[0] or 'all'}, T = {column[1] / 10:g} s",
            "Here, paper. Compare orders, not values: scenes, floor and budget differ.",
            Table(["method", *(COMPARED[name].title for name in names)], rows),
        ]
    return blocks


def write_comparison(
    table: Mapping[Condition, Figures], methods: Sequence[str], folder: Path
) -> None:
    """Write ``comparison.md``: paired differences to CCDiff, and all beside the paper.

    CCDiff is the one of equal training where it was played (``ccdiff_equal``), else the shipped.
    """
    base = "ccdiff_equal" if "ccdiff_equal" in methods else "ccdiff"
    blocks = _against(table, base)
    if not of_few(table):
        blocks += [*_distances(table), *_beside(table, base)]
    write_aside(folder / "comparison.md", document(*blocks or ["One method alone."]))
