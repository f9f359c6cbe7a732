"""Scenes and configurations of worlds, from what environments are given."""

from __future__ import annotations

import hashlib
import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

from ccdiff_env.config import BevConfig, WorldConfig
from ccdiff_env.errors import ConfigError
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.scenes.sources import load
from ccdiff_env.worlds.spaces import Form

#: Scenes by themselves, the text of a source, or the name of a split of the embedded ones.
Scenes: TypeAlias = SceneSet | Sequence[Scene] | Scene | str | None
SceneChoice: TypeAlias = str | int | None  #: A scene by name or by index.


def scene_set(scenes: Scenes) -> SceneSet:
    """Return scenes as a set: texts are those of :func:`ccdiff_env.load`.

    ``"train"`` (``None``), ``"val"`` and ``"all"`` are embedded ones.
    """
    if scenes is None or isinstance(scenes, str):
        return load("train" if scenes is None else scenes)
    if isinstance(scenes, SceneSet):
        found = scenes
    else:
        listed = list(scenes) if isinstance(scenes, Iterable) else [scenes]
        if not all(isinstance(scene, Scene) for scene in listed):
            raise ConfigError(
                "scenes: expected scenes, a SceneSet or the name of a split; "
                'load("embedded", names=[...]) gives scenes by name'
            )
        found = SceneSet(listed)
    if len(found) == 0:
        raise ConfigError("scenes: empty, expected at least one scene")
    return found


def asked_by(scenes: SceneSet) -> dict[str, Any]:
    """Return the options that scenes ask for: their step, and history and horizon of windows."""
    dt_s, window = scenes[0].dt, scenes.window
    if window is None:
        return {"dt_s": dt_s}
    history, horizon = window.steps(dt_s)
    return {"dt_s": dt_s, "history_steps": history, "horizon_steps": horizon}


def world_config(
    scenes: SceneSet,
    config: WorldConfig | None,
    options: Mapping[str, Any],
    observation: Form | None = None,
) -> WorldConfig:
    """Return the configuration of plain keywords over a base, or over what the scenes ask for.

    Rasters are drawn where the form of observation shows them, and refused elsewhere.
    """
    if config is None:
        options = {**asked_by(scenes), **options}
    resolved = (config or WorldConfig()).with_options(**options)
    if observation == "bev" and resolved.observation.bev is None:
        return resolved.with_options(bev=BevConfig())
    if observation not in ("dict", "bev") and resolved.observation.bev is not None:
        raise ConfigError(
            f"observation.bev is {resolved.observation.bev}, expected None: rasters are shown by "
            'environments of one ego with observation="dict" or "bev"'
        )
    return resolved


def exact_seed(seed: Any) -> int:
    """Return a seed as an integer of Python; a :class:`ConfigError` refuses what is none."""
    try:
        return operator.index(seed)
    except TypeError:
        raise ConfigError(f"seed is {seed!r}, expected an integer or None") from None


def normalize_seed(seed: Any) -> int:
    """Fold any integer into 0 .. 2^63 - 1; those within are themselves."""
    number = exact_seed(seed)
    if 0 <= number < 2**63:
        return number
    digest = hashlib.blake2b(str(number).encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") >> 1
