"""The animations of docs/tasks.md: one recorded episode of each task.

``python -m tools.task_videos docs`` writes ``task_ego.gif``, ``task_selection.gif`` and
``task_multi_agent.gif``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from ccdiff_env import AdversarySelectionEnv, Recorder, Rollout, parallel_env, planners
from ccdiff_env.view import render
from ccdiff_env.view.captions import DRIVER_TITLES, driver_of
from ccdiff_env.view.sources import find_scene, play_scene
from ccdiff_env.view.video import Video

__all__ = ["RUNS"]

SEED = 0
LAST_STEP = 60
HOLD = 8
"""Images for which the end stays."""
SIZE, STRIP_PX = (640, 330), 28


def ego() -> Rollout:
    """Return an episode of the shipped ego in critical CCDiff traffic."""
    scene = find_scene("left-turn-04")
    return play_scene(scene, driver="ego", seed=SEED, ccdiff={"criticality": 1.0})


def selection() -> Rollout:
    """Return an episode in which guidance moves the nearest vehicle of each plan."""
    env = AdversarySelectionEnv(scenes=find_scene("cut-in-04"), ego="replay")
    env.reset(seed=SEED)
    recorder, done = Recorder(env), False
    while not done:
        _, _, terminated, truncated, _ = env.step(0)
        done = terminated or truncated
    return recorder.rollout()


def multi_agent() -> Rollout:
    """Return an episode of four vehicles, each driven by the shipped ego, among IDM's."""
    policy = planners.load("ego")
    env = parallel_env(
        scenes=find_scene("tee-crossing-04"),
        config=policy.config.with_options(decision_steps=1),
        agents=4,
        traffic="idm",
    )
    observations, _ = env.reset(seed=SEED)
    recorder, step = Recorder(env), 0
    while env.agents:
        if step % policy.config.decision_steps == 0:
            rows = policy.act(np.stack([observations[name] for name in env.agents]))
            held = dict(zip(env.agents, rows, strict=True))
        observations, *_ = env.step({name: held[name] for name in env.agents})
        recorder.step()
        step += 1
    return recorder.rollout()


#: Episodes by name of the task.
RUNS = {"ego": ego, "selection": selection, "multi_agent": multi_agent}


def write(folder: Path) -> None:
    """Write the three files."""
    for name, run in RUNS.items():
        played = run()
        last = min(played.num_steps - 1, LAST_STEP)
        # an image that stands still makes a small file
        way_m = played.position[0, : last + 1][played.valid[0, : last + 1]]
        x_m, y_m = (way_m.min(axis=0) + way_m.max(axis=0)) / 2
        short_m, long_m = sorted(map(float, np.ptp(way_m, axis=0)))
        lies = np.ptp(way_m[:, 0]) > np.ptp(way_m[:, 1])
        video = Video(
            played,
            size=SIZE,
            span_m=max(long_m, 2.0 * short_m, 30.0) + 40.0,
            centre_m=(float(x_m), float(y_m)),
            up_rad=np.pi / 2 if lies else np.pi,
            captions=False,
        )
        words = _words(played)
        steps = [*range(0, last, 2), *[last] * HOLD]
        frames = (np.concatenate([words, video.frame(step)]) for step in steps)
        render.save(frames, folder / f"task_{name}.gif", fps=5)


def _words(played: Rollout) -> render.Image:
    """What the colours mean, in a line above the images [STRIP_PX, width, 3]."""
    from PIL import Image, ImageDraw, ImageFont

    kinds = played.scene.agent_types
    drivers = {driver_of(played, i) for i, kind in enumerate(kinds) if kind == "vehicle"}
    line = Image.new("RGB", (SIZE[0], STRIP_PX), "white")
    pen, font, x = ImageDraw.Draw(line), ImageFont.load_default(15), 12.0
    for name, title in DRIVER_TITLES.items():
        if name in drivers:
            pen.rounded_rectangle((x, 9, x + 18, 19), 3, fill=render.legend()[name])
            pen.text((x + 24, 14), title, fill="#222222", font=font, anchor="lm")
            x += 24 + pen.textlength(title, font=font) + 20
    return np.asarray(line)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
