"""The replay page: one HTML file with everything in it."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode

from ccdiff_env.errors import ConfigError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.system.files import write_aside
from ccdiff_env.view import render
from ccdiff_env.view.captions import DRIVER_TITLES, subtitle
from ccdiff_env.view.pack import pack

#: Scripts in the order in which they run.
SCRIPTS = (
    "data.js", "camera.js", "ground.js", "actors.js", "timeline.js", "strip.js", "panels.js",
    "player.js", "shared.js", "main.js",
)  # fmt: skip


def part(name: str) -> str:
    """Return a file of the page."""
    return resources.files("ccdiff_env.view").joinpath(f"assets/{name}").read_text(encoding="utf-8")


def page_html(
    rollout: Rollout,
    *,
    compare: Sequence[Rollout] = (),
    titles: Sequence[str] | None = None,
    home: tuple[str, str] | None = None,
    slider: bool = False,
) -> str:
    """Return the page of a rollout as HTML that needs nothing else.

    Args:
        rollout: What to show.
        compare: Runs beside it, in step with it: of the same scene, or of another one.
        titles: Name of each run; by default the scene's where there is one run, else A, B, C, ...
        home: Address and title of a page above this one, to be linked.
        slider: Show one run at a time, which a slider chooses.

    Raises:
        ConfigError: If there are not as many titles as runs.
    """
    runs = [rollout, *compare]
    letters = [chr(ord("A") + i) for i in range(len(runs))] if compare else [rollout.scene.name]
    names = letters if titles is None else list(titles)
    if len(names) != len(runs):
        raise ConfigError(f"titles: {len(names)} for {len(runs)} runs")
    data = "\n".join(
        f'<script class="run" type="text/plain">{pack(run, name)}</script>'
        for run, name in zip(runs, names, strict=True)
    )
    heading = names[0] if titles is not None and len(runs) == 1 else rollout.scene.name
    if len(runs) == 1:
        line = subtitle(rollout)
    else:
        each = "" if slider else " | ".join(names)
        line = " · ".join(filter(None, [rollout.scene.location, each]))
    parts = {
        "title": html.escape(heading),
        "subtitle": html.escape(line),
        "home": "" if home is None else f'<a href="{quote(home[0])}">{html.escape(home[1])}</a>',
        "style": part("page.css"),
        "settings": as_json({**look(), "slider": slider}),
        "runs": data,
        "script": "\n".join(part(name) for name in SCRIPTS),
    }
    return filled_page("page.html", parts)


def plain_html(title: str, line: str, *, style: str, body: str) -> str:
    """Return a page of text: a heading, a line below it, and HTML with its CSS."""
    parts = {"title": html.escape(title), "line": html.escape(line), "style": style, "body": body}
    return filled_page("plain.html", parts | {"script": part("plain.js")})


def filled_page(name: str, parts: Mapping[str, str], also: str = "") -> str:
    """Return a filled template: its own script, and what is ``also`` allowed, is all that runs."""
    template = part(name).replace("{{head}}\n", part("head.html"))
    script = f'\n(() => {{\n"use strict";\n{parts["script"]}\n}})();\n'
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    found = {**parts, "script": script, "policy": f"'sha256-{digest}'{also}"}
    return re.sub(r"\{\{(\w+)\}\}", lambda hole: found[hole[1]], template)


def address(
    path: str, *, time_s: float | None = None, follow: str | None = None, play: bool = False
) -> str:
    """Return the address of a page that opens at a moment, in seconds from the start, and follows
    the agent of an id.

    It plays from there, or waits.
    """
    wishes = {"t": None if time_s is None else f"{time_s:.1f}", "follow": follow}
    if play and time_s is not None:
        wishes["play"] = "1"
    query = urlencode({name: value for name, value in wishes.items() if value is not None})
    return f"{quote(path)}#{query}" if query else quote(path)


def look() -> dict[str, Any]:
    """Return what pages draw by, the same as images: colours by theme and name, titles of drivers
    in the order of the legend, times and lengths by name.
    """
    colours = {
        theme: {name: f"#{bytes(rgb).hex()}" for name, rgb in render.all_colours(theme).items()}
        for theme in render.THEMES
    }
    return {"colours": colours, "drivers": DRIVER_TITLES, "look": render.LOOK}


def as_json(value: object) -> str:
    """Return JSON that cannot end the element it stands in."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")


def write_page(rollout: Rollout, path: str | Path, **options: Any) -> int:
    """Write :func:`page_html`, which takes the options, to a file; returns its size in bytes."""
    if not isinstance(rollout, Rollout):
        raise ConfigError(f"write_page: rollout is {rollout!r:.60}, expected a Rollout")
    data = page_html(rollout, **options).encode()
    write_aside(Path(path), data)
    return len(data)
