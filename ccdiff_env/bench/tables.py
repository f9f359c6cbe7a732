"""Tables of the traffic benchmark: figures with bootstrap intervals, in the paper's layout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.intervals import FEW, LEAST_SCENES, column
from ccdiff_env.bench.methods import label_of
from ccdiff_env.metrics import PAPER_BOUNDS, comfort_distance, scores
from ccdiff_env.system.files import write_aside
from ccdiff_env.system.table import Block, Column, Table, TableRows, document
from ccdiff_env.system.terminal import counted

__all__ = [
    "FIGURES",
    "Condition",
    "Figures",
    "condition_of",
    "conditions",
    "of_few",
    "summarise",
    "write_tables",
]

#: Figures of a condition: name, unit, whether more is better for a method that seeks collisions.
FIGURES: dict[str, str] = {
    "scr": "share of scenes with a contact (all contacts)",
    "scr_new": "... of a pair that touches neither at the start nor in the log",
    "scr_controlled": "... that involves a controlled vehicle, new ones only",
    "collision_rate": "share of vehicles in a new contact, mean over scenes",
    "orr": "share of vehicle steps with the centre off the road, per cent",
    "orr_box": "... with a corner off the road, per cent",
    "orr_reference_impl": "... absent vehicles until the next plan count as off the road, %",
    "fde": "final displacement from the log, all vehicles, m",
    "fde_controlled": "... controlled vehicles only, m",
    "cfd": "comfort distance, body axes, x 100",
    "cfd_reference_impl": "... axes as released, x 100",
    "sor": "share of scenes with a controlled vehicle over the speed limit",
    "sor_log": "... of the same vehicles in the log",
    "excess": "speed above the limit, mean over steps of controlled vehicles, m/s",
    "realism_cost": "total variation of guided vehicles, mean over plans",
    "shift_sigmas": "the same in standard deviations, which does not saturate",
    "conflict_share": "share of guided denoising steps in which realism and guidance disagree",
    "gradient_cosine": "cosine of the gradients of realism and guidance",
    "graph_sparsity": "share of pairs that G does not join",
}
#: Figures that scenes without a road do not have.
NEED_ROAD = ("orr", "orr_box", "orr_reference_impl")
RESAMPLES = 1000
T = TypeVar("T")

Rows = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, order=True)
class Condition:
    """A column of a table: method, K (``None``: all), steps between plans."""

    method: str
    num_controlled: int | None
    replan_steps: int

    @property
    def k(self) -> str:
        """K as tables write it."""
        return "Full" if self.num_controlled is None else str(self.num_controlled)


@dataclass(frozen=True)
class Figures:
    """Figures of a condition by name: value, and the 95 % interval of a bootstrap over scenes.

    ``draws`` are the values in the resamples, ``[R]`` each: conditions of the same scenes and seed
    are resampled alike, so that differences of their draws are paired. Of few scenes intervals and
    draws are NaN.
    """

    num_scenes: int
    value: Mapping[str, float]
    low: Mapping[str, float]
    high: Mapping[str, float]
    draws: Mapping[str, npt.NDArray[np.float64]] = field(repr=False, compare=False)


def conditions(raw: Mapping[str, Any]) -> dict[Condition, list[Mapping[str, Any]]]:
    """Return the rows of each condition from results by job name."""
    found: dict[Condition, list[Mapping[str, Any]]] = {}
    for name in sorted(raw):
        found.setdefault(condition_of(name), []).extend(raw[name])
    return in_order(found)


def condition_of(job: str) -> Condition:
    """Return the condition that a job of :func:`~ccdiff_env.bench.traffic.traffic_jobs` plays."""
    method, k, steps, _ = job.rsplit("-", 3)
    return Condition(unquote(method), None if k == "KFull" else int(k[1:]), int(steps[1:]))


def summarise(rows: Rows, log: Rows, *, seed: int = 0) -> Figures:
    """Return the figures of one condition.

    Parameters
    ----------
    rows
        One dictionary per scene, see :func:`ccdiff_env.bench.traffic.measure`.
    log
        Those of the log's replay in the same scenes: reference of the comfort distance.
    seed
        Of the bootstrap.
    """
    columns = {
        "scr": [row["collision"]["all"] for row in rows],
        "scr_new": [row["collision"]["new"] for row in rows],
        "scr_controlled": [row["collision"]["controlled_new"] for row in rows],
        "collision_rate": [row["collision_rate"]["new"] for row in rows],
        "orr": 100 * column(rows, "off_road"),
        "orr_box": 100 * column(rows, "off_road_box"),
        "orr_reference_impl": 100 * column(rows, "off_road_reference_impl"),
        "fde": column(rows, "fde_m"),
        "fde_controlled": column(rows, "fde_controlled_m"),
        "sor": [row["over_speed"] for row in rows],
        "sor_log": column(rows, "over_speed_log"),
        "excess": column(rows, "excess_mps"),
        "realism_cost": column(rows, "realism_cost"),
        "shift_sigmas": column(rows, "shift_sigmas"),
        "conflict_share": column(rows, "conflict_share"),
        "gradient_cosine": column(rows, "gradient_cosine"),
        "graph_sparsity": column(rows, "graph_sparsity"),
    }
    table = np.stack([np.asarray(c, np.float64) for c in columns.values()], axis=1)
    histograms = {
        name: (
            np.array([row[key] for row in rows]),
            np.array([row[key] for row in log]).mean(axis=0),
        )
        for name, key in (("cfd", "comfort"), ("cfd_reference_impl", "comfort_reference_impl"))
    }

    def figures(chosen: npt.NDArray[np.int64]) -> dict[str, float]:
        part = table[chosen]
        counts = np.isfinite(part).sum(axis=0)
        means = np.where(counts > 0, np.nansum(part, axis=0) / np.maximum(counts, 1), np.nan)
        values = dict(zip(columns, means.tolist(), strict=True))
        for name, (stacked, reference) in histograms.items():
            values[name] = 100 * comfort_distance(stacked[chosen].mean(axis=0), reference).cfd
        return {name: values[name] for name in FIGURES}

    value = figures(np.arange(len(rows)))
    rng = np.random.default_rng(seed)
    drawn = [figures(rng.integers(len(rows), size=len(rows))) for _ in range(RESAMPLES)]
    draws = {name: np.array([d[name] for d in drawn]) for name in FIGURES}
    if len(rows) < LEAST_SCENES:
        draws = {name: np.full(RESAMPLES, np.nan) for name in FIGURES}
    bounds = {name: interval(draws[name]) for name in FIGURES}
    return Figures(
        num_scenes=len(rows),
        value=value,
        low={name: b[0] for name, b in bounds.items()},
        high={name: b[1] for name, b in bounds.items()},
        draws=draws,
    )


def interval(draws: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Return the 95 % interval of the draws of a bootstrap ``[R]``; NaN without a finite one."""
    if not np.isfinite(draws).any():
        return np.nan, np.nan
    low, high = np.nanpercentile(draws, [2.5, 97.5])
    return float(low), float(high)


