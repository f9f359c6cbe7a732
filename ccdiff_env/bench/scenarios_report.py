"""Report of a cross-evaluation: what is in the sets, who collides in whose set, and scores."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ccdiff_env.bench.intervals import LEAST_SCENES, figures, grouped, mean_interval
from ccdiff_env.bench.planner_report import short_name
from ccdiff_env.system.table import Block, Column, Table, TableRows

Row = Mapping[str, Any]
Sets = Mapping[str, Sequence[Row]]  #: Rows of :func:`.scenarios.generate` by generator.
#: How episodes and files name traffic that reacts to the planner, and how tables do.
REACTING, REACTING_TITLE = "reacting", "the planner tested (traffic reacts)"
#: Figures of a cell: column of the rows, title.
_FIGURES = {
    "collision": "Share of scenarios with a collision",
    "at_fault": "Share with a collision at fault",
    "score": "Score",
}
#: How far the guided vehicles are from what the model or the log has.
_REALISM = (
    Column("moved_m", "moved at 2 s, m"),
    Column("fde_m", "FDE m", digits=1),
)


def cross_rows(sets: Sets, episodes: Iterable[Row]) -> list[dict[str, Any]]:
    """Return episodes with what reports ask: ``at_fault``, and whether a collision is
    ``avoidable``.

    Rows have ``planner`` and ``generator``, which is ``None`` where the traffic reacted.
    """
    avoidable = {(g, s["scene"]): s["avoidable"] for g, made in sets.items() for s in made}
    return [
        {
            **row,
            "generator": row["generator"] or REACTING,
            "at_fault": 1.0 - row["no_at_fault_collision"],
            "avoidable": avoidable.get((row["generator"], row["scene"])),
        }
        for row in episodes
    ]


def _subsets(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """All episodes, and those of sets in which collisions can be avoided."""
    return {"all": list(rows), "avoidable": [row for row in rows if row["avoidable"]]}


def figures_table(rows: Sequence[Row]) -> Table:
    """Return the figures of every planner in every set, of all scenarios and of avoidable ones."""
    tidy = [{**row, "scenarios": name} for name, part in _subsets(rows).items() for row in part]
    return figures(tidy, ("generator", "planner", "scenarios"), tuple(_FIGURES))


def tables(sets: Sets, rows: Sequence[Row], what: str) -> list[Block]:
    """Return the sets, ``what`` they were made of, and a matrix of planners for each figure."""
    counted = sets_table(sets)
    shown = [[short_name(str(generator)), *row] for generator, *row in counted.rows]
    blocks: list[Block] = [Table(counted.heads, shown), what]
    for name, part in _subsets(rows).items():
        scope = "all scenarios" if name == "all" else "avoidable scenarios only"
        blocks += [_matrix(part, f, f"{title}: {scope}") for f, title in _FIGURES.items()]
    foot = (
        "Rows: the ego that the traffic was made against; columns: the planner tested. In a set "
        "the others do as recorded. Brackets: 95 % bootstrap intervals over scenarios, none of "
        f"fewer than {LEAST_SCENES}."
    )
    return [*blocks, foot]


def sets_table(sets: Sets) -> Table:
    """Return what there is in the sets."""
    rows: TableRows = []
    for generator, made in sets.items():
        hit = [s for s in made if s["collision"]]
        counts = [len(hit), *(sum(s[name] for s in hit) for name in ("at_fault", "avoidable"))]
        means = [mean_interval(made, c.name)[0] for c in _REALISM]
        rows.append([generator, len(made), *counts, *means])
    columns: list[Column | str] = [Column("generator", "made against"), "scenarios"]
    columns += [Column("collision"), Column("at_fault", "of them at fault")]
    columns += [Column("avoidable", "of them avoidable"), *_REALISM]
    return Table(columns, rows)


def _matrix(part: Sequence[Row], name: str, title: str) -> Table:
    cells = grouped(part, "generator", "planner")
    planners = list(dict.fromkeys(planner for _, planner in cells))
    generators = list(dict.fromkeys(generator for generator, _ in cells))
    lines: TableRows = []
    for generator in sorted(generators, key=REACTING.__eq__):
        rows = [cells.get((generator, planner), []) for planner in planners]
        label = REACTING_TITLE if generator == REACTING else short_name(generator)
        lines.append([label, max(map(len, rows)), *(mean_interval(r, name) for r in rows)])
    others = [
        [row for (g, p), of in cells.items() if p == planner and g not in (planner, REACTING)
         for row in of]
        for planner in planners
    ]  # fmt: skip
    if len(set(generators) - {REACTING}) > 1 and any(others):
        means = [float(np.mean([r[name] for r in rows])) if rows else None for rows in others]
        lines.append(["mean, own set left out", "", *means])
    heads = (Column(planner, short_name(planner)) for planner in planners)
    return Table(["made against", "scenarios", *heads], lines, title)
