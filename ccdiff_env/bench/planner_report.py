"""Report of the planner benchmark: table, robustness curve, worst scenes."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.intervals import FEW, RESAMPLES, are_few, brackets, mean_interval
from ccdiff_env.bench.page import anchor
from ccdiff_env.bench.planners import TRAFFIC
from ccdiff_env.bench.plots import colours_of, new_plot, save_plot
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.system.files import write_aside
from ccdiff_env.system.table import Block, Cell, Column, Figure, Table, TableRows, document
from ccdiff_env.system.terminal import counted
from ccdiff_env.view.captions import planner_title

__all__ = [
    "BASES",
    "comparison",
    "headlines",
    "over_seeds",
    "permutation_p",
    "short_name",
    "summary",
    "title_of",
    "verdict",
    "worst_scenes",
    "worst_table",
    "write_report",
]

Row = Mapping[str, Any]
#: Rows of one planner in one traffic: planner, traffic -> one dictionary per scene.
Results = Mapping[tuple[str, str], Sequence[Row]]

_PARTS = (
    "score",
    "no_at_fault_collision",
    "collision",
    "on_road",
    "makes_progress",
    "right_way",
    "progress",
    "ttc",
    "comfort",
    "speed_limit",
    "success",
)
#: nuPlan's own score of an episode, where it was asked for.
NUPLAN = "nuplan_score"
_REASONS = {
    "no_at_fault_collision": "collision at fault",
    "on_road": "off the road",
    "makes_progress": "no progress",
    "right_way": "wrong way",
    "ttc": "close call",
}
#: What built-in planners are, where the name alone does not say it.
_TITLES = {
    "idm": "IDM, log's path and speed",
}
#: Planners that all others are compared with: from outside, and the privileged one.
BASES = ("lane_idm", "idm")
#: Scores from here on are no bad ones: such scenes are listed where they have a replay alone.
BAD_BELOW = 0.7
_STATISTICS = PROTOCOL.fields["statistics"]


def over_seeds(found: Results) -> dict[tuple[str, str], list[dict[str, Any]]]:
    """Return rows that are means over the seeds of each scene: scenes are what is resampled."""
    means: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for key, rows in found.items():
        by_scene: dict[str, list[Row]] = {}
        for row in rows:
            by_scene.setdefault(row["scene"], []).append(row)
        means[key] = [
            {
                "scene": scene,
                "log_fails": several[0].get("log_fails", False),
                **{part: _mean([row[part] for row in several]) for part in _parts(several)},
            }
            for scene, several in sorted(by_scene.items())
        ]
    return means


def _parts(rows: Iterable[Row]) -> tuple[str, ...]:
    """Columns of rows: nuPlan's own score where all have it."""
    return _PARTS[:1] + (NUPLAN,) * all(NUPLAN in row for row in rows) + _PARTS[1:]