def with_scores(
    table: Mapping[Condition, Figures], paper_scale: bool
) -> dict[Condition, tuple[float, float]]:
    """CS and RS of every condition but the floor, over the bounds of them all or the paper's."""
    chosen = [c for c in table if c.num_controlled != 0]
    if not chosen:
        return {}
    named = {name: [table[c].value[name] for c in chosen] for name in ("scr", "orr", "fde", "cfd")}
    cs, rs = scores(**named, bounds=PAPER_BOUNDS if paper_scale else None)
    return {c: (float(a), float(b)) for c, a, b in zip(chosen, cs, rs, strict=True)}


def write_tables(table: Mapping[Condition, Figures], folder: Path) -> None:
    """Write ``figures.csv``, and ``table.md`` and ``table.tex`` in the paper's layout."""
    folder.mkdir(parents=True, exist_ok=True)
    relative, paper = with_scores(table, False), with_scores(table, True)
    names = ("method", "K", "replan_s", "scenes", *FIGURES, "cs", "rs", "cs_paper", "rs_paper")
    rows: TableRows = []
    for c, f in table.items():
        both = (*relative.get(c, (None, None)), *paper.get(c, (None, None)))
        figures = [(f.value[name], f.low[name], f.high[name]) for name in FIGURES]
        rows.append([c.method, c.k, c.replan_steps / 10, f.num_scenes, *figures, *both])
    Table(names, rows).write_csv(folder / "figures.csv")
    write_aside(folder / "table.md", _markdown(table, relative))
    write_aside(folder / "table.tex", _latex(table, relative))


