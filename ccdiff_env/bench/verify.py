"""``ccdiff-env bench verify``: episodes of a run or a submission, played again bit for bit."""

from __future__ import annotations

import json
import random
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ccdiff_env.bench.planners import TRAFFIC, drive, with_log
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.provenance import scene_hashes
from ccdiff_env.bench.record import Entry, Record
from ccdiff_env.bench.scenes import place_of, scenes_of
from ccdiff_env.bench.tape import Recorded
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, DatasetError
from ccdiff_env.system.progress import shown

__all__ = ["verify"]


def verify(
    record: Record, *, episodes: int | None = None, dataroot: str | None = None
) -> tuple[int, list[str]]:
    """Play episodes again with the recorded actions and compare every bit.

    No code of planners runs. Batches are played as a whole, as they were: networks round
    differently in others.

    Parameters
    ----------
    record
        The run or submission.
    episodes
        At least so many, by chance but the same every time; all by default.
    dataroot
        Folder of nuScenes, where it is another than that of the run.

    Returns
    -------
    int
        Episodes that were played.
    list of str
        Those that came out differently, and in what.

    Raises
    ------
    ConfigError
        If the number is not positive, the data's folder is missing, or a submission's traffic is
        code of its own.
    DatasetError
        If scenes or protocol are not those of the run.
    """
    if episodes is not None and episodes < 1:
        raise ConfigError(f"episodes is {episodes}, expected at least 1")
    chosen = list(record.entries)
    if episodes is not None:
        random.Random(0).shuffle(chosen)
        ends = [sum(len(e.rows) for e in chosen[: i + 1]) for i in range(len(chosen))]
        chosen = chosen[: sum(end < episodes for end in ends) + 1]
    differing: list[str] = []
    for entry in shown(chosen, what="episodes"):
        differing += _differences(entry, record.path, dataroot)
    return sum(len(entry.rows) for entry in chosen), differing


def _differences(entry: Entry, path: Path, dataroot: str | None) -> list[str]:
    place = place_of(entry.source)
    if path.is_file() and ":" in entry.traffic:
        raise ConfigError(f"{entry.traffic}: traffic of one's own is not run from a file of others")
    if path.is_file() and place.path is not None and dataroot is None:
        raise ConfigError(f"{path}: its scenes are of {place.source}, give --dataroot")
    if dataroot is not None and place.path is not None:
        place = replace(place, path=dataroot)
    source = str(place)
    if entry.made_from["protocol"] != PROTOCOL.sha256:
        raise DatasetError(f"{entry.where}: of another protocol than this release's")
    hashes = scene_hashes(source)
    wrong = [name for name in entry.names if hashes.get(name) != entry.made_from["scenes"][name]]
    if wrong:
        raise DatasetError(
            f"{entry.where}: scene {wrong[0]!r} has hash {hashes.get(wrong[0])} here, "
            f"{entry.made_from['scenes'][wrong[0]]} there"
        )
    outside = any("actions" in row for row in entry.rows)
    planner: Any = Recorded(entry.rows) if outside else entry.planner
    if not outside and (entry.planner_source is not None or ":" in entry.planner):
        raise DatasetError(f"{entry.where}: {entry.planner} without its actions")
    scenes = scenes_of(source, entry.names)
    rows, _ = drive(scenes, planner, TRAFFIC[entry.traffic], seed=entry.seed)
    rows = with_log(rows, source, entry.names)
    return [
        f"{entry.planner} in {entry.traffic}, seed {entry.seed}, {then['scene']}: {what}"
        for then, now in zip(entry.rows, rows, strict=True)
        if (what := _difference(then, now))
    ]


def _difference(then: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    """Say in what two rows of an episode differ; options that came later count as by default."""
    if "action" in then:
        options = WorldConfig.from_json(json.dumps({"action": then["action"]}))
        then = {**then, "action": json.loads(options.to_json())["action"]}
    names = [name for name in {**now, **then} if then.get(name) != now.get(name)]
    figures = [name for name in names if name not in ("digest", "actions", "action")]
    if figures:
        return f"{figures[0]} was {then.get(figures[0])}, is {now.get(figures[0])}"
    return f"another {names[0]}" if names else None
