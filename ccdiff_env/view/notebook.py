"""What notebooks show of rollouts, plans and scenes: their ``_repr_html_`` and ``_repr_svg_``.

What draws is imported when it is asked for: most programs show no notebook.
"""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene
from ccdiff_env.traffic import TrafficPlan

HEIGHT = 560  #: Of the frame that a replay is shown in, pixels.


def rollout_html(rollout: Rollout) -> str:
    """Return the replay page in a frame that can do nothing but run its own scripts."""
    from ccdiff_env.view.page import page_html

    page = html.escape(page_html(rollout), quote=True)
    return (
        f'<iframe sandbox="allow-scripts" title="{html.escape(repr(rollout), quote=True)}" '
        f'style="width: 100%; height: {HEIGHT}px; border: 1px solid #8888; border-radius: 8px" '
        f'srcdoc="{page}"></iframe>'
    )


def scene_svg(scene: Scene) -> str:
    """Return an image of the scene's log, in its middle."""
    from ccdiff_env.view.sources import log_rollout
    from ccdiff_env.view.video import Video

    return Video(log_rollout(scene)).svg(scene.num_steps // 2)


def plan_svg(plan: TrafficPlan) -> str | None:
    """Return :func:`ccdiff_env.view.graph.plan_svg`; ``None`` of a plan of a recording."""
    from ccdiff_env.view import graph

    return None if plan.moment is None else graph.plan_svg(plan)


def save_plan(plan: TrafficPlan, path: str | Path, **options: Any) -> None:
    """Write the plan's picture (``.svg``), see :func:`ccdiff_env.view.graph.plan_svg`."""
    from ccdiff_env.view import graph

    graph.save_plan(plan, path, **options)


Rollout._repr_html_ = rollout_html  # type: ignore[attr-defined]
Scene._repr_svg_ = scene_svg  # type: ignore[attr-defined]
TrafficPlan._repr_svg_ = plan_svg  # type: ignore[attr-defined]
TrafficPlan.save = save_plan  # type: ignore[attr-defined]
