"""The command line: wrong words, folders that a typo leaves alone, tables, training."""

import argparse
import csv
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ccdiff_env import SceneSet, cli, embedded_scenes
from ccdiff_env.cli import main
from ccdiff_env.errors import ConfigError
from ccdiff_env.models import TrajectoryModel
from ccdiff_env.system.settings import keep_settings
from ccdiff_env.system.table import Column, Markdown, Table, document, link
from ccdiff_env.system.terminal import align
from ccdiff_env.training.ppo import settings_of
from ccdiff_env_cli import parse


@pytest.mark.parametrize(
    ("words", "help_line", "said"),
    [
        ("viw left-turn-00", "ccdiff-env --help", "did you mean view?"),
        ("bench planers", "ccdiff-env bench --help", "did you mean planners?"),
        (
            "bench planners --out x --planers idm",
            "ccdiff-env bench planners --help",
            "mean --planners?",
        ),
        ("view left-turn-00 --trafic=idm", "ccdiff-env view --help", "did you mean --traffic?"),
    ],
)
def test_wrong_words_are_answered_by_their_verb(words, help_line, said, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(words.split())
    assert ended.value.code == 2
    err = capsys.readouterr().err
    assert help_line in err
    assert said in err


RUN = ["--planners", "replay", "--traffic", "replay", "--limit", "1", "--seeds", "0", "--quiet"]


def test_a_typo_leaves_no_folder_and_a_run_is_gone_on_with(tmp_path, capsys):
    out = tmp_path / "run"
    command = ["bench", "planners", "--out", str(out), *RUN]
    for wrong in (["--planners", "replayy"], ["--traffic", "idmm"]):
        assert cli.main([*command, *wrong]) == 2
        assert not out.exists()
    assert cli.main(command) == 0
    assert "no interval" in (out / "table.md").read_text()
    # planners may be added, and a run gone on with
    assert cli.main([*command, "--planners", "replay,constant_velocity"]) == 0
    assert cli.main([*command, "--seeds", "1"]) == 2
    assert "other settings: seeds [0], now [1]" in capsys.readouterr().err


def test_the_doctor_says_what_there_is_and_drives_a_world(capsys):
    assert cli.main(["doctor"]) == 0
    said = capsys.readouterr().out
    for word in ("ccdiff-env", "Python", "processor", "torch", "cache", "41 scenes", "steps a sec"):
        assert word in said
    assert cli.main(["doctor", "--scenes", "nuscenes:/nowhere"]) == 1
    assert "FAILS" in capsys.readouterr().out


def test_an_ego_is_trained_by_a_verb_that_refuses_what_means_nothing(tmp_path, capsys):
    pytest.importorskip("torch")
    import ccdiff_env

    out = tmp_path / "ego"
    for words, said in (
        (["--traffic", "imd"], "--traffic is 'imd'"),
        (["--traffic", "bank"], "go together"),
        (
            ["--traffic", "idm", "swift?criticality=1", "--criticality", "2"],
            "idm swift?criticality",
        ),
        (["--traffic", "learned?num_guided=1"], "learned without options"),
        (["--learning-rate", "nan"], "--learning-rate is nan"),
        (["--noise", "0.1", "0"], "--noise is [0.1, 0.0]"),
        (["--threads", "0"], "--threads is 0, expected at least 1"),
        (["--shown", "-1"], "--shown is -1, expected at least 0"),
        (["--start", "nobody"], "nobody"),
        (["--base", "nobody"], "one of idm, pdm"),
        (["--base", "pdm", "--dynamics", "unicycle"], "--base is for assisted dynamics"),
        (["--start", "ego", "--dynamics", "unicycle"], "--start ego drives by Assisted"),
        (["--start", "ego", "--base", "idm"], "--start ego drives by AssistedLimits(base='pdm'"),
    ):
        assert cli.main(["train-ego", "--out", str(out), *words]) == 2
        assert said in capsys.readouterr().err
        assert not out.exists()
    words = ["--base", "pdm", "--kl", "0.1", "--out", str(out), "--threads", "1"]
    assert cli.main(["train-ego", "--smoke", *words]) == 0
    policy = ccdiff_env.planners.load(out / "ego.safetensors")
    assert policy.config.action.dynamics.base == "pdm"
    assert "ego.safetensors" in capsys.readouterr().out
    words = ["--dynamics", "unicycle", "--long", "--shown", "100", "--out", str(tmp_path / "long")]
    assert cli.main(["train-ego", "--smoke", *words, "--threads", "1"]) == 0
    policy = ccdiff_env.planners.load(tmp_path / "long" / "ego.safetensors")
    assert "road_left" in policy.config.observation.ego_columns
    env = ccdiff_env.EgoEnv(driver=policy, horizon_steps=3)
    env.reset(seed=0)
    assert np.isfinite(env.step(env.action_space.sample())[1])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("train --steps 1 --threads 0 --out out", "--threads is 0, expected at least 1"),
        (
            "train --steps 1 --learning-rate nan --out out",
            "learning_rate is nan, expected a number",
        ),
        ("train --steps -1 --out out", "steps or minutes: -1"),
        ("train --minutes nan --out out", "steps or minutes: nan"),
        ("bench traffic --methods ccdiff --k -1 --out out", "K is -1, expected at least 0"),
        (
            "bench traffic --methods ccdiff --t 0 --out out",
            "--t is '0', expected multiples of 0.1 s",
        ),
        (
            "bench traffic --methods idm,ccdiff --t 0.5,5.3 --out out",
            "--t is 5.3, expected at most 5.2 s, as long as the plans of ccdiff",
        ),
        ("bench traffic --methods ccdiff --match 5 --out out", "expected rates between 0 and 1"),
        ("bench traffic --match 0.5 --strengths 1,1 --out out", "expected two at least"),
        ("bench planners --planners idm?title= --out out", "the title is empty"),
        ("bench scenarios --plans 0 --out out", "--plans is 0, expected at least 1"),
        ("train-ego --kl nan --smoke --out out", "--kl is nan, expected at least 0"),
    ],
)
def test_numbers_that_mean_nothing_are_refused(tmp_path, monkeypatch, capsys, words, said):
    if words.startswith("train"):
        pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    assert cli.main(words.split()) == 2
    assert said in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_any_integer_is_a_seed_as_in_environments():
    from ccdiff_env import EgoEnv, WorldConfig, embedded_scenes
    from ccdiff_env.record.episode import begin

    scenes, config = embedded_scenes("val")[:1], WorldConfig(start_spread_steps=20)
    env = EgoEnv(scenes=scenes, config=config)
    for seed in (-1, 2**70 + 3):
        env.reset(seed=seed)
        own, usual = begin(scenes, config, seed).native.status(0), env.worlds.native.status(0)
        assert (own.seed, own.step_idx) == (usual.seed, usual.step_idx)


