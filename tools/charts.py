"""Charts of the docs as SVG, from `docs/results`: dots and whiskers, on light and on dark ground.

``python -m tools.charts`` writes ``docs/charts``; ``python -m tools.results`` does so, too.
"""

from __future__ import annotations

import base64
import html
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
DATA, CHARTS = ROOT / "docs" / "results", ROOT / "docs" / "charts"
WIDTH = 480
#: Colours of Okabe and Ito, that of light and that of dark ground, and a marker for each.
COLOURS = {
    "blue": ("#0072b2", "#56b4e9"),
    "orange": ("#c26a00", "#e69f00"),
    "green": ("#00795a", "#2fcf9f"),
    "purple": ("#a6487f", "#cc79a7"),
    "grey": ("#5c6672", "#a5b0bc"),
}
MARKERS = {
    "circle": "M-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0Z",
    "square": "M-4.5 -4.5h9v9h-9Z",
    "triangle": "M0 -6l5.6 10h-11.2Z",
    "diamond": "M0 -6.2l6.2 6.2l-6.2 6.2l-6.2 -6.2Z",
}

Figure = tuple[float, float, float]
"""A value and the ends of its interval; nan where there is none."""


class Series(NamedTuple):
    """Figures under one name, a colour of :data:`COLOURS` and one of :data:`MARKERS`."""

    name: str
    colour: str
    marker: str
    figures: Sequence[Figure]


def _style() -> str:
    def rules(dark: bool) -> str:
        ink, faint = ("#e8edf3", "#39434f") if dark else ("#1d242c", "#d5dae1")
        tints = "".join(f".{name}{{color:{pair[dark]}}}" for name, pair in COLOURS.items())
        return f"text{{fill:{ink}}}.axis{{stroke:{faint}}}{tints}"

    return (
        "<style>text{font:13px system-ui,-apple-system,'Segoe UI',Roboto,sans-serif}"
        ".small{font-size:11.5px}.title{font-weight:600}"
        f"{rules(False)}@media(prefers-color-scheme:dark){{{rules(True)}}}</style>"
    )


def _svg(height: float, alt: str, body: Sequence[str]) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:g}" role="img" '
        f'aria-label="{html.escape(alt)}">{_style()}\n' + "\n".join(body) + "\n</svg>\n"
    )


def _text(x: float, y: float, text: str, kind: str = "", anchor: str = "start") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" class="{kind}" text-anchor="{anchor}">'
        f"{html.escape(text)}</text>"
    )


def _line(x0: float, y0: float, x1: float, y1: float, kind: str = "axis", more: str = "") -> str:
    return f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" class="{kind}" {more}/>'


def _dot(x: float, y: float, marker: str, colour: str) -> str:
    place = f'transform="translate({x:.1f} {y:.1f})"'
    return f'<path d="{MARKERS[marker]}" {place} class="{colour}" fill="currentColor"/>'


INK = 'stroke="currentColor" stroke-width="1.6"'


def rows_chart(
    title: str,
    rows: Sequence[tuple[str, Figure, str, str]],
    ticks: Sequence[float],
    *,
    line: tuple[float, str] | None = None,
    log: bool = False,
    form: str = "{:g}",
) -> str:
    """Return a chart with a dot and a whisker in each row: name, figure, colour, marker.

    Each of ``ticks`` has a line, the first and the last are the ends; ``line`` is a value to be
    marked, and its name; ``form`` how figures are written.
    """
    scale = math.log10 if log else float
    low, high = scale(ticks[0]), scale(ticks[-1])
    left, right, top, step = 168, 52, 44, 27
    bottom = top + step * len(rows)

    def x(value: float) -> float:
        return left + (WIDTH - left - right) * (scale(value) - low) / (high - low)

    body = [_text(0, 15, title, "title")]
    for tick in ticks:
        body += [
            _line(x(tick), top - 10, x(tick), bottom),
            _text(x(tick), bottom + 16, f"{tick:,g}", "small", "middle"),
        ]
    if line:
        body += [
            _line(x(line[0]), top - 10, x(line[0]), bottom, "grey", f"{INK} stroke-dasharray='4'"),
            _text(x(line[0]), top - 14, line[1], "small", "middle"),
        ]
    for i, (name, (value, less, more), colour, marker) in enumerate(rows):
        y = top + step * (i + 0.5)
        body.append(_text(0, y + 4, name))
        if math.isfinite(less):
            body.append(_line(x(less), y, x(more), y, colour, INK))
        body += [
            _dot(x(value), y, marker, colour),
            _text(WIDTH, y + 4, form.format(value), "", "end"),
        ]
    said = "; ".join(f"{name} {form.format(figure[0])}" for name, figure, *_ in rows)
    return _svg(bottom + 24, f"{title}: {said}", body)


