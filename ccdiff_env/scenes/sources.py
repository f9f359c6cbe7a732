"""Data sources: where scenes come from, and the texts that name them.

``SOURCE:PATH@VERSION/SPLIT?window_s=S&limit=N``: each source says which of these parts it
has. A source is one record of :data:`SOURCES`; commands, benchmarks, examples and environments take
every one of them.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.errors import ConfigError
from ccdiff_env.scenes import (
    Scene,
    SceneSet,
    expect_limit,
    is_lone_ego,
    load_nuscenes,
    load_scenarionet,
    of_kinds,
    splits,
    warn_of_lone_egos,
    with_tracks,
)
from ccdiff_env.scenes.embedded import embedded_scenes, embedded_splits
from ccdiff_env.scenes.gpudrive import load_gpudrive
from ccdiff_env.scenes.py123d import load_py123d
from ccdiff_env.scenes.windows import Windows, logs_of
from ccdiff_env.system.files import reading

__all__ = [
    "DEFAULT", "SOURCES", "Place", "Source", "coverage", "in_windows", "load", "parse", "settle",
    "split_names", "title",
]  # fmt: skip


@dataclass(frozen=True)
class Place:
    """Scenes of a source. ``str`` gives the text: ``nuscenes:/data@v1.0-mini/mini_val?limit=2``.

    Args:
        source: Name of the source.
        path, version, split: Where its files are, and which of them; several splits are joined,
            ``"train+train_val"``.
        limit: Only so many scenes, the first ones.
        window: How logs are cut into scenes; in the text ``window_s``, ``stride_s``, ``history_s``.
        names, kinds: Only scenes of these names, and only agents of these types. They are not in
            the text. A source may use them to read less: what it leaves is left out afterwards.
    """

    source: str
    path: str | None = None
    version: str | None = None
    split: str | None = None
    limit: int | None = None
    window: Windows | None = None
    names: tuple[str, ...] | None = None
    kinds: tuple[str, ...] | None = None

    def __str__(self) -> str:
        marks = {":": self.path, "@": self.version, "/": self.split}
        text = self.source + "".join(f"{m}{part}" for m, part in marks.items() if part is not None)
        options = {**(vars(self.window) if self.window else {}), "limit": self.limit}
        given = "&".join(
            f"{name}={value:g}" for name, value in options.items() if value is not None
        )
        return f"{text}?{given}" if given else text


@dataclass(frozen=True)
class Source:
    """A data source.

    Args:
        name: What texts call it.
        title: What pages call it.
        load: Loads the scenes of a place, all parts of which are settled.
        path: What its path means, in capitals; ``None`` where it has no path.
        splits: Returns the scene names of every split; ``None`` where it has no splits.
        usual: The splits to ``"train"`` and to ``"test"`` on by default, by version (``""`` where
            the source has no versions). The first version that is there is the default.
        kept_out: Splits whose scenes no network is trained on.
        lacks: What its scenes do not have, in words.
        cuts: Whether it cuts logs into windows itself, and reads no more than these.
    """

    name: str
    title: str
    load: Callable[[Place], SceneSet]
    path: str | None = None
    splits: Callable[[], Mapping[str, Sequence[str]]] | None = None
    usual: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    kept_out: tuple[str, ...] = ()
    lacks: str = ""
    cuts: bool = False

    @property
    def versions(self) -> tuple[str, ...]:
        """Versions that are looked for, the preferred one first; none where it has no versions."""
        return tuple(version for version in self.usual if version)

    @property
    def form(self) -> str:
        """Form of its texts, ``nuscenes:FOLDER[@VERSION][/SPLIT]``."""
        parts = ("" if self.path is None else f":{self.path}", "[@VERSION]" * bool(self.versions))
        return self.name + "".join(parts) + "[/SPLIT]" * (self.splits is not None)


def _nuscenes(place: Place) -> SceneSet:
    split = None if place.names or place.split is None else place.split.split("+")
    version = place.version or "v1.0-trainval"
    return load_nuscenes(place.path or "", version, split, place.names, kinds=place.kinds)


def _embedded(place: Place) -> SceneSet:
    parts = [embedded_scenes(name) for name in (place.split or "all").split("+")]
    return parts[0] if len(parts) == 1 else SceneSet(scene for part in parts for scene in part)


def _scenarionet(place: Place) -> SceneSet:
    return load_scenarionet(place.path or "")


def _gpudrive(place: Place) -> SceneSet:
    limit = None if place.names else place.limit
    return load_gpudrive(place.path or "", limit=limit, names=place.names)


def _py123d(place: Place) -> SceneSet:
    limit = None if place.names else place.limit
    cut = vars(place.window) if place.window else {}
    return load_py123d(place.path or "", **cut, limit=limit, names=place.names)


#: The sources by name.
SOURCES: dict[str, Source] = {
    source.name: source
    for source in (
        Source(
            "embedded",
            "embedded scenes",
            _embedded,
            splits=embedded_splits,
            usual={"": {"train": "train", "test": "val"}},
            kept_out=("val", "city", "val-lights", "city-lights"),
            lacks="recorded traffic: it is simulated",
        ),
        Source(
            "nuscenes",
            "nuScenes",
            _nuscenes,
            path="FOLDER",
            splits=splits,
            usual={
                "v1.0-trainval": {"train": "train+train_val", "test": "ccdiff100"},
                "v1.0-mini": {"train": "mini_train", "test": "mini_val"},
            },
            kept_out=("val", "mini_val"),
            lacks="states of traffic lights, speed limits",
        ),
        Source(
            "scenarionet",
            "ScenarioNet",
            _scenarionet,
            path="FILE_OR_FOLDER",
            lacks="a road where a file has neither road edges nor lanes",
        ),
        Source(
            "gpudrive",
            "Waymo (GPUDrive)",
            _gpudrive,
            path="FILE_OR_FOLDER_OR_PATTERN",
            lacks="surfaces of lanes; the road is made from its edges",
        ),
        Source(
            "py123d",
            "py123d",
            _py123d,
            path="LOG_OR_FOLDER",
            lacks="what py123d leaves out of a data set",
            cuts=True,
        ),
    )
}


_OPTION = r"(?:limit|window_s|stride_s|history_s)=[\w.]+"

DEFAULT = "embedded"  #: The source that is meant where none is named.


def parse(text: str) -> Place:
    """Take a text apart.

    A split of :data:`DEFAULT` may stand alone. The last part of a path is the split where it names
    one. A folder that is called as a split needs its version or split named as well.
    Folders may have an ``@`` in their names.

    Raises:
        ConfigError: If it names no source, no split of it, or a part that the source does not have
            or needs.
    """
    found = re.fullmatch(rf"(\w*)(.*?)(?:\?({_OPTION}(?:&{_OPTION})*))?", text, re.DOTALL)
    name, rest, given = found.groups() if found else (text, "", None)
    pairs = [option.split("=") for option in given.split("&")] if given else []
    options = dict(pairs)
    if len(options) < len(pairs):
        raise _wrong(text, f"an option twice in {given!r}")
    if stray := re.search(r"\?(\w+=[^/?]*)$", rest):
        raise _wrong(text, f"{stray[1]!r}, expected limit, window_s, stride_s, history_s, above 0")
    limit = options.pop("limit", None)
    if limit is not None and not limit.isdecimal():
        raise _wrong(text, f"limit is {limit!r}, expected a whole number")
    if name in (splits := split_names(SOURCES[DEFAULT])) and not rest:
        name, rest = DEFAULT, f"/{name}"
    window = _window(text, options) if options else None
    if name not in SOURCES:
        raise _wrong(text, f"no source {name!r}{_meant(text)}", name, [*SOURCES, *splits])
    path: str | None = None
    version = split = None
    if rest.startswith(":") and SOURCES[name].path is not None:
        if given and _is_there(os.path.expanduser(f"{rest[1:]}?{given}")):
            raise _wrong(text, f"a file or folder is called '?{given}' at its end: rename it")
        path, version, split = _parts(SOURCES[name], os.path.expanduser(rest[1:]))
    elif rest.startswith("/") and SOURCES[name].path is None:
        split = rest[1:]
    elif rest:
        raise _wrong(text, f"{rest!r} after {name!r}")
    number = None if limit is None else int(limit)
    return _checked(Place(name, path, version, split, number, window), text)


def _window(text: str, options: Mapping[str, str | float | None]) -> Windows:
    wanted = "expected window_s in seconds, and stride_s and history_s if need be"
    if options.get("window_s") is None:
        raise _wrong(text, wanted)
    try:
        return Windows(**{k: None if v is None else float(v) for k, v in options.items()})  # type: ignore[arg-type]
    except (TypeError, ValueError, ConfigError) as error:
        raise _wrong(text, f"{error}; {wanted}") from error


def _parts(source: Source, text: str) -> tuple[str, str | None, str | None]:
    """Path, version and split of what follows the colon: the longest path that is there."""
    folder, _, last = text.rpartition("/")
    has_split = bool(folder) and all(part in split_names(source) for part in last.split("+"))
    marks = [i for i, letter in enumerate(text) if letter == "@" and text.count("/", i) <= 1]
    if source.versions and marks and not _is_there(folder if has_split else text):
        at = max(marks, key=lambda i: (_is_there(text[:i]), i))
        version, _, split = text[at + 1 :].partition("/")
        return text[:at], version, split or None
    return (folder, None, last) if has_split else (text, None, None)


def split_names(source: Source) -> list[str]:
    """Return the names of a source's splits, ``"all"`` among them; none where it has no splits."""
    return [] if source.splits is None else [*source.splits(), "all"]