def test_vehicles_and_starts_are_drawn_but_the_ego_of_a_bank_stays(tmp_path):
    pytest.importorskip("torch")
    import ccdiff_env
    from ccdiff_env.training import train_ego
    from ccdiff_env.training.ppo import Worlds

    ccdiff_env.record_bank(ccdiff_env.embedded_scenes("val")[:2], tmp_path, ego="replay")
    words = ["--worlds", "32", "--traffic", "idm", "bank", "--bank", str(tmp_path), "--any-ego"]
    parser = argparse.ArgumentParser()
    train_ego.add_arguments(parser)
    config = ccdiff_env.WorldConfig().with_options(start_spread_steps=50)
    worlds = Worlds(parser.parse_args(words), config, seed=0)
    for name, env in zip(("idm", "bank"), worlds.envs, strict=True):
        native, scenes = env.worlds.native, env.worlds.scenes
        status = [native.status(i) for i in range(16)]
        egos = {scenes[one.scene_idx].agent_ids[one.ego_idx] for one in status}
        assert (egos == {"ego"}) == (name == "bank")
        assert ("idm" in {of for i in range(16) for of in native.drivers(i)}) == (name == "idm")


def test_each_network_draws_the_criticality_that_its_options_do_not_fix(tmp_path):
    pytest.importorskip("torch")
    import ccdiff_env
    from ccdiff_env.training import train_ego
    from ccdiff_env.training.ppo import Worlds

    traffic = ["ctg?num_guided=1", "swift?criticality=0.5", "ccdiff?follow_route=true", "learned"]
    words = ["--worlds", "16", "--criticality", "2", "--out", str(tmp_path), "--traffic", *traffic]
    words += ["--limit", "2", "--more-scenes", "embedded/val"]
    parser = argparse.ArgumentParser()
    train_ego.add_arguments(parser)
    worlds = Worlds(parser.parse_args(words), ccdiff_env.WorldConfig(), seed=0).envs
    assert len(worlds[0].worlds.scenes) == 2 + len(ccdiff_env.embedded_scenes("val"))
    drawn = [[env.worlds.criticality.get(i) for i in range(4)] for env in worlds]
    assert drawn[1] == [None] * 4
    assert worlds[1].worlds.configured_criticality == 0.5
    for own in (drawn[0], drawn[2], drawn[3]):
        assert 0.0 < min(own) < max(own) <= 2.0
    (ctg,), (ccdiff,), (learned,) = (
        worlds[i].worlds.config.networks_in_traffic() for i in (0, 2, 3)
    )
    assert ctg.num_guided == 1
    assert ctg.denoising_steps != 1
    assert ccdiff.follow_route
    assert ccdiff.denoising_steps == learned.denoising_steps == 1
    assert learned.adversary_policy == "learned"


