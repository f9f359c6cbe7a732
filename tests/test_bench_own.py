"""Figures, titles and traffic of one's own in the benchmarks."""

import csv
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from array_scenes import agent, array_scene

import ccdiff_env
import ccdiff_env.view
from ccdiff_env import cli
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.bench.tags import scene_tags
from ccdiff_env.errors import MissingFeatureError
from ccdiff_env.record.counterfactual import Avoidability, EgoPlan
from ccdiff_env.scenes import map_queries
from ccdiff_env.traffic import CcdiffConfig, TrafficBatch, TrafficPlan

OWN_CODE = (
    "desk_own",
    """
import numpy as np

from ccdiff_env.traffic import CcdiffConfig

calm = CcdiffConfig(careful=True, num_samples=1)


class Brakes:
    name = "Ours, braking"

    def __init__(self, worlds):
        self.count = worlds.num_worlds

    def __call__(self, obs):
        return np.tile(np.float32([-0.5, 0.0]), (self.count, 1))


def way_m(rollout):
    ego = rollout.agent_ids.index("ego")
    way = rollout.position[ego, rollout.valid[ego]]
    return np.linalg.norm(np.diff(way, axis=0), axis=1).sum()


def breaks(rollout):
    return 1 / 0


def words(rollout):
    return "many"
""",
)


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def bench(words, out="run"):
    words = ["bench", *words.split(), "--out", out, "--quiet"]
    return cli.main(words)


