"""Raw results of ``bench planners``: read from run folders and submissions, and submitted.

Figures of a leaderboard and of a check come from here alone, never from a table of the run.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ccdiff_env.bench.planner_report import title_of
from ccdiff_env.bench.planners import TRAFFIC, score_of
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.scenes import place_of, source_title
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.scenes.sources import coverage
from ccdiff_env.system.files import parsed_object, read_bytes, read_text, reading, write_aside

__all__ = ["Entry", "Record", "Result", "submit"]

FORMAT = "ccdiff-env submission 1"
FUNCTION = "ccdiff_env.bench.planners:evaluate"
#: Bytes of a submission, unpacked.
MOST_BYTES = 1 << 30


@dataclass(frozen=True)
class Entry:
    """A raw result: one planner in one traffic with one seed, in the scenes of a batch."""

    where: str
    source: str
    names: tuple[str, ...]
    planner: str
    traffic: str
    seed: int
    #: Digest of the planner's source; ``None`` for what is part of the package.
    planner_source: str | None
    made_from: Mapping[str, Any]
    rows: tuple[Mapping[str, Any], ...]


@dataclass(frozen=True)
class Result:
    """All that a record has of one planner, made from the same things throughout.

    Parameters
    ----------
    key
        What must be the same for figures to be compared.
    heading
        The same in words.
    planner, planner_source, privileged
        Name, digest of its source, and whether it uses what a vehicle cannot know.
    rows
        Rows per scene and seed, by traffic.
    """

    key: str
    heading: str
    planner: str
    planner_source: str | None
    privileged: bool
    rows: Mapping[str, list[Mapping[str, Any]]]


@dataclass(frozen=True)
class Record:
    """Raw results of a run.

    Parameters
    ----------
    path
        Run folder, or file of a submission.
    settings
        What ``run.json`` holds.
    entries
        The raw results.
    submission
        What was declared with a submission: ``code``, ``training_data``.
    """

    path: Path
    settings: Mapping[str, Any]
    entries: tuple[Entry, ...]
    submission: Mapping[str, Any]

    @classmethod
    def read(cls, path: Path) -> Record:
        """Read a run folder or a submission.

        Raises
        ------
        DatasetNotFoundError
            If there is no run of ``bench planners``.
        DatasetError
            If something is damaged, or a score is not what its parts make.
        ConfigError
            If it is the run of another benchmark.
        """
        if path.is_file():
            texts = dict(_of_file(path))
        else:
            found = [path / "run.json", *sorted((path / "raw").glob("*.json"))]
            with reading("a run of planners", path):
                texts = {f.relative_to(path).as_posix(): read_text(f) for f in found if f.is_file()}
        if "run.json" not in texts:
            raise DatasetNotFoundError(f"no run of `bench planners`: no {path / 'run.json'}")
        parsed = {name: _parsed(text, path / name) for name, text in texts.items()}
        settings = parsed.pop("run.json")
        if settings.get("benchmark") != "planners":
            raise ConfigError(
                f"{path} is a run of {settings.get('benchmark')!r}, expected planners"
            )
        submission = parsed.pop("submission.json", {})
        if submission and submission.get("format") != FORMAT:
            made = submission.get("format")
            raise DatasetError(f"{path}: format {made!r}, this release reads {FORMAT!r}")
        for name in ("code", "training_data"):
            text = submission.get(name) or ""
            if not isinstance(text, str) or not text.isprintable():
                raise DatasetError(f"damaged ({name} {text!r}): {path}")
        entries = [
            _entry(fields, str(path / name))
            for name, fields in parsed.items()
            if fields.get("function") == FUNCTION or not name.startswith("raw/replay-")
        ]
        if not entries:
            raise DatasetNotFoundError(f"no raw results in {path}")
        return cls(path, settings, tuple(entries), submission)

    def results(self) -> list[Result]:
        """Return what there is of each planner.

        Raises
        ------
        DatasetError
            If episodes of it are missing.
        """
        groups: dict[str, list[Entry]] = {}
        for entry in self.entries:
            same = {k: v for k, v in entry.made_from.items() if k != "scenes"}
            key = json.dumps([entry.planner, entry.planner_source, same], sort_keys=True)
            groups.setdefault(key, []).append(entry)
        return [self._result(entries) for entries in groups.values()]

    def _result(self, entries: list[Entry]) -> Result:
        first = entries[0]
        scenes = {k: v for entry in entries for k, v in entry.made_from["scenes"].items()}
        rows: dict[str, list[Mapping[str, Any]]] = {}
        for entry in entries:
            rows.setdefault(entry.traffic, []).extend(entry.rows)
        rows = dict(sorted(rows.items(), key=lambda item: (*TRAFFIC, item[0]).index(item[0])))
        seeds = sorted({entry.seed for entry in entries})
        wanted = {(scene, seed) for scene in scenes for seed in seeds}
        for traffic, found in rows.items():
            there = [(row["scene"], row["seed"]) for row in found]
            if set(there) != wanted or len(there) != len(wanted):
                raise DatasetError(
                    f"{self.path}: {first.planner} in {traffic} has {len(there)} of "
                    f"{len(wanted)} episodes; finish the run"
                )
        made = first.made_from
        level = PROTOCOL.level_of(made["protocol"], scenes, rows, seeds)
        facts = {
            "protocol": made["protocol"],
            "scenes": scenes,
            "traffic": sorted(rows),
            "seeds": seeds,
            # a protocol fixes the weights that drive; others may be there or not
            "weights": None if level else made.get("weights"),
            "made": made.get("version") if level else [made.get("version"), made.get("package")],
        }
        count = coverage(place_of(first.source), len(scenes))
        weights = f"no protocol, weights {str(made.get('weights'))[:8]}"
        heading = level or f"{source_title(first.source, count)}, {weights}"
        heading += f", seed {', '.join(map(str, seeds))}, version {made.get('version')}"
        key = json.dumps(facts, sort_keys=True)
        privileged = bool(made.get("privileged"))
        return Result(key, heading, first.planner, first.planner_source, privileged, rows)

    def label(self, result: Result) -> str:
        """Return the name of a planner in tables; one without code is marked."""
        coded = result.planner_source is None or self.submission.get("code")
        return title_of(result.planner) + ("" if coded else " (no code)")


def _of_file(path: Path) -> Iterator[tuple[str, str]]:
    try:
        with zipfile.ZipFile(io.BytesIO(read_bytes(path))) as file:
            if sum(info.file_size for info in file.infolist()) > MOST_BYTES:
                raise DatasetError(f"a submission of more than {MOST_BYTES} bytes: {path}")
            for name in file.namelist():
                yield name, file.read(name).decode("utf-8", errors="replace")
    except (zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError, RuntimeError) as error:
        raise DatasetError(f"no submission ({error}): {path}") from None


def _parsed(text: str, where: Path) -> dict[str, Any]:
    try:
        return parsed_object(text)
    except ValueError as error:
        raise DatasetError(f"damaged ({error}): {where}") from None


def _entry(fields: Mapping[str, Any], where: str) -> Entry:
    """Return a raw result, checked: it may be anybody's."""
    try:
        if fields["function"] != FUNCTION or "options" in fields["arguments"]:
            raise ValueError("no result of `bench planners`")
        given, made_from = dict(fields["arguments"]), dict(fields["made_from"])
        source_title(given["source"])
        planner, traffic, seed, names = (given[n] for n in ("planner", "traffic", "seed", "names"))
        for what, name in (("planner", planner), ("traffic", traffic)):
            if not isinstance(name, str) or set("|[]\n") & set(name) or not name.isprintable():
                raise ValueError(f"{what} {name!r}")
        if traffic not in TRAFFIC or type(seed) is not int:
            raise ValueError(f"traffic {traffic!r}, seed {seed!r}")
        scenes = made_from["scenes"]
        if sorted(scenes) != sorted(names) or not all(isinstance(s, str) for s in scenes.values()):
            raise ValueError("hashes of its scenes")
        if not isinstance(made_from["protocol"], str):
            raise ValueError("protocol")
        rows = tuple(_row(row, names, seed) for row in fields["result"])
        if [row["scene"] for row in rows] != list(names):
            raise ValueError("its scenes")
        source = given["sources"]["planner"]
        if source is not None and not isinstance(source, str):
            raise ValueError(f"planner's source {source!r}")
    except (AttributeError, ConfigError, KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"damaged result of a run ({error}): {where}") from None
    return Entry(
        where, given["source"], tuple(names), planner, traffic, seed, source, made_from, rows
    )


