"""Heat maps of reports: scenes x traffic of each planner, a cell for each score."""

from __future__ import annotations

import html
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ccdiff_env.bench.planners import TRAFFIC
from ccdiff_env.view.link import MAX_CRITICALITY

__all__ = ["heat_maps"]

Row = Mapping[str, Any]
#: Maps with more scenes than this have no figures in their cells.
LEGIBLE = 40


def heat_maps(
    found: Mapping[tuple[str, str], Sequence[Row]],
    pages: Mapping[tuple[str, str, str], str],
    source: str,
    titles: Mapping[str, str],
) -> str:
    """Return a heat map of each planner as HTML, the first one open.

    A cell is the mean score over seeds; it leads to its replay or, where there is none, its title
    has the command that plays it.

    Parameters
    ----------
    found
        Rows per scene and seed of every planner in every traffic.
    pages
        Addresses of replays by planner, traffic and scene.
    source
        Text of the scenes, for the commands.
    titles
        Of the planners.
    """
    planners = list(dict.fromkeys(planner for planner, _ in found))
    traffic = list(dict.fromkeys(name for _, name in found))
    maps = []
    for planner in planners:
        means = {name: _means(found[planner, name]) for name in traffic}
        scenes = sorted(means[traffic[0]], key=lambda s: np.mean([means[t][s] for t in traffic]))
        dense = len(scenes) > LEGIBLE
        heads = "".join(
            f'<th scope="col"><span>{html.escape(TRAFFIC[name].label)}</span></th>'
            for name in traffic
        )
        rows = "\n".join(
            f'<tr><th scope="row">{html.escape(scene)}</th>'
            + "".join(
                _cell(means[t][scene], pages.get((planner, t, scene)), dense,
                      _command(planner, t, scene, source))
                for t in traffic
            )
            + "</tr>"
            for scene in scenes
        )  # fmt: skip
        kind = "heat dense" if dense else "heat"
        opened = " open" if planner == planners[0] else ""
        maps.append(
            f"<details{opened}><summary>{html.escape(titles[planner])}, scene by scene"
            f'</summary><div class="wide" tabindex="0" role="region" '
            f'aria-label="scores of {html.escape(titles[planner], quote=True)} by scene">'
            f'<table class="{kind}"><thead><tr><th scope="col">scene</th>{heads}</tr></thead>'
            f"<tbody>\n{rows}\n</tbody></table></div></details>"
        )
    return "\n".join(maps)


def _means(rows: Sequence[Row]) -> dict[str, float]:
    """Score of each scene, mean over seeds."""
    seeds: dict[str, list[float]] = {}
    for row in rows:
        seeds.setdefault(row["scene"], []).append(row["score"])
    return {scene: float(np.mean(scores)) for scene, scores in seeds.items()}


def _cell(score: float, page: str | None, dense: bool, command: str) -> str:
    shown = "" if dense else f"{score:.2f}"
    if page is not None:
        shown = f'<a href="{html.escape(page, quote=True)}">{shown or "▸"}</a>'
    said = html.escape(f"{score:.2f}; {command}", quote=True)
    return f'<td style="--v:{score:.2f}" title="{said}">{shown}</td>'


def _command(planner: str, traffic: str, scene: str, source: str) -> str:
    """The command that plays a scene in a traffic; of its options it has criticality alone."""
    kind = TRAFFIC[traffic]
    words = ["ccdiff-env", "view", scene, "--scenes", source]
    words += ["--driver", planner, "--traffic", kind.driver]
    level = float(kind.ccdiff.get("criticality", 0.0))
    if 0.0 < level <= MAX_CRITICALITY:
        words += ["--criticality", f"{level:g}"]
    return shlex.join(words)
