"""Waymo scenes in GPUDrive's JSON: files found, read in parallel when they are looked at."""

from __future__ import annotations

import glob
import os
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import overload

from ccdiff_env import _native
from ccdiff_env._native import Scene
from ccdiff_env.errors import ConfigError, DatasetNotFoundError
from ccdiff_env.scenes import SceneSet, cache_folder
from ccdiff_env.scenes.load_report import LoadReport
from ccdiff_env.system.progress import shown

__all__ = ["SceneFiles", "load_gpudrive", "scene_files"]

_AT_ONCE, _KEPT = 16, 64  #: Scenes that are read at once, and scenes that are kept.


def scene_files(path: str | os.PathLike[str]) -> list[str]:
    """Return the files of a file, a folder (searched for ``.json``) or a pattern, in order.

    Raises:
        DatasetNotFoundError: There is none.
        ConfigError: Two of them have one name, which is the scene's.
    """
    text, folder = os.fspath(path), Path(path)
    if folder.is_file():
        found = [text]
    elif folder.is_dir():
        found = sorted(os.fspath(file) for file in folder.rglob("*.json"))
    else:
        found = sorted(glob.glob(text, recursive=True))
    if not found:
        raise DatasetNotFoundError(f"no scenes of GPUDrive at {text}: expected .json files")
    names: dict[str, str] = {}
    for file in found:
        other = names.setdefault(Path(file).stem, file)
        if other is not file:
            raise ConfigError(f"two scenes of one name: {other} and {file}")
    return found


class SceneFiles(Sequence[Scene]):
    """Scenes of files, read when they are looked at; the last 64 are kept.

    Args:
        files: One file a scene, whose stem is the scene's name.
        cache_directory: Folder of built scenes; ``None`` for none.
    """

    def __init__(self, files: Sequence[str], cache_directory: str | None) -> None:
        self.files = tuple(files)
        self._cache_directory = cache_directory
        self._kept: OrderedDict[int, Scene] = OrderedDict()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the scenes, in order."""
        return tuple(Path(file).stem for file in self.files)

    def report(self) -> LoadReport:
        """Read all scenes; return the report of the load."""
        _, report = self._read(range(len(self.files)))
        return LoadReport.from_json(report)

    def _read(self, indices: Sequence[int]) -> tuple[list[Scene], str]:
        files = [self.files[i] for i in indices]
        return _native.load_gpudrive(files, cache_directory=self._cache_directory)

    def __len__(self) -> int:
        return len(self.files)

    @overload
    def __getitem__(self, key: int) -> Scene: ...
    @overload
    def __getitem__(self, key: slice) -> SceneFiles: ...
    def __getitem__(self, key: int | slice) -> Scene | SceneFiles:
        """Return a scene, or a part of the files."""
        if isinstance(key, slice):
            return SceneFiles(self.files[key], self._cache_directory)
        return self._at([range(len(self.files))[key]])[0]

    def _at(self, indices: Sequence[int]) -> list[Scene]:
        """Scenes of some files, fewer than are kept; those that are not there are read."""
        missing = [i for i in indices if i not in self._kept]
        if missing:
            self._kept.update(zip(missing, self._read(missing)[0], strict=True))
        for index in indices:
            self._kept.move_to_end(index)
        while len(self._kept) > _KEPT:
            self._kept.popitem(last=False)
        return [self._kept[i] for i in indices]

    def __iter__(self) -> Iterator[Scene]:
        parts = range(0, len(self.files), _AT_ONCE)
        for start in shown(parts, what="scenes") if len(parts) > 1 else parts:
            yield from self._at(range(start, min(start + _AT_ONCE, len(self.files))))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SceneFiles) and self.files == other.files

    def __hash__(self) -> int:
        return hash(self.files)

    def __reduce__(self) -> tuple[type[SceneFiles], tuple[tuple[str, ...], str | None]]:
        return SceneFiles, (self.files, self._cache_directory)


def load_gpudrive(
    path: str | os.PathLike[str], *, cache: bool | str | os.PathLike[str] = True
) -> SceneSet:
    """Load Waymo scenes in GPUDrive's JSON: 9.1 s at 10 Hz, the present at step 10.

    Scenes are read in parallel when they are looked at, so that folders of many are no burden.
    The area where vehicles may drive is made from road edges, which have the road on their left.
    Lanes follow where one ends and another begins.

    Args:
        path: A ``.json`` file, a folder that is searched for them, or a pattern
            (``"data/*_1?.json"``). A file's stem is its scene's name, the scenario's id the token.
        cache: As in :func:`ccdiff_env.load_nuscenes`.

    Returns:
        SceneSet: The scenes in the order of the files; the track of ``sdc_track_index`` is
            ``"ego"`` and comes first. ``.report`` reads them all.

    Raises:
        DatasetNotFoundError: No such file.
        DatasetError: A file is damaged or breaks a rule, found when its scene is read; the message
            names file, place, field and value.
        ConfigError: Two files have one name.
    """
    files = SceneFiles(scene_files(path), cache_folder(cache))
    return SceneSet(files, files.report, names=files.names)