def test_training_begins_with_a_policy_and_stays_near_no_action():
    torch = pytest.importorskip("torch")
    import ccdiff_env
    from ccdiff_env.training.ego_network import Agent
    from ccdiff_env.training.ppo import update

    ego = ccdiff_env.planners.load("ego")
    env = ccdiff_env.make_vec(64, traffic="idm", **ego.env_options)
    obs, _ = env.reset(seed=0)
    moved = {}
    for kl in (0.0, 1e4):
        torch.manual_seed(0)
        agent = Agent(env.worlds.layout, (0.2, 0.1))
        agent.take(ego)
        agent.see(torch.from_numpy(obs))
        x = agent.normalised(torch.from_numpy(obs))
        with torch.no_grad():
            mean = agent(x)[0]
        assert np.allclose(mean.clamp(-1.0, 1.0).numpy(), ego.act(obs), atol=1e-4)
        actions = mean + 0.1 * torch.randn_like(mean)
        data = {"x": x, "actions": actions, "log_prob": agent.log_prob(mean, actions).detach()}
        data |= {"advantage": torch.randn(64), "returns": torch.zeros(64)}
        optimiser = torch.optim.Adam(agent.policy.parameters(), lr=1e-3)
        for _ in range(10):
            update(agent, optimiser, dict(data), kl)
        moved[kl] = float((agent(x)[0].abs().mean() / mean.abs().mean()).detach())
    assert moved[1e4] < 0.7 * moved[0.0]


def test_tables_are_aligned_numbers_to_the_right_and_the_best_is_marked():
    text = align(
        "Idm is best.\n\n### Scores\n\n| planner | score |\n|---|---:|\n"
        "| idm | **0.90** |\n| constant velocity | 10.25 [1, 2] |\n\nMeans."
    )
    assert text == (
        "Idm is best.\n\nScores\n\n"
        "planner                   score\n"
        "─────────────────  ────────────\n"
        "idm                      0.90 *\n"
        "constant velocity  10.25 [1, 2]\n\nMeans.\n"
    )
    wide = "| a | b |\n|---|---|\n| a long name | **0.50 [0.45, 0.55]** |\n"
    assert align(wide, 30).splitlines()[2] == "a long name  0.50 *"
    # tables without rows and empty cells stay
    heads = ["score", "as recorded", "IDM", "CCDiff", "CCDiff, criticality 1"]
    wide = (
        f"| {' | '.join(heads)} |\n|{'---|' * 5}\n| {'PDM-Closed' + ' | 0.50 [0.40, 0.60]' * 4} |\n"
    )
    assert align(wide, 80).splitlines()[0].split("  ")[-2:] == ["CC 0", "CC 1"]
    narrow = align(wide, 30).splitlines()
    assert narrow[0].split() == ["score", "as", "recorded", "IDM"]
    assert narrow[3:] == ["no room for: CC 0, CC 1"]
    assert align("| a | b |\n|---|---|\n") == "a  b\n─  ─\n"
    assert align("| a | b |\n|---|---|\n| x | |\n").splitlines()[2] == "x"
    # a wide letter takes two places, an accent of its own none
    wide = align("| a | b |\n|---|---|\n| 東京 | 1 |\n| e\u0301 | 10 |\n", 8)
    assert wide.splitlines()[1:] == ["────  ──", "東京   1", "e\u0301     10"]


