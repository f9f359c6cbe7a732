"""Report of the planner benchmark: scores, paired differences, worst scenes."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import permutations
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.intervals import (
    FEW,
    RESAMPLES,
    are_few,
    brackets,
    difference,
    figures,
    interval,
    mean_interval,
    mean_of,
    scene_means,
    significance,
)
from ccdiff_env.bench.planners import TRAFFIC
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.replays import Pages
from ccdiff_env.system.table import Block, Column, Figure, Table, TableRows, escaped, link
from ccdiff_env.system.terminal import counted
from ccdiff_env.view.captions import LOG_TITLES, planner_title

Row = Mapping[str, Any]
#: Episodes of every planner in every traffic: planner, traffic -> rows per scene and seed.
Results = Mapping[tuple[str, str], Sequence[Row]]

_PARTS = (
    "score", "no_at_fault_collision", "collision", "on_road", "makes_progress", "right_way",
    "progress", "ttc", "comfort", "speed_limit", "success",
)  # fmt: skip
NUPLAN = "nuplan_score"  #: nuPlan's own score of an episode, where it was asked for.
_REASONS = {
    "no_at_fault_collision": "collision at fault",
    "on_road": "off the road",
    "makes_progress": "no progress",
    "right_way": "wrong way",
    "ttc": "close call",
}
#: Planners that all others are compared with: from outside, and the privileged one.
BASES = ("lane_idm", "idm", "ego")
UNLINKED = 10  #: Worst scenes of a planner that are listed where none has a replay.
BAD_BELOW = 0.7  #: Scenes with a lower score are listed; others where they have a replay.


def _names(found: Results) -> tuple[list[str], list[str]]:
    """Planners and traffic of results."""
    return list(dict.fromkeys(p for p, _ in found)), list(dict.fromkeys(t for _, t in found))


def _few(found: Results) -> bool:
    return any(map(are_few, found.values()))


def _parts(found: Results, extra: Sequence[str] = ()) -> tuple[str, ...]:
    """Figures of a planner: nuPlan's own score where all episodes have it, and further ones."""
    by_nuplan = all(NUPLAN in row for rows in found.values() for row in rows)
    return (_PARTS[0], *[NUPLAN] * by_nuplan, *extra, *_PARTS[1:])


def _scores(
    found: Results, planner: str, traffic: Sequence[str], name: str = "score"
) -> npt.NDArray[np.float64]:
    """Scores of a planner, means over seeds [traffic, S], scenes sorted by name."""
    return np.array([list(scene_means(found[planner, t], name).values()) for t in traffic])


def headlines(found: Results) -> dict[str, dict[str, Figure]]:
    """Return ``mean`` and ``worst`` of the traffic for each planner, with 95 % intervals."""
    planners, traffic = _names(found)
    heads: dict[str, dict[str, Figure]] = {}
    for planner in planners:
        table = _scores(found, planner, traffic)
        count = table.shape[1]
        resamples = np.random.default_rng(0).integers(count, size=(RESAMPLES, count))
        drawn = table[:, resamples].mean(axis=2).min(axis=0)
        ends = (np.nan, np.nan) if _few(found) else interval(drawn)
        worst = (float(table.mean(axis=1).min()), *ends)
        heads[planner] = {"mean": mean_of(table.mean(axis=0)), "worst": worst}
    return heads


def figures_table(found: Results, extra: Sequence[str] = ()) -> Table:
    """Return score, parts and ``extra`` figures of every planner in every traffic; scores of their
    mean and worst traffic.
    """
    parts, (_, traffic) = _parts(found, extra), _names(found)
    table = figures((row for of in found.values() for row in of), ("planner", "traffic"), parts)
    ends: TableRows = []
    for planner, heads in headlines(found).items():
        count = len(scene_means(found[planner, traffic[0]], "score"))
        for name in ("mean", "worst"):
            ends.append([planner, name, count, heads[name], *[None] * (len(parts) - 1)])
    return Table(table.heads, [*table.rows, *ends])


def comparison(
    found: Results, bases: Sequence[str] = BASES, extra: Sequence[str] = ()
) -> list[Block]:
    """Return paired differences of planners, of the score and ``extra`` figures: from ``bases``,
    both IDM and the trained ego, and the one that scores best of the others.
    """
    planners, traffic = _names(found)
    if len(planners) < 2:
        return ["One planner alone."]
    if _few(found):
        return [FEW]
    columns = (Column("difference", digits=3, sign="+"), Column("p", digits=4))
    level = PROTOCOL.fields["statistics"]["level"]
    order = {p: float(_scores(found, p, traffic).mean()) for p in planners}
    tables: list[Block] = []
    for name in ("score", *extra):
        rows: TableRows = []
        for planner, other in _pairs(planners, bases, order):
            pairs = _paired(found, planner, other, traffic, name)
            figure, p = difference(pairs)
            names = short_name(planner), short_name(other)
            rows.append([*names, figure, p, significance(p, level)])
        title = "" if name == "score" else name.replace("_", " ")
        tables.append(Table(["planner", "against", *columns, "verdict"], rows, title))
    count = len(scene_means(found[planners[0], traffic[0]], "score"))
    return [
        f"Scores, means over traffic and seeds, {count} scenes: 95 % intervals of the paired "
        "bootstrap over scenes, p of the permutation test of signs.",
        *tables,
    ]


