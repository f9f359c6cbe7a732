"""The gallery of the site: scenes in critical and in realistic CCDiff traffic.

``python -m tools.gallery docs/site/gallery`` writes the pages and their index; with two planners
at the end, as ``ppo pdm``, scenes in which the first does better, or worse, at criticality 1.
Where CCDIFF_DATA names a folder with nuScenes, its validation scenes are tried, too.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.errors import DatasetError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.scenes.embedded import embedded_scenes
from ccdiff_env.scenes.sources import Place, load
from ccdiff_env.view.captions import planner_title
from ccdiff_env.view.index import Shown, write_index
from ccdiff_env.view.outcome import outcome

TITLES = ("criticality 1", "realistic")
DRIVERS = ("idm", "pdm", "ego", "ppo")  #: Who drives the ego.
HOME = ("../index.html", "documentation")  #: Page above the index: the site's.
TRIED = 30  #: Scenes of nuScenes.
EACH = 5  #: Scenes that one planner wins, and that it loses.


def scenes_here() -> list[Scene]:
    """Return the embedded scenes, and those of nuScenes where there are data."""
    found = [*embedded_scenes("val"), *embedded_scenes("train")]
    if data := os.environ.get("CCDIFF_DATA"):
        found += load(Place("nuscenes", f"{data}/nuscenes", "v1.0-trainval", "val", limit=TRIED))
    return found


def driven(
    scenes: Sequence[Scene], driver: str, traffic: str
) -> tuple[dict[str, float], dict[str, Rollout]]:
    """Return scores and episodes by scene, as ``bench planners`` drives them."""
    names = [scene.name for scene in scenes]
    rows, rollouts = drive(SceneSet([*scenes]), driver, TRAFFIC[traffic], record=names)
    return {row["scene"]: row["score"] for row in rows}, rollouts


def write_gallery(folder: Path, scenes: Sequence[Scene]) -> Path:
    """Write a page for each scene in which criticality makes the difference for one of
    :data:`DRIVERS`: in critical traffic it collides or leaves the road, in realistic traffic it
    reaches its goal and nobody collides. Each drives about as often. Pages of an ego that is hit
    come first. Returns the index.
    """
    found: dict[str, list[tuple[tuple[bool, bool], int, list[Rollout]]]] = {}
    for number, driver in enumerate(DRIVERS):
        critical, calm = (driven(scenes, driver, name)[1] for name in ("ccdiff-1", "ccdiff"))
        for name, run in critical.items():
            fate, other = outcome(run), outcome(calm[name])
            if fate.tone == "bad" and (other.tone, other.others) == ("good", 0):
                rank = (fate.mishap != "is hit", fate.fault == "at fault")
                found.setdefault(name, []).append((rank, number, [run, calm[name]]))
    times, shown = [0] * len(DRIVERS), list[tuple[tuple[bool, bool], Shown]]()
    for name, pairs in found.items():
        rank, number, pair = min(pairs, key=lambda of: (of[0], times[of[1]], of[1]))
        times[number] += 1
        shown.append((rank, (name, TITLES, pair)))
    shown.sort(key=lambda entry: entry[0])
    title = f"Gallery: criticality makes the ego collide in {len(shown)} of {len(scenes)} scenes"
    return write_index((page for _, page in shown), folder, title, home=HOME)


def write_duel(folder: Path, scenes: Sequence[Scene], one: str, other: str) -> Path:
    """Write pages of two planners side by side: at most :data:`EACH` scenes in which the first one
    scores most above the other, and as many in which it scores most below. Returns the index.
    """
    (mine, runs), (theirs, others) = (driven(scenes, of, "ccdiff-1") for of in (one, other))
    less = {name: score - theirs[name] for name, score in mine.items()}
    order = sorted(less, key=less.__getitem__)
    wins = [name for name in order[: -EACH - 1 : -1] if less[name] > 0.0]
    losses = [name for name in order[:EACH] if less[name] < 0.0]
    titles = (planner_title(one), planner_title(other))
    means = [f"{sum(of.values()) / len(of):.2f}" for of in (mine, theirs)]
    title = f"{titles[0]} (mean score {means[0]}) beside {titles[1]} ({means[1]}): "
    title += f"{len(wins)} scenes that it wins, {len(losses)} that it loses"
    shown = ((n, titles, [runs[n], others[n]]) for n in [*wins, *losses])
    return write_index(shown, folder, title, home=HOME)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where pages and index are written")
    parser.add_argument("planners", nargs="*", metavar="PLANNER", help="two, to be compared")
    args = parser.parse_args()
    if len(args.planners) not in (0, 2):
        parser.error(f"{len(args.planners)} planners, expected two or none")
    try:
        scenes = scenes_here()
    except DatasetError as error:
        parser.exit(2, f"CCDIFF_DATA: {error}\n")
    write = write_duel if args.planners else write_gallery
    print(write(args.folder, scenes, *args.planners))
