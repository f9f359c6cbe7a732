"""Progress bars."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from importlib import import_module
from typing import Any, TypeVar

T = TypeVar("T")


def shown(steps: Iterable[T], *, what: str, total: int | None = None, done: int = 0) -> Iterator[T]:
    """Go over steps with a bar, where this is a terminal and tqdm is installed.

    ``total`` is their number, with those ``done`` before; by default they are counted first.
    """
    tqdm = _tqdm()
    if tqdm is None:
        yield from steps
        return
    counted = steps if total else list(steps)
    bar = {"desc": what, "leave": False, "dynamic_ncols": True}
    yield from tqdm(counted, total=total, initial=done, **bar)


def _tqdm() -> Any:
    """The class of bars, where this is a terminal and tqdm is installed."""
    try:
        return import_module("tqdm").tqdm if sys.stderr.isatty() else None
    except ImportError:
        return None


class _Silent:
    def __getattr__(self, name: str) -> Any:
        return lambda *_: None


def bar(unit: str, wanted: bool) -> Any:
    """Return a bar of tqdm that counts ``unit``, or one that shows nothing where none can be."""
    tqdm = _tqdm() if wanted else None
    form = "{n:.0f} {unit} [{elapsed}{postfix}]"
    return tqdm(unit=unit, bar_format=form, dynamic_ncols=True) if tqdm else _Silent()