def _pairs(
    planners: Sequence[str], bases: Sequence[str], order: Mapping[str, float]
) -> Iterator[tuple[str, str]]:
    """Yield each planner with ``bases`` and with the best of the others; no pair twice."""
    seen = set[frozenset[str]]()
    others = [planner for planner in planners if planner not in bases]
    for planner in [*others, *(base for base in reversed(bases) if base in planners)]:
        best = max((p for p in planners if p != planner), key=order.__getitem__)
        for other in [*bases, best]:
            pair = frozenset((planner, other))
            if other in order and other != planner and pair not in seen:
                seen.add(pair)
                yield planner, other


def _paired(
    found: Results, one: str, other: str, traffic: Sequence[str], name: str
) -> npt.NDArray[np.float64]:
    """One planner less another in a figure, by scene, where both are known in all traffic [S]."""
    means = [[scene_means(found[p, t], name) for t in traffic] for p in (one, other)]
    known = set.intersection(*(set(by_scene) for of in means for by_scene in of))
    mine, theirs = (
        np.array([[by_scene[scene] for scene in sorted(known)] for by_scene in of]).mean(axis=0)
        for of in means
    )
    less: npt.NDArray[np.float64] = mine - theirs
    return less


def pairs_table(found: Results, extra: Sequence[str] = ()) -> Table:
    """Return the scores of each two planners, their difference and its p, by traffic and over all.

    ``value`` is that of the planner, ``other`` that of the one that it is compared with.
    """
    planners, traffic = _names(found)
    rows: TableRows = []
    for label, some in [*((t, [t]) for t in traffic), ("mean", traffic)]:
        for name in ("score", *[NUPLAN] * (NUPLAN in _parts(found)), *extra):
            rows_of = {p: [row for t in some for row in found[p, t]] for p in planners}
            means = {p: mean_interval(of, name) for p, of in rows_of.items()}
            for one, other in permutations(planners, 2):
                less = difference(_paired(found, one, other, some, name))
                rows.append([one, other, label, name, means[one], means[other], *less])
    columns = ["planner", "against", "traffic", "figure", "value", "other", "difference", "p"]
    return Table(columns, rows)


def parts_tables(found: Results, extra: Sequence[str] = ()) -> list[Block]:
    """Return a table of score and parts for each traffic, without parts that never differ."""
    planners, traffic = _names(found)
    means = {
        p: {mean_interval(rows, p)[0] for rows in found.values()} for p in _parts(found, extra)
    }
    shown = ("score", *extra)
    parts = [p for p, seen in means.items() if p in shown or len(seen) > 1]
    columns = [Column(part, interval=part in shown) for part in parts]
    tables = [
        Table(
            ["planner", *columns],
            [
                [short_name(p), *(mean_interval(found[p, t], part) for part in parts)]
                for p in planners
            ],
            f"Traffic: {TRAFFIC[t].label}",
        )
        for t in traffic
    ]
    best = "" if _few(found) else " Bold: best of its traffic."
    return [*tables, f"Means over scenes and seeds. {brackets(found.values())}{best}"]


def tags_table(found: Results, tags: Mapping[str, Sequence[str]]) -> list[Block]:
    """Return the scores of every planner, means over traffic and seeds, in the scenes of each city
    and tag; ``tags`` are city and tags by scene.
    """
    planners, traffic = _names(found)
    cities = sorted({of[0] for of in tags.values()})
    names = sorted({tag for of in tags.values() for tag in of[1:]})
    names += cities if len(cities) > 1 else []
    counts = {name: sum(name in of for of in tags.values()) for name in names}
    rows: TableRows = []
    notes = set[str]()
    for planner in planners:
        own = [row for t in traffic for row in found[planner, t]]
        tagged = [[row for row in own if name in tags[row["scene"]]] for name in names]
        rows.append([short_name(planner), *(mean_interval(of, "score") for of in tagged)])
        notes |= {brackets([of]) for of in tagged}
    columns = [Column(name, f"{name} ({counts[name]})") for name in names]
    if not names:
        return []
    note = "Number of scenes in brackets after a tag."
    return [Table(["score", *columns], rows), " ".join([note, *sorted(notes)])]


class Label(str):
    """The name of a planner in words, as tables have it."""

    __slots__ = ()


def short_name(planner: str) -> str:
    """Return the name of a planner in words: of a file, its name without the suffix."""
    if isinstance(planner, Label):
        return planner
    return LOG_TITLES.get(planner) or planner_title(planner)


