"""The report of a load: what was kept, what was left out and why."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, dataclass, is_dataclass
from functools import cache
from typing import Any, get_args, get_origin, get_type_hints


@dataclass(frozen=True)
class Dropped:
    """Tracks that were left out for one reason."""

    reason: str  #: Why.
    category: str  #: Category of the data set.
    tracks: int  #: Number of tracks.
    annotations: int  #: Number of annotations in them.


@dataclass(frozen=True)
class SceneReport:
    """What became of one scene."""

    name: str  #: Name of the scene.
    key_frames: int  #: Key frames of the data set.
    tracks: dict[str, int]  #: Tracks kept per category, the ego included.
    annotations: int  #: Annotations in the tracks kept, the ego's poses not counted.
    dropped: tuple[Dropped, ...]  #: Tracks left out.
    #: Gaps inside tracks, of up to two seconds, that were filled by interpolation.
    filled_gaps: int
    filled_key_frames: int  #: Key frames in those gaps; steps where the data set has no key frames.
    absences: int  #: Longer gaps: the agent is away meanwhile.
    #: Sensor channel of the ego poses; ``None`` where the scene has no ego.
    ego_channel: str | None
    #: How the area where vehicles may drive was had: ``"given"``, from ``"edges"`` or ``"lanes"``;
    #: ``"none"``: nothing is ever off the road.
    road: str
    map_layers: dict[str, int]  #: Elements per map layer round the scene.
    notes: tuple[str, ...]  #: Anything else worth knowing.


@dataclass(frozen=True)
class MapReport:
    """What one location's map file holds."""

    location: str  #: Location.
    notes: tuple[str, ...]  #: Elements that could not be used, and why.


@dataclass(frozen=True)
class CacheReport:
    """What the cache of built scenes did."""

    directory: str | None  #: Folder; ``None`` where the cache is off.
    hits: int  #: Scenes taken from the cache.
    built: int  #: Scenes built from files.
    #: Damaged files that were built again, folders that could not be written.
    notes: tuple[str, ...]


@dataclass(frozen=True)
class LoadReport:
    """Everything a load has to say; ``print`` shows it as a table."""

    dataroot: str  #: Root of the data set, or the file.
    version: str  #: Version of the data set.
    scenes: tuple[SceneReport, ...]  #: One entry per scene, in the order of the scenes.
    missing: tuple[str, ...]  #: Scenes of the split that the data set does not have.
    empty: tuple[str, ...]  #: Scenes that have no agent to show and were left out.
    missing_maps: tuple[str, ...]  #: Locations without a map file; their scenes have an empty map.
    #: Map files that were read; none where all scenes came from the cache.
    maps: tuple[MapReport, ...]
    cache: CacheReport  #: What the cache did.
    seconds: float  #: How long it took.

    @classmethod
    def blank(cls) -> LoadReport:
        """Return a report of nothing."""
        return cls("", "", (), (), (), (), (), CacheReport(None, 0, 0, ()), 0.0)

    @classmethod
    def from_json(cls, text: str) -> LoadReport:
        """Read what the native loader wrote."""
        report: LoadReport = _made(cls, json.loads(text))
        return report

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain containers, ready for JSON."""
        return asdict(self)

    @property
    def num_tracks(self) -> int:
        """Tracks kept in all scenes, egos included."""
        return sum(sum(scene.tracks.values()) for scene in self.scenes)

    @property
    def num_annotations(self) -> int:
        """Annotations in the tracks kept."""
        return sum(scene.annotations for scene in self.scenes)

    @property
    def tracks(self) -> dict[str, int]:
        """Tracks kept per category, over all scenes."""
        counts: Counter[str] = Counter()
        for scene in self.scenes:
            counts.update(scene.tracks)
        return dict(sorted(counts.items()))

    @property
    def dropped(self) -> tuple[Dropped, ...]:
        """Tracks left out per reason and category, over all scenes."""
        tracks: Counter[tuple[str, str]] = Counter()
        annotations: Counter[tuple[str, str]] = Counter()
        for scene in self.scenes:
            for entry in scene.dropped:
                tracks[entry.reason, entry.category] += entry.tracks
                annotations[entry.reason, entry.category] += entry.annotations
        return tuple(Dropped(*key, tracks[key], annotations[key]) for key in sorted(tracks))

    @property
    def missing_layers(self) -> dict[str, int]:
        """Number of scenes in which a map layer is empty, for each layer where there are such."""
        counts = Counter(k for s in self.scenes for k, count in s.map_layers.items() if count == 0)
        return dict(sorted(counts.items()))

    def __str__(self) -> str:
        return "\n".join(_lines(self))


_hints = cache(get_type_hints)


def _made(kind: Any, value: Any) -> Any:
    """A value of JSON as a record, a tuple, or as it is."""
    if is_dataclass(kind):
        hints = _hints(kind)  # type: ignore[arg-type]
        return kind(**{name: _made(hints[name], part) for name, part in value.items()})  # type: ignore[operator]
    if get_origin(kind) is tuple:
        return tuple(_made(get_args(kind)[0], part) for part in value)
    return value


def _some(names: tuple[str, ...]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _lines(report: LoadReport) -> list[str]:
    scenes = report.scenes
    dropped = report.dropped
    rows = [
        ("data", f"{report.dataroot} {report.version}".strip()),
        ("scenes", f"{len(scenes)} ({sum(s.key_frames for s in scenes)} key frames)"),
    ]
    if report.missing:
        rows.append(("  not in the data", f"{len(report.missing)}: {_some(report.missing)}"))
    if report.empty:
        rows.append(("  without agents", f"{len(report.empty)}: {_some(report.empty)}"))
    rows.append(("tracks kept", f"{report.num_tracks} ({report.num_annotations} annotations)"))
    rows += [(f"  {category}", str(count)) for category, count in report.tracks.items()]
    total = sum(d.tracks for d in dropped)
    rows.append(("tracks dropped", f"{total} ({sum(d.annotations for d in dropped)} annotations)"))
    rows += [(f"  {d.category}", f"{d.tracks}: {d.reason}") for d in dropped]
    gaps, frames = sum(s.filled_gaps for s in scenes), sum(s.filled_key_frames for s in scenes)
    rows.append(("gaps filled", f"{gaps} ({frames} key frames)"))
    if absences := sum(s.absences for s in scenes):
        rows.append(("gaps above 2 s", f"{absences}: away meanwhile"))
    channels = Counter(s.ego_channel or "none" for s in scenes)
    rows.append(("ego poses", ", ".join(f"{name} in {n} scenes" for name, n in channels.items())))
    roads = Counter(s.road for s in scenes)
    rows.append(("road", ", ".join(f"{name} in {n} scenes" for name, n in sorted(roads.items()))))
    if report.missing_maps:
        rows.append(("maps missing", _some(report.missing_maps)))
    rows += [("layer empty", f"{name} in {n} scenes") for name, n in report.missing_layers.items()]
    rows += [(f"map {m.location}", note) for m in report.maps for note in m.notes]
    rows += [(s.name, note) for s in scenes for note in s.notes]
    cache = report.cache
    used = f"{cache.hits} from the cache, {cache.built} built"
    rows.append(("cache", used if cache.directory else "off"))
    rows += [("  note", note) for note in cache.notes]
    rows.append(("time", f"{report.seconds:.2f} s"))
    return [f"{name:<32} {text}" for name, text in rows]
