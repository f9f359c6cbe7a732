"""Files made to harm are refused in words, or do nothing; ``attacks/README.md`` lists them."""

from __future__ import annotations

import runpy
import time
from pathlib import Path

import pytest

import ccdiff_env
from ccdiff_env import errors
from ccdiff_env.bench import scenario_sets
from ccdiff_env.bench.replays import write_replay
from ccdiff_env.cli import main
from ccdiff_env.files import file_name
from ccdiff_env.view.index import write_pages
from ccdiff_env.view.sources import log_rollout

FOLDER = Path(__file__).parent / "attacks"

#: Pickles that hold nothing which is looked at: they cost no more than their size.
HARMLESS = {"memo_of_64_gib", "nested_50000_deep"}


def test_the_folder_holds_what_its_script_makes():
    kept = {path.name: path.read_bytes() for path in FOLDER.iterdir() if path.suffix != ".py"}
    readme = kept.pop("README.md").decode()
    assert kept == runpy.run_path(str(FOLDER / "make.py"))["files"]()
    assert all(f"`{Path(name).stem}" in readme for name in kept)


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.pkl")), ids=lambda path: path.stem)
def test_scenario_pickles(path, capfd):
    start = time.process_time()
    if path.stem in HARMLESS:
        assert ccdiff_env.load_scenarionet(path)[0].num_steps == 11
    else:
        with pytest.raises(errors.DatasetError, match=path.name):
            ccdiff_env.load_scenarionet(path)
    assert time.process_time() - start < 2.0
    assert "attacked" not in capfd.readouterr().out


NAMES = ("../../pwned", "/pwned", "..", "", ".", "a/b", "a\\b", "con\0x", "x" * 5000, "\x1b[2J")


def test_names_of_files_stay_in_their_folder(tmp_path):
    found = [file_name(name, ".html") for name in NAMES]
    for name in found:
        assert (tmp_path / name).resolve().parent == tmp_path.resolve()
        (tmp_path / name).write_text("")
    assert len(set(found)) == len(NAMES)
    assert file_name("scene-0061") == "scene-0061"


def test_names_of_scenes_are_no_paths(tmp_path, monkeypatch):
    deep = tmp_path / "one" / "two"
    deep.mkdir(parents=True)
    monkeypatch.chdir(deep)
    rollout = log_rollout(ccdiff_env.embedded_scenes()[0])
    for name in ("../../pwned", str(tmp_path / "pwned")):
        scene = rollout.to_scene(name)
        log_rollout(scene).save("evil.npz")
        assert main(["view", "evil.npz"]) == 0
        write_replay(log_rollout(scene), deep / "replays" / file_name(f"x-{name}", ".html"))
        monkeypatch.setattr(scenario_sets, "scenes_of", lambda *_, scene=scene: [scene])
        scenario_sets.generate(
            source={},
            names=[name],
            generator="replay",
            traffic="replay",
            seed=0,
            folder="set",
            num_plans=1,
        )
    assert [path.name for path in tmp_path.iterdir()] == ["one"]
    assert [path.name for path in deep.parent.iterdir()] == ["two"]


def test_pages_of_a_folder_do_not_replace_each_other(tmp_path):
    rollout = log_rollout(ccdiff_env.embedded_scenes()[0])
    (tmp_path / "a").mkdir()
    rollout.save(tmp_path / "a-b.npz")
    rollout.save(tmp_path / "a" / "b.npz")
    pages = write_pages(tmp_path, tmp_path / "pages", thumbnails=False)
    assert len(set(pages)) == 3
    assert all(page.is_file() for page in pages)