def test_an_own_metric_is_in_tables_intervals_and_tests(desk, capsys):
    planners = "idm,desk_own:Brakes"
    words = f"planners --planners {planners} --traffic replay,idm --seeds 0"
    assert bench(f"{words} --metric desk_own:way_m,avoidable") == 0
    scenes = ccdiff_env.embedded_scenes("val")
    _, rollouts = drive(scenes, "idm", TRAFFIC["replay"], seed=0, record=[s.name for s in scenes])
    expected = {}
    for name, rollout in rollouts.items():
        frame = rollout.frame()
        ego = frame[frame.agent == "ego"].sort_values("step")
        expected[name] = np.hypot(ego.x_m.diff(), ego.y_m.diff()).sum()
    episodes = rows(desk / "run/episodes.csv")
    found = {
        row["scene"]: float(row["way_m"])
        for row in episodes
        if (row["planner"], row["traffic"]) == ("idm", "replay")
    }
    assert found == pytest.approx(expected, rel=1e-4)
    figure = next(r for r in rows(desk / "run/figures.csv") if r["planner"] == "idm")
    assert float(figure["way_m"]) == pytest.approx(np.mean([*expected.values()]), rel=1e-4)
    assert float(figure["way_m_low"]) < float(figure["way_m"]) < float(figure["way_m_high"])
    pairs = [r for r in rows(desk / "run/pairs.csv") if r["figure"] == "way_m"]
    assert {r["traffic"] for r in pairs} == {"replay", "idm", "mean"}
    assert "avoidable" in figure
    assert all(0.0 < float(r["p"]) <= 1.0 for r in pairs)
    report = (desk / "run/report.html").read_text(encoding="utf-8")
    assert report.count("way m") > 2
    # the name of the class is that of the row, everywhere
    assert "Ours, braking" in report
    assert "desk_own:Brakes" not in report.partition("made by")[0]
    assert "Ours, braking" in (desk / "run/table.tex").read_text()
    # bits follow without the metric, under the same title
    capsys.readouterr()
    assert cli.main(["bench", "verify", "run"]) == 0
    assert "Ours, braking" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--planners idm --metric desk_own:breaks", "metric desk_own:breaks: ZeroDivisionError"),
        ("--planners idm --metric desk_own:words", "returns 'many', expected a number (in left-"),
        ("--planners idm --traffic ccdiff-1?criticality=2", "ccdiff-1 says how critical it is"),
        ("--planners idm --tags tags.csv", "no scene 'left'; there are left-turn-04"),
        ("--planners idm --metric desk_own:nothing", "no 'nothing' in module 'desk_own'"),
        ("--planners idm --metric desk_own:way_m?title=score", "column 'score' is taken"),
        ("--planners desk_own:Brakes?title=PDM-Closed", "the title 'PDM-Closed' is another one's"),
        ("--planners desk_own:Brakes,desk_own:Brakes?title=Ours%2C%20braking", "is another one's"),
        ("--planners pdm?title=Ours", "the title 'Ours' is another one's"),
        ("--planners idm --traffic ccdif-1", "did you mean 'ccdiff-1'"),
        ("--planners idm --metric avoidble", "expected module:function of a rollout, or avoidable"),
        ("--planners idm --seeds=", "--seeds is '', expected integers, comma-separated"),
        ("--planners idm --replays -1", "--replays is -1, expected at least 0"),
        ("--planners idm --metric EPDMS", "metric 'EPDMS' cannot be had: NAVSIM"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(desk, capsys, words, said):
    (desk / "tags.csv").write_text("scene,tag\nleft,rare\n")
    assert bench(f"planners --limit 1 --seeds 0 --traffic replay {words}") == 2
    first, *below = capsys.readouterr().err.splitlines()
    assert said in first
    assert bool(below) == ("breaks" in words)


def test_a_title_is_the_name_of_a_row_and_a_run_apart(desk):
    planners = "desk_own:Brakes?title=A,desk_own:Brakes?title=B%20two"
    assert bench(f"planners --planners {planners} --limit 2 --seeds 0 --traffic replay") == 0
    text = (desk / "run/table.md").read_text(encoding="utf-8")
    assert "| A |" in text
    assert "| B two |" in text


def test_options_of_ccdiff_by_path_are_traffic(desk):
    words = "planners --planners idm --limit 3 --seeds 0 --traffic desk_own:calm?title=Calm"
    assert bench(words) == 0
    scenes = ccdiff_env.embedded_scenes("val")[:3]
    like = ccdiff_env.bench.planners.Traffic("x", "ccdiff", {"careful": True, "num_samples": 1})
    expected = {row["scene"]: row["score"] for row in drive(scenes, "idm", like, seed=0)[0]}
    found = {r["scene"]: float(r["score"]) for r in rows(desk / "run/episodes.csv")}
    assert found == expected
    assert "Calm" in (desk / "run/table.md").read_text(encoding="utf-8")
    env = ccdiff_env.EgoEnv(traffic="desk_own:calm")
    assert env.worlds.config.ccdiff == CcdiffConfig(careful=True, num_samples=1)


@pytest.mark.parametrize(
    "of",
    [
        TrafficPlan, map_queries.LaneAhead, TrafficBatch, CcdiffConfig, ccdiff_env.Rollout, EgoPlan,
        Avoidability, ccdiff_env.WorldConfig,
    ],
)  # fmt: skip
def test_help_lists_every_field(of):
    listed = of.__doc__.partition("Fields:")[2]
    names = [name for name in of.__dataclass_fields__ if not name.startswith("_")]
    assert [name for name in names if f"\n    {name}: " not in listed] == []


def test_states_and_plans_print_what_they_hold():
    env = ccdiff_env.EgoEnv(traffic="ccdiff")
    env.reset(seed=3)
    env.step(env.action_space.sample())
    status = repr(env.worlds.native.status(0))
    said = r"WorldStatus\(scene_idx=\d+, .*seed=3, .*elapsed_steps=1, ego_idx=0\)"
    assert re.fullmatch(said, status)
    plan = env.explain()
    assert f"samples=float32{list(plan.samples.shape)}" in repr(plan)
    lane = map_queries.lane_ahead(env.worlds.scenes[0], np.zeros((1, 2)), np.zeros(1), points=20)
    assert repr(lane).startswith("LaneAhead(position_m=float32[1, 20, 2], valid=bool[1, 20], lane=")
    for told in TrafficBatch.from_log(env.worlds.scenes[:1], [40], future_steps=7):
        assert re.match(r"\w+\(position_m=float32\[\d+, (31|7), 2\], heading_rad=", repr(told))


def test_a_data_frame_has_a_row_for_who_is_there(monkeypatch):
    scene = ccdiff_env.embedded_scenes("val")[0]
    rollout = ccdiff_env.view.log_rollout(scene)
    frame = rollout.frame()
    assert len(frame) == rollout.valid.sum()
    one = frame[(frame.agent == scene.agent_ids[1])]
    there = rollout.valid[1]
    np.testing.assert_array_equal(one.x_m, rollout.position[1, there, 0])
    np.testing.assert_array_equal(one.step, np.flatnonzero(there))
    np.testing.assert_allclose(one.time_s, np.flatnonzero(there) * 0.1)
    assert set(one.type) == {scene.agent_types[1]}
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingFeatureError, match="pip install pandas"):
        rollout.frame()


