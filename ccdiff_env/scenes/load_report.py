"""The report of a load: what was kept, what was left out and why."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class SceneReport:
    """What became of one scene."""

    name: str  #: Name of the scene.
    key_frames: int  #: Key frames of the data set.
    tracks: dict[str, int]  #: Tracks kept per category, the ego included.
    annotations: int  #: Annotations in the tracks kept, the ego's poses not counted.
    dropped: dict[str, int]  #: Tracks left out, by ``"category: reason"``.
    #: Gaps inside tracks, of up to two seconds, that were filled by interpolation.
    filled_gaps: int
    absences: int  #: Longer gaps: the agent is away meanwhile.
    #: Sensor channel of the ego poses; ``None`` where the scene has no ego.
    ego_channel: str | None
    #: How the area where vehicles may drive was had: ``"given"``, from ``"edges"`` or ``"lanes"``;
    #: ``"none"``: nothing is ever off the road.
    road: str
    notes: tuple[str, ...]  #: Anything else worth knowing.


@dataclass(frozen=True)
class CacheReport:
    """What the cache of built scenes did."""

    directory: str | None = None  #: Folder; ``None`` where the cache is off.
    hits: int = 0  #: Scenes taken from the cache.
    built: int = 0  #: Scenes built from files.
    #: Damaged files that were built again, folders that could not be written, or had.
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class LoadReport:
    """Everything a load has to say; ``print`` shows it as a table."""

    dataroot: str = ""  #: Root of the data set, or the file.
    version: str = ""  #: Version of the data set.
    scenes: tuple[SceneReport, ...] = ()  #: One entry per scene, in the order of the scenes.
    missing: tuple[str, ...] = ()  #: Scenes of the split that the data set does not have.
    empty: tuple[str, ...] = ()  #: Scenes that have no agent to show and were left out.
    #: Locations without a map file; their scenes have an empty map.
    missing_maps: tuple[str, ...] = ()
    #: Elements of map files that could not be used, and why; of the files read in this load.
    map_notes: tuple[str, ...] = ()
    cache: CacheReport = CacheReport()  #: What the cache did.
    seconds: float = 0.0  #: How long it took.

    @classmethod
    def from_json(cls, text: str, cache_notes: Iterable[str] = ()) -> LoadReport:
        """Read what the native loader wrote, with more notes of the cache."""
        fields = json.loads(text)
        fields["cache"]["notes"] += cache_notes
        fields["scenes"] = [SceneReport(**_frozen(scene)) for scene in fields["scenes"]]
        fields["cache"] = CacheReport(**_frozen(fields["cache"]))
        return cls(**_frozen(fields))

    def __str__(self) -> str:
        return "\n".join(_lines(self))


def _frozen(fields: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(part) if isinstance(part, list) else part for name, part in fields.items()}


def _some(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return f"{len(names)}: {', '.join(names[:8])}{more}" if names else ""


def _count_names(names: Iterable[str]) -> str:
    return ", ".join(f"{name} in {count} scenes" for name, count in sorted(Counter(names).items()))


def _lines(report: LoadReport) -> list[str]:
    scenes, cache = report.scenes, report.cache
    kept: Counter[str] = Counter()
    dropped: Counter[str] = Counter()
    for scene in scenes:
        kept.update(scene.tracks)
        dropped.update(scene.dropped)
    absences, used = sum(s.absences for s in scenes), f"{cache.hits} hits, {cache.built} built"
    rows = [
        ("data", f"{report.dataroot} {report.version}".strip()),
        ("scenes", f"{len(scenes)} ({sum(s.key_frames for s in scenes)} key frames)"),
        ("  not in the data", _some(report.missing)),
        ("  without agents", _some(report.empty)),
        ("tracks kept", f"{kept.total()} ({sum(s.annotations for s in scenes)} annotations)"),
        *((f"  {category}", str(count)) for category, count in sorted(kept.items())),
        ("tracks dropped", str(dropped.total())),
        *((f"  {which}", str(count)) for which, count in sorted(dropped.items())),
        ("gaps filled", str(sum(s.filled_gaps for s in scenes))),
        ("gaps above 2 s", f"{absences}: away meanwhile" if absences else ""),
        ("ego poses", _count_names(s.ego_channel or "none" for s in scenes)),
        ("road", _count_names(s.road for s in scenes)),
        ("maps missing", _some(report.missing_maps)),
        *(("map", note) for note in report.map_notes),
        *((s.name, note) for s in scenes for note in s.notes),
        ("cache", used if cache.directory else "off"),
        *(("  note", note) for note in cache.notes),
        ("time", f"{report.seconds:.2f} s"),
    ]
    return [f"{name:<32} {text}" for name, text in rows if text]
