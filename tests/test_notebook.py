"""What notebooks show, and that those of the examples run."""

from __future__ import annotations

import html
import re
from pathlib import Path

import pytest
from view_rollouts import planned_rollout

from ccdiff_env import embedded_scenes
from ccdiff_env.scenes import SceneSet
from ccdiff_env.view import page_html


def test_a_rollout_is_its_page_in_a_frame_without_rights():
    text = planned_rollout()._repr_html_()
    head = r'<iframe sandbox="allow-scripts" title="[^"]*" style="[^"]*" '
    found = re.fullmatch(head + r'srcdoc="([^"]*)"></iframe>', text)
    assert html.unescape(found[1]) == page_html(planned_rollout())
    assert repr(planned_rollout()).startswith("Rollout(left-turn-00, 81 steps of 0.1 s")
    assert len(repr(planned_rollout())) < 120


def test_the_frame_shows_a_canvas(browser, tmp_path):
    (tmp_path / "note.html").write_text(planned_rollout()._repr_html_(), encoding="utf-8")
    page = browser.new_page(reduced_motion="reduce")
    faults = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto((tmp_path / "note.html").as_uri())
    frame = page.frame_locator("iframe")
    frame.locator("body[data-ready=yes]").wait_for()
    assert frame.locator("canvas.map").bounding_box()["width"] > 300
    frame.locator("#layer-graph").click()
    page.wait_for_timeout(700)  # the address that it may not change
    assert faults == []
    page.close()


def test_scenes_and_sets_are_an_image_and_a_table():
    scenes = embedded_scenes()
    text = scenes["left-turn-00"]._repr_html_()
    assert text.startswith('<img src="data:image/png;base64,')
    assert "left-turn-00 · ccdiff-town" in text
    table = scenes._repr_html_()
    assert table.count("ccdiff-town") == 30
    assert f"and {len(scenes) - 30} more" in table
    assert SceneSet([])._repr_html_().startswith("<pre>0 scenes")


NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "examples/notebooks").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_is_kept_without_outputs(path, tmp_path, monkeypatch):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    monkeypatch.setenv("PYTHONPATH", str(path.parents[2]))
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert not cell.outputs
            assert cell.execution_count is None
            # smaller where a line says so: "STEPS = 300_000  # in tests: 2048"
            cell.source = re.sub(r"= [\d_]+  # in tests: (\d+)", r"= \1", cell.source)
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(
        notebook, timeout=280, kernel_name="python3", resources=resources
    ).execute()
    assert any(cell.get("outputs") for cell in notebook.cells)
