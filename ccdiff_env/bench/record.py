"""Raw results of ``bench planners``: read from run folders and submissions, and submitted.

Figures of a leaderboard and of a check come from here alone, never from a table of the run.
"""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ccdiff_env.bench.planner_report import NUPLAN, Label, short_name
from ccdiff_env.bench.planner_score import score_of
from ccdiff_env.bench.planners import SHORT_WINDOW, TRAFFIC, is_privileged, metric_name
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.scenes import place_of, source_title
from ccdiff_env.errors import CcdiffError, ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.planners.built_in import is_of_package
from ccdiff_env.scenes.sources import coverage
from ccdiff_env.system.files import (
    MOST_TEXT_BYTES,
    num_values,
    parsed_object,
    read_bytes,
    read_text,
    reading,
    write_aside,
)
from ccdiff_env.system.named_objects import title_of
from ccdiff_env.view.captions import is_taken

FORMAT = "ccdiff-env submission 1"
FUNCTION = "ccdiff_env.bench.planners:evaluate"
#: Bytes of a submission, packed and unpacked, its members, and values of all texts of a record.
MOST_BYTES, MOST_MEMBERS, MOST_VALUES = 256 << 20, 100_000, 1 << 23
MOST_STEPS = 100_000  #: Steps that an episode may last, or begin after.
_MEMBER = re.compile(r"(?:run|submission|raw/[\w.-]{1,250})\.json", re.ASCII)
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
    rows: tuple[Mapping[str, Any], ...]
    dynamics: frozenset[str]  #: Models of motion that the actions are of.
    #: Steps before and of an episode; ``None`` for those of the protocol.
    window: Mapping[str, int] | None = None
    #: Files of weights of the traffic's own, by name; of this machine.
    weights: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Result:
    """All that a record has of one planner, made from the same things throughout.

    ``key`` is what must be the same for figures to be compared, ``heading`` the same in words. Rows
    are per scene and seed, by traffic.
    """

    key: str
    heading: str
    planner: str
    planner_source: str | None
    privileged: bool
    seeds: tuple[int, ...]
    rows: Mapping[str, list[Mapping[str, Any]]]


