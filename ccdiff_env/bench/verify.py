"""``ccdiff-env bench verify``: episodes of a run, played again bit for bit."""

from __future__ import annotations

import json
import random
import secrets
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ccdiff_env.bench.planner_report import short_name
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.provenance import scene_hashes, source_digest
from ccdiff_env.bench.record import Entry, Record
from ccdiff_env.bench.scenes import place_of, scenes_of
from ccdiff_env.bench.tape import Recorded
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, DatasetError, UnknownNameError, hint_of, unknown
from ccdiff_env.planners.built_in import is_of_package
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.system.progress import shown


@dataclass(frozen=True)
class Verified:
    """What came of a check: episodes played, all that there are, the seed of the draw,
    differences.
    """

    played: int
    there: int
    seed: int
    differing: tuple[str, ...]


def verify(
    record: Record,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    dataroot: str | None = None,
    own_code: bool = False,
) -> Verified:
    """Play episodes again and compare every bit.

    No code of others runs: drivers of the world and planners of the package drive again, by name;
    of all other planners the recorded actions are played. Batches are played as a whole, as they
    were: torch rounds differently in others.

    Args:
        episodes: At least so many, by chance; all by default.
        seed: Repeats a draw; from the system's randomness by default, so that nobody knows the draw
            beforehand.
        dataroot: Folder of nuScenes, where it is another than that of the run.
        own_code: Whether traffic that a run folder names by ``module:name`` or by the file of a
            policy is run.

    Raises:
        ConfigError: If the number is not positive, the data's folder is missing, or traffic would
            run code.
        DatasetError: If scenes or protocol are not those of the run, or an episode lacks its
            actions.
    """
    if episodes is not None and episodes < 1:
        raise ConfigError(f"episodes is {episodes}, expected at least 1")
    drawn_by = secrets.randbits(32) if seed is None else seed
    chosen = list(record.entries)
    if episodes is not None:
        random.Random(drawn_by).shuffle(chosen)
        ends = [sum(len(e.rows) for e in chosen[: i + 1]) for i in range(len(chosen))]
        chosen = chosen[: sum(end < episodes for end in ends) + 1]
    differing: list[str] = []
    for entry in shown(chosen, what="episodes"):
        rows, _ = _played(entry, dataroot, own_code=own_code)
        differing += [
            f"{entry.planner} in {entry.traffic}, seed {entry.seed}, {then['scene']}: {what}"
            for then, now in zip(entry.rows, rows, strict=True)
            if (what := _difference(then, now))
        ]
    played, there = (sum(len(e.rows) for e in part) for part in (chosen, record.entries))
    return Verified(played, there, drawn_by, tuple(differing))


def replayed(
    path: Path,
    scene: str,
    *,
    planners: Sequence[str] = (),
    traffic: Sequence[str] = (),
    seed: int | None = None,
    dataroot: str | None = None,
    own_code: bool = False,
) -> list[tuple[str, Rollout]]:
    """Play episodes of a run again: titles, and what was recorded, of one scene.

    The recorded actions are played. With ``own_code`` a planner of a run folder whose code is here,
    unchanged, drives again, and is asked what it meant to do. Either way every bit is compared.

    Args:
        path: The run folder.
        scene: Name of the scene.
        planners: Planners, by name or title; all by default.
        traffic: Names of traffic, by default the one in which the first planner scores least.
        seed: The seed, by default the one with which it scores least there.
        dataroot: Folder of nuScenes, where it is another than that of the run.
        own_code: Whether code that the run names may run: planners, and custom traffic.

    Raises:
        UnknownNameError, ConfigError: If the run has no such scene, planner, traffic or seed.
        DatasetError: If an episode does not come out as it did.
    """
    record = Record.read(path)
    there = {
        (entry.planner, entry.traffic, entry.seed): (entry, row)
        for entry in record.entries
        for row in entry.rows
        if row["scene"] == scene
    }
    if not there:
        known = sorted({name for entry in record.entries for name in entry.names})
        raise UnknownNameError(f"no scene {scene!r} in {path}; {hint_of(scene, known)}")
    names = list(dict.fromkeys(planner for planner, _, _ in there))
    # a class that names itself is called without its title, too
    calls = {name.partition("?title=")[0]: name for name in names}
    calls |= {alias: name for name in names for alias in (name, short_name(name))}
    who = [_known(calls, "planner of the run", name) for name in planners] or names

    def least(worst_in: Collection[str]) -> tuple[str, int]:
        keys = [key for key in there if key[0] == who[0] and (not worst_in or key[1] in worst_in)]
        if not keys:
            raise unknown("traffic of the run", next(iter(worst_in)), {key[1] for key in there})
        return min(keys, key=lambda key: (there[key][1]["score"], key))[1:]

    found = least(traffic)
    chosen = [(p, t, found[1] if seed is None else seed) for p in who for t in traffic or found[:1]]
    shown_as = []
    for key in chosen:
        if key not in there:
            raise UnknownNameError("no {} in {} with seed {} in the run".format(*key))
        entry, then = there[key]
        rows, rollouts = _played(
            entry,
            dataroot,
            own_code=own_code,
            own_planner=own_code,
            record=[scene],
        )
        now = next(row for row in rows if row["scene"] == scene)
        if (what := _difference(then, now)) is not None:
            raise DatasetError(f"{scene}, {key[0]} in {key[1]}, comes out otherwise: {what}")
        words = [short_name(key[0])] + [TRAFFIC[key[1]].label] * (len(traffic) > 1)
        shown_as.append((", ".join(words), rollouts[scene]))
    return shown_as


