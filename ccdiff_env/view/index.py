"""The index page of a folder of replays."""

from __future__ import annotations

import html
import warnings
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

from ccdiff_env.errors import DatasetError, DatasetNotFoundError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.system.files import file_name, write_aside
from ccdiff_env.system.terminal import counted
from ccdiff_env.view.captions import subtitle
from ccdiff_env.view.outcome import LEAD_S, Outcome, outcome
from ccdiff_env.view.page import address, part, plain_html, write_page
from ccdiff_env.view.render import THEMES, data_address
from ccdiff_env.view.sources import log_rollout
from ccdiff_env.view.video import Video

THUMBNAIL = (480, 300)


@dataclass(frozen=True)
class Entry:
    """One replay of an index."""

    href: str  #: Address of its page, relative to the index, at the moment that matters.
    title: str
    line: str
    outcome: Outcome
    images: tuple[str, ...]  #: Data addresses of the thumbnail on light and on dark ground.
    beside: str = ""  #: What became of the run beside it.


def write_pages(folder: Path, out: Path, *, compare_log: bool = False) -> list[Path]:
    """Write a page for each rollout (``.npz``) below a folder, and ``index.html``; return it, then
    the pages.

    ``compare_log`` shows the log of the scene beside each. Files that cannot be read are left out
    with a warning; none at all is a :class:`DatasetNotFoundError` or :class:`DatasetError`.
    """
    files = sorted(folder.rglob("*.npz"))
    if not files:
        raise DatasetNotFoundError(f"no rollouts (.npz) below {folder}")
    out.mkdir(parents=True, exist_ok=True)
    entries, pages = [], []
    for file in files:
        try:
            rollout = Rollout.load(file)
        except DatasetError as error:
            warnings.warn(f"left out: {error}", stacklevel=2)
            continue
        parts = file.relative_to(folder).with_suffix("").parts
        name = "-".join(parts)
        page = out / file_name(name, ".html")
        if page in pages:  # a-b and a/b
            page = out / file_name(f"/{'/'.join(parts)}", ".html")
        log = log_rollout(rollout.scene, like=rollout) if compare_log else None
        titles = (name,) if log is None else (name, "log")
        write_page(rollout, page, compare=log, titles=titles, home=("index.html", "all replays"))
        entries.append(entry(rollout, name, page.name))
        pages.append(page)
    if not pages:
        raise DatasetError(f"no rollout (.npz) below {folder} can be read")
    index = out / "index.html"
    write_aside(index, index_page(folder.name or "replays", entries))
    return [index, *pages]


def entry(rollout: Rollout, title: str, page: str) -> Entry:
    """Return the entry of a rollout, whose page has a name beside the index."""
    fate = outcome(rollout)
    moment = fate.opening_s if fate.opening_s > 0.0 or fate.tone == "bad" else None
    return Entry(
        href=address(page, time_s=moment, play=True),
        title=title,
        line=subtitle(rollout),
        outcome=fate,
        images=tuple(_thumbnail(rollout, moment, theme) for theme in THEMES),
    )


def _thumbnail(rollout: Rollout, opening_s: float | None, theme: str) -> str:
    """The moment that matters, else the middle."""
    video = Video(rollout, size=THUMBNAIL, span_m=90.0, captions=False, theme=theme)
    last = rollout.num_steps - 1
    step = last // 2
    if opening_s is not None:
        step = min(round((opening_s + LEAD_S) / rollout.dt_s), last)
    # with fewer colours those of small things, as the ego's, are lost
    return data_address(video.frame(step), 256)


def index_page(title: str, entries: list[Entry], home: tuple[str, str] | None = None) -> str:
    """Return an HTML page that links replays in their order, with what became of each, and the page
    above.
    """
    cards = "\n".join(_card(entry) for entry in _short(entries))
    mishaps = Counter(entry.outcome.mishap for entry in entries)
    told = [f"{what} in {n}" for what, n in mishaps.most_common() if what]
    others = sum(entry.outcome.others > 0 for entry in entries)
    line = f"{counted(len(entries), 'replay')}: the ego {', '.join(told)}" if told else ""
    line = f"{line or counted(len(entries), 'replay')}; others collide in {others}"
    up = "" if home is None else f'<p><a href="{home[0]}">{html.escape(home[1])}</a></p>'
    body = f'{up}<div class="cards">\n{cards}\n</div>'
    return plain_html(title, line, style=part("index.css"), body=body)


def _short(entries: list[Entry]) -> list[Entry]:
    """Entries without the parts of their lines that all of them share."""
    parts = [entry.line.split(" · ") for entry in entries]
    shared = set.intersection(*map(set, parts)) if len(parts) > 1 else set()
    return [
        replace(entry, line=" · ".join(part for part in own if part not in shared))
        for entry, own in zip(entries, parts, strict=True)
    ]


def _card(entry: Entry) -> str:
    fate = entry.outcome
    alt = html.escape(f"{entry.title}: {fate.text}", quote=True)
    light, dark = entry.images
    image = (
        f'<picture><source srcset="{dark}" media="(prefers-color-scheme: dark)">'
        f'<img src="{light}" alt="{alt}" loading="lazy"></picture>'
    )
    name = html.escape(entry.title, quote=True)
    return (
        f'<a class="card" href="{html.escape(entry.href, quote=True)}">{image}'
        f'<h2 title="{name}">{name}</h2>'
        f'<p class="fate {fate.tone}">{html.escape(fate.line)}</p>'
        f"{f'<p>{html.escape(entry.beside)}</p>' if entry.beside else ''}"
        f"{f'<p>{html.escape(entry.line)}</p>' if entry.line else ''}</a>"
    )
