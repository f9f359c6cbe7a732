"""What commands say on a terminal: aligned tables, and where the page is."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path

from ccdiff_env.errors import ConfigError

__all__ = ["align", "say_page"]


def align(markdown: str) -> str:
    """Return Markdown whose tables are aligned for reading; numbers to the right.

    Rules under heads become lines, and cells that are emphasised (``**0.90**``) keep a star.
    """
    out: list[str] = []
    rows: list[list[str]] = []
    for line in [*markdown.splitlines(), ""]:
        if line.startswith("|"):
            rows.append([_plain(cell) for cell in line.strip().strip("|").split("|")])
            continue
        if rows:
            out += _aligned(rows)
            rows = []
        out.append(line.removeprefix("### "))
    return "\n".join(out).rstrip() + "\n"


def _plain(cell: str) -> str:
    text = cell.strip()
    bold = text.startswith("**") and text.endswith("**") and len(text) > 4
    return f"{text[2:-2]} *" if bold else text


def _aligned(rows: list[list[str]]) -> list[str]:
    head, body = rows[0], rows[2:]
    widths = [max(len(row[i]) for row in [head, *body] if i < len(row)) for i in range(len(head))]
    right = [bool(body) and all(_is_number(row[i]) for row in body) for i in range(len(head))]

    def line(row: list[str]) -> str:
        cells = zip(row, widths, right, strict=False)
        return "  ".join(t.rjust(w) if r else t.ljust(w) for t, w, r in cells).rstrip()

    return [line(head), "  ".join("─" * width for width in widths), *(line(row) for row in body)]


def _is_number(cell: str) -> bool:
    first = cell.replace("−", "-").split(" ")[0].rstrip("%")
    try:
        float(first)
    except ValueError:
        return not cell
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