def _row(row: Mapping[str, Any], names: list[str], seed: int) -> Mapping[str, Any]:
    if row["scene"] not in names or row["seed"] != seed or not isinstance(row["digest"], str):
        raise ValueError(f"scene {row['scene']!r}")
    parts = [*PROTOCOL.fields["score"]["gates"], *PROTOCOL.fields["score"]["weights"]]
    for part in (*parts, "score", "collision", "success"):
        if not (part == "on_road" and row[part] is None) and not 0.0 <= float(row[part]) <= 1.0:
            raise ValueError(f"{part} {row[part]!r}, expected 0 to 1")
    if type(row["log_fails"]) is not bool:
        raise ValueError(f"log_fails {row['log_fails']!r}")
    made = score_of(row)
    if made != row["score"]:
        raise ValueError(f"score of {row['scene']} is {row['score']}, its parts make {made}")
    return row


def submit(
    folder: Path, out: Path, *, code: str | None = None, training_data: str | None = None
) -> None:
    """Write a submission: the raw results of a run in one file, which anybody can check.

    Parameters
    ----------
    folder
        Run folder of ``bench planners``.
    out
        File to write.
    code
        Address of the planner's code, of the web.
    training_data
        What the planner was trained on, in words.

    Raises
    ------
    ConfigError
        If the address is none of the web.
    DatasetError, DatasetNotFoundError
        If the run is damaged, unfinished or not there.
    """
    if code is not None and not code.startswith(("https://", "http://")):
        raise ConfigError(f"--code is {code!r}, expected an address of the web (https://...)")
    record = Record.read(folder)
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
