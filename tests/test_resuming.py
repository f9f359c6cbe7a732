"""Runs that go on in their folder: others are refused, and what ends a run early loses nothing."""

import json
import os
import signal
import sys
from subprocess import PIPE, Popen

import numpy as np
import pytest
from test_models import QUICK, road

from ccdiff_env import cli, embedded_scenes
from ccdiff_env.errors import CcdiffError, ConfigError
from ccdiff_env.models import TrajectoryModel, shipped_weights
from ccdiff_env.system.files import write_aside
from ccdiff_env.system.settings import keep_settings
from ccdiff_env.training import distil, networks
from ccdiff_env.training.networks import train

torch = pytest.importorskip("torch")


def test_a_folder_keeps_one_choice_of_settings(tmp_path):
    path = tmp_path / "run" / "run.json"
    first = {"seed": 3, "scenes": {"town": "ab"}, "modes": (1, 2)}
    assert keep_settings(path, first)["modes"] == (1, 2)
    keep_settings(path, {"more": None})
    assert json.loads(path.read_text()) == {**first, "modes": [1, 2], "more": None}
    for changed, said in (
        ({"seed": 4}, "seed 3, now 4"),
        ({"scenes": {"town": "cd"}}, "scenes town 'ab', now 'cd'"),
        ({"scenes": {}}, "scenes town 'ab', now None"),
        ({"modes": [2]}, r"modes \[1, 2\], now \[2\]"),
    ):
        with pytest.raises(ConfigError, match=said):
            keep_settings(path, {**first, **changed})


def test_names_of_folders_need_not_be_utf_8(tmp_path):
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    path = folder / "run.json"
    keep_settings(path, {"scenes": str(folder)})
    assert keep_settings(path, {"scenes": str(folder)})["scenes"] == str(folder)
    write_aside(folder / "report.html", f"of {folder.name}")
    assert (folder / "report.html").read_bytes() == rb"of caf\udce9"


def test_a_folder_is_one_process_s_until_it_ends(tmp_path, capsys):
    run = ["bench", "traffic", "--methods", "replay", "--scenes", "embedded/val?limit=1"]
    run += ["--out", str(tmp_path / "run"), "--quiet"]
    begun = f"import pathlib; from {keep_settings.__module__} import keep_settings as keep\n"
    begun += "keep(pathlib.Path('run/run.json'), {}); print(flush=True); input()"
    with Popen([sys.executable, "-c", begun], cwd=tmp_path, stdin=PIPE, stdout=PIPE) as other:
        other.stdout.readline()
        assert cli.main(run) == 2
        assert "bench: another process writes into" in capsys.readouterr().err
        other.kill()
    for _ in range(2):
        assert cli.main(run) == 0


def test_a_training_goes_on_with_what_it_was_begun_with(tmp_path):
    begun = {"settings": QUICK, "held_out": [road()], "progress": False, "out": tmp_path}
    train([road()], steps=1, **begun)
    for changed, said in (
        ({"settings": {**QUICK, "seed": 9}}, "training seed 0, now 9"),
        ({"network": {"width": 32}}, "network width 64, now 32"),
        ({"held_out": []}, "held_out '.*', now '.*'"),
        ({"teacher": shipped_weights()}, "teacher None, now '.*'"),
        ({"start": shipped_weights()}, "start None, now '.*'"),
        ({"model": "ctg"}, "model 'ccdiff', now 'ctg'"),
    ):
        with pytest.raises(ConfigError, match=f"other settings: {said}"):
            train([road()], steps=2, **{**begun, **changed})
    with pytest.raises(ConfigError, match="other settings: scenes"):
        train([road(), road()], steps=2, **begun)
    train([road()], steps=2, **begun)


def test_a_training_that_diverges_keeps_its_last_finite_state(tmp_path, monkeypatch):
    monkeypatch.setattr(networks, "_CHUNK", 1)
    options = {"out": tmp_path, "checkpoint_minutes": 0.0, "progress": False}
    scenes = embedded_scenes("train")[:4]
    with pytest.raises(CcdiffError):
        train(scenes, steps=200, settings={**QUICK, "learning_rate": 300.0}, **options)
    step = TrajectoryModel(tmp_path / "weights.safetensors").header["step"]
    assert 0 < step < 200
    # the state is the same step's, and can be read to the last number
    train(scenes, steps=step, **options)


