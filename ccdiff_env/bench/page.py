"""Report pages of the benchmarks: one HTML file with tables, plots, and links to replays."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

from ccdiff_env.view.page import plain_html

__all__ = ["markdown_html", "write_report_page"]


def write_report_page(
    path: Path, *, title: str, line: str, plots: Sequence[Path], parts: Mapping[str, str]
) -> None:
    """Write a page that needs nothing else, but for the replays that it links.

    Parameters
    ----------
    path
        File to write.
    title, line
        Heading, and what stands below it.
    plots
        Pictures (PNG) to show; those that do not exist are left out.
    parts
        Sections: heading and Markdown, see :func:`markdown_html`; empty ones are left out.
    """
    shown = {head: text for head, text in parts.items() if text.strip()}
    contents = "".join(f'<a href="#{_anchor(h)}">{html.escape(h)}</a>' for h in shown)
    pictures = "\n".join(_picture(plot) for plot in plots if plot.exists())
    sections = (
        f'<h2 id="{_anchor(head)}">{html.escape(head)}</h2>\n{markdown_html(text)}'
        for head, text in shown.items()
    )
    body = "\n".join([f"<nav>{contents}</nav>", f'<div class="plots">{pictures}</div>', *sections])
    style = resources.files("ccdiff_env.bench").joinpath("assets/report.css")
    page = plain_html(title, line, style=style.read_text(encoding="utf-8"), body=body)
    path.write_text(page, encoding="utf-8")


def _anchor(head: str) -> str:
    return re.sub(r"\W+", "-", head.lower())


def _picture(path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img src="data:image/png;base64,{data}" alt="{html.escape(path.stem)}">'


def markdown_html(text: str) -> str:
    """Return the HTML of what the reports write: headings, tables, paragraphs, links.

    Headings become ``h3``. Nothing else of Markdown is known; all other text is escaped.
    """
    found: list[str] = []
    for block in re.split(r"\n\s*\n", text.strip()):
        lines = block.splitlines()
        if lines[0].startswith("#"):
            found.append(f"<h3>{_inline(lines[0].lstrip('# '))}</h3>")
            lines = lines[1:]
        if not lines:
            continue
        if len(lines) > 1 and lines[0].startswith("|"):
            found.append(_table(lines))
        else:
            found.append(f"<p>{_inline(' '.join(lines))}</p>")
    return "\n".join(found)


def _table(lines: Sequence[str]) -> str:
    rows = [[_inline(cell.strip()) for cell in line.strip()[1:-1].split("|")] for line in lines]
    head = "".join(f"<th>{cell}</th>" for cell in rows[0])
    body = "\n".join(
        "<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows[2:]
    )
    table = f"<table><thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody></table>"
    return f'<div class="wide">{table}</div>'


def _inline(text: str) -> str:
    escaped = html.escape(text)
    return re.sub(r"\[([^\]]*)\]\(([^)\s]*)\)", r'<a href="\2">\1</a>', escaped)