def _checked(place: Place, text: str) -> Place:
    """Refuse a place that no scenes can be found by."""
    source, there = SOURCES[place.source], place.path is None or _is_there(place.path)
    try:
        expect_limit(place.limit)
    except ConfigError as error:
        raise _wrong(text, str(error)) from None
    if source.path is not None and not place.path:
        raise _wrong(text, "no path")
    if place.split is not None and source.splits is None:
        raise _wrong(text, f"{source.name} has no splits")
    known = split_names(source)
    if place.split is not None:
        for part in place.split.split("+"):
            if part not in known:
                expected = f"no split {part!r}, expected one of {', '.join(known)}"
                raise _wrong(text, expected, part, known)
    elif known and not there:
        last = Path(place.path or "").name
        if _near(last, known):
            raise _wrong(text, f"neither a folder nor a split {last!r}", last, known)
    return place


def _is_there(path: str) -> bool:
    with reading("scenes", path):
        return Path(path).exists()


def _near(name: str, known: Iterable[str]) -> list[str]:
    return difflib.get_close_matches(name, list(known), n=2, cutoff=0.6)


def _meant(text: str) -> str:
    """What a text that names no source may be: a folder, or a scene."""
    if text[:1] in ("/", ".", "~") or os.path.exists(text):
        return f"; a folder or file needs one before it, as in nuscenes:{text}"
    known = [name for names in embedded_splits().values() for name in names]
    for name in difflib.get_close_matches(text, known, n=1, cutoff=0.8):
        return (
            f'; one embedded scene is load("embedded", names=[{name!r}]), '
            f'or reset(options={{"scene": {name!r}}})'
        )
    return ""


