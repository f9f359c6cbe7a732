"""The index page of a folder of replays."""

from __future__ import annotations

import html
import json
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from ccdiff_env.errors import DatasetError, DatasetNotFoundError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.system.files import file_name, write_aside
from ccdiff_env.system.terminal import counted
from ccdiff_env.view.captions import ego_title, is_log, traffic_title
from ccdiff_env.view.outcome import Outcome, outcome
from ccdiff_env.view.page import address, part, plain_html, write_page
from ccdiff_env.view.render import data_address
from ccdiff_env.view.video import Video

THUMBNAIL, THUMBNAIL_M = (480, 300), 60.0  #: Pixels, and metres of ground from side to side.
FILTERED, FILTERS = 8, 3  #: So many replays, at least, are chosen among, by so many menus at most.
LINES = ("driven by", "traffic")  #: Facts that a card tells where they differ.

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
    pages, collide, cards, facts = set[Path](), 0, list[str](), list[dict[str, str]]()
    for path, titles, (rollout, *others) in shown:
        name = path.replace("/", "-")
        page = out / file_name(name, ".html")
        if page in pages:  # a-b and a/b
            page = out / file_name(f"/{path}", ".html")
        home_of_page = ("index.html", "all replays")
        write_page(rollout, page, compare=others, titles=titles, home=home_of_page)
        pages.add(page)
        beside = zip(titles[1:], others, strict=True)
        runs = [(titles[0], rollout), *(run for run in beside if not is_log(run[1]))]
        fate = outcome(rollout)
        collide += fate.others > 0
        facts.append(_facts(rollout, fate))
        cards.append(_card(runs, name, page.name, fate))
    # what holds for all is said once
    values = {name: Counter(of[name] for of in facts) for name in (facts[0] if facts else ())}
    differ = [name for name, of in values.items() if len(of) > 1]
    common = [
        f"{name}: {next(iter(of))}"
        for name, of in values.items()
        if len(of) == 1 and name != "the ego"
    ]
    told = ", ".join(f"{what} in {n}" for what, n in values.get("the ego", Counter()).most_common())
    line = f"{counted(len(cards), 'replay')}: the ego {told}; others collide in {collide}"
    up = "" if home is None else f'<a href="{home[0]}">{html.escape(home[1])}</a>'
    menus = differ[:FILTERS] if len(cards) >= FILTERED else []
    above = up + "".join(_menu(name, values[name]) for name in menus)
    written = "".join(
        f'<div data-of="{html.escape(json.dumps([of[name] for name in menus]))}">{card}'
        + "".join(f"<p>{n}: {html.escape(of[n])}</p>" for n in LINES if n in differ)
        + "</a></div>\n"
        for card, of in zip(cards, facts, strict=True)
    )
    body = f'<p class="above">{above}</p>\n<div class="cards">\n{written}</div>'
    line = " · ".join([line, *(fact for fact in common if len(cards) > 1)])
    write_aside(out / "index.html", plain_html(title, line, style=part("index.css"), body=body))
    return out / "index.html"


def _facts(rollout: Rollout, fate: Outcome) -> dict[str, str]:
    """What replays are told apart by."""
    scene = rollout.scene
    family = scene.name.rpartition("-")[0] if "embedded" in scene.source else ""
    return {
        "the ego": fate.mishap or "is unharmed",
        "driven by": ego_title(rollout) if "ego" in rollout.agent_ids else "nobody",
        "traffic": traffic_title(rollout) or "as recorded",
        "scenes": family or scene.source,
    }


def _menu(name: str, values: Counter[str]) -> str:
    """A menu that chooses replays by a fact, of which most have the first."""
    options = "".join(
        f'<option value="{html.escape(value)}">{html.escape(value)} ({n})</option>'
        for value, n in values.most_common()
    )
    return f'<label>{name} <select><option value="">any</option>{options}</select></label>'


def _card(runs: Sequence[tuple[str, Rollout]], name: str, page: str, fate: Outcome) -> str:
    """The beginning of a link to a replay: images of the moment that matters in each of its runs,
    and what became of them.
    """
    moment = fate.opening_s if fate.opening_s > 0.0 or fate.tone == "bad" else None
    videos = [Video(run, size=THUMBNAIL, span_m=THUMBNAIL_M, captions=False) for _, run in runs]
    name, images, lines = html.escape(name), "", ""
    for (title, run), video in zip(runs, videos, strict=True):
        image = data_address(video.frame(min(videos[0].moment, video.num_steps - 1)))
        told = outcome(run)
        images += f'<img src="{image}" alt="{name}: {html.escape(told.text)}" loading="lazy">'
        line = told.line if len(runs) == 1 else f"{title}: {told.line}"
        lines += f'<p class="fate {told.tone}">{html.escape(line)}</p>'
    scene = html.escape(runs[0][1].scene.name)
    head = name if scene in name else f"{name} · {scene}"
    return (
        f'<a class="card" href="{html.escape(address(page, time_s=moment, play=True))}">'
        f'<span class="moments">{images}</span><h2 title="{head}">{head}</h2>{lines}'
    )
