"""Pictures of one crossing: ``python -m tools.pictures`` writes those of README and docs.

``hero.gif`` has it three times, ``view.png`` beside its log; ``saved.png`` says of a drive that
ended in a collision who caused it, and what would have saved it; ``crossing.png`` is the axis of
the chart of the dial.
"""

from __future__ import annotations

import argparse
import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.record.counterfactual import with_rescue
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene
from ccdiff_env.view import render
from ccdiff_env.view.captions import guided_agents
from ccdiff_env.view.link import play_keys, world_config
from ccdiff_env.view.outcome import outcome
from ccdiff_env.view.sources import find_scene, log_rollout, play_scene
from ccdiff_env.view.video import GAP, HOLD_S, Video, side_by_side
from tools.charts import CHARTS
from tools.pages import ROOT

DOCS = ROOT / "docs"
HERO = "double-left-00"
LEVELS = (0.0, 1.0, 2.0)
PREVIEW = (1200, 630)  #: Pixels of a picture that goes with a link.


def _font(size: int) -> Any:
    from matplotlib import font_manager
    from PIL import ImageFont

    return ImageFont.truetype(font_manager.findfont("DejaVu Sans"), size)


def _headed(image: render.Image, title: str, line: str) -> render.Image:
    """An image below a title and a line."""
    from PIL import Image, ImageDraw

    head = Image.new("RGB", (image.shape[1], 92), "#ffffff")
    draw, x = ImageDraw.Draw(head), image.shape[1] / 2
    draw.text((x, 30), title, "#1d242c", _font(30), anchor="mm")
    draw.text((x, 70), line, "#5c6672", _font(26), anchor="mm")
    return np.concatenate([np.asarray(head), image])


def _seen(scene: Scene) -> list[Rollout]:
    """Episodes of an ego that follows its log, by criticality."""
    return [
        play_scene(scene, traffic="ccdiff", driver="replay", ccdiff={"criticality": level})
        for level in LEVELS
    ]


def write_hero(path: Path, runs: list[Rollout]) -> None:
    """Write the crossing as recorded, in realistic and in critical traffic, to its contact."""
    calm, critical = runs[:2]
    last = round(outcome(critical).decided_s / critical.dt_s)
    titles = ("recorded", "CCDiff, realistic", "CCDiff, criticality 1")
    shown = [log_rollout(calm.scene, like=critical), calm, critical]
    videos = [Video(run, size=(384, 360), span_m=48.0, captions=False) for run in shown]
    gap = np.full((452, GAP, 3), 255, np.uint8)
    frames = []
    for step in range(last + 1):
        line = f"{step * critical.dt_s:.1f} s"
        panes = [
            _headed(video.frame(step), title, line)
            for video, title in zip(videos, titles, strict=True)
        ]
        frames.append(np.concatenate([panes[0], gap, panes[1], gap, panes[2]], axis=1))
    render.save_gif(np.stack(frames + frames[-1:] * round(10 * HOLD_S)), path, 10.0)


def write_crossing(path: Path, runs: list[Rollout]) -> None:
    """Write the moment of the contact at criticality 1 in all worlds, from left to right."""
    step = round(outcome(runs[1]).decided_s / runs[1].dt_s)
    images = []
    for run in runs:
        video = Video(run, size=(300, 240), span_m=32.0, captions=False)
        images.append(video.frame(min(step, video.num_steps - 1)))
    render.pillow().fromarray(np.concatenate(images, axis=1)).save(path, optimize=True)


def write_view(path: Path, run: Rollout) -> None:
    """Write the contact beside the log."""
    pair = [
        Video(of, size=(480, 400), span_m=60.0, title=title)
        for of, title in ((run, "criticality 1"), (log_rollout(run.scene, like=run), "log"))
    ]
    render.pillow().fromarray(side_by_side(pair, pair[0].moment)).save(path, optimize=True)