@pytest.mark.parametrize("module", ["ccdiff_env.cli", "ccdiff_env_cli"])
def test_output_that_nobody_reads_on_ends_without_a_word(module):
    command = [sys.executable, "-m", module, "scenes"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 1


NAN = math.nan


def table():
    columns = (Column("hit", unit="%", digits=1, factor=100.0), Column("gap", "distance", "m"))
    return Table(
        ["name", "count", *columns],
        [["a", 3, (0.25, 0.125, 0.5), 1.5], ["b", 4, (NAN, NAN, NAN), None]],
        "Two",
    )


def test_readers_see_units_digits_and_intervals():
    assert str(table()) == (
        "### Two\n\n| name | count | hit % | distance m |\n|---|---|---|---|\n"
        "| a | 3 | 25.0 [12.5, 50.0] | 1.50 |\n| b | 4 | n/a | |"
    )


def test_latex_has_the_same_cells_with_its_letters_escaped():
    cells = [["a_b & c", 0.25], [link("d", "page.html"), 0.5]]
    text = Table(["name", Column("hit", unit="%", best=True)], cells, "Two_").latex()
    assert text.splitlines() == [
        *(r"\begin{table}", r"\centering", r"\caption{Two\_}"),
        r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{\begin{tabular}{lc}",
        r"\toprule",
        r"name & hit \% \\",
        r"\midrule",
        r"a\_b \& c & 0.25 \\",
        r"d & \textbf{0.50} \\",
        r"\bottomrule",
        r"\end{tabular}}",
        r"\end{table}",
    ]


def test_files_have_the_values_themselves(tmp_path):
    table().write_csv(tmp_path / "t.csv")
    rows = list(csv.reader((tmp_path / "t.csv").open()))
    assert rows[0] == ["name", "count", "hit", "hit_low", "hit_high", "gap"]
    assert rows[1:] == [["a", "3", "0.25", "0.125", "0.5", "1.5"], ["b", "4", "", "", "", ""]]
    # a cell without an interval, in a column of intervals, moves no cell to another column
    Table(["a", "b"], [[0.5, (2.0, 1.0, 3.0)], [(0.5, 0.0, 1.0), None]]).write_csv(tmp_path / "t")
    rows = list(csv.reader((tmp_path / "t").open()))
    assert rows[1:] == [["0.5", "", "", "2.0", "1.0", "3.0"], ["0.5", "0.0", "1.0", "", "", ""]]


def test_the_highest_as_shown_are_emphasised():
    cells = (0.901, Markdown("[0.90](#a) [0.80, 0.95]"), 0.894, NAN, None)
    lines = str(Table([Column("score", best=True)], [[cell] for cell in cells])).splitlines()
    shown = ["**0.90**", "**[0.90](#a) [0.80, 0.95]**", "0.89", "n/a"]
    assert lines[2:] == [*(f"| {cell} |" for cell in shown), "| |"]
    # a document leaves out what has nothing
    assert document("First.", "", Table(["a"], []), "Last.") == "First.\n\nLast.\n"


def test_training_resumes_and_begins_with_weights_that_are_told_routes(tmp_path, capsys):
    command = ["train", "--scenes", "embedded/train?limit=8", "--batch-scenes", "1", "--quiet"]
    command += ["--hold-out-every", "4", "--out"]
    for steps in ("1", "2"):
        assert main([*command, str(tmp_path / "first"), "--steps", steps]) == 0
    path = Path(capsys.readouterr().out.splitlines()[-1])
    header = TrajectoryModel(path).header
    assert (header["step"], header["notes"]["num_scenes"]) == (2, 6)
    more = tmp_path / "routes"
    assert main([*command, str(more), "--start", str(path), "--routes", "--steps", "1"]) == 0
    told = TrajectoryModel(more / "weights.safetensors").header
    assert told["model"]["route_points_m"][0] == 5.0
    assert told["model"]["normalisation"] == header["model"]["normalisation"]
    assert told["training"]["drop_route"] == 0.5


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            "--scenes embedded/val",
            "12 scenes of val and city and val-lights and city-lights kept out",
        ),
        ("--scenes nuscenes:/nowhere", "/nowhere"),
        (f"--model simnet --scenes embedded/train --seed {2**70}", "training.seed is"),
    ],
)
def test_what_cannot_train_is_an_error_in_one_line(words, said, tmp_path, capsys):
    assert main(["train", *words.split(), "--out", str(tmp_path), "--steps", "1"]) == 2
    message = capsys.readouterr().err
    assert message.startswith("ccdiff-env train: ")
    assert said in message
    assert "Traceback" not in message


