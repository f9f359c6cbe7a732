"""What commands say on a terminal: aligned tables, and where the page is."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
import webbrowser
from collections.abc import Sequence
from itertools import groupby, zip_longest
from pathlib import Path
from unicodedata import combining, east_asian_width

from ccdiff_env.system.table import shielded, unshielded

ENDLESS = 1_000_000  #: Width where nothing says how wide the terminal is: a pipe.
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_BEST = re.compile(r"\*\*(.+)\*\*")
_INTERVAL = re.compile(r" \[[^\]]*\]")
#: Heads of tables that are too wide.
_SHORT = ((re.compile(r"^CCDiff, criticality "), "CC "), (re.compile(r"^CCDiff$"), "CC 0"))
_NUMBER = re.compile(r"([-+−]?[\d.,]+%?( .*)?)?")


def say(markdown: str) -> None:
    """Print Markdown as :func:`align` has it, for the terminal that reads it."""
    print(align(markdown, shutil.get_terminal_size((ENDLESS, 24)).columns), end="")


def counted(number: int, what: str) -> str:
    """Return ``"1 scene"``, ``"2 scenes"``."""
    return f"{number:,} {what}{'s' * (number != 1)}"


def align(markdown: str, width: int = ENDLESS) -> str:
    """Return Markdown with aligned tables; emphasised cells (``**0.90**``) get a star.

    Tables that are wider than ``width`` lose their intervals, have short heads, and at last name
    the columns for which there is no room.
    """
    out: list[str] = []
    plain = _LINK.sub(r"\1", shielded(markdown)).splitlines()
    for is_table, group in groupby(plain, lambda line: line.startswith("|")):
        lines = [*group]
        out += _aligned(lines, width) if is_table else [s.removeprefix("### ") for s in lines]
    return unshielded("\n".join(out).rstrip()) + "\n"


def _aligned(lines: Sequence[str], width: int) -> list[str]:
    head, _, *rows = ([c.strip() for c in line.strip().strip("|").split("|")] for line in lines)
    columns = [
        [_BEST.sub(r"\1 *", cell) for cell in column]
        for column in zip_longest(head, *rows, fillvalue="")
    ]
    if _width(columns) > width:
        columns = [[_INTERVAL.sub("", cell) for cell in column] for column in columns]
        for short, word in _SHORT:
            columns = [[short.sub(word, column[0]), *column[1:]] for column in columns]
    fits = (n for n in range(len(columns), 0, -1) if n < 3 or _width(columns[:n]) <= width)
    shown = columns[: next(fits)]
    for column in shown:
        wide, right = _width([column]), len(rows) > 0 and all(map(_NUMBER.fullmatch, column[1:]))
        gaps = [" " * (wide - _cells(cell)) for cell in column]
        column[:] = [g + c if right else c + g for g, c in zip(gaps, column, strict=True)]
        column.insert(1, "─" * wide)
    drawn = ["  ".join(row).rstrip() for row in zip(*shown, strict=True)]
    left = ", ".join(column[0] for column in columns[len(shown) :])
    return drawn + (textwrap.wrap(f"no room for: {left}", width) if left else [])


def _width(columns: Sequence[Sequence[str]]) -> int:
    return sum(max(map(_cells, column)) + 2 for column in columns) - 2


def _cells(text: str) -> int:
    """How many places of a terminal a text takes: wide letters two, accents of their own none."""
    return sum((east_asian_width(letter) in "WF") + (not combining(letter)) for letter in text)


def say_page(path: Path, *, open_it: bool = False) -> None:
    """Print the path of a page and open it if wanted; where no browser does, or this is a terminal,
    print how to open it.
    """
    print(path)
    address = path.resolve().as_uri()
    if open_it:
        if not webbrowser.open(address):
            print(f"no browser was found: open {address}", file=sys.stderr)
    elif sys.stdout.isatty():
        print(f"open {address}", file=sys.stderr)