def _mean(values: Sequence[float | None]) -> float | None:
    """Mean over seeds; ``None`` for what the scene does not have."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def headlines(found: Results, planner: str, traffic: Sequence[str]) -> dict[str, Figure]:
    """Return scores of a planner over traffic, with 95 % intervals.

    Parameters
    ----------
    found
        One row per scene, the same scenes in all traffic.
    planner, traffic
        Which.

    Returns
    -------
    dict
        ``mean`` and ``worst`` of the traffic; ``rest``: the mean without the scenes in which the
        logged driver scores 0, where there are such.
    """
    table = _table(found, planner, traffic)
    kept = [not row["log_fails"] for row in found[planner, traffic[0]]]
    count = table.shape[1]
    resamples = np.random.default_rng(0).integers(count, size=(RESAMPLES, count))
    drawn = table[:, resamples].mean(axis=2)
    few = are_few(found[planner, traffic[0]])
    low, high = (np.nan, np.nan) if few else np.percentile(drawn.min(axis=0), [2.5, 97.5])
    means = _by_scene(table.mean(axis=0))
    heads = {
        "mean": mean_interval(means, "score"),
        "worst": (float(table.mean(axis=1).min()), float(low), float(high)),
    }
    if any(kept) and not all(kept):
        rest = [row for row, keep in zip(means, kept, strict=True) if keep]
        heads["rest"] = mean_interval(rest, "score")
    return heads


def _by_scene(values: npt.NDArray[np.float64]) -> list[dict[str, Any]]:
    """Rows of scores by scene [S]."""
    return [{"scene": i, "score": value} for i, value in enumerate(values)]


def _table(found: Results, planner: str, traffic: Sequence[str]) -> npt.NDArray[np.float64]:
    """Scores of a planner [traffic, S]."""
    return np.array([[row["score"] for row in found[planner, name]] for name in traffic])


def comparison(
    found: Results, planners: Sequence[str], traffic: Sequence[str], bases: Sequence[str] = BASES
) -> str:
    """Return paired differences of planners in Markdown: against both IDM, and the best other one.

    Parameters
    ----------
    found
        One row per scene, the same scenes in all traffic.
    planners, traffic
        Which.
    bases
        Both IDM, by their names among the planners.
    """
    count = len(next(iter(found.values())))
    if len(planners) < 2:
        return "One planner alone.\n"
    if any(map(are_few, found.values())):
        return f"{FEW}\n"
    rows: TableRows = []
    for planner, other, pairs in _pairs(found, planners, traffic, bases):
        figure, p = mean_interval(_by_scene(pairs), "score"), permutation_p(pairs)
        same = "cannot be told apart" if p >= _STATISTICS["level"] else ""
        rows.append([title_of(planner), title_of(other), figure, p, same])
    columns = (Column("difference", digits=3, sign="+"), Column("p", digits=4))
    return document(
        f"Scores, means over traffic and seeds, {count} scenes: 95 % intervals of the paired "
        "bootstrap over scenes, p of the permutation test of signs.",
        Table(["planner", "against", *columns, ""], rows),
    )


def _pairs(
    found: Results, planners: Sequence[str], traffic: Sequence[str], bases: Sequence[str]
) -> Iterator[tuple[str, str, npt.NDArray[np.float64]]]:
    """Differences [S] of scores, means over traffic: to ``bases``, and to the best other one."""
    scores = {p: _table(found, p, traffic).mean(axis=0) for p in planners}
    for planner in planners:
        best = max((p for p in planners if p != planner), key=lambda p: float(scores[p].mean()))
        for other in dict.fromkeys([*bases, best]):
            if other in scores and other != planner:
                yield planner, other, scores[planner] - scores[other]


def permutation_p(pairs: npt.NDArray[np.float64]) -> float:
    """Return the two-sided p of a mean difference [S] by the permutation test of signs."""
    rng = np.random.default_rng(0)
    signs = rng.choice([-1.0, 1.0], size=(_STATISTICS["permutations"], len(pairs)))
    drawn = np.abs(signs @ pairs)
    return float((1 + (drawn >= abs(pairs.sum()) - 1e-12).sum()) / (1 + len(signs)))


def write_report(
    found: Results,
    folder: Path,
    *,
    worst: int = 10,
    pages: Mapping[tuple[str, str, str], str] | None = None,
    privileged: Collection[str] = (),
) -> None:
    """Write scores, headlines and pairs (``.csv``), tables (``.md``) and ``robustness.png``.

    Parameters
    ----------
    found
        Rows per scene and seed of every planner in every traffic.
    folder
        Where to.
    worst
        Scenes to list per planner.
    pages
        Addresses of replays by planner, traffic and scene.
    privileged
        Planners that use what a vehicle cannot know.
    """
    planners = list(dict.fromkeys(p for p, _ in found))
    traffic = list(dict.fromkeys(t for _, t in found))
    shown = _parts(row for rows in found.values() for row in rows)
    parts = ("seed", "scene", *shown, "min_ttc_s")
    rows = [[*key, *(row[part] for part in parts)] for key, of in found.items() for row in of]
    Table(["planner", "traffic", *parts], rows).write_csv(folder / "scores.csv")
    write_aside(folder / "scenes.md", scenes_table(found, planners, traffic, pages or {}))
    write_aside(folder / "worst.md", worst_table(found, worst, pages or {}))
    found = over_seeds(found)
    write_aside(folder / "comparison.md", comparison(found, planners, traffic))
    _write_headlines(found, planners, traffic, folder / "headlines.csv")
    if len(planners) > 1:
        _write_pairs(found, planners, traffic, folder / "pairs.csv")
    columns = [Column(part, interval=part == "score") for part in shown]
    tables = [
        Table(
            ["planner", *columns],
            [
                [title_of(p), *(mean_interval(found[p, t], part) for part in shown)]
                for p in planners
            ],
            f"Traffic: {TRAFFIC[t].label}",
        )
        for t in traffic
    ]
    best = "" if any(map(are_few, found.values())) else " Emphasised: best of its traffic."
    text = document(
        verdict(found, planners, traffic),
        *summary(found, planners, traffic, privileged, opens=True),
        *tables,
        f"Means over scenes and seeds. {brackets(found.values())}{best}",
    )
    write_aside(folder / "table.md", text)
    _plot(found, planners, traffic, folder / "robustness.png")


def _write_headlines(
    found: Results, planners: Sequence[str], traffic: Sequence[str], path: Path
) -> None:
    """Write mean, worst and each traffic's score of every planner, with intervals, as CSV."""
    names = ["mean", "worst", *traffic]
    rows: TableRows = []
    for planner in planners:
        heads = headlines(found, planner, traffic)
        heads |= {name: mean_interval(found[planner, name], "score") for name in traffic}
        rows.append([planner, *(heads[name] for name in names)])
    Table(["planner", *names], rows).write_csv(path)