def _by_number(k: str) -> tuple[bool, int]:
    """Order of K: by number, all vehicles last."""
    return (True, 0) if k == "Full" else (False, int(k))


def in_order(table: Mapping[Condition, T]) -> dict[Condition, T]:
    """Return conditions by method as they come, then by K, then by time between plans."""
    methods = list(dict.fromkeys(c.method for c in table))
    keys = sorted(table, key=lambda c: (methods.index(c.method), _by_number(c.k), c.replan_steps))
    return {c: table[c] for c in keys}


def verdict(table: Mapping[Condition, Figures]) -> str:
    """Say which method controls most and which is most realistic, over its conditions."""
    pairs = with_scores(table, False)
    if not pairs:
        return "Only the log was measured."
    if of_few(table):
        return FEW
    of: dict[str, list[tuple[float, float]]] = {}
    for c, pair in pairs.items():
        of.setdefault(label_of(c.method), []).append(pair)
    mean = {method: np.mean(found, axis=0) for method, found in of.items()}
    most = max(float(m[0]) for m in mean.values())
    control = [method for method, m in mean.items() if m[0] >= most - 0.005]
    at = ", ".join(f"RS {_number(mean[method][1])}" for method in control)
    s = "" if len(control) > 1 else "s"
    first = f"{' and '.join(control)} make{s} most collisions (CS {most:.2f}, mean over K; {at})"
    rated = [method for method, m in mean.items() if np.isfinite(m[1])]
    if not rated:
        return f"{first}; realism is n/a without a road."
    real = max(rated, key=lambda m: float(mean[m][1]))
    rs, cs = mean[real][1], mean[real][0]
    return f"{first}; {real} is the most realistic (RS {rs:.2f}, CS {cs:.2f})."


def of_few(table: Mapping[Condition, Figures]) -> bool:
    """Return whether a table is of too few scenes for intervals and verdicts."""
    return any(figures.num_scenes < LEAST_SCENES for figures in table.values())


