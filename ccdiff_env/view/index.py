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
from ccdiff_env.view.captions import ego_title, is_log, subtitle
from ccdiff_env.view.outcome import Outcome, outcome
from ccdiff_env.view.page import address, part, plain_html, write_page
from ccdiff_env.view.render import data_address
from ccdiff_env.view.video import Video

THUMBNAIL, THUMBNAIL_M = (480, 300), 60.0  #: Pixels, and metres of ground from side to side.
FILTERED = 8  #: So many replays, at least, can be chosen among.

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
    pages, fates = list[Path](), list[Outcome]()
    cards = list[tuple[str, list[str], list[list[str]]]]()
    for path, titles, (rollout, *others) in shown:
        name = path.replace("/", "-")
        page = out / file_name(name, ".html")
        if page in pages:  # a-b and a/b
            page = out / file_name(f"/{path}", ".html")
        home_of_page = ("index.html", "all replays")
        write_page(rollout, page, compare=others, titles=titles, home=home_of_page)
        fates.append(outcome(rollout))
        besides = [
            [f"{title}: {outcome(other).line}"]
            for title, other in zip(titles[1:], others, strict=True)
            if not is_log(other)
        ]
        lines = [*besides, subtitle(rollout).split(" · ")]
        cards.append((_card(rollout, name, page.name, fates[-1]), _tags(fates[-1], rollout), lines))
        pages.append(page)
    mishaps = Counter(fate.mishap for fate in fates)
    told = [f"{what} in {n}" for what, n in mishaps.most_common() if what]
    collide = sum(fate.others > 0 for fate in fates)
    line = f"{counted(len(fates), 'replay')}: the ego {', '.join(told)}" if told else ""
    line = f"{line or counted(len(fates), 'replay')}; others collide in {collide}"
    # what holds for all is said once
    each = [[part for parts in lines for part in parts] for _, _, lines in cards]
    common = each[0] if len(cards) > 1 else []
    common = [part for part in common if all(part in parts for parts in each)]
    up = "" if home is None else f'<p><a href="{home[0]}">{html.escape(home[1])}</a></p>'
    written = [_finished(*card, common) for card in cards]
    chips = _chips([tags for _, tags, _ in cards])
    body = f'{up}{chips}<div class="cards">\n{chr(10).join(written)}\n</div>'
    index = out / "index.html"
    line = " · ".join([line, *common])
    write_aside(index, plain_html(title, line, style=part("index.css"), body=body))
    return index


def _tags(fate: Outcome, rollout: Rollout) -> list[str]:
    """What a replay can be chosen by."""
    embedded = "embedded" in rollout.scene.source
    source = "" if embedded else rollout.scene.source
    return [*filter(None, [fate.mishap, source, "" if is_log(rollout) else ego_title(rollout)])]


def _chips(tags: Sequence[Sequence[str]]) -> str:
    """Buttons that choose: what is true of some of the replays, of most first."""
    count = Counter(tag for of in tags for tag in of)
    split = [tag for tag, of in count.most_common() if of < len(tags)]
    if len(tags) < FILTERED or not split:
        return ""
    buttons = (
        f'<button aria-pressed="false" data-filter="{tag}">{tag} ({count[tag]})</button>'
        for tag in split
    )
    return f'<p class="filters">{"".join(buttons)}</p>'


def _finished(card: str, tags: Sequence[str], lines: list[list[str]], common: list[str]) -> str:
    """A card with its lines but what all cards say, as an element that can be chosen."""
    own = (" · ".join(part for part in parts if part not in common) for parts in lines)
    written = "".join(f"<p>{html.escape(line)}</p>" for line in own if line)
    return f'<div data-tags="{"|".join(tags)}">{card}{written}</a></div>'


def _card(rollout: Rollout, title: str, page: str, fate: Outcome) -> str:
    """The beginning of a link to a replay, with an image of the moment that matters."""
    moment = fate.opening_s if fate.opening_s > 0.0 or fate.tone == "bad" else None
    video = Video(rollout, size=THUMBNAIL, span_m=THUMBNAIL_M, captions=False)
    image = data_address(video.frame(video.moment))
    name = html.escape(title, quote=True)
    href = html.escape(address(page, time_s=moment, play=True), quote=True)
    return (
        f'<a class="card" href="{href}">'
        f'<img src="{image}" alt="{name}: {html.escape(fate.text, quote=True)}" loading="lazy">'
        f'<h2 title="{name}">{name}</h2>'
        f'<p class="fate {fate.tone}">{html.escape(fate.line)}</p>'
    )
