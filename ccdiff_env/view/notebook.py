"""What notebooks show of scenes and rollouts: their ``_repr_html_``."""

from __future__ import annotations

import html

from ccdiff_env.errors import MissingFeatureError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene

HEIGHT = 560  #: Of the frame that a replay is shown in, pixels.


def rollout_html(rollout: Rollout) -> str:
    """Return the replay page in a frame that can do nothing but run its own scripts."""
    # imported here: most programs show no notebook
    from ccdiff_env.view.page import page_html

    page = html.escape(page_html(rollout), quote=True)
    return (
        f'<iframe sandbox="allow-scripts" title="{html.escape(repr(rollout), quote=True)}" '
        f'style="width: 100%; height: {HEIGHT}px; border: 1px solid #8888; border-radius: 8px" '
        f'srcdoc="{page}"></iframe>'
    )


def scene_html(scene: Scene) -> str | None:
    """Return an image of the middle of the log; nothing where Pillow is not installed."""
    # imported here: most programs show no notebook
    from ccdiff_env.view.render import data_address

    centre = "ego" if "ego" in scene.agent_ids else (0.0, 0.0)
    image = scene.render(scene.num_steps // 2, size=(560, 360), centre=centre)
    line = html.escape(repr(scene), quote=True)
    try:
        return f'<img src="{data_address(image, 64)}" alt="{line}"><p>{line}</p>'
    except MissingFeatureError:
        return None


Rollout._repr_html_ = rollout_html  # type: ignore[attr-defined]
Scene._repr_html_ = scene_html  # type: ignore[attr-defined]
