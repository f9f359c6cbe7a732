"""Progress bars."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

__all__ = ["bar", "shown"]

T = TypeVar("T")


def shown(steps: Iterable[T], *, what: str, total: int | None = None, done: int = 0) -> Iterator[T]:
    """Go over steps with a bar, where this is a terminal and tqdm is installed.

    ``total`` is their number, with those ``done`` before; by default they are counted first.
    """
    if sys.stderr.isatty():
        try:
            from tqdm import tqdm
        except ImportError:
            yield from steps
            return
        counted = steps if total else list(steps)
        bar = {"desc": what, "leave": False, "dynamic_ncols": True}
        yield from tqdm(counted, total=total, initial=done, **bar)
    else:
        yield from steps


class _Silent:
    def __getattr__(self, name: str) -> Any:
        return lambda *_: None


def bar(unit: str, wanted: bool) -> Any:
    """Return a bar of tqdm that counts ``unit``, or one that shows nothing where none can be."""
    if not wanted or not sys.stderr.isatty():
        return _Silent()
    try:
        from tqdm import tqdm
    except ImportError:
        return _Silent()
    form = "{n:.0f} {unit} [{elapsed}{postfix}]"
    return tqdm(unit=unit, bar_format=form, dynamic_ncols=True)
