"""The animation of the README: one embedded scene as recorded, and in CCDiff traffic.

``python -m tools.readme_video docs/hero.gif`` makes it anew.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np

from ccdiff_env.record.rollout import Rollout
from ccdiff_env.view import log_rollout, render
from ccdiff_env.view.sources import find_scene, play_scene
from ccdiff_env.view.video import Video, side_by_side

SCENE, SEED = "left-turn-00", 0
TITLES = ("recorded", "CCDiff, realistic", "CCDiff, criticality 1")
CENTRE_M, SPAN_M = (6.0, -53.0), 54.0
PANEL = (384, 360)
TITLE_PX = 40
FIRST_STEP = 18
HOLD_S = 1.2
"""The image rests at the collision, whose vehicles have a red outline."""


def runs() -> tuple[Rollout, Rollout, Rollout]:
    """Return the three runs; the ego follows its log in all of them."""
    scene = find_scene(SCENE)
    realistic, critical = (
        play_scene(scene, driver="replay", seed=SEED, ccdiff={"criticality": level})
        for level in (0.0, 1.0)
    )
    return log_rollout(scene, like=realistic), realistic, critical


def frames() -> Iterator[render.Image]:
    """Yield images [H, W, 3] up to the collision, at which the last run ends."""
    played = runs()
    videos = [
        Video(run, size=PANEL, span_m=SPAN_M, centre_m=CENTRE_M, captions=False) for run in played
    ]
    last = played[-1].num_steps - 1
    steps = [*range(FIRST_STEP, last), *[last] * round(HOLD_S / played[-1].dt_s)]
    title = None
    for step in steps:
        strip = side_by_side(videos, step)
        title = _titles(strip.shape[1]) if title is None else title
        yield np.concatenate([title, strip])


def _titles(width: int) -> render.Image:
    """Return the line of titles above the panels [TITLE_PX, width, 3]."""
    from PIL import Image, ImageDraw, ImageFont

    line = Image.new("RGB", (width, TITLE_PX), "white")
    pen, font = ImageDraw.Draw(line), ImageFont.load_default(22)
    for i, title in enumerate(TITLES):
        middle = (i + 0.5) * width / len(TITLES)
        pen.text((middle, TITLE_PX / 2), title, fill="#222222", font=font, anchor="mm")
    return np.asarray(line)


if __name__ == "__main__":
    render.save(frames(), sys.argv[1])
