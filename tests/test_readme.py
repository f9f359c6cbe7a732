"""Films of the docs are small; the gallery."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from ccdiff_env.view.sources import find_scene
from tools import gallery

HERO = Path(__file__).resolve().parents[1] / "docs/hero.gif"


def test_the_image_moves_and_loads_fast():
    assert HERO.stat().st_size < 500_000
    with Image.open(HERO) as video:
        assert video.n_frames > 30


@pytest.mark.parametrize("task", ["ego", "multi_agent", "selection"])
def test_the_image_of_a_task_moves_and_loads_fast(task):
    path = HERO.with_name(f"task_{task}.gif")
    assert path.stat().st_size < 400_000
    with Image.open(path) as video:
        assert video.n_frames > 10
    assert path.name in HERO.with_name("tasks.md").read_text(encoding="utf-8")


def test_the_gallery_links_its_pages_and_shows_two_runs_in_each(tmp_path):
    scenes = [find_scene(name) for name in ("cut-in-04", "tee-crossing-01")]
    index = gallery.write_gallery(tmp_path / "gallery", scenes).read_text(encoding="utf-8")
    # the story first: reached in realistic traffic, hit in critical traffic
    assert index.index("tee-crossing-01.html") < index.index("cut-in-04.html")
    assert "realistic: ego reached its goal" in index
    pages = sorted((tmp_path / "gallery").glob("*-*.html"))
    assert len(pages) == 2
    for page in pages:
        assert f'href="{page.name}' in index
        assert page.read_text(encoding="utf-8").count('class="run"') == 2
