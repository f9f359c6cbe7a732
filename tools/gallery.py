"""The gallery of the site: embedded scenes in critical and in realistic CCDiff traffic.

``python -m tools.gallery docs/site/gallery`` writes 30 pages and their index.
"""

from __future__ import annotations

import sys
from itertools import islice
from pathlib import Path

from ccdiff_env.scenes.embedded import embedded_scenes
from ccdiff_env.view import write_page
from ccdiff_env.view.index import entry, index_page
from ccdiff_env.view.sources import play_scene

NUM_PAGES = 30
TITLES = ("criticality 1", "realistic")


def write_gallery(folder: Path, num_pages: int = NUM_PAGES) -> Path:
    """Write the pages, held-out scenes first; IDM drives the ego. Returns the index."""
    folder.mkdir(parents=True, exist_ok=True)
    scenes = [*embedded_scenes("val"), *embedded_scenes("train")]
    entries = []
    for scene in islice(scenes, num_pages):
        critical, realistic = (
            play_scene(scene, traffic="ccdiff", driver="idm", ccdiff={"criticality": level})
            for level in (1.0, 0.0)
        )
        page = folder / f"{scene.name}.html"
        home = ("index.html", "all replays")
        write_page(critical, page, compare=realistic, titles=TITLES, home=home)
        entries.append(entry(critical, scene.name, page.name))
    index = folder / "index.html"
    index.write_text(index_page("Gallery", entries), encoding="utf-8")
    return index


if __name__ == "__main__":
    print(write_gallery(Path(sys.argv[1])))
