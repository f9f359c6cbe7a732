"""The animations of docs/tasks.md: one recorded episode of each task.

``python -m tools.task_videos docs`` writes ``task_ego.gif``, ``task_selection.gif`` and
``task_multi_agent.gif`` anew.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from ccdiff_env import AdversarySelectionEnv, Recorder, Rollout, parallel_env, policies
from ccdiff_env.view import render
from ccdiff_env.view.sources import find_scene, play_scene
from ccdiff_env.view.video import Video

__all__ = ["RUNS"]

SEED = 0
LAST_STEP = 60
HOLD = 10
"""Images for which the end stays."""


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
    policy = policies.load("ego")
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
        # an image that stands still makes a small file; the end matters most
        way_m = played.position[0, : last + 1][played.valid[0, : last + 1]]
        x_m, y_m = way_m[3 * len(way_m) // 4]
        video = Video(played, size=(480, 270), span_m=85.0, centre_m=(float(x_m), float(y_m)))
        steps = [*range(last), *[last] * HOLD]
        render.save((video.frame(step) for step in steps), folder / f"task_{name}.gif", fps=10)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
