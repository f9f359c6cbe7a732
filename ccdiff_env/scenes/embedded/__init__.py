"""Embedded scenes: a small procedural city and its traffic, shipped as a data set in the nuScenes
schema. ``python -m ccdiff_env.scenes.embedded --out DIR`` writes it as files.

``tools/embedded_city`` of the repository generates it.
"""

from __future__ import annotations

import json
import zipfile
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from tempfile import TemporaryDirectory

from ccdiff_env.errors import DatasetError, UnknownNameError
from ccdiff_env.scenes import SceneSet, load_nuscenes
from ccdiff_env.system.files import write_aside

__all__ = ["SHIPPED", "VERSION", "embedded_scenes", "embedded_splits", "shipped", "unpack"]

VERSION = "v1.0-embedded"
#: The zipped data set, in the package.
SHIPPED = "data/embedded.zip"


@cache
def embedded_splits() -> dict[str, tuple[str, ...]]:
    """Return the names of the embedded scenes by split, ``train`` and ``val``."""
    return {name: tuple(names) for name, names in json.loads(shipped()["splits.json"]).items()}


@cache
def embedded_scenes(split: str | None = None) -> SceneSet:
    """Return the scenes that come with the package; no files or downloads needed.

    They are loaded like any other nuScenes data set, once a process for each split.

    Parameters
    ----------
    split
        ``"train"``, ``"val"``, or ``"all"`` (``None``).

    Returns
    -------
    SceneSet
        The scenes, named by kind (``left-turn-00``), and ``.report``.

    Raises
    ------
    UnknownNameError
        If there is no such split.
    """
    if split == "all":
        return embedded_scenes()
    splits = embedded_splits()
    if split is not None and split not in splits:
        raise UnknownNameError(f"unknown split {split!r}, expected one of all, {', '.join(splits)}")
    names = splits[split] if split is not None else tuple(n for s in splits.values() for n in s)
    with TemporaryDirectory(prefix="ccdiff-env-") as folder:
        unpack(Path(folder))
        return load_nuscenes(folder, VERSION, scenes=names, interpolation="linear", cache=False)


def shipped() -> dict[str, bytes]:
    """Return the members of the shipped data set by path.

    Raises
    ------
    DatasetError
        If the package lacks the file or it is damaged.
    """
    try:
        with as_file(files("ccdiff_env") / SHIPPED) as path, zipfile.ZipFile(path) as archive:
            return {name: archive.read(name) for name in archive.namelist()}
    except (OSError, zipfile.BadZipFile) as error:
        raise DatasetError(f"the package's {SHIPPED} cannot be read: {error}") from error


def unpack(folder: Path) -> None:
    """Write the shipped data set below a folder."""
    for name, data in shipped().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_aside(path, data)
