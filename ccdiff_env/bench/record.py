"""Raw results of ``bench planners``, read from run folders.

Figures of a check come from here alone, never from a table of the run.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ccdiff_env.bench.planner_report import (
    BASES,
    NUPLAN,
    Label,
    Row,
    comparison,
    short_name,
    summary,
    verdict,
)
from ccdiff_env.bench.planner_score import score_of
from ccdiff_env.bench.planners import (
    SHORT_WINDOW,
    TRAFFIC,
    is_privileged,
    metric_name,
    window_title,
)
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.scenes import place_of, source_title
from ccdiff_env.errors import CcdiffError, ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.planners.built_in import is_of_package
from ccdiff_env.scenes.sources import coverage
from ccdiff_env.system.files import num_values, parse_object, read_text, reading
from ccdiff_env.system.named_objects import title_of
from ccdiff_env.system.table import document
from ccdiff_env.view.captions import is_taken

FUNCTION = "ccdiff_env.bench.planners:evaluate"
MOST_VALUES = 1 << 23  #: Values of all texts of a record.
MOST_STEPS = 100_000  #: Steps that an episode may last, or begin after.
_FORMER = ("log_fails",)  #: Figures that rows of this protocol had once.
_VERSION = re.compile(r"[\w.+-]{1,40}", re.ASCII)


@dataclass(frozen=True)
class Entry:
    """A raw result: one planner in one traffic with one seed, in the scenes of a batch."""

    where: str
    source: str
    names: tuple[str, ...]
    planner: str
    traffic: str
    seed: int
    #: Digest of the planner's source; ``None`` for drivers and planners of the package alone.
    planner_source: str | None
    made_from: Mapping[str, Any]
    rows: tuple[Row, ...]
    dynamics: frozenset[str]  #: Models of motion that the actions are of.
    #: Steps before and of an episode; ``None`` for those of the protocol.
    window: Mapping[str, int] | None = None
    #: Files of weights of the traffic's own, by name; of this machine.
    weights: Mapping[str, str] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """What results of one planner have in common that were made from the same things."""
        same = {k: v for k, v in self.made_from.items() if k != "scenes"}
        return json.dumps([self.planner, self.planner_source, self.window, same], sort_keys=True)

    @property
    def privileged(self) -> bool:
        """Whether the planner sees the log: told of the package, declared by others."""
        if self.planner_source is None:
            return is_privileged(self.planner)
        return self.made_from.get("privileged") is True

    @property
    def label(self) -> Label:
        """Name of the planner in tables. A file keeps its suffix, and its path where its name is
        one of the package.
        """
        if self.planner_source is None:
            return Label(short_name(self.planner))
        file = re.fullmatch(r"(?:.*/)?([^/:]+)", self.planner)
        name = self.planner if file is None or is_taken(file[1]) else file[1]
        title = title_of(self.planner)
        name = title if title and title.isascii() and title.isprintable() else name
        return Label(name + " (not of the package)" * is_taken(name))


@dataclass(frozen=True)
class Record:
    """Raw results of a run folder."""

    path: Path
    entries: tuple[Entry, ...]

    @classmethod
    def read(cls, path: Path) -> Record:
        """Read a run folder.

        Raises:
            DatasetNotFoundError: If there is no run of ``bench planners``.
            DatasetError: If something is damaged, or a score is not what its parts make.
            ConfigError: If it is the run of another benchmark.
        """
        with reading("run to play again", path):
            if path.is_file():
                raise DatasetError("a file, expected a run folder")
            parsed = _parsed(path)
            if "run.json" not in parsed:
                raise DatasetNotFoundError(f"no run of a benchmark: no {path / 'run.json'}")
            if (kind := parsed.pop("run.json").get("benchmark")) != "planners":
                raise ConfigError(f"a run of {kind!a:.40}, expected one of bench planners")
            entries = [_entry(fields, str(path / name)) for name, fields in parsed.items()]
            if not entries:
                raise DatasetNotFoundError(f"no raw results in {path}")
            return cls(path, tuple(entries))

    def tables(self) -> list[tuple[str, str]]:
        """Return the scores, recomputed from the episodes: heading and Markdown of each table.

        Planners share a table where scenes (by their hashes), traffic, seeds, weights, version and
        protocol are the same. What takes a name of the package and is not of it is marked.

        Raises:
            DatasetError: If episodes are missing.
        """
        planners: dict[str, list[Entry]] = {}
        for entry in self.entries:
            planners.setdefault(entry.key, []).append(entry)
        groups: dict[str, tuple[dict[tuple[str, str], list[Row]], set[str]]] = {}
        for entries in planners.values():
            heading, rows = self._played(entries)
            found, privileged = groups.setdefault(heading, ({}, set()))
            label, taken = entries[0].label, {known for known, _ in found}
            if label in taken:
                label = Label(f"{label} #{sum(known.startswith(label) for known in taken) + 1}")
            found |= {(label, traffic): played for traffic, played in rows.items()}
            if entries[0].privileged:
                privileged.add(label)
        bases = [short_name(planner) for planner in BASES]
        return [
            (
                json.loads(heading)[0],
                document(verdict(found), *summary(found, privileged), *comparison(found, bases)),
            )
            for heading, (found, privileged) in groups.items()
        ]

    def _played(self, entries: list[Entry]) -> tuple[str, dict[str, list[Row]]]:
        """Return of one planner what its table is of, heading first, and its rows by traffic."""
        first = entries[0]
        made, window = first.made_from, first.window
        scenes = {k: v for entry in entries for k, v in entry.made_from["scenes"].items()}
        rows: dict[str, list[Row]] = {}
        panel = (*PROTOCOL.panel, *TRAFFIC)
        for entry in sorted(entries, key=lambda e: (*panel, e.traffic).index(e.traffic)):
            rows.setdefault(entry.traffic, []).extend(entry.rows)
        seeds = sorted({entry.seed for entry in entries})
        wanted = {(scene, seed) for scene in scenes for seed in seeds}
        for traffic, found in rows.items():
            there = [(row["scene"], row["seed"]) for row in found]
            if set(there) != wanted or len(there) != len(wanted):
                raise DatasetError(
                    f"{self.path}: {first.planner} in {traffic} has {len(there)} of "
                    f"{len(wanted)} episodes; finish the run"
                )
        heading = None
        if window is None:
            moves = {name for entry in entries for name in entry.dynamics}
            heading = PROTOCOL.level_of(made["protocol"], scenes, rows, seeds, moves)
        if heading is None:
            heading = source_title(first.source, coverage(place_of(first.source), scenes))
            heading += f", no protocol, weights {str(made.get('weights'))[:8]}"
        heading += f", seed {', '.join(map(str, seeds))}, version {made.get('version')}"
        heading += window_title(window)
        same = [made.get(name) for name in ("protocol", "weights", "package")]
        return json.dumps([heading, sorted(rows), scenes, *same], sort_keys=True), rows


def _parsed(path: Path) -> dict[str, dict[str, Any]]:
    found, values = {}, 0
    for file in (path / "run.json", *sorted((path / "raw").glob("*.json"))):
        if not file.is_file():
            continue
        values += num_values(text := read_text(file))
        if values > MOST_VALUES:
            raise DatasetError(f"more than {MOST_VALUES} values")
        with reading("result", file):
            found[file.relative_to(path).as_posix()] = parse_object(text)
    return found


def _is_plain(text: object, most: int = 300) -> bool:
    """Return whether a text can be shown in tables and terminals as it is."""
    return isinstance(text, str) and len(text) <= most and text.isprintable()


def _entry(fields: Mapping[str, Any], where: str) -> Entry:
    """Return a raw result, checked: it may be anybody's."""
    try:
        if fields["function"] != FUNCTION or "options" in fields["arguments"]:
            raise ValueError("no result of `bench planners`")
        given, made_from = dict(fields["arguments"]), dict(fields["made_from"])
        source_title(given["source"])
        planner, traffic, seed, names = (given[n] for n in ("planner", "traffic", "seed", "names"))
        if not planner.isascii():
            raise ValueError(f"the name {planner!a:.80}, expected letters of ASCII")
        scenes, weights = made_from["scenes"], made_from.get("weights") or ""
        for text in (planner, traffic, *names, *scenes.values(), made_from["version"], weights):
            if not _is_plain(text):
                raise ValueError(f"the text {text!a:.80}")
        if not _VERSION.fullmatch(made_from["version"]):
            raise ValueError(f"version {made_from['version']!a:.80}")
        own_weights = dict(given.get("weights", {}))
        TRAFFIC.add(own_weights)
        if traffic not in TRAFFIC or type(seed) is not int:
            raise ValueError(f"traffic {traffic!r}, seed {seed!r}")
        if sorted(scenes) != sorted(names):
            raise ValueError("hashes of its scenes")
        if not isinstance(made_from["protocol"], str):
            raise ValueError("protocol")
        window = given.get("window")
        if not (window is None or window.keys() == SHORT_WINDOW.keys()) or any(
            type(steps) is not int or not 0 < steps < MOST_STEPS
            for steps in (window or {}).values()
        ):
            raise ValueError(f"window {window!a:.80}")
        own = [metric_name(metric) for metric in given.get("metrics", ())]
        rows = tuple(_row(row, names, seed, own) for row in fields["result"])
        moves = frozenset(
            name for row in rows for name in row.get("action", {}).get("dynamics", ())
        )
        if [row["scene"] for row in rows] != list(names):
            raise ValueError("its scenes")
        source = given["sources"]["planner"]
        if (source is None) != is_of_package(planner) or not _is_plain(source or ""):
            raise ValueError(f"planner's source {source!a:.80} of {planner}")
    except (AttributeError, CcdiffError, KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"damaged result of a run ({error}): {where}") from None
    return Entry(
        where, given["source"], tuple(names), planner, traffic, seed, source, made_from, rows,
        moves, window, own_weights,
    )  # fmt: skip


def _row(row: Row, names: list[str], seed: int, own: list[str]) -> Row:
    if row["scene"] not in names or row["seed"] != seed or not isinstance(row["digest"], str):
        raise ValueError(f"scene {row['scene']!r}")
    parts = [*PROTOCOL.fields["score"]["gates"], *PROTOCOL.fields["score"]["weights"]]
    for part in (*parts, "score", "collision", "success"):
        if part == "on_road" and row[part] is None:
            continue
        if type(row[part]) not in (float, int) or not 0.0 <= row[part] <= 1.0:
            raise ValueError(f"{part} {row[part]!a:.80}, expected 0 to 1")
    made = score_of(row)
    if made != row["score"]:
        raise ValueError(f"score of {row['scene']} is {row['score']}, its parts make {made}")
    # no check measures nuPlan's metrics, or somebody's own, again
    return {name: value for name, value in row.items() if name not in (NUPLAN, *_FORMER, *own)}
