"""What notebooks show of scenes, sets of scenes and rollouts: their ``_repr_html_``."""

from __future__ import annotations

import html

from ccdiff_env.errors import MissingFeatureError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.system.table import Table
from ccdiff_env.system.terminal import counted

HEIGHT = 560  #: Of the frame that a replay is shown in, pixels.
HEADS = ("scene", "location", "seconds", "agents", "vehicles")  #: Of tables of scenes.
ROWS = 30  #: Scenes of a set that are listed, at most.


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


def scene_html(scene: Scene) -> str:
    """Return an image of the middle of the log, and one line on the scene."""
    # imported here: most programs show no notebook
    from ccdiff_env.view.render import data_address

    name, location, seconds, agents, _ = scene_row(scene)
    parts = [name, location, f"{seconds} s", counted(int(agents), "agent")]
    line = html.escape(" · ".join(part for part in parts if part))
    centre = "ego" if "ego" in scene.agent_ids else (0.0, 0.0)
    image = scene.render(scene.num_steps // 2, size=(560, 360), centre=centre)
    try:
        return f'<img src="{data_address(image, 64)}" alt="{line}"><p>{line}</p>'
    except MissingFeatureError:
        return f"<p>{line}</p>"


def scene_set_html(scenes: SceneSet) -> str:
    """Return a table of the scenes."""
    more = f"\nand {len(scenes) - ROWS} more" if len(scenes) > ROWS else ""
    table = Table(HEADS, [scene_row(scene) for scene in scenes[:ROWS]])
    return f"<pre>{counted(len(scenes), 'scene')}\n\n{html.escape(str(table))}{more}</pre>"


def scene_row(scene: Scene) -> tuple[str, ...]:
    """Return name, location, seconds, agents and vehicles of a scene."""
    seconds = f"{(scene.num_steps - 1) * scene.dt:.1f}"
    vehicles = scene.agent_types.count("vehicle")
    return scene.name, scene.location, seconds, str(scene.num_agents), str(vehicles)


Rollout._repr_html_ = rollout_html  # type: ignore[attr-defined]
Scene._repr_html_ = scene_html  # type: ignore[attr-defined]
SceneSet._repr_html_ = scene_set_html  # type: ignore[attr-defined]
