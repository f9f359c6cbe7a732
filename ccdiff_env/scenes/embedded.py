"""Embedded scenes: a small procedural city and its traffic, shipped as a data set in the nuScenes
schema. A second set, the split ``city``, has 200 other scenes of the same streets: planners are
compared on it. With ``-lights`` behind its name a split has traffic lights at crossings.
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
from ccdiff_env.scenes.signals import with_signals
from ccdiff_env.system.files import write_aside

__all__ = ["CITY", "SHIPPED", "VERSION", "embedded_scenes", "embedded_splits", "shipped", "unpack"]

VERSION = "v1.0-embedded"
SHIPPED = "data/embedded.zip"  #: The zipped data set, in the package.
CITY = "data/city.zip"  #: The set that planners are compared on, zipped.
LIGHTS = "-lights"  #: Ends the names of splits with traffic lights.


@cache
def embedded_splits() -> dict[str, tuple[str, ...]]:
    """Return the names of the embedded scenes by split; ``city-lights`` has those of ``city``, and
    so on.
    """
    files = [shipped(file, "splits.json")["splits.json"] for file in (SHIPPED, CITY)]
    found = {name: tuple(names) for text in files for name, names in json.loads(text).items()}
    return found | {f"{name}{LIGHTS}": names for name, names in found.items()}


@cache
def embedded_scenes(split: str | None = None) -> SceneSet:
    """Return the scenes that come with the package; no files or downloads needed.

    They are loaded like any other nuScenes data set, once a process for each split.

    Args:
        split: ``"train"``, ``"val"``, ``"city"``, one of them with lights (``"city-lights"``), or
            ``"all"`` of train and val (``None``).

    Returns:
        SceneSet: The scenes, named by kind (``left-turn-00``), and ``.report``.

    Raises:
        UnknownNameError: If there is no such split.
    """
    if split == "all":
        return embedded_scenes()
    splits = embedded_splits()
    if split is not None and split not in splits:
        near = "; did you mean 'embedded'?" if split.startswith("embed") else ""
        raise UnknownNameError(
            f"unknown split {split!r}, expected one of all, {', '.join(splits)}{near}"
        )
    if split is not None and split.endswith(LIGHTS):
        bare = embedded_scenes(split.removesuffix(LIGHTS))
        return SceneSet(map(with_signals, bare), bare.report)
    names = splits["train"] + splits["val"] if split is None else splits[split]
    with TemporaryDirectory(prefix="ccdiff-env-") as folder:
        unpack(Path(folder), CITY if split == "city" else SHIPPED)
        return load_nuscenes(folder, VERSION, scenes=names, interpolation="linear", cache=False)


def shipped(file: str = SHIPPED, member: str | None = None) -> dict[str, bytes]:
    """Return the members of a shipped data set by path, or one of them.

    Raises:
        DatasetError: If the package lacks the file or it is damaged.
    """
    try:
        with as_file(files("ccdiff_env") / file) as path, zipfile.ZipFile(path) as archive:
            members = archive.namelist() if member is None else [member]
            return {name: archive.read(name) for name in members}
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise DatasetError(f"the package's {file} cannot be read: {error}") from error


def unpack(folder: Path, file: str = SHIPPED) -> None:
    """Write a shipped data set below a folder."""
    for name, data in shipped(file).items():
        write_aside(folder / name, data)
