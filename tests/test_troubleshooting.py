"""Every message of docs/troubleshooting.md is seen by making the mistake that it stands for."""

import pickle
import re
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium
import pytest
from stable_baselines3 import PPO

import ccdiff_env
from ccdiff_env.envs.sb3 import SB3VecEnv
from ccdiff_env.scenes.embedded import VERSION, embedded_splits, unpack
from ccdiff_env.worlds.fit import Fit

PAGE = Path(__file__).resolve().parents[1] / "docs" / "troubleshooting.md"
ID = "ccdiff_env/Ego-v0"
#: Messages that other tests see, by the names of these.
ELSEWHERE = {
    "made in process ..., used in its forked child ...": "test_a_forked_child_is_told_to_spawn"
}


def messages() -> list[str]:
    """Messages of the page: code at the start of a row."""
    return re.findall(r"^\* `([^`]*)`", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


def begun():
    worlds = ccdiff_env.make_vec(2)
    worlds.reset(seed=0)
    return worlds


def data_set(folder, *, maps=True):
    unpack(folder)
    if not maps:
        for file in (folder / "maps/expansion").iterdir():
            file.unlink()
    return folder


def split_of_another_set(folder):
    table = data_set(folder) / VERSION / "scene.json"
    name = embedded_splits()["val"][0]
    table.write_text(table.read_text().replace(f'"{name}"', '"scene-0003"'))
    ccdiff_env.load_nuscenes(folder, VERSION, "val", cache=False)


def pickled(folder):
    (folder / "a.pkl").write_bytes(pickle.dumps(print))
    ccdiff_env.load_scenarionet(folder / "a.pkl")


def unknown_to_a_worker():
    """Gymnasium reads no entry points: a process that did not import the package knows no id."""
    code = "import gymnasium; gymnasium.make('{}ccdiff_env/Ego-v0')"
    for prefix in ("ccdiff_env:", ""):
        command = [sys.executable, "-c", code.format(prefix)]
        done = subprocess.run(command, cwd=PAGE.parents[1], capture_output=True, text=True)
        if done.returncode:
            assert not prefix, done.stderr
            raise RuntimeError(done.stderr)


MISTAKES = {
    "Namespace": lambda *_: unknown_to_a_worker(),
    "The environment is": lambda *_: PPO("MlpPolicy", ccdiff_env.make_vec(2)),
    "Can't pickle": lambda *_: pickle.dumps(
        ccdiff_env.EgoEnv(traffic="swift", criticality=lambda progress: progress)
    ),
    "'OrderEnforcing' object": lambda *_: gymnasium.make(ID).explain(),
    "Cannot use": lambda *_: gymnasium.make_vec(
        ID, num_envs=2, wrappers=[gymnasium.wrappers.TimeLimit]
    ),
    "autoreset_mode is": lambda *_: SB3VecEnv(begun()),
    "version of the data set (there": lambda tmp_path, *_: ccdiff_env.load_nuscenes(
        data_set(tmp_path), "v7"
    ),
    "version of the data set (the data": lambda tmp_path, *_: ccdiff_env.load_nuscenes(
        data_set(tmp_path) / VERSION, VERSION
    ),
    "... of the 150": lambda tmp_path, *_: split_of_another_set(tmp_path),
    "no map file": lambda tmp_path, *_: ccdiff_env.load_nuscenes(
        data_set(tmp_path, maps=False), VERSION, cache=False
    ),
    "the pickle asks": lambda tmp_path, *_: pickled(tmp_path),
    "... does not say": lambda *_: Fit.read(None, "old.zip"),
}


@pytest.mark.parametrize("message", messages())
def test_the_mistake_gives_the_message(message, tmp_path):
    if message in ELSEWHERE:
        tests = Path(__file__).parent.glob("test_*.py")
        assert any(f"def {ELSEWHERE[message]}(" in file.read_text() for file in tests)
        return
    (mistake,) = (make for begin, make in MISTAKES.items() if message.startswith(begin))
    seen = ".*".join(re.escape(part.strip()) for part in message.split("..."))
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        with pytest.raises(Exception, match=f"(?s){seen}"):
            mistake(tmp_path)


def test_actions_outside_are_clipped():
    ends = []
    for action in ([5.0, 9.0], [1.0, 1.0]):
        env = ccdiff_env.EgoEnv(traffic="replay")
        env.reset(seed=0)
        env.step(action)
        ends.append(env.worlds.native.digest(0))
    assert ends[0] == ends[1]
