"""Scenario sets and cross-evaluation: what is saved, what is refused, who meets what in them."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from view_rollouts import planned_rollout

from ccdiff_env import cli
from ccdiff_env.bench import scenarios
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.bench.scenarios import (
    cross_jobs,
    evaluate_in_set,
    generate,
    generation_jobs,
    realism,
    set_folders,
)
from ccdiff_env.bench.scenarios_report import cross_rows, figures_table, sets_table, tables
from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError, UnknownNameError
from ccdiff_env.record.rollout import Rollout, RolloutEvent, as_scene
from ccdiff_env.system.table import document

VAL = "embedded/val"
#: IDM collides in the first two, in the first by each of two plans, and not in the last.
NAMES = ["hard-brake-04", "merge-in-03", "left-turn-05"]
CRITICAL = "ccdiff-2"


def make(folder, generator="idm", names=NAMES):
    return generate(
        source=VAL, names=names, generator=generator, traffic=CRITICAL, seed=17,
        folder=str(folder), num_plans=2,
    )  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder and rows of a set against IDM."""
    folder = tmp_path_factory.mktemp("set")
    return folder, make(folder)


def test_recording_changes_nothing_and_gives_the_scenes_that_were_asked_for():
    scenes = scenes_of(VAL, NAMES)
    rows, rollouts = drive(scenes, "idm", TRAFFIC["ccdiff-1"], record=NAMES[:1])
    assert list(rollouts) == NAMES[:1]
    assert rows == drive(scenes, "idm", TRAFFIC["ccdiff-1"])[0]


def test_a_planner_meets_in_its_own_set_what_it_met_when_the_set_was_made(tmp_path):
    for generator in ("idm", "replay", "pdm"):
        rows = make(tmp_path / generator, generator)
        found = [Rollout.load(tmp_path / generator / row["file"]) for row in rows]
        scenes = [as_scene(rollout) for rollout in found]
        driven, again = drive(scenes, generator, TRAFFIC["replay"], record=NAMES)
        for scenario, rollout, row in zip(rows, found, driven, strict=True):
            assert row["collision"] == scenario["collision"]
            assert 1.0 - row["no_at_fault_collision"] == scenario["at_fault"]
            then, now = (one.collisions("ego") for one in (rollout, again[row["scene"]]))
            assert [(e.step, e.partner_id, e.kind) for e in now] == [
                (e.step, e.partner_id, e.kind) for e in then
            ]


def test_sets_hold_collisions_that_can_and_that_cannot_be_avoided(made):
    rows = made[1]
    assert [row["scene"] for row in rows] == NAMES
    assert [row["collision"] for row in rows] == [True, True, False]
    assert [row["avoidable"] for row in rows] == [False, True, True]
    for row in rows:
        assert 0.0 < row["moved_m"] < 10.0
        assert row["fde_m"] > 0.0
        assert (row["time_s"] is None) == (not row["collision"])


def test_collisions_after_the_goal_count_as_the_matrix_counts_them(tmp_path, monkeypatch):
    """A collision at step 30, also where the goal was reached at step 20, is judged."""
    rollout = planned_rollout()
    goal = RolloutEvent(20, "ego", None, "goal")
    for played in (rollout, replace(rollout, events=(goal, *rollout.events))):
        monkeypatch.setattr(
            scenarios, "drive", lambda scenes, *_, played=played, **__: ([], {NAMES[0]: played})
        )
        (row,) = make(tmp_path, "idm", NAMES[:1])
        assert row["collision"]
        assert row["time_s"] == pytest.approx(30 * rollout.dt_s)


def test_realism_is_that_of_the_vehicles_that_follow_plans():
    rollout = planned_rollout()
    found = realism(rollout)
    # agents 1 and 2 were moved by up to two metres on both axes; 2 is guided
    assert found["fde_m"] == pytest.approx(np.hypot(2.0, 2.0), rel=1e-3)
    assert found["moved_m"] == pytest.approx(0.25)
    alone = realism(replace(rollout, plans=()))
    assert alone["fde_m"] is None
    assert alone["moved_m"] is None
    json.dumps([found, alone], allow_nan=False)


def test_sets_of_two_generators_need_two_names(tmp_path):
    with pytest.raises(ConfigError, match="two of the same name"):
        set_folders(["a/ego.zip", "b/ego.zip"], tmp_path)
    folders = set_folders(["egos/ego.zip", "my.planners:Mine"], tmp_path)
    assert [folder.name for folder in folders.values()] == ["ego", "my.planners-Mine"]
    with pytest.raises(UnknownNameError, match="no traffic 'ctg-9'"):
        generation_jobs(VAL, folders, traffic="ctg-9")


