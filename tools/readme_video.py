"""The animation of the README: one embedded scene as recorded, and in CCDiff traffic.

``python -m tools.readme_video docs/hero.gif`` regenerates it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence

import numpy as np

from ccdiff_env.record.rollout import Rollout
from ccdiff_env.view import log_rollout, render
from ccdiff_env.view.outcome import outcome
from ccdiff_env.view.sources import find_scene, play_scene
from ccdiff_env.view.video import Video, side_by_side

SCENE, SEED = "tee-crossing-01", 0
TITLES = ("recorded", "CCDiff, realistic", "CCDiff, criticality 1")
CENTRE_M, SPAN_M = (1.0, -40.0), 46.0
PANEL = (384, 360)
TITLE_PX = 92
FIRST_STEP = 4
HOLD_S = 1.6
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
    hit = f"{outcome(played[2]).text.partition(' in ')[0]} at {last * played[-1].dt_s:.1f} s"
    fates = ["", "", hit]
    for step in steps:
        strip = side_by_side(videos, step)
        clock = [f"{step * played[-1].dt_s:.1f} s"] * len(played)
        yield np.concatenate([_titles(strip.shape[1], fates if step == last else clock), strip])


def _titles(width: int, below: Sequence[str]) -> render.Image:
    """Return the titles above the panels and a line below each [TITLE_PX, width, 3]."""
    from PIL import Image, ImageDraw, ImageFont

    line = Image.new("RGB", (width, TITLE_PX), "white")
    pen, font, small = ImageDraw.Draw(line), ImageFont.load_default(36), ImageFont.load_default(30)
    for i, title in enumerate(TITLES):
        middle = (i + 0.5) * width / len(TITLES)
        pen.text((middle, 26), title, fill="#222222", font=font, anchor="mm")
        colour = "#b3121f" if " hit " in below[i] else "#444444"
        pen.text((middle, 68), below[i], fill=colour, font=small, anchor="mm")
    return np.asarray(line)


if __name__ == "__main__":
    render.save(frames(), sys.argv[1])
