"""``ccdiff-env train`` on the real mini scenes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ccdiff_env.cli import main
from ccdiff_env.models import TrajectoryModel


@pytest.mark.nuscenes
def test_training_on_the_mini_scenes_writes_weights_and_resumes(
    data_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["train", "--dataroot", str(data_root / "nuscenes"), "--version", "v1.0-mini",
               "--split", "mini_train", "--out", str(tmp_path), "--batch-scenes", "2", "--quiet",
               "--hold-out-every", "4"]  # fmt: skip
    assert main([*command, "--steps", "2"]) == 0
    assert main([*command, "--steps", "3"]) == 0
    path = Path(capsys.readouterr().out.splitlines()[-1])
    header = TrajectoryModel(path).header
    assert header["step"] == 3
    # two of the eight are validation scenes of the full set, one is held out
    assert header["notes"]["num_scenes"] == 5
    assert header["model"]["normalisation"]["trajectory_std"][0] > 1.0
    # on from there, told routes
    more = tmp_path / "routes"
    start = ["--start", str(path), "--routes", "--steps", "1"]
    at = command.index("--out") + 1
    assert main([*command[:at], str(more), *command[at + 1 :], *start]) == 0
    told = TrajectoryModel(more / "weights.safetensors").header
    assert told["model"]["route_points_m"][0] == 5.0
    assert told["model"]["normalisation"] == header["model"]["normalisation"]
    assert told["training"]["drop_route"] == 0.5


def test_scenes_that_are_kept_out_of_training_are_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["train", "--scenes", "embedded/val", "--out", str(tmp_path), "--steps", "1"]
    assert main(command) == 2
    assert "12 scenes of val and city kept out of training, 0 remain" in capsys.readouterr().err


def test_a_missing_data_set_is_an_error_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [
        "train",
        "--dataroot",
        str(tmp_path / "none"),
        "--out",
        str(tmp_path),
        "--steps",
        "1",
    ]
    assert main(command) == 2
    message = capsys.readouterr().err
    assert message.startswith("ccdiff-env train: ")
    assert "none" in message
    assert "Traceback" not in message


def test_the_queue_goes_on_after_a_failure_and_leaves_what_is_finished(tmp_path: Path) -> None:
    from tools.train_all import main as train_all

    short = ["--batch-scenes", "1", "--hold-out-every", "4", "--limit", "8", "--steps", "1"]
    trainings = [
        {"name": "refused", "arguments": ["--model", "nobody", *short]},
        {"name": "short", "arguments": ["--model", "simnet", *short]},
    ]
    listed = tmp_path / "trainings.json"
    listed.write_text(json.dumps(trainings))
    command = ["--list", str(listed), "--out", str(tmp_path / "runs"), "--scenes", "embedded/train"]
    assert train_all(command) == 1
    assert "nobody" in (tmp_path / "runs/refused/log.txt").read_text()
    weights = tmp_path / "runs/short/weights.safetensors"
    assert TrajectoryModel(weights).header["step"] == 1
    written = weights.stat().st_mtime_ns
    assert train_all([*command, "--only", "short"]) == 0
    assert weights.stat().st_mtime_ns == written
    with pytest.raises(SystemExit):
        train_all([*command, "--only", "long"])