def test_the_matrix_leaves_out_what_could_not_be_avoided(tmp_path):
    figures = {"at_fault": False, "moved_m": 0.5, "fde_m": 1.0}
    scenarios = [
        {"scene": scene, "collision": hit, "avoidable": avoidable, **figures}
        for scene, hit, avoidable in (("a", True, False), ("b", True, True), ("c", False, True))
    ]

    def rows(generator, planner, *hits):
        return [
            {
                "generator": generator,
                "planner": planner,
                "scene": s["scene"],
                "collision": float(h),
                "no_at_fault_collision": 1.0,
                "score": 1.0 - h,
            }
            for s, h in zip(scenarios, hits, strict=True)
        ]

    episodes = [*rows("idm", "idm", 1, 1, 0), *rows("idm", "pdm", 1, 0, 0)]
    episodes += [*rows(None, "idm", 1, 1, 0), *rows(None, "pdm", 0, 0, 0)]
    sets = {"idm": scenarios}
    crossed = cross_rows(sets, episodes)
    figures_table(crossed).write_csv(tmp_path / "figures.csv")
    with (tmp_path / "figures.csv").open(encoding="utf-8") as file:
        found = {
            (r["generator"], r["planner"], r["scenarios"]): (
                int(r["scenes"]),
                float(r["collision"]),
            )
            for r in csv.DictReader(file)
        }
    assert found == {
        ("idm", "idm", "all"): (3, pytest.approx(2 / 3)),
        ("idm", "pdm", "all"): (3, pytest.approx(1 / 3)),
        ("reacting", "idm", "all"): (3, pytest.approx(2 / 3)),
        ("reacting", "pdm", "all"): (3, 0.0),
        ("idm", "idm", "avoidable"): (2, 0.5),
        ("idm", "pdm", "avoidable"): (2, 0.0),
    }
    figures = ["idm", 3, 2, 0, 1, 0.5, 1.0]
    assert sets_table(sets).rows == [figures]
    text = document(*tables(sets, crossed, "what"))
    assert "| IDM on the log's path | 3 | 2 | 0 | 1 | 0.50 | 1.0 |" in text


def test_the_command_makes_sets_and_crosses_them_and_goes_on(tmp_path, capsys):
    def command(folder, *more):
        names = ["--generators", "idm,replay", "--planners", "replay"]
        out = ["--out", str(tmp_path / folder), "--quiet", "--limit", "2"]
        return cli.main(["bench", "scenarios", *out, *names, *more])

    assert command("one") == 0
    assert "figure by figure" in capsys.readouterr().out
    raw = tmp_path / "one" / "raw"
    first = {path.name: path.stat().st_mtime_ns for path in raw.iterdir()}
    assert command("one") == 0
    assert {path.name: path.stat().st_mtime_ns for path in raw.iterdir()} == first
    assert command("two") == 0
    for name in ("table.md", "figures.csv", "sets.csv"):
        one, two = ((tmp_path / f / name).read_bytes() for f in ("one", "two"))
        assert one == two
    capsys.readouterr()
    assert command("one", "--plans", "5") == 2
    assert "other settings: plans" in capsys.readouterr().err


def one_command(folder, capsys, scenes):
    """Make the set of two scenes against IDM on lanes; returns the digest that the command says."""
    names = ["--generators", "lane_idm", "--planners", "lane_idm", "--plans", "16", "--limit", "2"]
    out = ["--out", str(folder), "--quiet"]
    assert cli.main(["bench", "scenarios", "--scenes", scenes, *names, *out]) == 0
    (said,) = re.findall(r"set against lane_idm: (\w+)", capsys.readouterr().out)
    assert json.loads((folder / "run.json").read_text())["digests"] == {"lane_idm": said}
    return said


def test_sets_of_the_city_are_made_by_one_command_with_one_digest(tmp_path, capsys):
    digest = "0036596a4a3a54f93ad5eded2efcababc1a3772e90a138283a2e1ce00c5d9c8f"
    assert one_command(tmp_path, capsys, "embedded/city") == digest


@pytest.mark.nuscenes
@pytest.mark.filterwarnings("ignore:.*has 93 of the 150 scenes")
def test_sets_of_nuscenes_are_made_by_one_command_and_checked_by_digest(
    tmp_path, capsys, data_root
):
    digest = "7a30cd9b5e33e062f6ac25801602af5e46bbeaedac15b57369296d2ffbcee69d"
    assert one_command(tmp_path, capsys, f"nuscenes:{data_root}/nuscenes/val") == digest


def test_a_job_refuses_an_episode_that_changed_or_is_lost(tmp_path, made):
    (tmp_path / "set").mkdir()
    for row in made[1]:
        (tmp_path / "set" / row["file"]).write_bytes((made[0] / row["file"]).read_bytes())
    (making,) = generation_jobs(VAL + "?limit=3", {"idm": tmp_path / "set"}, traffic=CRITICAL)
    job = cross_jobs({"idm": made[1]}, {"idm": making}, ["constant_velocity"])[0]
    rows, _ = evaluate_in_set(**job.arguments)
    assert [row["scene"] for row in rows] == NAMES
    file = tmp_path / "set" / made[1][0]["file"]
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(DatasetError, match="has changed.*" + file.name):
        evaluate_in_set(**job.arguments)
    file.unlink()
    with pytest.raises(DatasetNotFoundError, match=file.name):
        evaluate_in_set(**job.arguments)