@pytest.fixture
def heard():
    """Ctrl-C is heard, also where the tests are a shell's job in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("heard")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_is_interrupted_keeps_its_state_and_goes_on(number, tmp_path, monkeypatch, capsys):
    from ccdiff_env.training import ppo

    def interrupted(command, place, name, when):
        """Run a command that the signal meets in a call; expect its end by the signal."""
        real, calls = getattr(place, name), []

        def meets(*given, **more):
            calls.append(name)
            if len(calls) == when:
                signal.raise_signal(number)
            return real(*given, **more)

        with monkeypatch.context() as patch:
            patch.setattr(place, name, meets)
            assert cli.main(command) == 128 + number
        assert capsys.readouterr().err.endswith("interrupted\n")

    ego = ["train-ego", "--worlds", "16", "--decisions", "768", "--threads", "1"]
    ego += ["--scenes", "embedded/train?limit=4", "--out", str(tmp_path / "ego")]
    interrupted(ego, ppo, "rollout", 3)
    done = torch.load(tmp_path / "ego" / "checkpoint.pt", weights_only=True)["done"]
    assert (done["updates"], done["decisions"]) == (2, 512)
    assert (tmp_path / "ego" / "ego.safetensors").is_file()
    assert cli.main(ego) == 0
    done = torch.load(tmp_path / "ego" / "checkpoint.pt", weights_only=True)["done"]
    assert (done["updates"], done["decisions"]) == (3, 768)
    kept = (tmp_path / "ego" / "ego.safetensors").read_bytes()
    for words, said in (
        (["--dynamics", "bicycle"], "dynamics 'assisted', now 'bicycle'"),
        (["--worlds", "32"], "worlds 16, now 32"),
        (["--start", str(tmp_path / "ego" / "checkpoint.pt")], "start None, now '"),
    ):
        assert cli.main([*ego, *words]) == 2
        assert f"other settings: {said}" in capsys.readouterr().err
    assert cli.main(ego) == 0  # finished
    assert (tmp_path / "ego" / "ego.safetensors").read_bytes() == kept
    with monkeypatch.context() as patch:
        patch.setattr(ppo, "update", lambda agent, *_: agent.log_std.data.fill_(torch.nan))
        assert cli.main([*ego, "--decisions", "1024"]) == 2  # diverges
    assert "weights are not finite" in capsys.readouterr().err
    assert (tmp_path / "ego" / "ego.safetensors").read_bytes() == kept
    assert cli.main([*ego, "--decisions", "1024"]) == 0
    done = torch.load(tmp_path / "ego" / "checkpoint.pt", weights_only=True)["done"]
    assert done["decisions"] == 1024
    again = [
        *ego,
        "--start",
        str(tmp_path / "ego" / "checkpoint.pt"),
        "--out",
        str(tmp_path / "on"),
    ]
    assert cli.main([*again, "--dynamics", "unicycle"]) == 2
    assert "checkpoint.pt drives by AssistedLimits(" in capsys.readouterr().err
    assert cli.main([*again, "--decisions", "1"]) == 0
    zip_file = tmp_path / "policy.zip"
    zip_file.touch()
    assert cli.main([*ego, "--start", str(zip_file), "--out", str(tmp_path / "other")]) == 2
    assert "policy.zip' is one of stable-baselines3" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()

    one = ["train", "--scenes", "embedded/train?limit=4", "--hold-out-every", "4", "--quiet"]
    one += ["--batch-scenes", "1", "--steps", "3", "--out", str(tmp_path / "train")]
    monkeypatch.setattr(networks, "_CHUNK", 1)
    interrupted(one, networks.Curves, "write", 2)
    state = tmp_path / "train" / "weights.safetensors"
    assert TrajectoryModel(state).header["step"] == 2
    assert cli.main(one) == 0
    assert TrajectoryModel(state).header["step"] == 3


def test_a_distillation_belongs_to_one_teacher_and_keeps_what_is_finished(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(distil, "LOGGED_STARTS", 1)
    monkeypatch.setattr(distil, "fit_dial", lambda *_: ([[0.0, 0.0], [1.0, 1.0]], {}))
    words = ["distil", "--scenes", "embedded/val", "--fit-scenes", "embedded/val", "--rounds", "1"]
    words += ["--episodes", "4", "--updates", "4", "--out", str(tmp_path)]
    teacher = ["--teacher", '{"denoising_steps": 1}']
    with monkeypatch.context() as patch:
        patch.setattr(distil, "train", lambda *_, **__: signal.raise_signal(signal.SIGTERM))
        assert cli.main([*words, *teacher]) == 143
    labels = {file: file.stat().st_mtime_ns for file in tmp_path.glob("labels-*.npy")}
    assert {file.name for file in labels} == {"labels-fit.npy", "labels-log.npy", "labels-0.npy"}
    capsys.readouterr()
    for changed, said in (
        (["--teacher", '{"denoising_steps": 1, "criticality": 2}'], "teacher criticality 6.0, now"),
        (["--teacher", "{}"], "teacher denoising_steps 1, now 5"),
        ([*teacher, "--updates", "5"], "updates 4, now 5"),
        ([*teacher, "--scenes", "embedded/train"], "scenes '"),
    ):
        assert cli.main([*words, *changed]) == 2
        assert f"other settings: {said}" in capsys.readouterr().err
    assert cli.main([*words, *teacher]) == 0
    assert {file: file.stat().st_mtime_ns for file in labels} == labels
    assert np.load(next(iter(labels))).size > 0
