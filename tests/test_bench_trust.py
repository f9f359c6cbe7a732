"""Numbers that a stranger can check: nothing stale, no other rules, every bit played again."""

import base64
import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from array_scenes import agent, array_scene, begun, wide_road

import ccdiff_env
from ccdiff_env import cli
from ccdiff_env.bench.intervals import are_few, scene_means
from ccdiff_env.bench.planner_report import comparison
from ccdiff_env.bench.planner_score import Judge
from ccdiff_env.bench.planners import TRAFFIC, drive, planner_jobs
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.provenance import package_digest, sha256_of
from ccdiff_env.bench.record import Record
from ccdiff_env.bench.tape import Recorded
from ccdiff_env.bench.verify import verify
from ccdiff_env.errors import ConfigError, DatasetError
from ccdiff_env.models import weight_files
from ccdiff_env.planners import SHIPPED
from ccdiff_env.record.episode import begin
from ccdiff_env.system.table import document
from ccdiff_env.worlds.worlds_view import behind, worlds_view
from ccdiff_env_cli import parse

ROOT = Path(__file__).resolve().parents[1]


def run(folder, *words):
    command = ["bench", "planners", "--out", str(folder), "--quiet", "--traffic", "replay"]
    return cli.main([*command, "--seeds", "0", "--limit", "2", *words])


def test_a_file_that_was_trained_again_is_driven_anew(tmp_path, capsys):
    policy = tmp_path / "p.safetensors"
    policy.write_bytes(SHIPPED["ego"].read_bytes())
    assert run(tmp_path / "run", "--planners", str(policy)) == 0
    (first,) = (tmp_path / "run" / "raw").iterdir()
    before = json.loads(first.read_text())
    policy.write_bytes(SHIPPED["ego_replay"].read_bytes())
    capsys.readouterr()
    assert run(tmp_path / "run", "--planners", str(policy)) == 0
    told = capsys.readouterr().err
    assert "1 result is made again" in told
    assert told.endswith(" because sources planner has changed\n")
    after = json.loads(first.read_text())
    digests = [row["digest"] for made in (before, after) for row in made["result"]]
    assert len(set(digests)) == 4


@pytest.mark.parametrize("name", ["version", "package", "weights", "protocol", "scenes"])
def test_what_else_has_changed_is_driven_anew(tmp_path, capsys, name):
    assert run(tmp_path, "--planners", "idm") == 0
    (raw,) = (tmp_path / "raw").iterdir()
    made = json.loads(raw.read_text())
    now = made["made_from"][name]
    made["made_from"][name] = dict.fromkeys(now, "other") if name == "scenes" else "other"
    raw.write_text(json.dumps(made))
    capsys.readouterr()
    assert run(tmp_path, "--planners", "idm") == 0
    assert f"{name}" in capsys.readouterr().err
    assert json.loads(raw.read_text())["made_from"][name] == now


def test_a_run_says_what_it_was_made_with(tmp_path):
    assert run(tmp_path, "--planners", "idm") == 0
    settings = json.loads((tmp_path / "run.json").read_text())
    made = settings["made_with"]
    assert made["version"] == ccdiff_env.__version__
    assert made["package"] == package_digest()
    assert made["processor"]
    assert made["commit"] is None or re.match("[0-9a-f]{40}", made["commit"])
    assert made["libraries"]["numpy"] == np.__version__
    assert settings["protocol_sha256"] == PROTOCOL.sha256
    assert settings["planners"] == {"idm": None}
    scenes = ccdiff_env.embedded_scenes("val")[:2]
    assert settings["scenes"] == {scene.name: scene.hash for scene in scenes}
    shipped = [file for file in weight_files() if file.stem.endswith("_fast")]
    assert settings["weights"] == sha256_of(*shipped)
    heads = (tmp_path / "figures.csv").read_text().splitlines()[0].split(",")
    assert {*PROTOCOL.fields["score"]["gates"]} <= {*heads}


class Idle:
    def __call__(self, obs):
        return np.zeros((len(obs), 2), np.float32)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"horizon_steps": 5}, "horizon_steps to 5, which planner-1.4 fixes at 100"),
        ({"speed_limit_mps": 100.0}, "speed_limit_mps"),
        ({"traffic": "idm"}, "traffic"),
        ({"dt_s": 0.05}, "dt_s"),
        ({"config": ccdiff_env.WorldConfig(terminate_at_goal=False)}, "terminate_at_goal"),
        ({"config": ccdiff_env.WorldConfig(horizon_steps=5)}, "horizon_steps"),
    ],
)
def test_planners_cannot_change_the_rules(options, named):
    scenes = ccdiff_env.embedded_scenes("val")[:1]
    planner = Idle()
    assert drive(scenes, planner, TRAFFIC["replay"])[0][0]["score"] < 1.0
    planner.env_options = options
    with pytest.raises(ConfigError, match=f"Idle: env_options changes {named}"):
        drive(scenes, planner, TRAFFIC["replay"])


