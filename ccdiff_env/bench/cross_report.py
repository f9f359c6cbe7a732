"""Report of a cross-evaluation: what is in the sets, who collides in whose set, and scores."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.cross_evaluation import Realism
from ccdiff_env.bench.intervals import FEW, LEAST_SCENES, are_few, mean_interval
from ccdiff_env.bench.planner_report import short_name
from ccdiff_env.bench.plots import new_plot, save_plot
from ccdiff_env.bench.replays import write_replay
from ccdiff_env.bench.scenario_sets import ScenarioSet
from ccdiff_env.bench.scenes import source_title
from ccdiff_env.system.files import file_name, write_aside
from ccdiff_env.system.table import Block, Column, Table, TableRows, document

__all__ = ["avoidable_rows", "write_collisions", "write_cross"]

#: Rows of each planner in each set; the generator is ``None`` where the traffic reacted.
Cells = Mapping[tuple[str | None, str], Sequence[Mapping[str, Any]]]

REACTING = "the planner tested (traffic reacts)"
#: Figures of a cell: column of the rows, title.
_FIGURES = {
    "collision": "Share of scenarios with a collision",
    "at_fault": "Share with a collision at fault",
    "score": "Score",
}


def write_cross(
    sets: Mapping[str, ScenarioSet],
    realism: Mapping[str, Realism],
    cells: Cells,
    folder: Path,
) -> None:
    """Write ``table.md``, ``cross.csv``, ``sets.csv`` and ``cross.png``.

    Parameters
    ----------
    sets, realism
        Sets and their realism by generator.
    cells
        Rows per scene of every planner in every set, and in reacting traffic.
    folder
        Where to.
    """
    planners = list(dict.fromkeys(planner for _, planner in cells))
    subsets = {
        "all": {g: {s.scene for s in made.scenarios} for g, made in sets.items()},
        "avoidable": {g: {s.scene for s in m.scenarios if s.avoidable} for g, m in sets.items()},
    }
    parts = {
        name: {
            (g, p): [
                {**row, "at_fault": 1.0 - row["no_at_fault_collision"]}
                for row in rows
                if g is None or row["scene"] in kept[g]
            ]
            for (g, p), rows in cells.items()
            if name == "all" or g is not None
        }
        for name, kept in subsets.items()
    }
    few = any(are_few(rows) for rows in parts["avoidable"].values() if rows)
    blocks: list[Block] = [FEW if few else _verdict(parts["avoidable"], list(sets), planners)]
    blocks += _sets_table(sets, realism)
    for name, part in parts.items():
        for figure, title in _FIGURES.items():
            scope = "all scenarios" if name == "all" else "avoidable scenarios only"
            blocks.append(_matrix(part, list(sets), planners, figure, f"{title}: {scope}"))
    foot = (
        "Rows: the ego that the traffic was made against; columns: the planner tested. In a set "
        "the others do as recorded. Brackets: 95 % bootstrap intervals over scenarios, none of "
        f"fewer than {LEAST_SCENES}."
    )
    write_aside(folder / "table.md", document(*blocks, foot))
    _write_csv(sets, realism, parts, folder)
    _plot(parts, list(sets), planners, folder / "cross.png")


def _verdict(part: Cells, generators: Sequence[str], planners: Sequence[str]) -> str:
    """Say who collides least where collisions can be avoided, and whose traffic is hardest."""
    share = {
        (g, p): float(np.mean([row["collision"] for row in part[g, p]]))
        for g in generators
        for p in planners
        if part.get((g, p))
    }
    if not share:
        return "No collision in these sets could have been avoided."

    by_planner = {p: _mean(v for key, v in share.items() if key[1] == p) for p in planners}
    by_set = {g: _mean(v for key, v in share.items() if key[0] == g) for g in generators}
    best = min(planners, key=lambda p: by_planner[p])
    worst = max(planners, key=lambda p: by_planner[p])
    hard = max(generators, key=lambda g: by_set[g])
    text = f"{short_name(best)} collides least ({by_planner[best]:.2f} of the avoidable scenarios)"
    if best != worst:
        text += f", {short_name(worst)} most ({by_planner[worst]:.2f})"
    if len(generators) > 1:
        text += f". The set made against {short_name(hard)} is the hardest ({by_set[hard]:.2f})"
    return text + "."


def _mean(values: Iterable[float]) -> float:
    listed = list(values)
    return float(np.mean(listed)) if listed else np.nan


def avoidable_rows(
    sets: Mapping[str, ScenarioSet], cells: Cells
) -> dict[tuple[str, str], list[Mapping[str, Any]]]:
    """Return the rows of every planner in every set, by planner and generator: avoidable ones."""
    kept = {g: {s.scene for s in made.scenarios if s.avoidable} for g, made in sets.items()}
    return {
        (planner, generator): [row for row in rows if row["scene"] in kept[generator]]
        for (generator, planner), rows in cells.items()
        if generator is not None
    }


def write_collisions(sets: Mapping[str, ScenarioSet], folder: Path, replays: int) -> None:
    """Write ``collisions.md``: collisions of the egos that the sets were made against.

    Parameters
    ----------
    sets
        The sets by generator.
    folder
        Run folder.
    replays
        Collisions of each set that get a replay page.
    """
    heads = ("scene", "hit", "time s", "at fault", "avoidable")
    tables = []
    for generator, made in sets.items():
        rows: TableRows = []
        for i, s in enumerate(s for s in made.scenarios if s.collision):
            scene = s.scene
            if i < replays:
                page = file_name(f"set-{made.folder.name}-{scene}", ".html")
                path = folder / "replays" / page
                scene = f"[{scene}]({write_replay(made.rollout(scene), path)})"
            verdicts = ["yes" if so else "no" for so in (s.at_fault, s.avoidable)]
            kind = str(s.kind).removeprefix("collision_")
            figures = (s.realism_cost, s.shift_sigmas, s.fde_m)
            rows.append([scene, kind, f"{s.time_s:.1f}", *verdicts, *figures])
        tables.append(Table([*heads, *_REALISM], rows, f"Made against {short_name(generator)}"))
    write_aside(folder / "collisions.md", document(*tables))


#: How far the guided vehicles are from what the model or the log has.
_REALISM = (
    Column("realism_cost", "C(tau)"),
    Column("shift_sigmas"),
    Column("fde_m", "FDE m", digits=1),
)


def _sets_figures(made: ScenarioSet) -> tuple[int, int, int, int]:
    """Scenarios, those with a collision, at fault, and avoidable."""
    hit = [s for s in made.scenarios if s.collision]
    return (
        len(made.scenarios),
        len(hit),
        sum(s.at_fault for s in hit),
        sum(s.avoidable for s in hit),
    )


def _share(count: int, total: int) -> str:
    return f"{count} ({count / total:.2f})" if total else "0"


def _sets_table(sets: Mapping[str, ScenarioSet], realism: Mapping[str, Realism]) -> list[Block]:
    first = next(iter(sets.values()))
    rows: TableRows = []
    for generator, made in sets.items():
        total, hit, fault, avoidable = _sets_figures(made)
        shares = (_share(hit, total), _share(fault, hit), _share(avoidable, hit))
        real = realism[generator]
        figures = (real.realism_cost, real.shift_sigmas, real.fde_m, real.cfd)
        rows.append([short_name(generator), total, *shares, *figures])
    shares_of = ("with a collision", "of them at fault", "of them avoidable")
    figures_of = (*_REALISM, Column("cfd", "CFD", digits=1))
    what = f"Scenes: {source_title(first.source)}. Traffic: {first.traffic}, seed {first.seed}."
    return [
        "### Scenario sets",
        what,
        Table(["made against", "scenarios", *shares_of, *figures_of], rows),
    ]


def _matrix(
    part: Cells, generators: Sequence[str], planners: Sequence[str], name: str, title: str
) -> Table:
    lines: TableRows = []
    for generator in (*generators, None):
        rows = [part.get((generator, planner), []) for planner in planners]
        if any(rows):
            label = REACTING if generator is None else short_name(generator)
            cells = [mean_interval(r, name) if r else None for r in rows]
            lines.append([label, max(map(len, rows)), *cells])
    others = [
        [row for g in generators if g != planner for row in part[g, planner]]
        for planner in planners
    ]
    if len(generators) > 1 and any(others):
        means = [mean_interval(rows, name)[0] if rows else None for rows in others]
        lines.append(["mean, own set left out", "", *means])
    heads = (Column(planner, short_name(planner)) for planner in planners)
    return Table(["made against", "scenarios", *heads], lines, title)


def _write_csv(
    sets: Mapping[str, ScenarioSet],
    realism: Mapping[str, Realism],
    parts: Mapping[str, Cells],
    folder: Path,
) -> None:
    heads = ["generator", "scenarios", "collision", "at_fault", "avoidable", "realism_cost"]
    rows: TableRows = []
    for generator, made in sets.items():
        real = realism[generator]
        figures = (real.realism_cost, real.shift_sigmas, real.fde_m, real.cfd, real.seconds)
        rows.append([generator, *_sets_figures(made), *figures])
    heads += ["shift_sigmas", "fde_m", "cfd", "seconds"]
    Table(heads, rows).write_csv(folder / "sets.csv")
    rows = [
        [
            made_against or "reacting",
            planner,
            subset,
            len(of),
            *(mean_interval(of, f) for f in _FIGURES),
        ]
        for subset, cells in parts.items()
        for (made_against, planner), of in cells.items()
        if of
    ]
    heads = ["generator", "planner", "scenarios", "count", *_FIGURES]
    Table(heads, rows).write_csv(folder / "cross.csv")


def _plot(
    parts: Mapping[str, Cells], generators: Sequence[str], planners: Sequence[str], path: Path
) -> None:
    size = (4.2 + 1.5 * len(planners), 3.6 + 1.0 * len(generators))
    figure, axes = new_plot(*size, nrows=2, ncols=2)
    for line, (subset, cells) in zip(np.asarray(axes), parts.items(), strict=True):
        rows = list(dict.fromkeys(generator for generator, _ in cells))
        for axis, name in zip(line, ("collision", "score"), strict=True):
            values = np.array(
                [
                    [
                        np.mean([r[name] for r in cells.get((g, p), [])] or [np.nan])
                        for p in planners
                    ]
                    for g in rows
                ]
            )
            colours = "Reds" if name == "collision" else "Greens"
            axis.imshow(values, vmin=0.0, vmax=1.0, cmap=colours, aspect="auto")
            for (i, j), value in np.ndenumerate(values):
                if np.isfinite(value):
                    colour = "#ffffff" if value > 0.6 else "#000001"
                    axis.text(j, i, f"{value:.2f}", ha="center", va="center", color=colour)
            axis.set_xticks(range(len(planners)), [short_name(p) for p in planners], fontsize=8)
            labels = ["(reacting)" if g is None else short_name(g) for g in rows]
            axis.set_yticks(range(len(rows)), labels, fontsize=8)
            axis.set_title(f"{name}, {subset} scenarios", fontsize=10)
            axis.set_ylabel("made against", fontsize=8)
    save_plot(figure, path)