def _write_pairs(
    found: Results, planners: Sequence[str], traffic: Sequence[str], path: Path
) -> None:
    """Write the differences of :func:`comparison` in each traffic, with p, as CSV."""
    rows: TableRows = []
    for name in traffic:
        for planner, other, pairs in _pairs(found, planners, [name], BASES):
            figure = mean_interval(_by_scene(pairs), "score")
            rows.append([planner, other, name, figure, permutation_p(pairs)])
    columns = (Column("difference"), Column("p"))
    Table(["planner", "against", "traffic", *columns], rows).write_csv(path)


def short_name(planner: str) -> str:
    """Return the name of a planner in words: of a file, its name without the suffix."""
    return "Log replay" if planner == "replay" else planner_title(planner)


def title_of(planner: str) -> str:
    """Return the title of a planner in the tables of its benchmark."""
    return _TITLES.get(planner, short_name(planner))


def worst_scenes(found: Results, planner: str, count: int) -> list[tuple[str, Row]]:
    """Return the scenes in which a planner scores least: traffic and row, the worst first.

    Each scene stands once, with the traffic that is worst. Ties go to the smaller least time to
    contact.
    """
    rows = [(name, row) for (p, name), part in found.items() if p == planner for row in part]
    rows.sort(key=lambda r: (r[1]["score"], r[1]["min_ttc_s"], r[0], r[1]["scene"]))
    seen: dict[str, tuple[str, Row]] = {}
    for name, row in rows:
        seen.setdefault(row["scene"], (name, row))
    return list(seen.values())[:count]


def worst_table(
    found: Results, count: int, pages: Mapping[tuple[str, str, str], str], traffic: str = "traffic"
) -> str:
    """Return the worst scenes of every planner in Markdown.

    Parameters
    ----------
    found
        Rows per scene of every planner in every traffic.
    count
        Scenes per planner.
    pages
        Addresses of replays by planner, traffic and scene.
    traffic
        Heading of the traffic's column.
    """
    blocks: list[Block] = []
    for planner in dict.fromkeys(p for p, _ in found):
        rows: TableRows = []
        for name, row in worst_scenes(found, planner, count):
            page = pages.get((planner, name, row["scene"]))
            if row["score"] < BAD_BELOW or page is not None:
                kind = TRAFFIC[name].label if name in TRAFFIC else short_name(name)
                rows.append([_scene(row, page), kind, row["score"], _why(row)])
        table = Table(["scene", traffic, Column("score"), "why"], rows)
        blocks += [f"### {short_name(planner)}", table or f"No scene below {BAD_BELOW:g}."]
    return document(*blocks)


def _scene(row: Row, page: str | None) -> str:
    return row["scene"] if page is None else f"[{row['scene']}]({page})"


def _why(row: Row) -> str:
    """What keeps a score from being 1."""
    why = [text for part, text in _REASONS.items() if row[part] is not None and row[part] < 1.0]
    if row["collision"] and row["no_at_fault_collision"]:
        why.insert(0, "collision, not at fault")
    return ", ".join(why)


def scenes_table(
    found: Results,
    planners: Sequence[str],
    traffic: Sequence[str],
    pages: Mapping[tuple[str, str, str], str],
) -> str:
    """Return the scenes behind each cell of :func:`summary`, the worst first, in Markdown.

    Parameters
    ----------
    found
        Rows per scene and seed of every planner in every traffic.
    planners, traffic
        Which.
    pages
        Addresses of replays by planner, traffic and scene.
    """
    tables = []
    for planner, name in ((p, t) for p in planners for t in traffic):
        seeds: dict[str, list[Row]] = {}
        for row in found[planner, name]:
            seeds.setdefault(row["scene"], []).append(row)
        means = {scene: float(np.mean([r["score"] for r in rows])) for scene, rows in seeds.items()}
        rows: TableRows = []
        for scene in sorted(seeds, key=lambda scene: (means[scene], scene)):
            worst = min(seeds[scene], key=lambda row: row["score"])
            link = _scene(worst, pages.get((planner, name, scene)))
            rows.append([link, means[scene], _why(worst)])
        tables.append(Table(["scene", Column("score"), "why"], rows, _cell_title(planner, name)))
    return document(*tables)


def _cell_title(planner: str, traffic: str) -> str:
    return f"{short_name(planner)} in {TRAFFIC[traffic].label}"


