"""Every message of docs/troubleshooting.md is seen by making the mistake that it stands for."""

import pickle
import re
import sys
import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import cli
from ccdiff_env.envs.sb3 import SB3VecEnv
from ccdiff_env.planners.built_in import ego_driver
from ccdiff_env.scenes.embedded import VERSION, embedded_splits, unpack
from ccdiff_env.worlds.fit import Fit

PAGE = Path(__file__).resolve().parents[1] / "docs" / "troubleshooting.md"
ID = "ccdiff_env/Ego-v0"
#: Messages that other tests see, by the names of these.
ELSEWHERE = {
    "made in process ..., used in its forked child ...": "test_a_forked_child_is_told_to_spawn"
}


def messages() -> list[str]:
    """Messages of the page: code in the first column."""
    rows = re.findall(r"^\| (`.*?)\|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return [row.split("`")[1] for row in rows]


def begun():
    worlds = ccdiff_env.make_vec(2)
    worlds.reset(seed=0)
    return worlds


def without_torch(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    ccdiff_env.models.require_networks()


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


def text_as_weights(folder):
    (folder / "README.md").write_text("# A page, no weights")
    ccdiff_env.EgoEnv(traffic="ccdiff", ccdiff={"weights": str(folder / "README.md")})


def two_seeds(folder, capsys):
    for seed in ("0", "1"):
        words = ["--planners", "replay", "--traffic", "replay", "--limit", "1", "--quiet"]
        cli.main(["bench", "planners", *words, "--seed", seed, "--out", str(folder)])
    raise RuntimeError(capsys.readouterr().err)


MISTAKES = {
    "'OrderEnforcing' object": lambda *_: gymnasium.make(ID).explain(),
    "Cannot use": lambda *_: gymnasium.make_vec(
        ID, num_envs=2, wrappers=[gymnasium.wrappers.TimeLimit]
    ),
    "world 0 must": lambda *_: ccdiff_env.EgoEnv().step(np.zeros(2, np.float32)),
    "did you mean": lambda *_: ccdiff_env.EgoEnv(ego_columns=("speed",)),
    "autoreset_mode is": lambda *_: SB3VecEnv(begun()),
    "need torch": lambda tmp_path, monkeypatch, capsys: without_torch(monkeypatch),
    "criticality: ": lambda *_: ccdiff_env.EgoEnv(traffic="idm", criticality=1.0),
    "ccdiff: ": lambda *_: ccdiff_env.EgoEnv(traffic="idm", ccdiff={"num_guided": 2}),
    "explain: ": lambda *_: ccdiff_env.EgoEnv(traffic="idm").explain(),
    "weights: ": lambda *_: ccdiff_env.EgoEnv(traffic="ccdiff", ccdiff={"weights": "nothere"}),
    "not a safetensors": lambda tmp_path, *_: text_as_weights(tmp_path),
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
    "planner 'mine": lambda *_: ego_driver("mine:MyPlanner"),
    "... does not say": lambda *_: Fit.read(None, "old.zip"),
    "--out holds": lambda tmp_path, monkeypatch, capsys: two_seeds(tmp_path / "run", capsys),
}


@pytest.mark.parametrize("message", messages())
def test_the_mistake_gives_the_message(message, tmp_path, monkeypatch, capsys):
    if message in ELSEWHERE:
        tests = Path(__file__).parent.glob("test_*.py")
        assert any(f"def {ELSEWHERE[message]}(" in file.read_text() for file in tests)
        return
    (mistake,) = (make for begin, make in MISTAKES.items() if message.startswith(begin))
    seen = ".*".join(re.escape(part.strip()) for part in message.split("..."))
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        with pytest.raises(Exception, match=f"(?s){seen}"):
            mistake(tmp_path, monkeypatch, capsys)


def test_actions_outside_are_clipped():
    ends = []
    for action in ([5.0, 9.0], [1.0, 1.0]):
        env = ccdiff_env.EgoEnv(traffic="replay")
        env.reset(seed=0)
        env.step(action)
        ends.append(env.worlds.native.digest(0))
    assert ends[0] == ends[1]
