"""What `view` plays is what the benchmark plays, and what fails says where."""

import dataclasses
import json
import re
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from browser_page import Page
from test_view import elements, unpacked

import ccdiff_env
from ccdiff_env import cli, embedded_scenes
from ccdiff_env.bench.planners import TRAFFIC, drive, window_of
from ccdiff_env.errors import ConfigError, ShapeError
from ccdiff_env.planners.planning import overlap
from ccdiff_env.record.counterfactual import EgoPlan, avoidable, with_rescue
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import SceneSet
from ccdiff_env.scenes.scenarionet_export import write_scenario
from ccdiff_env.view import log_rollout, page_html, write_page
from ccdiff_env.view.video import Video

PLANNERS = """
import numpy as np


class Brakes:
    name = "braking"

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
OWN_CODE = "desk_planners", PLANNERS


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


def test_a_scene_beside_shorter_ones_is_played_as_alone(tmp_path):
    windows = ccdiff_env.load("embedded/val?window_s=8&history_s=1")
    for file, scene in (("short", windows[0]), ("long", embedded_scenes("val")[1])):
        write_scenario(scene, tmp_path / f"{file}.pkl")
    words = ["view", scene.name, "--scenes", f"scenarionet:{tmp_path}", "--traffic", "idm"]
    assert (
        cli.main([*words, "--save", str(tmp_path / "run.npz"), "-o", str(tmp_path / "a.html")]) == 0
    )
    assert window_of(f"scenarionet:{tmp_path}") == {"history_steps": 10, "horizon_steps": 80}
    (alone,) = ccdiff_env.load(f"scenarionet:{tmp_path / 'long.pkl'}")
    like = drive(SceneSet([alone]), "idm", TRAFFIC["idm"], record=[alone.name])[1][alone.name]
    assert Rollout.load(tmp_path / "run.npz").position.tobytes() == like.position.tobytes()


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
        (["idm", "desk_planners:Brakes"], ["IDM on the log's path", "braking"]),
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
    # without its code the recorded actions are played
    before = states(run / "page.html")
    (run / "desk_planners.py").write_text(PLANNERS.replace("-0.5", "-0.1"))
    assert cli.main(["view", "run", *common, "--planner", *planners]) == 0
    assert states(run / "page.html") == before
    # the worst traffic and seed of the first planner by default
    assert cli.main(["view", "run", "--scene", scene, "-o", "worst.html"]) == 0
    for words, said in (
        ([], "run keeps no rollouts: give --scene"),
        (["--scene", "left-turn"], "no scene 'left-turn'"),
        (["--scene", "7"], "no scene '7' in run; there are left-turn-04, "),
        (["--scene", scene, "-o", "a.png", "--size", "0"], "image size is 0 x 0 pixels"),
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


class Fan:
    """Goes straight on at its speed; bends to the left or right would cost more."""

    frame = "ego"

    def __init__(self, worlds):
        self.native = worlds.native

    def __call__(self, obs):
        time_s, self.told = 0.1 * np.arange(1, 31), []
        for i in range(self.native.num_worlds):
            speed = self.native.states(i)["speed"][self.native.slot_agents(i)[0]]
            way = np.stack([speed * time_s, 0.0 * time_s, 0.0 * time_s], axis=-1)
            left, right = (way + [[0.0, side, 0.0]] * (time_s / 3)[:, None] for side in (2, -2))
            self.told.append((np.stack([left, way, right]), np.array([4.0, 1.0, 2.0])))
        return np.stack([poses[1] for poses, _ in self.told])

    def explain(self):
        return self.told


def test_what_a_planner_weighed_is_recorded_in_the_scenes_frame_and_drawn(tmp_path):
    scene = embedded_scenes("val")[0]
    _, rollouts = drive(SceneSet([scene]), Fan, TRAFFIC["replay"], record=[scene.name])
    run = rollouts[scene.name]
    run.save(tmp_path / "run.npz")
    again = Rollout.load(tmp_path / "run.npz")
    ego = run.agent_ids.index("ego")
    assert [m.made_at for m in again.intentions] == list(range(len(again.intentions)))
    for meant, kept in zip(run.intentions, again.intentions, strict=True):
        np.testing.assert_array_equal(meant.trajectories, kept.trajectories)
        assert kept.costs.tolist() == [1.0, 2.0, 4.0]
        # the chosen one first: on from where the ego is, the way that it looks
        at, turn = run.position[ego, meant.made_at], run.heading[ego, meant.made_at]
        ahead = meant.trajectories[0, :, :2] - at
        assert np.abs(ahead @ [-np.sin(turn), np.cos(turn)]).max() < 1e-3
        assert (ahead @ [np.cos(turn), np.sin(turn)] >= -1e-3).all()
    (element,) = elements(page_html(run))
    drawn = unpacked(element)[0]["intentions"]
    assert drawn[0]["share"] == [0.0, 0.333, 1.0]
    without = dataclasses.replace(run, intentions=())
    assert len(Video(run).svg(10)) > len(Video(without).svg(10))

    class Wrong(Fan):
        def explain(self):
            return [(np.zeros((2, 30, 2)), np.zeros(2))]

    with pytest.raises(ShapeError, match=r"explain\(\) says of world 0"):
        drive(SceneSet([scene]), Wrong, TRAFFIC["replay"])


def test_a_collision_that_can_be_avoided_shows_how(tmp_path):
    scenes = embedded_scenes("val")
    name = "tee-crossing-04"
    _, rollouts = drive(
        SceneSet([scenes[name]]), "constant_velocity", TRAFFIC["ccdiff-1"], record=[name]
    )
    run = with_rescue(rollouts[name])
    rescue, hit = run.meta["rescue"], run.collisions("ego")[0].step
    assert rescue["text"] == f"avoidable: brake at 1.5 m/s² from {(hit - 30) / 10:.1f} s"
    assert rescue["step"] == hit - 30
    path, ego = np.array(rescue["path"]), run.agent_ids.index("ego")
    np.testing.assert_allclose(path[0, :2], run.position[ego, hit - 30], atol=2e-3)
    speed = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1) / 0.1
    braked = np.diff(speed[:15]) / 0.1
    assert braked == pytest.approx(-1.5, abs=0.3)
    # who it meets as recorded is never touched on this way
    for step in range(hit - 30, min(hit + 15, run.num_steps)):
        pose, sizes = path[step - hit + 30], run.scene.sizes[:, :2]
        others = [i for i in np.flatnonzero(run.valid[:, step]) if i != ego]
        boxes = np.column_stack(
            [run.position[others, step], run.heading[others, step], sizes[others]]
        )
        assert not overlap([*pose, *sizes[ego]], boxes).any()
    assert avoidable(run) == 1.0
    assert np.isnan(avoidable(log_rollout(scenes[0])))
    (element,) = elements(page_html(run))
    told = unpacked(element)[0]["run"]
    assert told["outcome"]["rescue"] == rescue["text"]
    assert EgoPlan((-8.0, 2.0), 1.5, -2.5).words == (
        "brake at 8.0 m/s² for 1.5 s, then accelerate at 2.0 m/s², 2.5 m to the right"
    )


def test_the_strip_shows_a_figure_over_time_and_a_click_goes_there(tmp_path, browser):
    scene = embedded_scenes("val")[0]
    _, rollouts = drive(SceneSet([scene]), "idm", TRAFFIC["replay"], record=[scene.name])
    run = rollouts[scene.name]
    write_page(run, tmp_path / "page.html")
    page = Page(browser, tmp_path / "page.html")
    ego = run.agent_ids.index("ego")
    speeds = page.evaluate(
        f"replay.runs[0].a && Array.from({{length: {run.num_steps}}}, "
        f"(_, step) => replay.runs[0].speed({ego}, step))"
    )
    expected = np.linalg.norm(run.velocity[ego], axis=-1)
    there = run.valid[ego]
    np.testing.assert_allclose(np.array(speeds)[there], expected[there], atol=0.02)
    change = page.evaluate(f"replay.runs[0].acceleration({ego}, 20)")
    assert change == pytest.approx((expected[21] - expected[19]) / 0.2, abs=0.2)
    gap = page.evaluate(f"replay.runs[0].gap({ego}, 20)")
    away = np.linalg.norm(run.position[:, 20] - run.position[ego, 20], axis=-1)
    assert gap is None or 0.0 <= gap <= away[run.valid[:, 20]].max()
    box = page.locator("#strip").bounding_box()
    page.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + 10)
    page.frames()
    assert page.time() == pytest.approx((run.num_steps - 1) * 0.05, abs=0.2)
    page.page.select_option("#figure", "time to contact")
    page.frames()
    # an ego that a contact stops within a step leaves its other accelerations their room
    page.evaluate("replay.runs[0].acceleration = (_, step) => (step === 30 ? -54 : 1)")
    page.page.select_option("#figure", "acceleration")
    said = page.texts("replay.touch(); await new Promise(requestAnimationFrame)")
    assert said[-2:] == ["1.0 m/s²", "-10 m/s²"]
    assert not page.faults
    page.page.set_viewport_size({"width": 390, "height": 844})
    assert not page.locator("#strip").is_visible()
    page.context.close()


def test_plans_and_scenes_draw_themselves(tmp_path, capsys):
    env = ccdiff_env.EgoEnv(
        scenes=embedded_scenes()["double-left-00"], traffic="ccdiff", criticality=1.0
    )
    env.reset(seed=0)
    env.step(np.zeros(2, np.float32))
    plan = env.explain()
    into, _ = np.nonzero(plan.graph & ~np.eye(len(plan.agents), dtype=bool))
    follow = env.worlds.scenes[0].agent_ids[plan.agents[into[0]]]
    plan.save(tmp_path / "plan.svg", follow=follow)
    text = (tmp_path / "plan.svg").read_text(encoding="utf-8")
    ElementTree.fromstring(text)
    pairs = int((plan.graph & ~np.eye(len(plan.agents), dtype=bool)).sum())
    assert text.count("<polygon") == pairs > 0, "neighbours, too"
    assert text.count("<circle") == min(len(plan.ranking), 9)
    # strong arrows lead to who is followed, in the middle
    tips = re.findall(r'<g opacity="0.95"><line.*?points="([\d.]+),([\d.]+)', text)
    assert len(tips) > 0
    assert all(np.hypot(float(x) - 360.0, float(y) - 360.0) < 14.0 for x, y in tips)
    assert plan._repr_svg_().count("<polygon") == text.count("<polygon")
    assert env.worlds.scenes[0]._repr_svg_().startswith("<svg")
    with pytest.raises(ConfigError, match=r"ends in \.svg"):
        plan.save(tmp_path / "plan.png")
    out = str(tmp_path / "graph.svg")
    words = ["view", "double-left-00", "--traffic", "ccdiff-1", "--show", "graph"]
    assert cli.main([*words, "-o", out, "--step", "20"]) == 0
    assert "<polygon" in (tmp_path / "graph.svg").read_text()
    for more, said in (
        (["-o", str(tmp_path / "g.png")], "--show is of an SVG"),
        (["-o", str(tmp_path / "g.html")], "--show goes with an image"),
    ):
        assert cli.main([*words, *more]) == 2
        assert said in capsys.readouterr().err
    assert cli.main(["view", "double-left-00", "--show", "graph", "-o", out]) == 2
    assert "follows no plan" in capsys.readouterr().err