def _plot(found: Results, planners: Sequence[str], traffic: Sequence[str], path: Path) -> None:
    level = {n: float(TRAFFIC[n].ccdiff.get("criticality", 0.0)) for n in traffic}
    names = sorted((n for n in traffic if TRAFFIC[n].driver == "ccdiff"), key=lambda n: level[n])
    if len(names) < 2:
        return
    figure, axes = new_plot(7, 4.2)
    x = [level[n] for n in names]
    aside = np.linspace(-0.015, 0.015, len(planners)) if len(planners) > 1 else [0.0]
    for (planner, colour), by in zip(colours_of(planners).items(), aside, strict=True):
        means = np.array([mean_interval(found[planner, n], "score") for n in names])
        whiskers = np.nan_to_num(np.abs(means[:, 1:] - means[:, :1]).T)
        axes.errorbar(
            np.array(x) + by, means[:, 0], yerr=whiskers, fmt="o-", label=short_name(planner),
            color=colour, markersize=4.5, elinewidth=1, capsize=2.5,
        )  # fmt: skip
    axes.set_xlabel("criticality of the CCDiff traffic")
    axes.set_ylabel("score")
    axes.set_ylim(0, 1)
    axes.grid(alpha=0.3)
    axes.legend(framealpha=0)
    save_plot(figure, path)


def verdict(found: Results, planners: Sequence[str], traffic: Sequence[str]) -> str:
    """Say in two sentences who is best, and where planners break."""
    if any(map(are_few, found.values())):
        return FEW
    mean = {key: mean_interval(rows, "score") for key, rows in found.items()}
    label = {name: TRAFFIC[name].label for name in traffic}
    sentences = []
    over_all = {p: float(np.mean([mean[p, t][0] for t in traffic])) for p in planners}
    best, *rest = sorted(planners, key=lambda p: -over_all[p])
    if rest:
        seen = {key: round(value[0], 2) for key, value in mean.items()}  # ties as tables have them
        first = [t for t in traffic if all(seen[best, t] >= seen[p, t] for p in rest)]
        where = (
            "in all traffic" if len(first) == len(traffic) else f"in {len(first)} of {len(traffic)}"
        )
        text = f"{short_name(best)} is best over all ({over_all[best]:.2f}), first {where}"
        near = [
            short_name(p) for p in rest if all(mean[p, t][2] >= mean[best, t][1] for t in traffic)
        ]
        if near:
            text += f"; the intervals overlap with those of {' and '.join(near)} everywhere"
        sentences.append(text)
    drops = []
    for planner in planners:
        top = max(traffic, key=lambda t: mean[planner, t][0])
        low = min(traffic, key=lambda t: mean[planner, t][0])
        drops.append((mean[planner, top][0] - mean[planner, low][0], planner, top, low))
    drop, planner, top, low = max(drops)
    if drop >= 0.005:
        sentences.append(
            f"{short_name(planner)} breaks most: from {mean[planner, top][0]:.2f} ({label[top]}) "
            f"to {mean[planner, low][0]:.2f} ({label[low]})"
        )
    count = len(next(iter(found.values())))
    return ". ".join([*sentences, counted(count, "scene")]) + "."


def summary(
    found: Results,
    planners: Sequence[str],
    traffic: Sequence[str],
    privileged: Collection[str] = (),
    *,
    opens: bool = False,
) -> list[Block]:
    """Return a matrix of planners and traffic, the best of each emphasised, and its notes.

    Parameters
    ----------
    found
        One row per scene, the same scenes in all traffic.
    planners, traffic
        Which.
    privileged
        Planners that use what a vehicle cannot know; they are marked.
    opens
        Whether each score leads to its scenes, see :func:`scenes_table`.
    """
    rows = next(iter(found.values()))
    heads = {planner: headlines(found, planner, traffic) for planner in planners}
    ends = {"mean": "mean", "worst": "worst", "rest": "mean, log can"}
    ends = {name: title for name, title in ends.items() if name in heads[planners[0]]}
    some = len(planners) > 1 and not any(map(are_few, found.values()))
    scores = [Column(t, TRAFFIC[t].label, best=some) for t in traffic]
    lines: TableRows = []
    for planner in sorted(planners, key=lambda p: -heads[p]["mean"][0]):
        cells: list[Cell] = []
        for column in scores:
            figure = mean_interval(found[planner, column.name], "score")
            score, gap, interval = column.text(figure).partition(" ")
            place = f"(#{anchor(_cell_title(planner, column.name))})"
            cells.append(f"[{score}]{place}{gap}{interval}" if opens else figure)
        mark = " †" if planner in privileged else ""
        lines.append([title_of(planner) + mark, *cells, *(heads[planner][n] for n in ends)])
    columns = [*scores, *(Column(name, title) for name, title in ends.items())]
    blocks: list[Block] = [Table(["score", *columns], lines)]
    if privileged:
        blocks.append("† privileged: uses what a vehicle cannot know, as the log.")
    if "rest" in ends:
        fails = ", ".join(row["scene"] for row in rows if row["log_fails"])
        blocks.append(
            f"*log can*: without the scenes in which the logged driver scores 0 ({fails})."
        )
    return blocks
