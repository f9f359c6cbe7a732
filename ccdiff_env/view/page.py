"""The replay page: one HTML file with everything in it."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from urllib.parse import quote, urlencode

from ccdiff_env import render
from ccdiff_env.rollout import Rollout
from ccdiff_env.view.facts import DRIVER_TITLES, subtitle
from ccdiff_env.view.pack import pack

#: Scripts in the order in which they run.
SCRIPTS = (
    "data.js",
    "camera.js",
    "ground.js",
    "actors.js",
    "timeline.js",
    "panels.js",
    "player.js",
    "main.js",
)


def part(name: str) -> str:
    """Return a file of the page."""
    return resources.files("ccdiff_env.view").joinpath(f"assets/{name}").read_text(encoding="utf-8")


def page_html(
    rollout: Rollout, *, compare: Rollout | None = None, titles: tuple[str, str] = ("A", "B")
) -> str:
    """Return the page of a rollout as HTML that needs nothing else.

    Parameters
    ----------
    rollout
        What to show.
    compare
        A second run beside it, in step with it: of the same scene, or of another one.
    titles
        Names of the two runs where there are two.
    """
    runs = [rollout] if compare is None else [rollout, compare]
    names = (rollout.scene.name,) if compare is None else titles
    data = "\n".join(
        f'<script class="run" type="text/plain">{pack(run, name)}</script>'
        for run, name in zip(runs, names, strict=True)
    )
    if compare is None:
        heading, line = rollout.scene.name, subtitle(rollout)
    else:
        heading = " and ".join(names)
        line = f"{rollout.scene.name} · {rollout.scene.location}"
    parts = {
        "title": html.escape(heading),
        "subtitle": html.escape(line),
        "style": part("page.css"),
        "settings": _json({"colours": colours(), "drivers": DRIVER_TITLES}),
        "runs": data,
        "script": "\n".join(part(name) for name in SCRIPTS),
    }
    return _filled("page.html", parts)


def plain_html(title: str, line: str, *, style: str, body: str) -> str:
    """Return a page without scripts: a heading, a line below it, and HTML.

    Parameters
    ----------
    title, line
        Texts.
    style
        CSS of the body.
    body
        HTML.
    """
    texts = {"title": html.escape(title), "line": html.escape(line)}
    return _filled("plain.html", {**texts, "style": style, "body": body})


def _filled(template: str, parts: Mapping[str, str]) -> str:
    return re.sub(r"\{\{(\w+)\}\}", lambda hole: parts[hole[1]], part(template))


def address(path: str, *, time_s: float | None = None, follow: str | None = None) -> str:
    """Return the address of a page that opens at a moment and follows an agent.

    Parameters
    ----------
    path
        Address of the page.
    time_s
        Seconds from the start of the run.
    follow
        Id of the agent.
    """
    wishes = {"t": None if time_s is None else f"{time_s:.1f}", "follow": follow}
    query = urlencode({name: value for name, value in wishes.items() if value is not None})
    return f"{quote(path)}#{query}" if query else quote(path)


def colours() -> dict[str, str]:
    """Return the colour of each driver, as in pictures: ``"#rrggbb"``."""
    legend = render.legend()
    names = {"static": "static obstacle"}
    return {name: _hex(legend[names.get(name, name)]) for name in DRIVER_TITLES}


def _hex(rgb: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def _json(value: object) -> str:
    """JSON that cannot end the element it stands in."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")


def write_page(
    rollout: Rollout,
    path: str | Path,
    *,
    compare: Rollout | None = None,
    titles: tuple[str, str] = ("A", "B"),
) -> int:
    """Write :func:`page_html` to a file; returns its size in bytes."""
    return Path(path).write_text(
        page_html(rollout, compare=compare, titles=titles), encoding="utf-8"
    )