def test_planners_choose_actions_observations_and_decision_steps():
    planner = Idle()
    planner.env_options = {
        "dynamics": "bicycle",
        "decision_steps": 5,
        "observation": {"num_neighbors": 4},
    }
    (row,), _ = drive(ccdiff_env.embedded_scenes("val")[:1], planner, TRAFFIC["replay"])
    assert "bicycle" in row["action"]["dynamics"]


class Peeks:
    """Asks for the actions that lead along the log."""

    privileged = True

    def __init__(self, worlds):
        self.worlds = worlds

    def __call__(self, obs):
        native = self.worlds.native
        return np.stack([native.expert_actions(i)[0] for i in range(self.worlds.num_worlds)])


class Hidden(Peeks):
    privileged = False


def test_only_privileged_planners_see_the_log():
    scenes = ccdiff_env.embedded_scenes("val")[:2]
    assert len(drive(scenes, Peeks, TRAFFIC["replay"])[0]) == 2
    with pytest.raises(
        ConfigError, match=r"Hidden: worlds\.native\.expert_actions is for planners"
    ):
        drive(scenes, Hidden, TRAFFIC["replay"])
    worlds = worlds_view(ccdiff_env.EgoEnv(scenes=scenes).worlds, "mine")
    assert worlds.native.num_worlds == worlds.num_worlds == 1
    assert worlds.config.dt_s == 0.1
    assert worlds.scenes[0].sizes.shape == (scenes[0].num_agents, 3)
    assert len(worlds.scenes) == 2


@pytest.mark.parametrize(
    "name",
    [
        *("assign", "last", "set_progress", "criticality", "drivers", "curriculum"),
        *(f"scenes[0].{n}" for n in ("name", "token", "hash", "agent_ids", "tracks", "to_bytes")),
        *(f"native.status(0).{n}" for n in ("seed", "episode")),
        *(f"native.{n}" for n in ("metrics", "snapshot", "digest", "driver_table", "explain")),
        *(f"config.{n}" for n in ("traffic", "ccdiff", "named_drivers", "idm", "drivers")),
        "config.to_json",
    ],
)
def test_planners_are_not_shown_which_episode_it_is_nor_who_drives_the_others(name):
    """What an oracle would look the episode up by, or play it beforehand."""
    env = begun()
    shown = {"worlds": worlds_view(env.worlds, "mine")}
    with pytest.raises(ConfigError, match=re.escape(f".{name.rpartition('.')[2]} is for planners")):
        eval(f"worlds.{name}", shown)


def test_planners_are_shown_of_agents_what_is_there_and_no_scene_by_name():
    t = np.arange(160) * 0.1
    late = agent("late", 60.0 + 4.0 * t, size=(9.0, 2.5, 3.0), valid=t > 4.0)
    scene = array_scene(agent("ego", 8.0 * t), late, name="own", layers=wide_road())
    env = begun(scenes=[scene], driver="replay")
    shown = worlds_view(env.worlds, "mine").scenes[0]
    assert shown.sizes[:, 0].tolist() == [4.5, 0.0]
    assert shown.agent_types == ["vehicle", ""]
    for _ in range(15):
        env.step(np.zeros(2, np.float32))
    assert shown.sizes[:, 0].tolist() == [4.5, 9.0]
    assert shown.agent_types == ["vehicle", "vehicle"]
    with pytest.raises(ConfigError, match="by their numbers"):
        worlds_view(env.worlds, "mine").scenes["own"]


def test_sizes_tell_no_scene_in_which_somebody_comes_later():
    """What a planner that knows all scenes by their sizes finds at the first step."""
    scenes = ccdiff_env.embedded_scenes("val")
    known = {scene.sizes.tobytes(): scene.name for scene in scenes}
    shown = worlds_view(begin(scenes, ccdiff_env.WorldConfig(), 0), "mine").scenes
    found = {known.get(shown[i].sizes.tobytes()) for i in range(len(scenes))} - {None}
    assert found == {s.name for s in scenes if s.tracks()["valid"][:, 30].all()}
    assert len(found) < len(scenes) / 2