def _wrong(text: str, what: str, name: str = "", known: Iterable[str] = ()) -> ConfigError:
    near = " or ".join(map(repr, _near(name, known)))
    hint = f" (did you mean {near}?)" if near else ""
    forms = ", ".join(source.form for source in SOURCES.values())
    return ConfigError(f"scenes {text!r}: {what}{hint}; sources are {forms}")


def settle(place: Place, use: str | None = None) -> Place:
    """Return a place whose version and split are named.

    Args:
        place: The place.
        use: ``"train"`` or ``"test"``: which split of the source is meant where none is named; all
            scenes for ``None``.
    """
    source, version, split = SOURCES[place.source], place.version, place.split
    if version is None and source.versions:
        there = [v for v in source.versions if (Path(place.path or "") / v).is_dir()]
        version = (there or list(source.versions))[0]
    if split is None and source.splits is not None:
        split = source.usual.get(version or "", {}).get(use or "", "all")
    return _checked(replace(place, version=version, split=split), str(place))


def load(
    scenes: str | Place,
    limit: int | None = None,
    *,
    names: Sequence[str] | None = None,
    kinds: Sequence[str] | None = None,
    window_s: float | None = None,
    stride_s: float | None = None,
    history_s: float | None = None,
) -> SceneSet:
    """Load scenes of any source.

    Args:
        scenes: ``"embedded/val"``, ``"nuscenes:/data/nuscenes@v1.0-mini/mini_val"``,
            ``"scenarionet:/data/files"``. Without a version the first that is there is taken,
            without a split all scenes. ``?limit=N`` may follow, and ``window_s=S`` and so on,
            joined by ``&``.
        limit: Only so many scenes, the first ones.
        window_s, stride_s, history_s: Cut logs into scenes for episodes of ``window_s`` seconds,
            one every ``stride_s`` (``window_s`` by default), ``history_s`` (3) before each.
        names: Only scenes of these names, in this order.
        kinds: Only agents of these types (``vehicle``, ``pedestrian``, ...), and the ego.

    Returns:
        SceneSet: The scenes and the report of their load. A split with missing scenes warns.

    Raises:
        ConfigError: If the text names no source, or a part that the source does not have.
        UnknownNameError: If there is no scene of a name.
        DatasetError: If files are missing or damaged.

    Examples:
        >>> import ccdiff_env
        >>> len(ccdiff_env.load("embedded/val", limit=3))
        3
    """
    place = parse(scenes) if isinstance(scenes, str) else scenes
    if limit is not None:
        place = _checked(replace(place, limit=limit), str(place))
    asked = {"window_s": window_s, "stride_s": stride_s, "history_s": history_s}
    if any(value is not None for value in asked.values()):
        place = replace(place, window=_window(str(place), asked))
    names, kinds = ([one] if isinstance(one, str) else one for one in (names, kinds))
    place = replace(
        settle(place),
        names=None if names is None else tuple(names),
        kinds=None if kinds is None else tuple(kinds),
    )
    source, whole = SOURCES[place.source], place
    if place.window is not None and not source.cuts:
        logs = place.names and logs_of(place.names)
        whole = replace(place, window=None, limit=None, names=logs)
    found = loaded = source.load(whole)
    if whole is not place and place.window is not None:
        found = in_windows(found, place.window)
    if place.names is not None:
        found = found.having([found[name] for name in place.names])
    if place.limit is not None:
        found = found[: place.limit]
    if kinds is not None:
        found = of_kinds(found, kinds)
    if sum(map(is_lone_ego, found)) > sum(map(is_lone_ego, loaded)):  # of which nobody has warned
        warn_of_lone_egos(found)
    return found