def worst_scenes(found: Results, planner: str, count: int) -> list[tuple[str, Row]]:
    """Return the scenes in which a planner scores least: traffic and row, the worst first.

    Each scene occurs once, with its worst traffic. Ties go to the smaller least time to contact.
    """
    rows = [(name, row) for (p, name), part in found.items() if p == planner for row in part]
    rows.sort(key=lambda r: (r[1]["score"], r[1]["min_ttc_s"], r[0], r[1]["scene"]))
    seen: dict[str, tuple[str, Row]] = {}
    for name, row in rows:
        seen.setdefault(row["scene"], (name, row))
    return list(seen.values())[:count]


def worst_table(found: Results, count: int, pages: Pages, traffic: str = "traffic") -> list[Block]:
    """Return the ``count`` worst scenes of every planner, linked to their replays; some, without
    links, for 0.

    ``traffic`` heads its column.
    """
    blocks: list[Block] = []
    for planner in dict.fromkeys(p for p, _ in found):
        rows: TableRows = []
        for name, row in worst_scenes(found, planner, count or UNLINKED):
            page = pages.get((row["job"], row["scene"]))
            if row["score"] < BAD_BELOW or page is not None:
                kind = TRAFFIC[name].label if name in TRAFFIC else short_name(name)
                scene = row["scene"] if page is None else link(row["scene"], page)
                rows.append([scene, kind, row["score"], _why(row)])
        name = short_name(planner)
        table = Table(["scene", traffic, Column("score"), "why"], rows, name)
        blocks.append(table or f"### {escaped(name)}\n\nNo scene below {BAD_BELOW:g}.")
    return blocks


def _why(row: Row) -> str:
    """What keeps a score from being 1."""
    why = [text for part, text in _REASONS.items() if row[part] is not None and row[part] < 1.0]
    if row["collision"] and row["no_at_fault_collision"]:
        why.insert(0, "collision, not at fault")
    if (avoidable := row.get("avoidable")) is not None:
        why.append("avoidable" if avoidable else "not avoidable")
    return ", ".join(why)


def verdict(found: Results) -> str:
    """Say in two sentences of Markdown who is best, and where planners break."""
    if _few(found):
        return FEW
    planners, traffic = _names(found)
    mean = {key: mean_interval(rows, "score") for key, rows in found.items()}
    sentences = []
    over_all = {p: float(np.mean([mean[p, t][0] for t in traffic])) for p in planners}
    best, *rest = sorted(planners, key=lambda p: -over_all[p])
    if rest:
        seen = {key: round(value[0], 2) for key, value in mean.items()}  # ties as tables have them
        first = [t for t in traffic if all(seen[best, t] >= seen[p, t] for p in rest)]
        of_all = f"{len(first)} of {len(traffic)}"
        where = "all traffic" if len(first) == len(traffic) else f"{of_all} kinds of traffic"
        text = f"{short_name(best)} has the best mean ({over_all[best]:.2f}) and leads in {where}"
        level = PROTOCOL.fields["statistics"]["level"]
        less = {p: difference(_paired(found, best, p, traffic, "score"))[1] for p in rest}
        if near := [short_name(p) for p in rest if less[p] >= level]:
            text += f"; not significantly above {' and '.join(near)} (paired, p >= {level:g})"
        sentences.append(text)
    drops = []
    for planner in planners:
        worst_first = sorted((mean[planner, t][0], TRAFFIC[t].label) for t in traffic)
        low, top = worst_first[0], worst_first[-1]
        drops.append((top[0] - low[0], short_name(planner), top, low))
    drop, name, top, low = max(drops)
    if drop >= 0.005:
        ends = "from {:.2f} ({}) to {:.2f} ({})".format(*top, *low)
        sentences.append(f"{name} loses most, {ends}")
    count = len({row["scene"] for row in next(iter(found.values()))})
    return escaped(". ".join([*sentences, counted(count, "scene")]) + ".")


def summary(found: Results, privileged: Collection[str] = ()) -> list[Block]:
    """Return a matrix of planners and traffic, the best of each bold, and its notes.

    Planners that use what a vehicle cannot know are marked.
    """
    planners, traffic = _names(found)
    heads = headlines(found)
    some = len(planners) > 1 and not _few(found)
    scores = [Column(t, TRAFFIC[t].label, best=some) for t in traffic]
    by_nuplan = all(NUPLAN in row for rows in found.values() for row in rows)
    lines: TableRows = []
    for planner in sorted(planners, key=lambda p: -heads[p]["mean"][0]):
        cells = [mean_interval(found[planner, t], "score") for t in traffic]
        mark = " †" if planner in privileged else ""
        cells += heads[planner].values()
        if by_nuplan:
            cells.append(mean_of(_scores(found, planner, traffic, NUPLAN).mean(axis=0)))
        lines.append([short_name(planner) + mark, *cells])
    columns = [*scores, Column("mean"), Column("worst")]
    columns += [Column(NUPLAN, "nuPlan's score")] if by_nuplan else []
    blocks: list[Block] = [Table(["score", *columns], lines)]
    if privileged:
        blocks.append("† privileged: uses what a vehicle cannot know, as the log.")
    return blocks
