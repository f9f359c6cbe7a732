"""Report pages of the benchmarks: one HTML file with tables, plots, and links to replays."""

from __future__ import annotations

import html
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

from ccdiff_env.system.files import read_text, write_aside
from ccdiff_env.system.table import shielded, unshielded
from ccdiff_env.view.page import plain_html

#: What abbreviations in the reports stand for.
TERMS = {
    "CS": "controllability score: how far collisions are reached, 0 to 1 within a table",
    "RS": "realism score: how near to the log traffic stays, 0 to 1 within a table",
    "SCR": "scene collision rate: share of scenes with a contact",
    "ORR": "off-road rate: share of vehicle steps with the centre off the road",
    "FDE": "final displacement error from the log, metres",
    "ADE": "average displacement error from the log, metres",
    "CFD": "comfort distance from the log, x 100",
    "SOR": "share of scenes in which a controlled vehicle exceeds the speed limit",
    "K": "number of controlled vehicles",
    "ttc": "time to contact; of planners the share of scenes without one below 0.95 s",
    "IDM": "intelligent driver model",
    "PDM-Closed": "rule-based planner that tries proposals in simulation and drives the best",
    "CCDiff": "the diffusion model that drives the traffic",
}


def write_report_page(
    path: Path,
    *,
    title: str,
    line: str,
    plots: Sequence[Path],
    parts: Mapping[str, str],
    command: str = "",
    folded: bool = False,
) -> None:
    """Write a page that needs nothing else, but for the replays that it links.

    ``parts`` are Markdown by heading (see :func:`markdown_html`), empty ones are left out; the
    first comes, up to its subheadings, before the ``plots`` (SVG) and says what was found.
    ``command`` made the page. With ``folded`` the plots come first, and parts open by a click.
    """
    shown = {head: text for head, text in parts.items() if text.strip()}
    contents = "".join(f'<a href="#{anchor(h)}">{html.escape(h)}</a>' for h in shown)
    sections = [
        f'<h2 id="{anchor(head)}">{html.escape(head)}</h2>\n{markdown_html(text)}'
        for head, text in shown.items()
    ]
    if folded and plots:
        heads = [section.replace("</h2>", "</h2></summary>", 1) for section in sections]
        sections = [f'<details class="part"><summary>{part}</details>' for part in heads]
        first, rest = "", sections[0]
    else:
        # what comes before the first subheading, and the rest
        first, mark, rest = (sections[0] if sections else "").partition("<h3")
        rest = mark + rest
    drawn = "\n".join(map(_plot, plots))
    body = "\n".join(
        [
            f"<nav>{contents}</nav>",
            first,
            _terms(" ".join(shown.values())),
            f'<div class="plots" role="region" aria-label="plots" tabindex="0">{drawn}</div>'
            if drawn
            else "",
            rest,
            *sections[1:],
            f"<footer>made by <code>{html.escape(command)}</code></footer>" if command else "",
        ]
    )
    regions = Counter[str]()

    def numbered(found: re.Match[str]) -> str:  # no two regions have one name
        regions[found[1]] += 1
        return f'aria-label="table {regions[found[1]]}: {found[1]}"'

    body = re.sub(r'aria-label="table: ([^"]*)"', numbered, body)
    style = resources.files("ccdiff_env.bench").joinpath("assets/report.css")
    page = plain_html(title, line, style=style.read_text(encoding="utf-8"), body=body)
    write_aside(path, page)


def anchor(head: str) -> str:
    """Return the name of the place of a heading on the page."""
    return re.sub(r"\W+", "-", head.lower())


def _plot(path: Path) -> str:
    text = read_text(path)
    named = f'<svg role="img" aria-label="{html.escape(path.stem)}" '
    return text[text.index("<svg") :].replace("<svg ", named, 1)


def _terms(text: str) -> str:
    """What the abbreviations that occur stand for."""
    known = [term for term in TERMS if re.search(rf"(?<![\w]){re.escape(term)}(?![\w])", text)]
    entries = "".join(
        f"<dt>{html.escape(term)}</dt><dd>{html.escape(TERMS[term])}</dd>" for term in known
    )
    return f"<details><summary>Abbreviations</summary><dl>{entries}</dl></details>" if known else ""


def markdown_html(text: str) -> str:
    """Return the HTML of what the reports write: headings, tables, paragraphs, links, emphasis.

    Headings become ``h3``. Nothing else of Markdown is known; all other text is escaped. Numbers
    from 0 to 1 of tables whose first head is ``score`` are coloured.
    """
    found: list[str] = []
    for block in re.split(r"\n\s*\n", shielded(text.strip())):
        lines = block.splitlines()
        if lines[0].startswith("#"):
            head = lines[0].lstrip("# ")
            found.append(f'<h3 id="{anchor(head)}">{_inline(head)}</h3>')
            lines = lines[1:]
        if not lines:
            continue
        if len(lines) > 1 and lines[0].startswith("|"):
            found.append(_table(lines))
        else:
            found.append(f"<p>{_inline(' '.join(lines))}</p>")
    return unshielded("\n".join(found), html.escape)


def _table(lines: Sequence[str]) -> str:
    rows = [[cell.strip() for cell in line.strip()[1:-1].split("|")] for line in lines]
    heat = rows[0][0] == "score"
    head = "".join(f'<th scope="col">{_inline(cell)}</th>' for cell in rows[0])
    body = "\n".join(
        "<tr>" + "".join(_cell(cell, i, heat) for i, cell in enumerate(row)) + "</tr>"
        for row in rows[2:]
    )
    kind = ' class="good"' if heat else ""
    table = f"<table{kind}><thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody></table>"
    name = html.escape(rows[0][0] or "table", quote=True)
    return f'<div class="wide" role="region" aria-label="table: {name}" tabindex="0">{table}</div>'


def _cell(text: str, column: int, heat: bool) -> str:
    if column == 0:
        return f'<th scope="row">{_inline(text)}</th>'
    number = re.match(r"\**\[?(\d\.\d+|1|0)\b", text)
    tint = f' style="--v:{number[1]}"' if heat and number else ""
    inner = _inline(text)
    if heat:
        inner = re.sub(r" (\[[^\]]*\])", r"<small>\1</small>", inner)
    return f"<td{tint}>{inner}</td>"


#: Address of a web page, or of a file beside this one: what comes from files may hold others.
ADDRESS = r"(?:https?://|(?![^)/#?]*:))[^)\s]*"
LINK = re.compile(rf"\[([^\]]*)\]\(({ADDRESS})\)")  #: A link of Markdown.


def _inline(text: str) -> str:
    linked = LINK.sub(r'<a href="\2">\1</a>', html.escape(text))
    return re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", linked)
