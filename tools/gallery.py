"""The gallery of the site: embedded scenes in critical and in realistic CCDiff traffic.

``python -m tools.gallery docs/site/gallery`` writes the pages and their index.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.embedded import embedded_scenes
from ccdiff_env.view.index import write_index
from ccdiff_env.view.outcome import outcome
from ccdiff_env.view.sources import play_scene

TITLES = ("criticality 1", "realistic")
HOME = ("../index.html", "documentation")  #: Page above the index: the site's.


def write_gallery(folder: Path, scenes: Sequence[Scene] = ()) -> Path:
    """Write a page for each scene in which criticality makes the difference: in critical traffic
    the ego collides or leaves the road, in realistic traffic it reaches its goal and nobody
    collides. Pages of an ego that is not at fault come first. Returns the index.

    The ego follows its log in both runs: the traffic alone differs.
    """
    scenes = scenes or [*embedded_scenes("val"), *embedded_scenes("train")]
    shown = []
    for scene in scenes:
        pair = [
            play_scene(scene, traffic="ccdiff", driver="replay", ccdiff={"criticality": level})
            for level in (1.0, 0.0)
        ]
        critical, calm = map(outcome, pair)
        if critical.tone == "bad" and (calm.tone, calm.others) == ("good", 0):
            shown.append((critical.fault != "not at fault", (scene.name, TITLES, pair)))
    shown.sort(key=lambda entry: entry[0])
    title = f"Gallery, {len(shown)} of {len(scenes)} scenes: criticality makes the ego collide"
    return write_index((page for _, page in shown), folder, title, home=HOME)


if __name__ == "__main__":
    print(write_gallery(Path(sys.argv[1])))
