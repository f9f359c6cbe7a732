"""What `view` plays is what the benchmark plays, and what fails says where."""

import json
import sys

import pytest
from test_view import elements, unpacked

from ccdiff_env import cli, embedded_scenes
from ccdiff_env.bench import provenance
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import SceneSet

PLANNERS = """
import numpy as np


class Brakes:
    def __init__(self, worlds):
        self.count = worlds.num_worlds

    def __call__(self, obs):
        return np.tile(np.float32([-0.5, 0.0]), (self.count, 1))


class Fails(Brakes):
    def __call__(self, obs):
        return {}["lattice"]  # no such key


def asks(batch):
    return batch.nothing


def shapes(obs):
    from ccdiff_env.planners.planning import overlap

    return overlap(np.zeros(3), np.zeros(5))
"""


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A working folder with planners of one's own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "desk_planners", raising=False)
    monkeypatch.setattr(provenance, "_SEEN", {})
    (tmp_path / "desk_planners.py").write_text(PLANNERS)
    return tmp_path


def states(path):
    text = path.read_text(encoding="utf-8")
    return [(u[0]["run"]["title"], u[0]["arrays"]) for u in map(unpacked, elements(text))]


@pytest.mark.parametrize("options", ["ccdiff-1", "ccdiff --criticality 1", "idm-hasty", "replay"])
def test_a_scene_is_played_as_the_benchmark_plays_it(options, tmp_path):
    scenes, name = embedded_scenes("val")[:3], options.partition(" ")[0]
    name = "ccdiff-1" if "criticality" in options else name
    _, expected = drive(scenes, "pdm", TRAFFIC[name], seed=4, record=[scenes[1].name])
    kept = tmp_path / "run.npz"
    words = ["view", scenes[1].name, "--traffic", *options.split(), "--driver", "pdm"]
    words += ["--seed", "4", "--save", str(kept), "-o", str(tmp_path / "page.html")]
    assert cli.main(words) == 0
    run, like = Rollout.load(kept), expected[scenes[1].name]
    assert run.num_steps == like.num_steps
    assert run.position.tobytes() == like.position.tobytes()


@pytest.fixture
def run(desk):
    words = ["bench", "planners", "--planners", "idm,desk_planners:Brakes", "--traffic"]
    words += ["replay,ccdiff-1", "--limit", "3", "--seeds", "0,1", "--out", "run", "--quiet"]
    assert cli.main(words) == 0
    return desk


def test_episodes_of_a_run_are_played_side_by_side_bit_for_bit(run, monkeypatch, capsys):
    scene = json.loads((run / "run/raw/idm-replay-0-000.json").read_text())["arguments"]["names"][1]
    common = ["--scene", scene, "--traffic", "ccdiff-1", "--seed", "1", "-o", "page.html"]
    scenes = SceneSet([embedded_scenes()[scene]])
    for planners, titles in (
        (["idm"], None),
        (["idm", "desk_planners:Brakes"], ["IDM on the log's path", "desk_planners:Brakes"]),
    ):
        assert cli.main(["view", "run", *common, "--planner", *planners]) == 0
        shown = states(run / "page.html")
        assert titles is None or [title for title, _ in shown] == titles
        _, rollouts = drive(scenes, "idm", TRAFFIC["ccdiff-1"], seed=1, record=[scene])
        rollouts[scene].save("alone.npz")
        assert cli.main(["view", "alone.npz", "-o", "alone.html"]) == 0
        assert shown[0][1] == states(run / "alone.html")[0][1]
    # a folder of somebody else's runs no code, unless that is asked for
    monkeypatch.delitem(sys.modules, "desk_planners")
    assert cli.main(["view", "run", *common, "--planner", *planners]) == 0
    assert "desk_planners" not in sys.modules
    assert cli.main(["view", "run", *common, "--own-code", "--planner", *planners]) == 0
    assert "desk_planners" in sys.modules
    # without its code the recorded actions are played, from a submission, too
    before = states(run / "page.html")
    (run / "desk_planners.py").write_text(PLANNERS.replace("-0.5", "-0.1"))
    assert cli.main(["bench", "submit", "run", "--out", "it.zip"]) == 0
    assert cli.main(["view", "it.zip", *common, "--planner", *planners]) == 0
    assert states(run / "page.html") == before
    # the worst traffic and seed of the first planner by default
    assert cli.main(["view", "run", "--scene", scene, "-o", "worst.html"]) == 0
    for words, said in (
        (["--scene", "left-turn"], "no scene 'left-turn'"),
        (["--scene", scene, "--planner", "pdm"], "unknown planner of the run 'pdm'"),
        (["--scene", scene, "--traffic", "idm"], "unknown traffic of the run 'idm'"),
        (["--scene", scene, "--seed", "7"], "with seed 7"),
        (["--scene", scene, "--samples", "4"], "--samples simulates a scene"),
    ):
        capsys.readouterr()
        assert cli.main(["view", "run", *words]) == 2
        assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "line", "where"),
    [
        ("--planners desk_planners:Fails", "KeyError: 'lattice'", '{}["lattice"]  # no such key'),
        ("--planners desk_planners:Fails --workers 2", "KeyError", '{}["lattice"]'),
        ("--planners idm --traffic desk_planners:asks", "'desk_planners:asks'", "batch.nothing"),
        ("--planners desk_planners:shapes", "boxes", "overlap(np.zeros(3), np.zeros(5))"),
    ],
)
def test_what_fails_in_code_of_ones_own_keeps_its_traceback(desk, capsys, options, line, where):
    words = ["bench", "planners", "--traffic", "replay", *options.split(), "--limit", "2"]
    assert cli.main([*words, "--seeds", "0", "--out", "run", "--quiet"]) == 2
    first, *below = capsys.readouterr().err.splitlines()
    assert line in first
    assert any(where in text for text in below)
    assert any("desk_planners.py" in text for text in below)


def test_what_the_package_refuses_is_one_line(desk, capsys):
    assert cli.main(["bench", "planners", "--planners", "pdmm", "--out", "run"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
