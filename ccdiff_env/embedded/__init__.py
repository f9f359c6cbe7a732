"""Embedded scenes: a small procedural city and its traffic, shipped as a data set in the nuScenes
schema.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from ccdiff_env.embedded.dataset import shipped, unpack
from ccdiff_env.embedded.tables import VERSION
from ccdiff_env.errors import UnknownNameError
from ccdiff_env.scenes import SceneSet, load_nuscenes

__all__ = ["embedded_scenes", "embedded_splits"]


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
        ``"train"``, ``"val"``, or None for all.

    Returns
    -------
    SceneSet
        The scenes, named by kind (``left-turn-00``), and ``.report``.

    Raises
    ------
    UnknownNameError
        If there is no such split.
    """
    splits = embedded_splits()
    if split is not None and split not in splits:
        raise UnknownNameError(f"unknown split {split!r}, expected one of {', '.join(splits)}")
    names = splits[split] if split is not None else tuple(n for s in splits.values() for n in s)
    with TemporaryDirectory(prefix="ccdiff-env-") as folder:
        unpack(Path(folder))
        return load_nuscenes(folder, VERSION, scenes=names, cache=False)
