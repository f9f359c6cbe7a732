"""Waymo scenes in GPUDrive's JSON: files found, and read in parallel."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from ccdiff_env import _native
from ccdiff_env.errors import ConfigError, DatasetNotFoundError, UnknownNameError, hint_of
from ccdiff_env.scenes import SceneSet, cache_folder, expect_limit, warn_of_lone_egos
from ccdiff_env.scenes.load_report import LoadReport

__all__ = ["load_gpudrive", "scene_files"]


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
        # what is there is no pattern, whatever letters it has
        there = os.path.dirname(text)
        while there and not os.path.isdir(there):
            there = os.path.dirname(there)
        found = sorted(glob.glob(glob.escape(there) + text[len(there) :], recursive=True))
    if not found:
        raise DatasetNotFoundError(f"no scenes of GPUDrive at {text}: expected .json files")
    names: dict[str, str] = {}
    for file in found:
        other = names.setdefault(Path(file).stem, file)
        if other is not file:
            raise ConfigError(f"two scenes have the same name: {other} and {file}")
    return found


def load_gpudrive(
    path: str | os.PathLike[str],
    *,
    limit: int | None = None,
    names: Sequence[str] | None = None,
    cache: bool | str | os.PathLike[str] = True,
) -> SceneSet:
    """Load Waymo scenes in GPUDrive's JSON: 9.1 s at 10 Hz, the present at step 10.

    Files are read in parallel. The area where vehicles may drive is made from road edges, which
    have the road on their left. Lanes follow where one ends and another begins.

    Args:
        path: A ``.json`` file, a folder that is searched for them, or a pattern
            (``"data/*_1?.json"``). A file's stem is its scene's name, the scenario's id the token.
        limit: Only so many files, the first ones.
        names: Only scenes of these names, in this order.
        cache: As in :func:`ccdiff_env.load_nuscenes`.

    Returns:
        SceneSet: The scenes in the order of the files; the track of ``sdc_track_index`` is
            ``"ego"`` and comes first.

    Raises:
        DatasetNotFoundError: No such file.
        DatasetError: A file is damaged or breaks a rule; the message names file, place, field and
            value.
        ConfigError: Two files have one name.
        UnknownNameError: No file has a name of ``names``.
    """
    expect_limit(limit)
    files = scene_files(path)
    if names is not None:
        known = {Path(file).stem: file for file in files}
        if unknown := [name for name in names if name not in known]:
            hint = hint_of(unknown[0], known)
            raise UnknownNameError(f"no scene {unknown[0]!r} among files {path}: {hint}")
        files = [known[name] for name in names]
    folder, notes = cache_folder(cache)
    loaded, report = _native.load_gpudrive(files[:limit], cache_directory=folder)
    scenes = SceneSet(loaded, partial(LoadReport.from_json, report, notes))
    warn_of_lone_egos(scenes)
    return scenes
