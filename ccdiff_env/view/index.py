"""The index page of a folder of replays."""

from __future__ import annotations

import html
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from ccdiff_env.errors import DatasetError, DatasetNotFoundError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.system.files import file_name, write_aside
from ccdiff_env.system.terminal import counted
from ccdiff_env.view.captions import is_log, subtitle
from ccdiff_env.view.outcome import Outcome, outcome
from ccdiff_env.view.page import address, part, plain_html, write_page
from ccdiff_env.view.render import data_address
from ccdiff_env.view.video import Video

THUMBNAIL = (480, 300)


#: A replay: what its page is called, titles of its runs, and these: one, or one beside another.
Shown = tuple[str, Sequence[str], Sequence[Rollout]]


def write_pages(folder: Path, out: Path) -> Path:
    """Write a page for each rollout (``.npz``) below a folder, and ``index.html``; return it.

    Files that cannot be read are left out with a warning; none at all is a
    :class:`DatasetNotFoundError` or :class:`DatasetError`.
    """
    files = sorted(folder.rglob("*.npz"))
    if not files:
        raise DatasetNotFoundError(f"no rollouts (.npz) below {folder}")

    def found() -> Iterator[Shown]:
        readable = 0
        for file in files:
            try:
                rollout = Rollout.load(file)
            except DatasetError as error:
                warnings.warn(f"left out: {error}", stacklevel=2)
                continue
            path = file.relative_to(folder).with_suffix("").as_posix()
            yield path, [path.replace("/", "-")], [rollout]
            readable += 1
        if not readable:
            raise DatasetError(f"no rollout (.npz) below {folder} can be read")

    return write_index(found(), out, folder.name or "replays")


def write_index(
    shown: Iterable[Shown], out: Path, title: str, *, home: tuple[str, str] | None = None
) -> Path:
    """Write pages of replays, and ``index.html``, which links them in their order with what became
    of each; return it.

    ``home`` is address and title of the page above.
    """
    out.mkdir(parents=True, exist_ok=True)
    pages, cards, fates = list[Path](), list[str](), list[Outcome]()
    for path, titles, (rollout, *others) in shown:
        name = path.replace("/", "-")
        page = out / file_name(name, ".html")
        if page in pages:  # a-b and a/b
            page = out / file_name(f"/{path}", ".html")
        home_of_page = ("index.html", "all replays")
        write_page(rollout, page, compare=others, titles=titles, home=home_of_page)
        fates.append(outcome(rollout))
        besides = [
            f"{title}: {outcome(other).line}"
            for title, other in zip(titles[1:], others, strict=True)
            if not is_log(other)
        ]
        cards.append(_card(rollout, name, page.name, fates[-1], [*besides, subtitle(rollout)]))
        pages.append(page)
    mishaps = Counter(fate.mishap for fate in fates)
    told = [f"{what} in {n}" for what, n in mishaps.most_common() if what]
    collide = sum(fate.others > 0 for fate in fates)
    line = f"{counted(len(fates), 'replay')}: the ego {', '.join(told)}" if told else ""
    line = f"{line or counted(len(fates), 'replay')}; others collide in {collide}"
    up = "" if home is None else f'<p><a href="{home[0]}">{html.escape(home[1])}</a></p>'
    body = f'{up}<div class="cards">\n{chr(10).join(cards)}\n</div>'
    index = out / "index.html"
    write_aside(index, plain_html(title, line, style=part("index.css"), body=body))
    return index


def _card(rollout: Rollout, title: str, page: str, fate: Outcome, lines: Sequence[str]) -> str:
    """A replay in the index: a link with an image of the moment that matters."""
    moment = fate.opening_s if fate.opening_s > 0.0 or fate.tone == "bad" else None
    video = Video(rollout, size=THUMBNAIL, span_m=90.0, captions=False)
    image = data_address(video.frame(video.moment))
    name = html.escape(title, quote=True)
    href = html.escape(address(page, time_s=moment, play=True), quote=True)
    return (
        f'<a class="card" href="{href}">'
        f'<img src="{image}" alt="{name}: {html.escape(fate.text, quote=True)}" loading="lazy">'
        f'<h2 title="{name}">{name}</h2>'
        f'<p class="fate {fate.tone}">{html.escape(fate.line)}</p>'
        f"{''.join(f'<p>{html.escape(line)}</p>' for line in lines)}</a>"
    )