def turning(angle_rad, speed_mps, offset_m=0.0):
    """A scene whose ego drives so fast on an arc, behind a car 15 m ahead."""
    time_s = 0.1 * np.arange(131)
    yaw = angle_rad * time_s / 13.0
    along = speed_mps * time_s
    radius = 13.0 * speed_mps / angle_rad if angle_rad else None
    x = along if radius is None else radius * np.sin(yaw)
    y = np.zeros(131) if radius is None else radius * (1.0 - np.cos(yaw))
    ahead = agent("1", x + 15.0, y + offset_m, heading=yaw)
    return array_scene(agent("ego", x, y, heading=yaw), ahead)


@pytest.mark.parametrize(
    ("scene", "tags"),
    [
        (turning(np.deg2rad(80.0), 6.0, 9.0), ["turn"]),
        (turning(np.deg2rad(20.0), 6.0, 9.0), []),
        (turning(0.0, 14.0, 9.0), ["high speed"]),
        (turning(0.0, 8.0), ["following"]),
        (turning(0.0, 0.0), ["stop"]),
    ],
)
def test_tags_are_those_of_the_motion(scene, tags):
    assert scene_tags(scene, 30, 130) == tags


def test_scenes_whose_names_say_what_they_ask_for_have_its_tag():
    found = {scene.name: scene_tags(scene, 30, 130) for scene in ccdiff_env.embedded_scenes()}
    for part, tag in (("left-turn", "crossing"), ("tee-crossing", "crossing")):
        share = [tag in tags for name, tags in found.items() if name.startswith(part)]
        assert np.mean(share) > 0.5, (part, share)


def test_reports_have_scores_by_tag_and_papers_whole_tables(desk):
    (desk / "tags.csv").write_text("scene,tag\nleft-turn-04,rare\nleft-turn-04,mine\n")
    words = "planners --planners idm,replay --seeds 0,1 --traffic replay,idm --tags tags.csv"
    assert bench(words) == 0
    episodes = rows(desk / "run/episodes.csv")
    assert {row["city"] for row in episodes} == {"ccdiff-town"}
    rare = [row for row in episodes if "rare" in row["tags"].split(", ")]
    assert {row["scene"] for row in rare} == {"left-turn-04"}
    mean = np.mean([float(row["score"]) for row in rare if row["planner"] == "idm"])
    table = (desk / "run/table.md").read_text().partition("## Scores by what")[2]
    head, _, *lines = [line for line in table.splitlines() if line.startswith("|")]
    column = head.split(" | ").index(next(h for h in head.split(" | ") if "rare" in h))
    line = next(line for line in lines if line.startswith("| IDM on"))
    assert line.split(" | ")[column].startswith(f"{mean:.2f}")
    # a tag of few scenes has no interval
    few = min(int(count) for count in re.findall(r"\((\d+)\)", head)) < 10
    assert few == ("Fewer than 10 scenes" in table.partition("\n## ")[0])
    pairs = table.partition("## Planners against")[2].partition("\n## ")[0]
    assert pairs.count("| Log replay | IDM on the log's path |") == 1
    assert "| IDM on" not in pairs.replace("| Log replay | IDM on", "")
    text = (desk / "run/table.tex").read_text()
    tables = text.split(r"\begin{table}")[1:]
    assert len(tables) > 4
    assert len({re.search(r"\\label\{(.+?)\}", one)[1] for one in tables}) == len(tables)
    assert all(r"\caption{" in one and r"\footnotesize" in one for one in tables)
    assert [r"$\dagger$ privileged" in one for one in tables] == [True] + [False] * 4
    assert "permutation test" in text
    assert "Worst" not in text
    if shutil.which("pdflatex"):
        head = r"\documentclass{article}\usepackage{booktabs,graphicx}\begin{document}"
        (desk / "paper.tex").write_text(head + r"\input{run/table.tex}\end{document}")
        subprocess.run(["pdflatex", "-halt-on-error", "paper.tex"], check=True, timeout=120)
    (desk / "tags.csv").write_text("scene,tag\nleft-turn-4,rare\n")
    assert bench(words) == 2


