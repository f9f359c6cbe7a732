"""Progress bars."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import TypeVar

__all__ = ["shown"]

T = TypeVar("T")


def shown(steps: Iterable[T], *, what: str) -> Iterator[T]:
    """Go over steps with a bar, where this is a terminal and tqdm is installed."""
    if sys.stderr.isatty():
        try:
            from tqdm import tqdm
        except ImportError:
            yield from steps
            return
        yield from tqdm(list(steps), desc=what, leave=False, dynamic_ncols=True)
    else:
        yield from steps