@dataclass(frozen=True)
class Record:
    """Raw results of a run folder or a submission, with what was declared."""

    path: Path
    entries: tuple[Entry, ...]
    code: str | None
    training_data: str | None

    @classmethod
    def read(cls, path: Path) -> Record:
        """Read a run folder or a submission.

        Raises:
            DatasetNotFoundError: If there is no run of ``bench planners``.
            DatasetError: If something is damaged, or a score is not what its parts make.
            ConfigError: If it is the run of another benchmark.
        """
        with reading("run of planners", path):
            parsed = _parsed(_of_file(path) if path.is_file() else _of_folder(path), path)
            if "run.json" not in parsed:
                raise DatasetNotFoundError(f"no run of `bench planners`: no {path / 'run.json'}")
            settings, declared = parsed.pop("run.json"), parsed.pop("submission.json", {})
            if (kind := settings.get("benchmark")) != "planners":
                raise ConfigError(f"a run of {kind!a:.40}, expected planners")
            if declared and (made := declared.get("format")) != FORMAT:
                raise DatasetError(f"format {made!a:.40}, this release reads {FORMAT!r}")
            if path.is_file() and any("weights" in f.get("arguments", ()) for f in parsed.values()):
                raise DatasetError("weights of its traffic are named, but not in it")
            entries = [_entry(fields, str(path / name)) for name, fields in parsed.items()]
            if not entries:
                raise DatasetNotFoundError(f"no raw results in {path}")
            code, trained = _declared(declared.get("code"), declared.get("training_data"))
            return cls(path, tuple(entries), code, trained)

    def results(self) -> list[Result]:
        """Return what there is of each planner.

        Raises:
            DatasetError: If episodes of it are missing.
        """
        groups: dict[str, list[Entry]] = {}
        for entry in self.entries:
            same = {k: v for k, v in entry.made_from.items() if k != "scenes"}
            key = json.dumps(
                [entry.planner, entry.planner_source, entry.window, same], sort_keys=True
            )
            groups.setdefault(key, []).append(entry)
        return [self._result(entries) for entries in groups.values()]

    def _result(self, entries: list[Entry]) -> Result:
        first = entries[0]
        scenes = {k: v for entry in entries for k, v in entry.made_from["scenes"].items()}
        rows: dict[str, list[Mapping[str, Any]]] = {}
        for entry in entries:
            rows.setdefault(entry.traffic, []).extend(entry.rows)
        rows = dict(
            sorted(
                rows.items(), key=lambda item: (*PROTOCOL.panel, *TRAFFIC, item[0]).index(item[0])
            )
        )
        seeds = sorted({entry.seed for entry in entries})
        wanted = {(scene, seed) for scene in scenes for seed in seeds}
        for traffic, found in rows.items():
            there = [(row["scene"], row["seed"]) for row in found]
            if set(there) != wanted or len(there) != len(wanted):
                raise DatasetError(
                    f"{self.path}: {first.planner} in {traffic} has {len(there)} of "
                    f"{len(wanted)} episodes; finish the run"
                )
        made, window = first.made_from, first.window
        level = None
        if window is None:
            moves = {name for entry in entries for name in entry.dynamics}
            level = PROTOCOL.level_of(made["protocol"], scenes, rows, seeds, moves)
        facts = {
            "protocol": made["protocol"],
            "scenes": scenes,
            "traffic": sorted(rows),
            "window": window,
            # a protocol has seeds drawn, and fixes the weights that drive; others may be there
            "seeds": None if level else seeds,
            "weights": None if level else made.get("weights"),
            "made": made.get("version") if level else [made.get("version"), made.get("package")],
        }
        count = coverage(place_of(first.source), scenes)
        weights = f"no protocol, weights {str(made.get('weights'))[:8]}"
        heading = level or f"{source_title(first.source, count)}, {weights}"
        heading += "" if level else f", seed {', '.join(map(str, seeds))}"
        heading += f", version {made.get('version')}"
        if window is not None:
            heading += ", {horizon_steps} steps after {history_steps}".format(**window)
        key = json.dumps(facts, sort_keys=True)
        packaged = first.planner_source is None
        privileged = is_privileged(first.planner) if packaged else made.get("privileged") is True
        source = first.planner_source
        return Result(key, heading, first.planner, source, privileged, tuple(seeds), rows)

    def label(self, result: Result) -> Label:
        """Return the name of a planner in tables; one without code is marked.

        A file keeps its suffix, and its path where its name is one of the package.
        """
        if result.planner_source is None:
            return Label(short_name(result.planner))
        file = re.fullmatch(r"(?:.*/)?([^/:]+)", result.planner)
        name = result.planner if file is None or is_taken(file[1]) else file[1]
        title = title_of(result.planner)
        name = title if title and title.isascii() and title.isprintable() else name
        marks = [" (not of the package)"] * is_taken(name) + [" (no code)"] * (self.code is None)
        return Label(name + "".join(marks))


def _of_folder(path: Path) -> Iterator[tuple[str, str]]:
    for file in (path / "run.json", *sorted((path / "raw").glob("*.json"))):
        if file.is_file():
            yield file.relative_to(path).as_posix(), read_text(file)


