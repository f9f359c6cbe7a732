"""Progress bars."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from importlib import import_module
from importlib.util import find_spec
from typing import TypeVar

T = TypeVar("T")
EVERY_S = 10.0  #: Seconds between two lines of what takes long and has no bar.


def shown(steps: Iterable[T], *, what: str, total: int | None = None, done: int = 0) -> Iterator[T]:
    """Go over steps with a bar, where this is a terminal and tqdm is installed.

    ``total`` is their number, with those ``done`` before; by default they are counted first.
    """
    if not (sys.stderr and sys.stderr.isatty()) or find_spec("tqdm") is None:
        yield from steps
        return
    counted = steps if total else list(steps)
    bar = {"desc": what, "leave": False, "dynamic_ncols": True}
    yield from import_module("tqdm").tqdm(counted, total=total, initial=done, **bar)