def _number(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "n/a"


def _axes(
    table: Mapping[Condition, Figures],
) -> list[tuple[str, list[str], dict[str, dict[str, Condition]]]]:
    """Tables to print: caption, column heads, conditions by method and head."""
    played = [c for c in table if c.num_controlled != 0]
    steps = sorted({c.replan_steps for c in played})
    found = []
    for n in steps[:1]:
        part = [c for c in played if c.replan_steps == n]
        heads = sorted({c.k for c in part}, key=_by_number)
        rows: dict[str, dict[str, Condition]] = {}
        for c in part:
            rows.setdefault(c.method, {})[c.k] = c
        if rows:
            found.append((f"K controlled vehicles, a plan every {n / 10:g} s", heads, rows))
    for k in sorted({c.k for c in played if c.replan_steps != steps[0]}, key=_by_number):
        part = [c for c in played if c.k == k]
        heads = [f"{n / 10:g} s" for n in steps]
        rows = {}
        for c in part:
            rows.setdefault(c.method, {})[f"{c.replan_steps / 10:g} s"] = c
        swept = {method: by_head for method, by_head in rows.items() if len(by_head) > 1}
        found.append((f"a plan every T seconds, K = {k}", heads, swept))
    return found


#: Lines of a method in the tables.
_LINES = (
    Column("scr", "SCR"),
    Column("scr_controlled", "SCR new, controlled"),
    Column("orr", "ORR", "%"),
    Column("fde", "FDE", "m"),
    Column("cfd", "CFD"),
    Column("sor", "SOR"),
    Column("sor_log", "SOR of the log"),
    Column("excess", "excess", "m/s"),
    Column("realism_cost", "C(tau)"),
    Column("shift_sigmas", "shift sigmas"),
    Column("conflict_share", "gradients in conflict"),
    Column("gradient_cosine", "gradient cosine", digits=3),
)


def _cell(line: Column, c: Condition | None, table: Mapping[Condition, Figures]) -> str:
    """A figure of a condition; nothing where it has none and a road is not what it lacks."""
    if c is None or not (line.name in NEED_ROAD or np.isfinite(table[c].value[line.name])):
        return ""
    f = table[c]
    return line.text((f.value[line.name], f.low[line.name], f.high[line.name]))


def _scores_of(
    conditions: Sequence[Condition | None],
    scores: Mapping[Condition, tuple[float, float]],
    which: int,
) -> list[str]:
    found = [scores.get(c) if c is not None else None for c in conditions]
    return ["" if pair is None else _number(pair[which]) for pair in found]


def _floor(table: Mapping[Condition, Figures]) -> str:
    parts = []
    for c, f in table.items():
        if c.num_controlled == 0:
            v = f.value
            scenes = counted(f.num_scenes, "scene")
            parts.append(
                f"Floor (K = 0, log replay), {scenes}: SCR {v['scr']:.3f}, of new contacts "
                f"{v['scr_new']:.3f}, ORR {_number(v['orr'])} %, FDE {v['fde']:.2f} m, "
                f"CFD {v['cfd']:.2f}, SOR {v['sor']:.2f}."
            )
    return "\n".join(parts)


def _markdown(
    table: Mapping[Condition, Figures], relative: Mapping[Condition, tuple[float, float]]
) -> str:
    blocks: list[Block] = [verdict(table), *_matrices(table, relative), _floor(table)]
    for caption, heads, by_method in _axes(table):
        rows: list[list[str]] = []
        for method, by_head in by_method.items():
            chosen = [by_head.get(h) for h in heads]
            lines = [[line.title, *(_cell(line, c, table) for c in chosen)] for line in _LINES]
            lines = [line for line in lines if any(line[1:])]
            lines += [[n, *_scores_of(chosen, relative, j)] for j, n in enumerate(("CS", "RS"))]
            rows += [["" if i else label_of(method), *line] for i, line in enumerate(lines)]
        blocks.append(Table(["method", "", *heads], rows, f"{caption[0].upper()}{caption[1:]}"))
    brackets = FEW if of_few(table) else "Brackets: 95 % bootstrap intervals over scenes."
    return document(*blocks, f"{brackets} CS, RS: bounds over this table.")


def _matrices(
    table: Mapping[Condition, Figures], relative: Mapping[Condition, tuple[float, float]]
) -> list[Table]:
    """Methods by K: control and realism at a glance, the best of each K emphasised."""
    found = []
    for _, heads, by_method in _axes(table)[:1]:
        some = len(by_method) > 1 and not of_few(table)
        for j, title in enumerate(("CS", "RS")):
            rows = [
                [label_of(method), *_scores_of([by_head.get(h) for h in heads], relative, j)]
                for method, by_head in by_method.items()
            ]
            columns = [Column(h, f"K = {h}", best=some) for h in heads]
            found.append(Table([title, *columns], rows))
    return found


def _latex(
    table: Mapping[Condition, Figures], relative: Mapping[Condition, tuple[float, float]]
) -> str:
    out = []
    for caption, heads, rows in _axes(table):
        out += [
            r"\begin{table}",
            rf"\caption{{{caption[0].upper()}{caption[1:]}}}",
            r"\begin{tabular}{ll" + "c" * len(heads) + "}",
            r"\toprule",
            "Method & Metric & " + " & ".join(heads) + r" \\",
        ]
        for method, by_head in rows.items():
            chosen = [by_head.get(h) for h in heads]
            out.append(r"\midrule")
            for j, name in enumerate((r"CS~($\uparrow$)", r"RS~($\uparrow$)")):
                cells = _scores_of(chosen, relative, j)
                out.append(
                    f"{'' if j else label_of(method)} & {name} & " + " & ".join(cells) + r" \\"
                )
        out += [r"\bottomrule", r"\end{tabular}", r"\end{table}", ""]
    return "\n".join(out)