def test_scenes_come_to_planners_in_an_order_that_the_seed_draws():
    known = [scene.name for scene in ccdiff_env.embedded_scenes("city")]
    orders = [
        [name for job in planner_jobs("embedded/city", ["idm"], ["replay"], seed=seed)
         for name in job.arguments["names"]]
        for seed in (0, 0, 1)
    ]  # fmt: skip
    assert orders[0] == orders[1] != orders[2]
    for order in orders:
        assert sorted(order) == sorted(known)
        assert sum(a == b for a, b in zip(order, known, strict=True)) < 10


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run of two planners with networks in traffic, and the command that made it."""
    folder = tmp_path_factory.mktemp("made")
    command = ["bench", "planners", "--out", str(folder), "--quiet", "--limit", "3"]
    command += ["--planners", "ego,idm", "--traffic", "idm-hasty,ccdiff-1", "--seeds", "0,1"]
    assert cli.main(command) == 0
    return folder


def test_every_episode_is_played_again_bit_for_bit(made, capsys):
    assert cli.main(["bench", "verify", str(made)]) == 0
    out = capsys.readouterr().out
    assert "24 of 24 episodes come out the same, bit for bit" in out
    assert (made / "table.md").read_text().splitlines()[0] in out
    assert verify(Record.read(made), episodes=4).played == 6  # whole batches
    with pytest.raises(ConfigError, match="episodes is 0"):
        verify(Record.read(made), episodes=0)


def on_a_narrow_processor(*words):
    """Do as another machine would: no wide vectors in Rust, numpy, BLAS and the C library."""
    text = "import sys; from ccdiff_env import _native, cli; _native.hold_to_base(); "
    text += f"sys.exit(cli.main({['bench', *map(str, words)]!r}))"
    narrow = {
        "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F AVX512CD AVX512_SKX",
        "OPENBLAS_CORETYPE": "Prescott",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F",
    }
    done = subprocess.run(
        [sys.executable, "-c", text], env={**os.environ, **narrow}, text=True, capture_output=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_wider_processors_verify_what_those_with_fewer_instructions_made(tmp_path, capsys):
    """Learned planners in networks' traffic, scenes of the city."""
    words = ["--planners", "pdm,ego,ego_replay", "--traffic", "ccdiff-2,tokens"]
    few = ["--scenes", "embedded/city", "--limit", "2", "--seeds", "0", "--quiet"]
    on_a_narrow_processor("planners", *words, *few, "--out", tmp_path)
    assert cli.main(["bench", "verify", str(tmp_path)]) == 0
    assert "12 of 12 episodes come out the same, bit for bit" in capsys.readouterr().out


class Leaps(Idle):
    env_options: ClassVar = {"dynamics": "delta_pose"}


class Weakens(Idle):
    """Digs behind the view, and takes the guidance out of the traffic's plans."""

    def __init__(self, worlds):
        self.native = behind(worlds).native

    def __call__(self, obs):
        for i in range(len(obs)):
            self.native.override_plan(i, guided=[], criticality=0.0)
        return super().__call__(obs)


class Flatters(Idle):
    """Changes in its own process how it is judged."""

    def __init__(self, worlds):
        row = Judge.row

        def best(judge, metrics):
            found = row(judge, metrics) | dict.fromkeys(PROTOCOL.fields["score"]["gates"], 1.0)
            found |= dict.fromkeys(PROTOCOL.fields["score"]["weights"], 1.0)
            return {**found, "score": 1.0}

        Judge.row = best


class Lucky:
    """Draws anew in every run: the best of several is kept."""

    def __init__(self, worlds):
        self.rng = np.random.default_rng()

    def __call__(self, obs):
        return self.rng.normal(0.0, 0.3, (len(obs), 2)).clip(-1, 1)