def lines_chart(
    title: str,
    across: str,
    places: Sequence[float],
    series: Sequence[Series],
    ticks: Sequence[float],
    *,
    note: str = "",
    stills: Sequence[tuple[float, str, bytes]] = (),
) -> str:
    """Return a chart of lines with whiskers, named at their ends, below images of some places.

    Figures of a series stand at ``places``, which ``across`` names; nan leaves one out. ``stills``
    are place, what is said below, and an image (PNG) of 7 to 6.
    """
    left, right, high = 34, 104, 210
    wide = WIDTH - left - right
    still = WIDTH / max(len(stills), 1)
    top = 34 + (still * 6 / 7 + 30 if stills else 0)
    first, last = places[0], places[-1]

    def x(place: float) -> float:
        return left + 12 + (wide - 24) * (place - first) / (last - first)

    def y(value: float) -> float:
        return top + high * (1 - (value - ticks[0]) / (ticks[-1] - ticks[0]))

    body = []
    for i, (_, said, png) in enumerate(stills):
        at = i * still
        data = base64.b64encode(png).decode()
        body += [
            f'<image x="{at + 2:.1f}" width="{still - 4:.1f}" height="{(still - 4) * 6 / 7:.1f}" '
            f'href="data:image/png;base64,{data}"/>',
            _text(at + still / 2, still * 6 / 7 + 12, said, "small", "middle"),
        ]
    body.append(_text(0, top - 14, title, "title"))
    for tick in ticks:
        body += [
            _line(left, y(tick), WIDTH - right, y(tick)),
            _text(left - 6, y(tick) + 4, f"{tick:g}", "small", "end"),
        ]
    for place in places:
        body.append(_text(x(place), top + high + 18, f"{place:g}", "small", "middle"))
    body.append(_text(left + wide / 2, top + high + 36, across, "small", "middle"))
    known = [[f for f in one.figures if math.isfinite(f[0])] for one in series]
    ends = _apart([y(figures[-1][0]) for figures in known], 17)
    for k, (one, end) in enumerate(zip(series, ends, strict=True)):
        aside = 5.0 * (k - (len(series) - 1) / 2)
        pairs = zip(places, one.figures, strict=True)
        points = [(x(p) + aside, f) for p, f in pairs if math.isfinite(f[0])]
        path = "".join(
            f"{'L' if i else 'M'}{u:.1f} {y(f[0]):.1f}" for i, (u, f) in enumerate(points)
        )
        body.append(f'<path d="{path}" fill="none" class="{one.colour}" {INK}/>')
        for u, (value, less, more) in points:
            if math.isfinite(less):
                body.append(_line(u, y(less), u, y(more), one.colour, INK))
            body.append(_dot(u, y(value), one.marker, one.colour))
        body += [
            _dot(WIDTH - right + 14, end, one.marker, one.colour),
            _text(WIDTH - right + 24, end + 4, one.name),
        ]
    body.append(_text(left, top + high + 56, note, "small"))
    said = "; ".join(
        f"{one.name} {', '.join(f'{f[0]:.0f}' for f in figures)}"
        for one, figures in zip(series, known, strict=True)
    )
    return _svg(top + high + 64, f"{title} at {', '.join(map(str, places))}: {said}", body)


def _apart(places: Sequence[float], gap: float) -> list[float]:
    """Places moved so far that none is nearer than a gap to the next."""
    order = sorted(range(len(places)), key=lambda i: places[i])
    found, last = [0.0] * len(places), -math.inf
    for i in order:
        last = max(places[i], last + gap)
        found[i] = last
    return found


def kept(name: str) -> Any:
    """Return what the run of a table kept."""
    return json.loads((DATA / f"{name}.json").read_text(encoding="utf-8"))


def _figure(row: Mapping[str, Any], column: str, factor: float = 1.0) -> Figure:
    value, less, more = (math.nan if v is None else factor * v for v in row[column])
    return value, less, more


