"""The gallery of the site: embedded scenes in critical and in realistic CCDiff traffic.

``python -m tools.gallery docs/site/gallery`` writes 30 pages and their index.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.embedded import embedded_scenes
from ccdiff_env.view.index import write_index
from ccdiff_env.view.outcome import outcome
from ccdiff_env.view.sources import play_scene

NUM_PAGES = 30
TITLES = ("criticality 1", "realistic")
HOME = ("../index.html", "documentation")  #: Page above the index: the site's.
MOVES_MPS = 0.5  #: An ego that is slower when it is hit stood.
RANKS = (False, True)  #: Whether the ego was at fault, what is shown first.


def write_gallery(folder: Path, scenes: Sequence[Scene] = ()) -> Path:
    """Write the pages, those that tell the story first; returns the index.

    The ego follows its log in both runs: the traffic alone differs.
    """
    scenes = scenes or [*embedded_scenes("val"), *embedded_scenes("train")]
    runs = [
        tuple(
            play_scene(scene, traffic="ccdiff", driver="replay", ccdiff={"criticality": level})
            for level in (1.0, 0.0)
        )
        for scene in scenes
    ]
    runs = sorted(runs, key=lambda pair: _rank(*pair))[:NUM_PAGES]
    shown = ((pair[0].scene.name, TITLES, pair) for pair in runs)
    return write_index(shown, folder, "Gallery: the ego follows its log", home=HOME)[0]


def _rank(critical: Rollout, realistic: Rollout) -> tuple[int, float]:
    """Place in the gallery: an ego that reaches its goal in realistic traffic, where nobody
    collides, and is hit while it moves in critical traffic; it is better not to blame.
    """
    calm, fate = outcome(realistic), outcome(critical)
    hit = critical.collisions("ego")
    if not hit or calm.tone != "good" or calm.others or fate.tone != "bad":
        return len(RANKS), 0.0
    speed = float(np.linalg.norm(critical.velocity[0, max(hit[0].step - 1, 0)]))
    return (RANKS.index(hit[0].at_fault) if speed > MOVES_MPS else len(RANKS)), -speed


if __name__ == "__main__":
    print(write_gallery(Path(sys.argv[1])))
