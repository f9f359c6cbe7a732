"""Scenario sets and cross-evaluation: what is saved, what is refused, who meets what in them."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from view_rollouts import planned_rollout

from ccdiff_env import cli
from ccdiff_env.bench.cross_evaluation import (
    cross_jobs,
    evaluate_in_set,
    generation_jobs,
    set_folders,
)
from ccdiff_env.bench.cross_report import cross_rows, figures_table, sets_table, tables
from ccdiff_env.bench.planners import TRAFFIC, drive, play
from ccdiff_env.bench.scenario_sets import (
    Scenario,
    ScenarioSet,
    ego_collisions,
    generate,
    load_scenario_set,
    realism,
    write_manifest,
)
from ccdiff_env.bench.scenes import scene_names, scenes_of
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError, UnknownNameError
from ccdiff_env.record.rollout import RolloutEvent, as_scene
from ccdiff_env.system.table import document
from ccdiff_env.system.version import __version__

VAL = "embedded/val"
#: IDM collides in the first two, unavoidably in the first, and not in the last.
NAMES = ["cut-in-04", "double-left-03", "left-turn-05"]
CRITICAL = "ccdiff-2"
#: Of the set of these scenes against IDM, on any machine.
DIGEST = "6e2db17a8260203c207a8da331d732c41838e76a7f51b713cca86d3c234eef65"


def make(folder, generator="idm"):
    return generate(
        source=VAL, names=NAMES, generator=generator, traffic=CRITICAL, seed=17,
        folder=str(folder), num_plans=128,
    )  # fmt: skip


def manifest(folder, entries):
    return write_manifest(
        ScenarioSet(
            folder=folder, generator="idm", traffic=CRITICAL, seed=17, weights="w", source=VAL,
            settings={}, scenarios=tuple(Scenario(**entry["scenario"]) for entry in entries),
        )
    )  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A set against IDM, and what its maker said."""
    folder = tmp_path_factory.mktemp("set")
    entries = make(folder)
    manifest(folder, entries)
    return load_scenario_set(folder), entries


def test_recording_changes_nothing_and_gives_the_scenes_that_were_asked_for():
    scenes = scenes_of(VAL, NAMES)
    rows, rollouts = drive(scenes, "idm", TRAFFIC["ccdiff-1"], record=NAMES[:1])
    assert list(rollouts) == NAMES[:1]
    assert rows == play(scenes, "idm", TRAFFIC["ccdiff-1"])


def test_the_same_set_is_made_twice(tmp_path, made):
    entries = make(tmp_path)
    assert entries == made[1]
    manifest(tmp_path, entries)
    found = load_scenario_set(tmp_path).digest
    assert found == made[0].digest == DIGEST
    other = replace(made[0], scenarios=made[0].scenarios[:-1])
    assert other.digest != made[0].digest


def test_a_planner_meets_in_its_own_set_what_it_met_when_the_set_was_made(made, tmp_path):
    for generator in ("idm", "replay", "pdm"):
        folder = tmp_path / generator
        entries = make(folder, generator)
        manifest(folder, entries)
        found = load_scenario_set(folder)
        scenes = [found.scene(name) for name in NAMES]
        rows, again = drive(scenes, generator, TRAFFIC["replay"], record=NAMES)
        for name, row in zip(NAMES, rows, strict=True):
            scenario = found.find(name)
            assert row["collision"] == scenario.collision
            assert 1.0 - row["no_at_fault_collision"] == scenario.at_fault
            then, now = ego_collisions(found.rollout(name)), ego_collisions(again[name])
            assert [(e.step, e.partner_id, e.kind) for e in now] == [
                (e.step, e.partner_id, e.kind) for e in then
            ]


def test_sets_hold_collisions_that_can_and_that_cannot_be_avoided(made):
    found = [made[0].find(name) for name in NAMES]
    assert [s.collision for s in found] == [True, True, False]
    assert [s.avoidable for s in found] == [False, True, True]
    for scenario in found:
        assert 0.0 < scenario.realism_cost < 1.0
        assert scenario.fde_m > 0.0
        assert (scenario.time_s is None) == (not scenario.collision)


def test_in_a_scene_of_a_set_the_others_do_as_recorded_and_the_ego_has_its_log(made):
    rollout, scene = made[0].rollout(NAMES[0]), made[0].scene(NAMES[0])
    logged, tracks = rollout.scene.tracks(), scene.tracks()
    span = slice(rollout.start_step, rollout.start_step + rollout.num_steps)
    for row, name in enumerate(scene.agent_ids):
        agent = rollout.agent_ids.index(name)
        wanted = (
            logged["position"][agent, span] if name == "ego" else rollout.position[agent]
        ) * rollout.valid[agent][:, None]
        there = tracks["valid"][row, span]
        np.testing.assert_array_equal(there, rollout.valid[agent])
        np.testing.assert_array_equal(tracks["position"][row, span][there], wanted[there])
    assert scene.name == rollout.scene.name


def test_collisions_after_the_goal_do_not_count():
    rollout = planned_rollout()
    assert [event.step for event in ego_collisions(rollout)] == [30]
    goal = RolloutEvent(20, "ego", None, "goal")
    assert not ego_collisions(replace(rollout, events=(goal, *rollout.events)))


def test_realism_is_that_of_the_vehicles_that_follow_plans():
    rollout = planned_rollout()
    found = realism(rollout)
    # agents 1 and 2 were moved by up to two metres on both axes; 2 is guided
    assert found["fde_m"] == pytest.approx(np.hypot(2.0, 2.0), rel=1e-3)
    assert found["realism_cost"] == pytest.approx(0.25)
    assert found["shift_sigmas"] is None  # a rollout of before, which has none
    alone = realism(replace(rollout, plans=()))
    assert alone["fde_m"] is None
    assert alone["realism_cost"] is None
    json.dumps([found, alone], allow_nan=False)