def in_windows(scenes: SceneSet, window: Windows) -> SceneSet:
    """Return the windows of all scenes, in order, with the agents that are there in each; a
    :class:`ConfigError` names the longest scene if none is long enough.
    """
    found = [
        _slice(scene, name, *part)
        for scene in scenes
        for name, part in window.cut(scene.name, scene.num_steps, scene.dt).items()
    ]
    if not found and len(scenes):
        longest = max(scenes, key=lambda scene: scene.num_steps)
        raise ConfigError(
            f"no scene has the {sum(window.steps(longest.dt)) + 1} steps of a window: "
            f"{longest.name!r} has {longest.num_steps}; see window_s and history_s"
        )
    return scenes.having(found, window)


def _slice(scene: Scene, name: str, first: int, end: int) -> Scene:
    if (first, end) == (0, scene.num_steps):
        return scene
    whole: dict[str, Any] = {**scene.tracks()}
    tracks = {field: values[:, first:end] for field, values in whole.items()}
    return with_tracks(
        scene, tracks, np.flatnonzero(tracks["valid"].any(axis=1)), name=name, first=first
    )


def coverage(place: Place, names: Collection[str]) -> str:
    """Say how many of the scenes of a split there are, ``93 of 150 scenes of val``."""
    splits, count = SOURCES[place.source].splits, len(names)
    if place.window is not None:
        logs = len(logs_of(names))
        return f"{count} window{'s' * (count != 1)} of {logs} log{'s' * (logs != 1)}"
    if splits is None or place.split in (None, "all"):
        return f"{count} scene{'s' * (count != 1)}"
    lists = splits()
    whole = {name for part in place.split.split("+") for name in lists[part]}
    return f"{count} of {len(whole)} scenes of {place.split}"


def title(place: Place, counted: str | None = None) -> str:
    """Return a place in words; ``counted`` is its :func:`coverage`, where that is known."""
    source = SOURCES[place.source]
    name = place.version or (place.path and Path(place.path).name) or ""
    parts = [f"{source.title} {name}".strip(), counted or place.split or ""]
    parts += [] if place.limit is None else [f"the first {place.limit}"]
    return ", ".join(part for part in parts if part)
