"""Every example runs."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import ccdiff_env

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
    assert len(text.splitlines()) < 150
    command = [sys.executable, str(path), "--smoke"]
    if '"--out"' in text:
        command += ["--out", str(tmp_path / "out")]
    env = {**os.environ, "PYTHONPATH": str(HERE), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=280
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip()


def test_torchrl_takes_single_vector_and_several_vehicles():
    pytest.importorskip("torchrl")
    from torchrl.envs.libs.gym import GymEnv, GymWrapper
    from torchrl.envs.libs.pettingzoo import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    worlds = ccdiff_env.make_vec(3, autoreset_mode="same_step", info="none")
    game = ccdiff_env.parallel_env(agents=3, names="slot", info="none")
    for env in (
        GymEnv("ccdiff_env/Ego-v0", traffic="idm"),
        GymWrapper(worlds),
        PettingZooWrapper(game),
    ):
        check_env_specs(env)
