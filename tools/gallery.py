"""The gallery of the site: scenes in critical and in realistic CCDiff traffic.

``python -m tools.gallery docs/site/gallery`` writes the pages and their index. Where CCDIFF_DATA
names a folder with nuScenes, its validation scenes are tried, too.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from ccdiff_env.errors import SceneError
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.embedded import embedded_scenes
from ccdiff_env.scenes.sources import Place, load
from ccdiff_env.view.index import write_index
from ccdiff_env.view.outcome import outcome
from ccdiff_env.view.sources import play_scene

TITLES = ("criticality 1", "realistic")
HOME = ("../index.html", "documentation")  #: Page above the index: the site's.
TRIED = 30  #: Scenes of nuScenes.


def scenes_here() -> list[Scene]:
    """Return the embedded scenes, and those of nuScenes where there are data."""
    data = os.environ.get("CCDIFF_DATA")
    found = [*embedded_scenes("val"), *embedded_scenes("train")]
    if data:
        place = Place("nuscenes", f"{data}/nuscenes", "v1.0-trainval", "val", limit=TRIED)
        found += load(place)
    return found


def write_gallery(folder: Path, scenes: Sequence[Scene] = ()) -> Path:
    """Write a page for each scene in which criticality makes the difference for IDM: in critical
    traffic it collides or leaves the road, in realistic traffic it reaches its goal and nobody
    collides. Pages of an ego that is hit come first. Returns the index.
    """
    scenes = scenes or scenes_here()
    shown, known = [], 0
    for scene in scenes:
        try:
            pair = [
                play_scene(scene, traffic="ccdiff", driver="idm", ccdiff={"criticality": level})
                for level in (1.0, 0.0)
            ]
        except SceneError:  # too short, or without an ego
            continue
        known += 1
        critical, calm = map(outcome, pair)
        if critical.tone == "bad" and (calm.tone, calm.others) == ("good", 0):
            rank = (critical.mishap != "is hit", critical.fault == "at fault")
            shown.append((rank, (scene.name, TITLES, pair)))
    shown.sort(key=lambda entry: entry[0])
    title = f"Gallery, {len(shown)} of {known} scenes: criticality makes IDM collide"
    return write_index((page for _, page in shown), folder, title, home=HOME)


if __name__ == "__main__":
    print(write_gallery(Path(sys.argv[1])))
