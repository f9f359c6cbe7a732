"""What a data source is, and a place in it: the records behind :mod:`ccdiff_env.scenes.sources`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from ccdiff_env.scenes import SceneSet


@dataclass(frozen=True)
class Place:
    """Scenes of a source. ``str`` gives the text: ``nuscenes:/data@v1.0-mini/mini_val?limit=2``.

    Args:
        source: Name of the source.
        path, version, split: Where its files are, and which of them; several splits are joined,
            ``"train+train_val"``.
        limit: Only so many scenes, the first ones.
        ego_reference: Which point of a recording car its poses are of, where the source asks for
            it.
        names, kinds: Only scenes of these names, and only agents of these types. They are not in
            the text. A source may use them to read less: what it leaves is left out afterwards.
    """

    source: str
    path: str | None = None
    version: str | None = None
    split: str | None = None
    limit: int | None = None
    ego_reference: str | None = None
    names: tuple[str, ...] | None = None
    kinds: tuple[str, ...] | None = None

    def __str__(self) -> str:
        marks = {":": self.path, "@": self.version, "/": self.split}
        text = self.source + "".join(f"{m}{part}" for m, part in marks.items() if part is not None)
        options = {"ego_reference": self.ego_reference, "limit": self.limit}
        given = "&".join(f"{name}={part}" for name, part in options.items() if part is not None)
        return text + f"?{given}" * bool(given)


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
        ego_references: What ``ego_reference`` may be; nothing where poses are centres anyway.
        kept_out: Splits whose scenes no network is trained on.
        lacks: What its scenes do not have, in words.
    """

    name: str
    title: str
    load: Callable[[Place], SceneSet]
    path: str | None = None
    splits: Callable[[], Mapping[str, Sequence[str]]] | None = None
    usual: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    ego_references: tuple[str, ...] = ()
    kept_out: tuple[str, ...] = ()
    lacks: str = ""

    @property
    def versions(self) -> tuple[str, ...]:
        """Versions that are looked for, the preferred one first; none where it has no versions."""
        return tuple(version for version in self.usual if version)

    @property
    def form(self) -> str:
        """Form of its texts, ``nuscenes:FOLDER[@VERSION][/SPLIT]``."""
        parts = ("" if self.path is None else f":{self.path}", "[@VERSION]" * bool(self.versions))
        return self.name + "".join(parts) + "[/SPLIT]" * (self.splits is not None)