def _of_file(path: Path) -> Iterator[tuple[str, str]]:
    """Return the members of a submission, one after another: they may be large, or say so."""
    data = read_bytes(path, MOST_BYTES)
    if data.count(b"PK\1\2") > MOST_MEMBERS:  # each takes memory before it is looked at
        raise DatasetError(f"more than {MOST_MEMBERS} members")
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        members = [info for info in file.infolist() if not info.is_dir()]
        names = [info.filename for info in members]
        if len(set(names)) < len(names):
            raise DatasetError("two members have the same name")
        if sum(info.file_size for info in members) > MOST_BYTES:
            raise DatasetError(f"more than {MOST_BYTES} bytes, unpacked")
        for info in members:
            if not _MEMBER.fullmatch(info.filename):
                raise DatasetError(f"a member {info.filename!a:.80}, expected raw results")
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise DatasetError(f"{info.filename} is neither stored nor deflated")
            if info.file_size > MOST_TEXT_BYTES:
                raise DatasetError(f"{info.filename} has more than {MOST_TEXT_BYTES} bytes")
            with file.open(info) as member:  # a size that is not true is found, not unpacked
                yield info.filename, member.read(info.file_size + 1).decode()


def _parsed(texts: Iterator[tuple[str, str]], path: Path) -> dict[str, dict[str, Any]]:
    found, values = {}, 0
    for name, text in texts:
        values += num_values(text)
        if values > MOST_VALUES:
            raise DatasetError(f"more than {MOST_VALUES} values")
        with reading("result", path / name):
            found[name] = parsed_object(text)
    return found


def _is_plain(text: object, most: int = 300) -> bool:
    """Return whether a text can be shown in tables and terminals as it is."""
    return isinstance(text, str) and len(text) <= most and text.isprintable()


def _declared(code: object, training_data: object) -> tuple[str | None, str | None]:
    """Return what is declared with a submission, checked; raises ``ValueError``."""
    if code is not None and not (_is_plain(code) and re.fullmatch(r"https://[^\s()]+", str(code))):
        raise ValueError(f"code is {code!a:.80}, expected an address of the web (https://...)")
    if training_data is not None and not _is_plain(training_data):
        raise ValueError(f"training_data is {training_data!a:.80}, expected a line of words")
    found = (None if text is None else str(text) for text in (code, training_data))
    return next(found), next(found)


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
    names, place = tuple(names), given["source"]
    return Entry(
        where,
        place,
        names,
        planner,
        traffic,
        seed,
        source,
        made_from,
        rows,
        moves,
        window,
        own_weights,
    )


def _row(row: Mapping[str, Any], names: list[str], seed: int, own: list[str]) -> Mapping[str, Any]:
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
    # no check measures nuPlan's metrics, or somebody's own, again, and no leaderboard shows them
    return {name: value for name, value in row.items() if name not in (NUPLAN, *_FORMER, *own)}


def submit(
    folder: Path, out: Path, *, code: str | None = None, training_data: str | None = None
) -> None:
    """Write a submission: the raw results of a run in one file, which anybody can check.

    ``code`` is an ``https://`` address of the planner's code, ``training_data`` says what it was
    trained on.

    Raises:
        ConfigError: If the address is none of the web, or the words are not one line of text.
        DatasetError, DatasetNotFoundError: If the run is damaged, unfinished or not there.
    """
    try:
        _declared(code, training_data)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    record = Record.read(folder)
    if any(entry.weights for entry in record.entries):
        raise ConfigError(f"{folder}: its traffic has own weights, which nobody else could check")
    record.results()
    declared = {"format": FORMAT, "code": code, "training_data": training_data}
    found = {"run.json": folder / "run.json"}
    found |= {f"raw/{Path(e.where).name}": Path(e.where) for e in record.entries}
    parts = {name: parsed_object(read_text(path)) for name, path in found.items()}
    for fields in parts.values():  # where the data lies is nobody's business
        holder = fields.get("arguments", fields)
        place = place_of(holder["source"])
        holder["source"] = str(place if place.path is None else replace(place, path="data"))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as file:
        for name, fields in {"submission.json": declared, **parts}.items():
            # without dates: the same run makes the same bytes
            info = zipfile.ZipInfo(name)
            file.writestr(info, json.dumps(fields, indent=1), zipfile.ZIP_DEFLATED)
    write_aside(out, packed.getvalue())