@pytest.mark.parametrize(
    ("cheat", "said"),
    [(Weakens, "in ccdiff-2"), (Flatters, "was 1.0, is"), (Lucky, None)],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_planners_that_cheat_are_found_or_named_by_the_page(tmp_path, monkeypatch, cheat, said):
    """Those who look the episode up are refused, see above; so are wider dynamics and NaN."""
    monkeypatch.setattr(Judge, "row", Judge.row)  # as it was, whatever a planner does
    words = ["--planners", f"{__name__}:{cheat.__name__}", "--traffic", "ccdiff-2", "--seeds", "0"]
    out = ["--limit", "2", "--out", str(tmp_path), "--quiet"]
    assert cli.main(["bench", "planners", *words, *out]) == 0
    monkeypatch.undo()
    found = verify(Record.read(tmp_path)).differing
    if said is None:
        page = " ".join((ROOT / "docs/benchmark.md").read_text().split())
        assert not found
        assert "the best of several draws verifies, too" in page
    else:
        assert len(found) == 2
        assert all(said in line for line in found)


def changed(made, folder, change, name="ego-ccdiff-1-1-000.json"):
    """A copy of a run with one raw result changed."""
    (folder / "raw").mkdir(parents=True)
    (folder / "run.json").write_text((made / "run.json").read_text())
    result = json.loads((made / "raw" / name).read_text())
    change(result)
    (folder / "raw" / name).write_text(json.dumps(result))
    return folder


def nudge(result, by=0.001):
    row = result["result"][1]
    actions = np.frombuffer(base64.b64decode(row["actions"]), "<f4").copy()
    actions[20] += by
    row["actions"] = base64.b64encode(actions.tobytes()).decode()


def test_an_action_changed_by_a_thousandth_is_found(made, tmp_path, capsys):
    folder = changed(made, tmp_path / "run", nudge)
    assert cli.main(["bench", "verify", str(folder)]) == 1
    out = capsys.readouterr().out
    (raw,) = (folder / "raw").iterdir()
    scene = json.loads(raw.read_text())["arguments"]["names"][1]
    assert f"ego in ccdiff-1, seed 1, {scene}: " in out
    assert "2 of 3 episodes" in out


def test_golden_episodes_come_out_as_they_did(tmp_path):
    """Scores, parts and digests of 24 episodes of another day; no network draws in them.

    Made anew, where that is meant, by `bench planners --planners ego,idm --traffic idm-hasty
    --seeds 0`: `run.json` and `raw/`, zipped.
    """
    with zipfile.ZipFile(ROOT / "tests/golden/planners.zip") as file:
        file.extractall(tmp_path)
    found = verify(Record.read(tmp_path))
    assert found.played == 24
    assert not found.differing


def test_discrete_actions_are_played_again():
    class Index:
        env_options = {"discrete": True}  # noqa: RUF012

        def __call__(self, obs):
            return np.full(len(obs), 3)

    scenes = ccdiff_env.embedded_scenes("val")[:2]
    rows, _ = drive(scenes, Index(), TRAFFIC["idm"])
    assert drive(scenes, Recorded(rows), TRAFFIC["idm"])[0] == rows
    with pytest.raises(DatasetError, match="damaged actions"):
        Recorded([{**rows[0], "actions": 3}])


# the protocol


def test_the_city_is_fixed_by_200_hashes_and_shares_no_scene_with_training():
    level = PROTOCOL.fields["levels"]["city"]
    scenes = {scene.name: scene.hash for scene in ccdiff_env.embedded_scenes(level["embedded"])}
    assert len(scenes) == 200
    assert scenes == level["hashes"]
    others = {scene.hash for scene in ccdiff_env.embedded_scenes()}
    assert not others & set(scenes.values())


def test_the_protocol_fixes_scenes_and_weights():
    level = PROTOCOL.fields["levels"]["smoke"]
    scenes = {scene.name: scene.hash for scene in ccdiff_env.embedded_scenes(level["embedded"])}
    PROTOCOL.check("smoke", scenes)
    with pytest.raises(DatasetError, match=r"'queue-03' has hash x, planner-1\.4 fixes"):
        PROTOCOL.check("smoke", {**scenes, "queue-03": "x"})
    with pytest.raises(DatasetError, match="'queue-03' has hash None"):
        PROTOCOL.check("smoke", {k: v for k, v in scenes.items() if k != "queue-03"})


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--traffic", "idm"], "--traffic: planner-1.4 fixes it"),
        (["--seeds", "0,1"], "--seeds has 2, planner-1.4 smoke takes 1"),
        (
            ["--level", "mini", "--scenes", "nuscenes:x", "--seeds", "5,05,5"],
            "--seeds has 1, planner-1.4 mini takes 3",
        ),
        (
            ["--planners", f"{__name__}:Leaps"],
            "moves by DeltaPoseLimits, planner-1.4 allows unicycle",
        ),
        (["--limit", "2"], "--limit: planner-1.4 fixes it"),
        (["--scenes", "embedded/train"], "--level smoke of planner-1.4 takes no --scenes"),
        (["--level", "val"], "--level val of planner-1.4 takes --scenes nuscenes:FOLDER"),
        (["--level", "val", "--scenes", "nuscenes:x/train"], "takes --scenes nuscenes:FOLDER"),
        (["--level", "vla"], "no level 'vla', there is smoke, city, mini, val"),
        (["--protocol", "planner-2"], "no protocol 'planner-2', there is planner-1.4"),
    ],
)
def test_options_cannot_change_what_the_protocol_fixes(tmp_path, capsys, words, said):
    command = ["bench", "planners", "--out", str(tmp_path / "r"), "--protocol", "planner-1.4"]
    assert cli.main([*command, *words]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "r").exists()


