"""Which scenes a benchmark plays: a text that fits into a job, and its scenes."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import lru_cache
from multiprocessing import parent_process
from typing import TypeVar

from ccdiff_env.errors import ConfigError
from ccdiff_env.scenes import SceneSet
from ccdiff_env.scenes.sources import Place, load, parse, title

T = TypeVar("T")


def place_of(source: object) -> Place:
    """Return the place that a text names, of a file perhaps.

    Raises:
        ConfigError: If it is no text of a source; run folders of older releases hold another form.
    """
    if not isinstance(source, str):
        raise ConfigError(
            f"source is {source!r}, expected a text such as 'embedded/val': folders of an older "
            "release are not read"
        )
    return parse(source)


def source_title(source: object, coverage: str | None = None) -> str:
    """Return the scenes of a text in words, with their coverage where it is known."""
    return title(place_of(source), coverage)


@lru_cache(maxsize=2)
def _load(place: Place) -> SceneSet:
    with warnings.catch_warnings():
        if parent_process() is not None:  # it has warned
            warnings.simplefilter("ignore")
        return load(place)


def scenes_of(source: str, names: Sequence[str] | None = None) -> SceneSet:
    """Return the scenes of a text, all or some by name; a process loads them once."""
    scenes = _load(place_of(source))
    return scenes if names is None else scenes.having(scenes[name] for name in names)


def chunks(scenes: Sequence[T], size: int) -> list[list[T]]:
    """Return names or rows of scenes in chunks, which share a batch of the network."""
    return [list(scenes[i : i + size]) for i in range(0, len(scenes), size)]