def _known(calls: Mapping[str, str], what: str, name: str) -> str:
    if name not in calls:
        raise unknown(what, name, calls)
    return calls[name]


def _played(
    entry: Entry,
    dataroot: str | None,
    *,
    own_code: bool,
    own_planner: bool = False,
    record: Collection[str] = (),
) -> tuple[list[dict[str, Any]], dict[str, Rollout]]:
    """Play a result again, all scenes of its batch, and record some; see :func:`.drive`."""
    if ":" in entry.traffic and not own_code:
        raise ConfigError(
            f"{entry.where}: custom traffic {entry.traffic!r} is only replayed "
            "with --own-code: trust whoever made it"
        )
    place = place_of(entry.source)
    if dataroot is not None and place.path is not None:
        place = replace(place, path=dataroot)
    source = str(place)
    if entry.made_from["protocol"] != PROTOCOL.sha256:
        raise DatasetError(f"{entry.where}: another protocol than that of this release")
    hashes = scene_hashes(source)
    wrong = [name for name in entry.names if hashes.get(name) != entry.made_from["scenes"][name]]
    if wrong:
        raise DatasetError(
            f"{entry.where}: scene {wrong[0]!r} has hash {hashes.get(wrong[0])} here, "
            f"{entry.made_from['scenes'][wrong[0]]} there"
        )
    planner: Any = entry.planner
    if not is_of_package(planner):
        if any("actions" not in row for row in entry.rows):
            raise DatasetError(f"{entry.where}: {planner} without its actions")
        if not (own_planner and _is_here(entry)):
            planner = Recorded(entry.rows, planner)
    return drive(
        scenes_of(source, entry.names),
        planner,
        TRAFFIC[entry.traffic].with_weights(entry.weights),
        seed=entry.seed,
        options=entry.window,
        record=record,
    )


def _is_here(entry: Entry) -> bool:
    """Return whether the code of a planner is here, as it was."""
    try:
        return source_digest(entry.planner) == entry.planner_source
    except (ConfigError, DatasetError, ImportError):
        return False


def _difference(then: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    """Say in what two rows of an episode differ; options that came later count as by default."""
    if "action" in then:
        options = WorldConfig.from_json(json.dumps({"action": then["action"]}))
        then = {**then, "action": json.loads(options.to_json())["action"]}
    names = [name for name in {**now, **then} if then.get(name) != now.get(name)]
    figures = [name for name in names if name not in ("digest", "actions", "action")]
    if figures:  # names and values may be anybody's
        name, was, now_is = figures[0], then.get(figures[0]), now.get(figures[0])
        return f"{ascii(name)[1:-1]:.40} was {was!a:.40}, is {now_is!a:.40}"
    return f"another {names[0]}" if names else None
