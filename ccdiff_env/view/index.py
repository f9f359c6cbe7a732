"""The index page of a folder of replays."""

from __future__ import annotations

import base64
import html
import io
from dataclasses import dataclass
from pathlib import Path

from ccdiff_env.render import Image
from ccdiff_env.rollout import Rollout
from ccdiff_env.scenes import file_name
from ccdiff_env.view.facts import collisions, subtitle
from ccdiff_env.view.film import Film
from ccdiff_env.view.page import address, part, plain_html, write_page
from ccdiff_env.view.sources import log_rollout, rollout_files

THUMBNAIL = (320, 200)
LEAD_S = 2.0
"""Replays open so long before the first collision."""


@dataclass(frozen=True)
class Entry:
    """One replay of an index."""

    href: str
    """Address of its page, relative to the index, at the moment that matters."""
    title: str
    line: str
    collisions: int
    picture: str
    """Address of the thumbnail: a data address."""


def write_pages(
    folder: Path, out: Path, *, compare_log: bool = False, thumbnails: bool = True
) -> list[Path]:
    """Write a page for each rollout below a folder, and ``index.html`` that links them.

    Parameters
    ----------
    folder
        Folder of rollouts (``.npz``), searched as deep as it goes.
    out
        Folder of the pages.
    compare_log
        Show the log of the scene beside each rollout.
    thumbnails
        Put a picture of each rollout on the index.

    Returns
    -------
    list of Path
        The index, then the pages.
    """
    out.mkdir(parents=True, exist_ok=True)
    entries, pages = [], []
    for file in rollout_files(folder):
        rollout = Rollout.load(file)
        parts = file.relative_to(folder).with_suffix("").parts
        name = "-".join(parts)
        page = out / file_name(name, ".html")
        if page in pages:  # a-b and a/b
            page = out / file_name(f"/{'/'.join(parts)}", ".html")
        log = log_rollout(rollout.scene, like=rollout) if compare_log else None
        write_page(rollout, page, compare=log, titles=("rollout", "log"))
        hits = collisions(rollout)
        first = min((step for step, _ in hits), default=None)
        entries.append(
            Entry(
                href=address(page.name, time_s=_before(rollout, first)),
                title=name,
                line=subtitle(rollout),
                collisions=len(hits),
                picture=_data_address(_thumbnail(rollout, first)) if thumbnails else "",
            )
        )
        pages.append(page)
    index = out / "index.html"
    index.write_text(index_page(folder.name or "replays", entries), encoding="utf-8")
    return [index, *pages]


def _before(rollout: Rollout, step: int | None) -> float | None:
    """A moment before a collision, seconds; none where there is none."""
    return None if step is None else max(0.0, step * rollout.dt_s - LEAD_S)


def _thumbnail(rollout: Rollout, step: int | None) -> Image:
    """The moment of the first collision, else the middle."""
    film = Film(rollout, size=THUMBNAIL, span_m=90.0, captions=False)
    return film.frame(rollout.num_steps // 2 if step is None else step)


def _data_address(image: Image) -> str:
    from ccdiff_env.render import pillow

    buffer = io.BytesIO()
    pillow().fromarray(image).quantize(64).save(buffer, format="PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def index_page(title: str, entries: list[Entry]) -> str:
    """Return an HTML page that links replays; those with collisions are marked."""
    cards = "\n".join(_card(entry) for entry in entries) or "<p>No rollouts here.</p>"
    hits = sum(entry.collisions > 0 for entry in entries)
    line = f"{len(entries)} replays, {hits} with a collision"
    body = f'<div class="cards">\n{cards}\n</div>'
    return plain_html(title, line, style=part("index.css"), body=body)


def _card(entry: Entry) -> str:
    picture = f'<img src="{entry.picture}" alt="" loading="lazy">' if entry.picture else ""
    mark = f'<b class="hit">{entry.collisions} ⚑</b>' if entry.collisions else ""
    return (
        f'<a class="card" href="{html.escape(entry.href, quote=True)}">{picture}'
        f"<h2>{html.escape(entry.title)}{mark}</h2><p>{html.escape(entry.line)}</p></a>"
    )