def write_saved(path: Path, scene: Scene) -> None:
    """Write a drive that was hit: the plan of the attacker and its influence, both at criticality
    0, and a plan that would have saved the ego.
    """
    from matplotlib import pyplot as plt
    from matplotlib.patches import FancyArrowPatch, Polygon

    hit, calm = (
        play_keys(scene, (), world_config("ccdiff", level), goes_on=True) for level in (1.0, 0.0)
    )
    contact = hit.collisions("ego")[0]
    step, ids = contact.step, list(hit.agent_ids)
    pair = ego, other = ids.index("ego"), ids.index(str(contact.partner_id))
    assert ids[other] in guided_agents(hit), f"{scene.name}: nobody is guided into the ego"
    rescue = with_rescue(hit).meta["rescue"]
    plan = [p for p in hit.plans if other in p.agents and p.made_at <= step][-1]
    row = list(plan.agents).index(other)
    colours = {n: np.array(rgb) / 255.0 for n, rgb in render.all_colours("light").items()}
    width, height = PREVIEW
    span = 44.0
    centre = hit.position[ego, step] + (0.0, 1.5)
    at_m = tuple(centre.tolist())
    video = Video(hit, size=PREVIEW, span_m=span, centre_m=at_m, captions=False)
    figure = plt.figure(figsize=(width / 100, height / 100), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1))
    half = np.array([span, span * height / width]) / 2
    (left, bottom), (right, top) = centre - half, centre + half
    axes.imshow(video.frame(step), extent=(left, right, bottom, top), interpolation="none")
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.axis("off")

    def ghost(agent: int, pose: Any, colour: Any, inside: float = 0.25) -> None:
        corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * scene.sizes[agent, :2] / 2
        c, s = np.cos(pose[2]), np.sin(pose[2])
        corners = corners @ np.array([[c, s], [-s, c]]) + pose[:2]
        axes.add_patch(Polygon(corners, facecolor=(*colour, inside), edgecolor="none", zorder=3))
        axes.add_patch(Polygon(corners, fill=False, edgecolor=colour, lw=2.5, ls="--", zorder=4))

    def say(text: str, at: Any, place: tuple[float, float], colour: Any) -> None:
        axes.annotate(
            textwrap.fill(text, 26), at, xytext=place, textcoords="axes fraction",
            color="#1d242c", fontsize=17,
            va="center", zorder=6, bbox={"boxstyle": "round,pad=0.4", "fc": "white", "ec": colour},
            arrowprops={"arrowstyle": "-", "color": colour, "lw": 1.8},
        )  # fmt: skip

    way = plan.samples[plan.selected_sample[row], row, :, :2]
    way = np.concatenate([hit.position[None, other, plan.made_at], way])
    for agent, colour in zip(pair, ("ego", "ccdiff"), strict=True):
        pose = (*calm.position[agent, step], calm.heading[agent, step])
        ghost(agent, pose, colours[colour])
    say("at criticality 0", calm.position[other, step], (0.05, 0.3), colours["ccdiff"])
    if "path" in rescue:
        path_m = np.array(rescue["path"])
        at = min(step - rescue["step"], len(path_m) - 1)
        axes.plot(*path_m[:, :2].T, color="white", lw=3, ls=(0, (2, 1.2)), zorder=4)
        ghost(ego, path_m[at], np.ones(3), 0.35)
        say(rescue["text"], path_m[at, :2], (0.62, 0.66), np.zeros(3))
    axes.add_patch(
        FancyArrowPatch(
            hit.position[other, step], hit.position[ego, step], color=colours["causal arrow"],
            arrowstyle="-|>", mutation_scale=26, lw=3, connectionstyle="arc3,rad=-0.3", zorder=5,
        )
    )  # fmt: skip
    say("its plan, guided", way[len(way) // 2], (0.05, 0.7), colours["adversary"])
    say(outcome(hit).text.replace("ego ", "you: "), hit.position[ego, step], (0.62, 0.3),
        colours["collision"])  # fmt: skip
    axes.text(
        0.03, 0.93, "It hit me; I could have avoided it", transform=axes.transAxes, fontsize=27,
        fontweight="bold", va="center", zorder=7,
        bbox={"boxstyle": "round,pad=0.35", "fc": "white", "ec": "none"},
    )  # fmt: skip
    figure.savefig(path, dpi=100)
    plt.close(figure)


def write() -> None:
    """Write all pictures."""
    runs = _seen(find_scene(HERO))
    write_hero(DOCS / "hero.gif", runs)
    write_crossing(CHARTS / "crossing.png", runs)
    write_view(DOCS / "view.png", runs[1])
    write_saved(DOCS / "saved.png", find_scene(HERO))


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    write()
