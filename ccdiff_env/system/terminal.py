"""What commands say on a terminal: tables that fit it, and where the page is."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
import webbrowser
from collections.abc import Sequence
from pathlib import Path

from ccdiff_env.errors import ConfigError

BOLD, PLAIN = "\033[1m", "\033[0m"  #: What a terminal shows bold, and what ends it.
ENDLESS = 1_000_000  #: Width where nothing says how wide the terminal is: a pipe.
_GAP = "  "
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_INTERVAL = re.compile(r" \[[^\]]*\]")


def say(markdown: str) -> None:
    """Print Markdown as :func:`align` has it, for the terminal that reads it."""
    width = shutil.get_terminal_size((ENDLESS, 24)).columns
    print(align(markdown, width=width, bold=sys.stdout.isatty()), end="")


def counted(number: int, what: str) -> str:
    """Return ``"1 scene"``, ``"2 scenes"``."""
    return f"{number:,} {what}{'s' * (number != 1)}"


def align(markdown: str, *, width: int = ENDLESS, bold: bool = False) -> str:
    """Return Markdown whose tables are aligned for reading in lines of ``width``.

    Tables that are too wide lose their intervals, then their columns stand in several tables.
    Emphasised cells (``**0.90**``) and headings are ``bold``; else cells keep a star.
    """
    out: list[str] = []
    rows: list[list[str]] = []
    for line in [*markdown.splitlines(), ""]:
        if line.startswith("|"):
            rows.append([_text(cell, bold) for cell in line.strip().strip("|").split("|")])
            continue
        if rows:
            out += _fitted(rows, width)
            rows = []
        heading = line.startswith("### ")
        text = _LINK.sub(r"\1", line.removeprefix("### "))
        lines = textwrap.wrap(text, max(width, 20), break_on_hyphens=False) or [""]
        out += [f"{BOLD}{part}{PLAIN}" if heading and bold else part for part in lines]
    return "\n".join(out).rstrip() + "\n"


def _text(cell: str, bold: bool) -> str:
    text = _LINK.sub(r"\1", cell.strip())
    if not (text.startswith("**") and text.endswith("**") and len(text) > 4):
        return text
    return f"{BOLD}{text[2:-2]}{PLAIN}" if bold else f"{text[2:-2]} *"


def _length(text: str) -> int:
    return len(text.replace(BOLD, "").replace(PLAIN, ""))


def _fitted(rows: list[list[str]], width: int) -> list[str]:
    """Lines of a table; what is too wide goes on in another table, then below in the line."""
    count = len(rows[0])
    table = [(row + [""] * count)[:count] for row in (rows[0], *rows[2:])]
    columns = [list(column) for column in zip(*table, strict=True)]
    if _width(columns) > width:
        columns = [[_INTERVAL.sub("", cell) for cell in column] for column in columns]
    parts = [columns[:1]]
    for column in columns[1:]:
        if len(parts[-1]) > 1 and _width([*parts[-1], column]) > width:
            parts.append(columns[:1])
        parts[-1] = [*parts[-1], column]
    lines = [line for part in parts for line in ("", *_aligned(part))][1:]
    return [wrapped for line in lines for wrapped in _cut(line, width)]


def _cut(line: str, width: int) -> list[str]:
    """A line; one that is still too wide goes on below, away from the margin."""
    if _length(line) <= width:
        return [line]
    return textwrap.wrap(line, width, subsequent_indent=_GAP, break_on_hyphens=False)


def _widths(columns: Sequence[Sequence[str]]) -> list[int]:
    return [max(map(_length, column)) for column in columns]


def _width(columns: Sequence[Sequence[str]]) -> int:
    return sum(_widths(columns)) + len(_GAP) * (len(columns) - 1)


def _aligned(columns: list[list[str]]) -> list[str]:
    widths = _widths(columns)
    right = [len(column) > 1 and all(map(_is_number, column[1:])) for column in columns]
    made = []
    for row in zip(*columns, strict=True):
        if len(columns) > 1 and not any(row[1:]) and any(any(c[1:]) for c in columns[1:]):
            continue  # it has nothing in this part of the table
        rooms = [" " * (wide - _length(text)) for wide, text in zip(widths, row, strict=True)]
        cells = zip(rooms, row, right, strict=True)
        made.append(_GAP.join(room + t if r else t + room for room, t, r in cells).rstrip())
    return [made[0], _GAP.join("─" * wide for wide in widths), *made[1:]]


def _is_number(cell: str) -> bool:
    text = cell.replace(BOLD, "").replace("−", "-").replace(PLAIN, "")
    try:
        float(text.split(" ")[0].rstrip("%"))
    except ValueError:
        return not text
    return True


def say_page(path: Path, *, open_it: bool = False) -> None:
    """Print the path of a page, how to open it where this is a terminal, and open it if wanted:
    without a browser a :class:`ConfigError`.
    """
    print(path)
    address = path.resolve().as_uri()
    if open_it:
        if not webbrowser.open(address):
            raise ConfigError(f"--open: no browser was found; open {address}")
    elif sys.stdout.isatty():
        print(f"open {address}", file=sys.stderr)
