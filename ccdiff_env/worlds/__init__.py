"""The native worlds with their scenes, schemas and arrays: what every environment class sits on."""

from __future__ import annotations

from ccdiff_env.worlds.configured import (
    SceneChoice,
    Scenes,
    asked_by,
    exact_seed,
    normalize_seed,
    scene_set,
    world_config,
)
from ccdiff_env.worlds.spaces import StepArrays
from ccdiff_env.worlds.worlds import Worlds

__all__ = [
    "SceneChoice", "Scenes", "StepArrays", "Worlds", "asked_by", "exact_seed",
    "normalize_seed", "scene_set", "world_config",
]  # fmt: skip