def test_a_level_is_told_by_what_was_played():
    smoke, val = (PROTOCOL.fields["levels"][name] for name in ("smoke", "val"))
    scenes, panel = smoke["hashes"], PROTOCOL.panel

    def level(sha256=PROTOCOL.sha256, scenes=scenes, traffic=panel, seeds=(0,)):
        return PROTOCOL.level_of(sha256, scenes, traffic, seeds)

    assert level() == level(seeds=(7,)) == "planner-1.4 smoke"
    assert level(sha256="x") is None
    assert level(traffic=panel[1:]) is None
    assert level(seeds=(1, 2)) is None
    assert PROTOCOL.level_of(PROTOCOL.sha256, scenes, panel, (0,), ["assisted"]) == level()
    assert PROTOCOL.level_of(PROTOCOL.sha256, scenes, panel, (0,), ["delta_pose"]) is None
    assert level(scenes={**scenes, "queue-03": "x"}) is None
    some = dict.fromkeys(ccdiff_env.scenes.splits()["val"][:93], "x")
    assert level(scenes=some, seeds=range(val["num_seeds"])) == "planner-1.4 val, 93 of 150 scenes"


def test_seeds_of_a_protocol_are_drawn_when_a_run_begins_and_kept_in_it(tmp_path):
    def drawn(folder, *words):
        given = ["--protocol", "planner-1.4", "--planners", "idm", "--out", str(tmp_path / folder)]
        args = parse(["bench", "planners", *given, *words])
        PROTOCOL.fix(args)
        return args.seeds

    seeds = {drawn(str(i)) for i in range(4)}
    assert len(seeds) == 4
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / "run.json").write_text('{"seeds": [17]}')
    assert drawn("begun") == "17"
    assert drawn("begun", "--seeds", "5") == "5"


@pytest.mark.slow
def test_the_smoke_level_of_the_protocol_in_one_command(tmp_path, capsys):
    command = ["bench", "planners", "--protocol", "planner-1.4", "--planners", "idm", "--quiet"]
    assert cli.main([*command, "--out", str(tmp_path)]) == 0
    ((heading, _),) = Record.read(tmp_path).tables()
    assert heading.startswith("planner-1.4 smoke")
    assert {entry.traffic for entry in Record.read(tmp_path).entries} == set(PROTOCOL.panel)


# statistics


def rows_of(**scores):
    return {
        (planner, "replay"): [{"scene": f"{i:02d}", "score": v} for i, v in enumerate(values)]
        for planner, values in scores.items()
    }


def test_differences_are_paired_and_p_is_that_of_all_signs():
    rng = np.random.default_rng(0)
    idm, mine = rng.uniform(size=(2, 12))
    text = document(*comparison(rows_of(idm=idm, mine=mine)))
    pairs = mine - idm
    signs = np.array(np.meshgrid(*[[-1, 1]] * 12)).reshape(12, -1)
    exact = np.mean(np.abs(pairs @ signs) >= abs(pairs.sum()) - 1e-12)
    line = next(line for line in text.splitlines() if line.startswith("| mine "))
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[1] == "IDM on the log's path"
    assert cells[2].startswith(f"{pairs.mean():+.3f} [")
    assert float(cells[3]) == pytest.approx(exact, abs=0.02)
    assert (cells[4] == "not significant") == (exact >= 0.05)
    sure = comparison(rows_of(idm=idm, mine=idm + 0.1))
    assert "not significant" not in document(*sure)


def test_scenes_are_what_is_resampled_not_seeds():
    rows = [
        {"scene": scene, "seed": seed, "score": value}
        for seed in (0, 1)
        for scene, value in (("b", 0.2 + seed * 0.2), ("a", 1.0))
    ]
    found = scene_means(rows, "score")
    assert list(found.items()) == [("a", 1.0), ("b", pytest.approx(0.3))]
    assert are_few(rows)
