"""Every example runs."""

import os
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env.bench.planners import TRAFFIC, drive

HERE = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((HERE / "examples").glob("*.py"))
#: Libraries that only one example needs.
NEEDS = {"train_ego_torchrl": "torchrl", "self_play_rllib": "ray.rllib"}


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_smoke_run_of_an_example_succeeds(path, tmp_path):
    if path.stem in NEEDS:
        pytest.importorskip(NEEDS[path.stem], exc_type=ImportError)
    text = path.read_text()
    assert len(text.splitlines()) < 160
    done = ran(path, tmp_path, *["--out", "out"] * ('"--out"' in text))
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip()


def ran(path, folder, *words):
    """A smoke run of an example."""
    command = [sys.executable, str(path), "--smoke", *words]
    env = {**os.environ, "PYTHONPATH": str(HERE), "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        command, cwd=folder, env=env, capture_output=True, text=True, timeout=280, check=False
    )


@pytest.mark.slow
def test_an_ego_goes_on_elsewhere_in_traffic_that_is_as_critical_as_asked(tmp_path):
    path = HERE / "examples" / "train_ego_sb3.py"
    assert ran(path, tmp_path, "--out", "a").returncode == 0
    kept = (tmp_path / "a" / "ego.zip").read_bytes()
    for words, said in (
        (["--start", "a", "--out", "a"], "other settings: start None, now 'a'"),
        (["--start", "a", "--out", "b", "--algorithm", "sac"], "a is of PPO, not sac"),
        (["--criticality", "1", "--out", "c"], "expected one that can be guided"),
    ):
        done = ran(path, tmp_path, *words)
        assert done.returncode
        assert said in done.stderr
    assert (tmp_path / "a" / "ego.zip").read_bytes() == kept
    words = ["--traffic", "swift?num_guided=1", "--criticality", "1", "--start", "a", "--out", "d"]
    done = ran(path, tmp_path, *words)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "start " in done.stdout


@pytest.mark.slow
def test_a_choice_of_adversaries_belongs_to_its_folder(tmp_path):
    path = HERE / "examples" / "train_adversary_selection.py"
    for words, said in ((["--ego", "idm"], ""), (["--ego", "pdm"], "other settings: ego 'idm'")):
        done = ran(path, tmp_path, "--out", "a", *words)
        assert bool(said) == bool(done.returncode), done.stderr[-2000:]
        assert said in done.stderr


@pytest.mark.parametrize(
    ("answers", "says"),
    [
        ("print(json.dumps(answer))", None),
        ("print(json.dumps(answer)); print(json.dumps(answer))", "not number 2"),
        ("print(json.dumps(answer['actions']))", "not number 1"),
        ("break", "has ended with 0"),
        ("time.sleep(999)", "no answer of .* in 0.5 s"),
    ],
)
def test_a_program_answers_each_decision_once_and_in_time(tmp_path, monkeypatch, answers, says):
    monkeypatch.syspath_prepend(HERE / "examples")
    (tmp_path / "mine.py").write_text(f"""
import json, sys, time
for line in sys.stdin:
    asked = json.loads(line)
    answer = {{"number": asked["number"], "actions": [[0.0, 0.0]] * len(asked["worlds"])}}
    {answers}
    sys.stdout.flush()
""")
    command = f"{sys.executable} {tmp_path / 'mine.py'}"
    limit_s = 0.5 if "sleep" in answers else 100.0
    planner = f"planner_over_a_pipe:Piped?command={command}&limit_s={limit_s}"
    scenes = ccdiff_env.load("embedded/val", limit=2)
    with pytest.raises(ccdiff_env.errors.CcdiffError, match=says) if says else nullcontext():
        assert len(drive(scenes, planner, TRAFFIC["replay"])[0]) == 2


def test_torchrl_takes_single_vector_and_several_vehicles():
    pytest.importorskip("torchrl")
    from torchrl.envs.libs.gym import GymEnv, GymWrapper
    from torchrl.envs.libs.pettingzoo import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    worlds, twin = (ccdiff_env.make_vec(3, autoreset_mode="disabled") for _ in range(2))
    game = ccdiff_env.parallel_env(agents=3, names="slot", info="none")
    for env in (
        GymEnv("ccdiff_env/Ego-v0", traffic="idm"),
        GymWrapper(worlds),
        PettingZooWrapper(game),
    ):
        check_env_specs(env)
    env = GymWrapper(worlds)
    env.set_seed(5)
    twin.reset(seed=5)
    twin.reset()
    ends = 0
    for step in env.rollout(150, break_when_any_done=False).unbind(1):
        _, rewards, terminated, truncated, _ = twin.step(step["action"].numpy())
        np.testing.assert_array_equal(rewards, step["next", "reward"][:, 0])
        if (done := terminated | truncated).any():
            twin.reset(options={"reset_mask": done})
        ends += done.sum()
    assert ends > 3  # also of second episodes
