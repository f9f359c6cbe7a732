"""Which scenes a benchmark plays: a description that fits into a job, and its scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from ccdiff_env.embedded import embedded_scenes
from ccdiff_env.errors import ConfigError
from ccdiff_env.scenes import SceneSet, load_nuscenes

__all__ = ["chunks", "scene_names", "scenes_of", "source_of", "source_title"]


def source_of(
    *,
    dataroot: str | None,
    version: str = "v1.0-trainval",
    split: str = "ccdiff100",
    limit: int | None = None,
) -> dict[str, Any]:
    """Return a description of scenes: splits of a nuScenes copy (``"a+b"``), or of the embedded.

    Parameters
    ----------
    dataroot, version
        Folder of nuScenes, ``None`` for the embedded scenes, and of its tables.
    split
        Name of the split.
    limit
        Only so many of its scenes, the first ones.
    """
    if limit is not None and limit < 1:
        raise ConfigError(f"limit is {limit}, expected at least 1")
    few = {} if limit is None else {"limit": str(limit)}
    if dataroot is None:
        return {"embedded": split, **few}
    return {"dataroot": dataroot, "version": version, "split": split, **few}


def source_title(source: Mapping[str, str]) -> str:
    """Return a description of scenes in words.

    Raises
    ------
    ConfigError
        If it is not what :func:`source_of` returns.
    """
    _check(source)
    few = f", the first {source['limit']}" if "limit" in source else ""
    if "embedded" in source:
        return f"embedded scenes, {source['embedded']}{few}"
    return f"nuScenes {source['version']}, {source['split']}{few}"


def _check(source: Mapping[str, str]) -> None:
    """Refuse descriptions, of a file perhaps, that no scenes can be found by."""
    kinds = ({"embedded"}, {"dataroot", "version", "split"})
    named = isinstance(source, Mapping) and all(isinstance(value, str) for value in source.values())
    if (
        not named
        or set(source) - {"limit"} not in kinds
        or not source.get("limit", "1").isdecimal()
    ):
        raise ConfigError(
            f"source is {source!r}, expected embedded, or dataroot, version and split"
        )


@lru_cache(maxsize=2)
def _load(description: tuple[tuple[str, str], ...]) -> SceneSet:
    source = dict(description)
    _check(source)
    limit = source.pop("limit", None)
    if limit is not None:
        return SceneSet(_load(tuple(sorted(source.items())))[: int(limit)])
    if set(source) == {"embedded"}:
        return embedded_scenes(source["embedded"])
    return load_nuscenes(source["dataroot"], source["version"], source["split"].split("+"))


def scenes_of(source: Mapping[str, str], names: Sequence[str] | None = None) -> SceneSet:
    """Return the scenes of a description, all or some by name; a process loads them once."""
    scenes = _load(tuple(sorted(source.items())))
    if names is None:
        return scenes
    by_name = {scene.name: scene for scene in scenes}
    return SceneSet([by_name[name] for name in names])


def scene_names(source: Mapping[str, str]) -> list[str]:
    """Return the names of the scenes of a description."""
    return [scene.name for scene in scenes_of(source)]


def chunks(names: Sequence[str], size: int) -> list[list[str]]:
    """Return names in chunks. Chunks decide which scenes share a batch of the network."""
    return [list(names[i : i + size]) for i in range(0, len(names), size)]