def test_files_that_are_not_those_of_the_manifest_are_refused(tmp_path, made):
    entries = make(tmp_path)
    path = manifest(tmp_path, entries)
    assert load_scenario_set(path).scenarios == load_scenario_set(tmp_path).scenarios
    text = path.read_text(encoding="utf-8")
    file = tmp_path / entries[0]["scenario"]["file"]
    content = file.read_bytes()

    file.write_bytes(content[:-1])
    with pytest.raises(DatasetError, match="SHA-256"):
        load_scenario_set(tmp_path)
    with pytest.raises(DatasetError, match="SHA-256"):
        replace(made[0], folder=tmp_path).rollout(NAMES[0])
    file.unlink()
    with pytest.raises(DatasetNotFoundError, match=file.name):
        load_scenario_set(tmp_path)
    file.write_bytes(content)

    path.write_text(text.replace("scenarios 1", "scenarios 0"), encoding="utf-8")
    with pytest.raises(DatasetError, match="format 'ccdiff-env scenarios 0'"):
        load_scenario_set(tmp_path)
    with pytest.raises(DatasetNotFoundError, match="no scenario set"):
        load_scenario_set(tmp_path / "nowhere")
    with pytest.raises(UnknownNameError, match="no scenario of scene 'queue-03'"):
        made[0].find("queue-03")


def test_sets_of_two_generators_need_two_names(tmp_path):
    with pytest.raises(ConfigError, match="two of the same name"):
        set_folders(["a/ego.zip", "b/ego.zip"], tmp_path)
    folders = set_folders(["egos/ego.zip", "my.planners:Mine"], tmp_path)
    assert [folder.name for folder in folders.values()] == ["ego", "my.planners-Mine"]
    with pytest.raises(UnknownNameError, match="no traffic 'ctg-9'"):
        generation_jobs(VAL, folders, traffic="ctg-9")


def scenario(scene, *, collision, avoidable):
    return Scenario(
        scene=scene, token="", file=f"{scene}.npz", sha256="", collision=collision, kind=None,
        partner=None, time_s=None, at_fault=False, avoidable=avoidable, realism_cost=0.5,
        fde_m=1.0, shift_sigmas=1.5,
    )  # fmt: skip


def test_the_matrix_leaves_out_what_could_not_be_avoided(tmp_path):
    scenarios = (
        scenario("a", collision=True, avoidable=False),
        scenario("b", collision=True, avoidable=True),
        scenario("c", collision=False, avoidable=True),
    )
    made = ScenarioSet(
        folder=tmp_path, generator="idm", traffic="ccdiff-1", seed=0, weights="", source=VAL,
        settings={}, scenarios=scenarios,
    )  # fmt: skip

    def rows(generator, planner, *hits):
        return [
            {
                "generator": generator,
                "planner": planner,
                "scene": s.scene,
                "collision": float(h),
                "no_at_fault_collision": 1.0,
                "score": 1.0 - h,
            }
            for s, h in zip(scenarios, hits, strict=True)
        ]

    episodes = [*rows("idm", "idm", 1, 1, 0), *rows("idm", "pdm", 1, 0, 0)]
    episodes += [*rows(None, "idm", 1, 1, 0), *rows(None, "pdm", 0, 0, 0)]
    sets = {"idm": made}
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
    figures = ["idm", 3, 2, 0, 1, 0.5, 1.5, 1.0]
    assert sets_table(sets).rows == [figures]
    text = document(*tables(sets, crossed))
    assert "| IDM on the log's path | 3 | 2 | 0 | 1 | 0.50 | 1.50 | 1.0 |" in text


def test_a_limit_takes_the_first_scenes():
    few = "embedded/val?limit=2"
    assert scene_names(few) == scene_names(VAL)[:2]
    with pytest.raises(ConfigError, match="limit"):
        scene_names("embedded/val?limit=0")


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
    for name in ("table.md", "figures.csv", "sets/idm/manifest.json", "sets/replay/manifest.json"):
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
    found = load_scenario_set(folder / "sets" / "lane_idm")
    assert found.digest == said
    assert found.version == __version__
    (folder / "sets" / "lane_idm" / found.scenarios[0].file).write_bytes(b"other")
    with pytest.raises(DatasetError, match="the manifest says"):
        load_scenario_set(folder / "sets" / "lane_idm")
    return said


def test_sets_of_the_city_are_made_by_one_command_with_one_digest(tmp_path, capsys):
    digest = "ac4209f879a4e0578e3ff790ca1432ca0b3211f327ee8eebf8a5c889ae71b286"
    assert one_command(tmp_path, capsys, "embedded/city") == digest


@pytest.mark.nuscenes
@pytest.mark.filterwarnings("ignore:.*has 93 of the 150 scenes")
def test_sets_of_nuscenes_are_made_by_one_command_and_checked_by_digest(
    tmp_path, capsys, data_root
):
    digest = "d4201c254c2a9b79cbad3ce4cdcb333d67715b39123b1528cd92a918f3ba986c"
    assert one_command(tmp_path, capsys, f"nuscenes:{data_root}/nuscenes/val") == digest


def test_a_job_refuses_a_set_that_changed(tmp_path, made):
    job = cross_jobs({"idm": made[0]}, ["idm"])[0]
    wrong = {**job.arguments, "files": dict.fromkeys(job.arguments["files"], "0")}
    with pytest.raises(ConfigError, match="not the one"):
        evaluate_in_set(**wrong)
    rollout = made[0].rollout(NAMES[0])
    assert as_scene(rollout).hash == made[0].scene(NAMES[0]).hash
