"""Pictures of a plan: its causal graph, ranks, and how far guidance moved it, over the map."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.errors import ConfigError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.system.files import write_aside
from ccdiff_env.traffic import TrafficPlan
from ccdiff_env.view.render import all_colours
from ccdiff_env.view.video import Video

RANKED = 9  #: Agents whose ranks are written, at most.
ASIDE_PX, HEAD_PX = 13.0, 7.0  #: How far arrows stay from centres, and the length of their heads.


def plan_svg(plan: TrafficPlan, *, follow: str | None = None, span_m: float = 90.0) -> str:
    """Return a picture of what a plan that ``explain()`` returned was made of, as SVG.

    An arrow from j to i says that j may influence i, those to ``follow`` (an id; the first agent by
    default) strongly. Numbers are ranks among those who may be guided; metres, how far guidance
    moved a plan by 2 s. A :class:`ConfigError` refuses the plan of a recording, which the rollout
    draws (:func:`graph_svg`).
    """
    if plan.moment is None:
        raise ConfigError(
            "this plan is of a recording: ccdiff-env view run.npz --show graph --out x.svg draws it"
        )
    scene, states, table, drivers = plan.moment
    names = [name for name, _ in table]
    run = Rollout(
        scene=scene,
        start_step=0,
        dt_s=scene.dt,
        agent_ids=tuple(scene.agent_ids),
        valid=states["active"][:, None],
        **{n: states[n][:, None] for n in ("position", "heading", "velocity")},
        elevation_m=states["elevation_m"][:, None] if "elevation_m" in states else None,
        drivers=np.array([names.index(driver) for driver in drivers], np.int64),
        driver_table=table,
        plans=(dataclasses.replace(plan, made_at=0, moment=None),),
    )
    return graph_svg(run, 0, follow=follow, span_m=span_m)


def graph_svg(run: Rollout, step: int, **options: Any) -> str:
    """Return a step of a recording as SVG with the graph of its plan, see :func:`plan_svg`.

    Options are those of :class:`~ccdiff_env.view.video.Video`. Without a plan it is a
    :class:`ConfigError`.
    """
    plan = next((p for p in reversed(run.plans) if p.made_at <= step), None)
    if plan is None:
        raise ConfigError(
            f"step {step} of {run.scene.name} follows no plan that has a causal graph"
        )
    video = Video(run, **options)
    text = video.svg(step)
    return text.replace("</svg>", "\n".join([*_overlay(run, step, plan, video), "</svg>"]))


def _overlay(run: Rollout, step: int, plan: TrafficPlan, video: Video) -> Iterator[str]:
    theme = video.theme
    colours = {name: f"#{bytes(rgb).hex()}" for name, rgb in all_colours(theme).items()}
    there = run.valid[:, step]
    places = {int(i): video.pixels(run.position[i, step], step) for i in plan.agents if there[i]}
    into, origin = np.nonzero(plan.graph & ~np.eye(len(plan.agents), dtype=bool))
    edges = [(int(plan.agents[j]), int(plan.agents[i])) for i, j in zip(into, origin, strict=True)]
    for start, end in sorted(edges, key=lambda edge: edge[1] == video.middle):
        if start in places and end in places:
            strong = end == video.middle
            yield _arrow(places[start], places[end], colours["causal arrow"], strong)
    style = 'font-family="system-ui, sans-serif" font-size="11"'
    halo = f'paint-order="stroke" stroke="{colours["paper"]}" stroke-width="3"'
    for rank, agent in enumerate(plan.ranking[:RANKED].tolist(), start=1):
        if agent in places:
            x, y = places[agent]
            yield (
                f'<circle cx="{x + 14:.1f}" cy="{y - 12:.1f}" r="7.5" fill="{colours["ink"]}"/>'
                f'<text {style} text-anchor="middle" x="{x + 14:.1f}" y="{y - 8:.1f}" '
                f'font-weight="700" fill="{colours["paper"]}">{rank}</text>'
            )
    for row in np.flatnonzero(plan.guided).tolist():
        agent = int(plan.agents[row])
        moved = None if plan.moved_m is None else float(plan.moved_m[row])
        if agent in places and moved is not None and np.isfinite(moved):
            x, y = places[agent]
            yield (
                f'<text {style} {halo} text-anchor="end" x="{x - 16:.1f}" y="{y + 4:.1f}" '
                f'fill="{colours["ink"]}">moved {moved:.1f} m</text>'
            )


def _arrow(start: Any, end: Any, colour: str, strong: bool) -> str:
    way = np.subtract(end, start)
    long = max(float(np.hypot(*way)), 1e-3)
    unit, aside = way / long, min(ASIDE_PX, 0.2 * long)  # of neighbours it lies over their bodies
    tail, tip = start + aside * unit, end - aside * unit
    left = np.array([-unit[1], unit[0]]) * HEAD_PX / 2
    base = tip - min(HEAD_PX, 0.5 * long) * unit
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in (tip, base + left, base - left))
    look = f'stroke="{colour}" stroke-width="{2 if strong else 1}"'
    return (
        f'<g opacity="{0.95 if strong else 0.3}"><line x1="{tail[0]:.1f}" y1="{tail[1]:.1f}" '
        f'x2="{base[0]:.1f}" y2="{base[1]:.1f}" {look}/>'
        f'<polygon points="{points}" fill="{colour}"/></g>'
    )


def save_plan(plan: TrafficPlan, path: str | Path, **options: Any) -> None:
    """Write :func:`plan_svg`, which takes the options, to a file that ends in ``.svg``."""
    if Path(path).suffix.lower() != ".svg":
        raise ConfigError(f"path is {path}, expected a file that ends in .svg")
    write_aside(Path(path), plan_svg(plan, **options))