#: Methods of the chart of realism: what they are called, colour, marker.
REALISM = {
    "tokens_routes_careful": ("tokens, routes, care", "green", "square"),
    "ccdiff_routes_careful": ("CCDiff, routes, care", "blue", "circle"),
    "idm": ("IDM", "orange", "triangle"),
    "ccdiff_one_sample": ("CCDiff", "blue", "circle"),
    "bits_one_sample": ("BITS", "purple", "diamond"),
    "ctgpp_one_sample": ("CTG++", "purple", "diamond"),
    "simnet_unguided": ("SimNet", "purple", "diamond"),
    "constant_velocity": ("constant velocity", "grey", "triangle"),
}
#: Planners of the dial likewise.
DIAL = {
    "lane_idm": ("IDM", "orange", "triangle"),
    "pdm": ("PDM-Closed", "purple", "diamond"),
    "ego": ("trained ego", "blue", "circle"),
}
LEVELS = {"ccdiff": 0.0, "ccdiff-0.5": 0.5, "ccdiff-1": 1.0, "ccdiff-1.5": 1.5, "ccdiff-2": 2.0}
STILL_SCENE, STILL_SIZE = "tee-crossing-01", (350, 300)


def realism() -> str:
    """Return the chart of realism."""
    rows = {row["method"]: row for row in kept("realism")["rows"]}
    shown = [
        (title, _figure(rows[name], "realism"), colour, marker)
        for name, (title, colour, marker) in REALISM.items()
    ]
    log = _figure(rows["replay"], "realism")[0]
    return rows_chart(
        "realism, 93 scenes", shown, (0.4, 0.5, 0.6, 0.7, 0.8), line=(log, "log"), form="{:.3f}"
    )


def speed() -> str:
    """Return the chart of speed."""
    rows = [
        (row["what"], (row["steps_per_s"], math.nan, math.nan), row["colour"], "circle")
        for row in kept("speed")["rows"]
    ]
    ticks = (1_000, 10_000, 100_000, 1_000_000)
    return rows_chart(
        "steps a second on one core, 64 worlds", rows, ticks, log=True, form="{:,.0f}"
    )


def dial() -> str:
    """Return the chart of the dial, with stills of one crossing."""
    run = kept("dial_planners")
    rows = {(row["planner"], row["traffic"]): row for row in run["rows"]}
    none = {"collision": [None] * 3}
    series = [
        Series(*look, [_figure(rows.get((name, t), none), "collision", 100) for t in LEVELS])
        for name, look in DIAL.items()
    ]
    return lines_chart(
        f"collisions of the planner, % of {run['scenes'].split()[0]} scenes",
        "criticality of the CCDiff traffic",
        list(LEVELS.values()),
        series,
        (0, 10, 20, 30, 40),
        note="nuScenes val, which chose no model; 95 % intervals over scenes.",
        stills=_stills(),
    )


def _stills() -> list[tuple[float, str, bytes]]:
    """One moment of one crossing at criticality 0, 1 and 2."""
    from ccdiff_env.view.render import pillow
    from ccdiff_env.view.sources import find_scene, play_scene
    from ccdiff_env.view.video import Video

    scene, found, moment = find_scene(STILL_SCENE), [], None
    for level in (1.0, 0.0, 2.0):
        run = play_scene(scene, driver="replay", ccdiff={"criticality": level})
        if moment is None:
            moment = Video(run).moment
            centre_m = (float(run.position[0, moment, 0]), float(run.position[0, moment, 1]))
        video = Video(run, size=STILL_SIZE, span_m=36.0, centre_m=centre_m, captions=False)
        image = pillow().fromarray(video.frame(min(moment, video.num_steps - 1)))
        file = io.BytesIO()
        image.quantize(96).save(file, format="PNG", optimize=True)
        found.append((level, f"criticality {level:g}", file.getvalue()))
    return sorted(found)


#: Charts by name of their file.
MADE = {"realism": realism, "speed": speed, "dial": dial}


def write() -> None:
    """Write all charts."""
    CHARTS.mkdir(exist_ok=True)
    for name, chart in MADE.items():
        (CHARTS / f"{name}.svg").write_text(chart(), encoding="utf-8")


if __name__ == "__main__":
    write()