def test_policies_of_one_name_are_told_apart(desk):
    files = ["a/mine.safetensors", "b/mine.safetensors"]
    for file in files:
        (desk / file).parent.mkdir()
        shutil.copy(Path(ccdiff_env.__file__).parent / "data/ego.safetensors", desk / file)
    assert bench(f"planners --planners {','.join(files)} --limit 1 --seeds 0 --traffic replay") == 0
    table = (desk / "run/table.md").read_text()
    assert all(f"\n| {file} |" in table for file in files)


def test_methods_of_realism_are_compared_in_pairs(desk):
    assert bench("realism --methods replay,constant_velocity,idm") == 0
    episodes = rows(desk / "run/episodes.csv")
    by = {m: {r["scene"]: float(r["realism"]) for r in episodes if r["method"] == m}
          for m in ("replay", "idm")}  # fmt: skip
    less = np.mean([by["replay"][scene] - by["idm"][scene] for scene in by["idm"]])
    pairs = rows(desk / "run/pairs.csv")
    (pair,) = [
        r for r in pairs if (r["method"], r["against"], r["figure"]) == ("replay", "idm", "realism")
    ]
    assert float(pair["difference"]) == pytest.approx(less)
    assert 0.0 < float(pair["p"]) < 0.05
    # the report opens with the figure, and its tables by a click
    report = (desk / "run/report.html").read_text(encoding="utf-8")
    assert 0 < report.index('aria-label="realism"') < report.index('<details class="part">')
    drawn = (desk / "run/realism.svg").read_text()
    assert "Constant velocity" in drawn
    assert "dashed: the log" in drawn
    assert "the log" in (desk / "run/densities.svg").read_text()
    compared = (desk / "run/table.md").read_text().partition("against one")[2]
    heads = [line.split(" | ")[:2] for line in compared.splitlines() if line.startswith("| ")][1:]
    # with the best that is not the log, once
    assert heads == [["| Log replay", "IDM"], ["| IDM", "Constant velocity"]]
    assert " | significant |" in compared


@pytest.mark.parametrize(
    ("words", "count"),
    [
        ("realism --methods ccdiff_one_sample,idm --samples 2", 2 * 2 + 2),  # IDM draws nothing
        ("traffic --methods ccdiff_random,idm --k 1", 2 * 3 + 2 + 2),  # three seeds; the floor
    ],
)
def test_kept_rollouts_are_played_again_bit_for_bit(desk, capsys, words, count):
    assert bench(f"{words} --limit 2 --keep") == 0
    files = sorted((desk / "run/rollouts").glob("ccdiff*.npz"))
    assert len([*(desk / "run/rollouts").iterdir()]) == count
    assert ccdiff_env.Rollout.load(files[0]).meta["traffic"] == "ccdiff"
    # wherever the folder is now
    (desk / "run").rename(desk / "moved")
    files = [desk / "moved/rollouts" / file.name for file in files]
    capsys.readouterr()
    assert cli.main(["bench", "verify", "moved"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^(\d+) of \1 episodes come out the same", said, re.MULTILINE)
    files[0].write_bytes(files[1].read_bytes())
    assert cli.main(["bench", "verify", "moved"]) == 1
    assert "another rollout than the one" in capsys.readouterr().out
    raw = next((desk / "moved/raw").glob("idm*.json"))
    raw.write_text(re.sub(r'"(kinematic|fde)": ', r'"\1": 1', raw.read_text()))
    assert cli.main(["bench", "verify", "moved"]) == 1
    assert "idm, " in capsys.readouterr().out
