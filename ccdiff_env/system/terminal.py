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

__all__ = ["align", "counted", "say", "say_page"]

#: What a terminal shows bold, and what ends it.
BOLD, PLAIN = "\033[1m", "\033[0m"
#: Width where nothing says how wide the terminal is: a pipe.
ENDLESS = 1_000_000
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
    """Return Markdown whose tables are aligned for reading in lines of ``width``; numbers to the
    right.

    Rules under heads become lines. Tables that are too wide lose their intervals, then their heads
    stand on several lines, then their columns stand in several tables. Emphasised cells
    (``**0.90**``) and headings are ``bold``; else cells keep a star.
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
    """Lines of a table that is no wider than that, unless one column is."""
    head, body = rows[0], rows[2:]
    if _width(head, body) > width:
        body = [[_INTERVAL.sub("", cell) for cell in row] for row in body]
    if _width(head, body) <= width:
        return _aligned([head], body)
    columns = [max((_length(row[i]) for row in body if i < len(row)), default=0)
               for i in range(len(head))]  # fmt: skip
    columns = [max(c, *map(len, [*h.split(), ""])) for c, h in zip(columns, head, strict=True)]
    lines: list[str] = []
    start = 1
    while start < len(head):
        end, total = start, columns[0]
        while end < len(head) and (end == start or total + len(_GAP) + columns[end] <= width):
            total += len(_GAP) + columns[end]
            end += 1
        kept = [0, *range(start, end)]
        heads = [textwrap.wrap(head[i], columns[i]) or [""] for i in kept]
        high = max(map(len, heads))
        stacked = [[""] * (high - len(h)) + h for h in heads]
        part = [[row[i] if i < len(row) else "" for i in kept] for row in body]
        part = [row for row in part if any(row[1:])]
        lines += [""] * bool(lines) + _aligned([list(r) for r in zip(*stacked, strict=True)], part)
        start = end
    return [wrapped for line in lines for wrapped in _cut(line, width)]


def _cut(line: str, width: int) -> list[str]:
    """A line; one that is still too wide goes on below, away from the margin."""
    if _length(line) <= width:
        return [line]
    return textwrap.wrap(line, width, subsequent_indent=_GAP, break_on_hyphens=False)


def _width(head: Sequence[str], body: Sequence[Sequence[str]]) -> int:
    widths = [max(_length(row[i]) for row in [head, *body] if i < len(row))
              for i in range(len(head))]  # fmt: skip
    return sum(widths) + len(_GAP) * (len(widths) - 1)


def _aligned(heads: list[list[str]], body: list[list[str]]) -> list[str]:
    rows, count = [*heads, *body], len(heads[0])
    widths = [max(_length(row[i]) for row in rows if i < len(row)) for i in range(count)]
    right = [bool(body) and all(_is_number(row[i]) for row in body if i < len(row))
             for i in range(count)]  # fmt: skip

    def line(row: list[str]) -> str:
        cells = []
        for text, wide, to_right in zip(row, widths, right, strict=False):
            room = " " * (wide - _length(text))
            cells.append(room + text if to_right else text + room)
        return _GAP.join(cells).rstrip()

    rule = _GAP.join("─" * wide for wide in widths)
    return [*map(line, heads), rule, *map(line, body)]


def _is_number(cell: str) -> bool:
    text = cell.replace(BOLD, "").replace("−", "-").replace(PLAIN, "")
    try:
        float(text.split(" ")[0].rstrip("%"))
    except ValueError:
        return not text
    return True


def say_page(path: Path, *, open_it: bool = False) -> None:
    """Print the path of a page, how to open it where this is a terminal, and open it if wanted.

    Raises
    ------
    ConfigError
        If it is to be opened and there is no browser.
    """
    print(path)
    address = path.resolve().as_uri()
    if open_it:
        if not webbrowser.open(address):
            raise ConfigError(f"--open: no browser was found; open {address}")
    elif sys.stdout.isatty():
        print(f"open {address}", file=sys.stderr)