@pytest.mark.parametrize("seed", [-1, 2**64 - 1, 2**70])
def test_any_integer_is_the_seed_of_an_ego(seed, tmp_path):
    assert main(["train-ego", "--smoke", "--seed", str(seed), "--out", str(tmp_path)]) == 0


def test_the_queue_goes_on_after_a_failure_and_leaves_what_is_finished(tmp_path, monkeypatch):
    from tools import train_all

    short = ["--batch-scenes", "1", "--hold-out-every", "4", "--limit", "8", "--steps", "1"]
    refused, simnet = ["--model", "nobody", *short], ["--model", "simnet", *short]
    monkeypatch.setattr(train_all, "TRAININGS", {"refused": refused, "short": simnet})
    command = ["--out", str(tmp_path), "--scenes", "embedded/train"]
    assert train_all.main(command) == 1
    assert "nobody" in (tmp_path / "refused/log.txt").read_text()
    weights = tmp_path / "short/weights.safetensors"
    assert TrajectoryModel(weights).header["step"] == 1
    written = weights.stat().st_mtime_ns
    assert train_all.main([*command, "--only", "short"]) == 0
    assert weights.stat().st_mtime_ns == written
    asked = []  # what is finished with other arguments is not finished: train refuses or goes on
    monkeypatch.setattr(train_all.subprocess, "call", lambda line, **_: asked.append(line) or 2)
    monkeypatch.setitem(train_all.TRAININGS, "short", [*simnet, "--seed", "9"])
    assert train_all.main([*command, "--only", "short"]) == 1
    assert asked[0][-2:] == ["--seed", "9"]
    monkeypatch.setitem(train_all.TRAININGS, "short", simnet)
    assert train_all.main(["--out", str(tmp_path), "--scenes", "embedded", "--only", "short"]) == 1
    assert "embedded" in asked[1]


def test_a_table_of_other_scenes_stands_beside_the_kept_one(tmp_path, monkeypatch):
    from tools import pages, results

    made_with = dict.fromkeys(("version", "commit", "processor"), "")
    row = dict.fromkeys(("planner", "figure", "value", "other", "difference", "p"), "0")
    row |= {"traffic": "idm", "planner": "nuplan:pdm_closed_planner", "against": "pdm"}
    monkeypatch.setattr(pages, "DATA", tmp_path)
    monkeypatch.setattr(results, "_run", lambda *_: (about, [row]))
    for few in (93, 150, 93):
        coverage = f"{few} of 150 scenes of val"
        about = {"made_with": made_with, "weights": "", "coverage": coverage}
        results.record("nuplan", "nuscenes:data/val", 1, tmp_path)
    for name, few in (("nuplan", 93), ("nuplan_150", 150)):
        assert f"{few} of 150 scenes of val" in results.render(name)
    assert len([*tmp_path.iterdir()]) == 2


def test_studies_take_as_done_what_was_made_with_the_same(tmp_path, monkeypatch):
    from tools import expectations

    done = []
    rows = [dict.fromkeys(("scene", *expectations.FIGURES), 0.0)]
    monkeypatch.setattr(expectations, "drive", lambda *made_of: done.append("drive") or (rows, {}))
    scenes = embedded_scenes("val")
    for policy, part in ((b"a", [0, 1]), (b"a", [0, 1]), (b"a", [1, 2]), (b"b", [1, 2])):
        (tmp_path / "ego.safetensors").write_bytes(policy)
        assert expectations.test(tmp_path, SceneSet([scenes[i] for i in part]), "idm") == rows
    assert len(done) == 3

    monkeypatch.setattr(expectations.subprocess, "run", lambda *_, **__: done.append("train"))
    words = "--scenes embedded/train --seed 1 --traffic idm"
    begun = ["train-ego", *words.split(), *expectations.SAME.split(), "--out", str(tmp_path)]
    keep_settings(tmp_path / "run.json", settings_of(parse(begun)))
    taken_s = [expectations.train(tmp_path, words) for _ in range(2)]
    assert taken_s[0] == taken_s[1]
    assert done[3:] == ["train"]
    with pytest.raises(ConfigError, match="other settings: traffic"):
        expectations.train(tmp_path, words.replace("idm", "replay"))
