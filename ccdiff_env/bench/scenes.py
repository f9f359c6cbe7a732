"""Which scenes a benchmark plays: a description that fits into a job, and its scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from ccdiff_env.embedded import embedded_scenes
from ccdiff_env.errors import ConfigError
from ccdiff_env.scenes import SceneSet, load_nuscenes

__all__ = ["chunks", "scene_names", "scenes_of", "source_of"]


def source_of(
    *, dataroot: str | None, version: str = "v1.0-trainval", split: str = "ccdiff100"
) -> dict[str, Any]:
    """Return a description of scenes: splits of a nuScenes copy (``"a+b"``), or of the embedded."""
    if dataroot is None:
        return {"embedded": split}
    return {"dataroot": dataroot, "version": version, "split": split}


@lru_cache(maxsize=2)
def _load(description: tuple[tuple[str, str], ...]) -> SceneSet:
    source = dict(description)
    if set(source) == {"embedded"}:
        split = source["embedded"]
        return embedded_scenes(None if split == "all" else split)
    if set(source) != {"dataroot", "version", "split"}:
        raise ConfigError(f"source has {sorted(source)}, expected dataroot, version, split")
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
    """Return names in pieces. Pieces decide which scenes share a batch of the network."""
    return [list(names[i : i + size]) for i in range(0, len(names), size)]
