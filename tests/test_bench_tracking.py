"""The log driven through models of motion by inverse actions."""

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import cli
from ccdiff_env.bench.tracking import evaluate, tracking_jobs
from ccdiff_env.errors import UnknownNameError

DT, STEPS, START = 0.1, 131, 30


def sliding(lateral_mps):
    """A scene whose ego drives east at 10 m/s while it slides to the left, heading east."""
    t = np.arange(STEPS) * DT
    position = np.stack([10.0 * t, lateral_mps * t], axis=-1)[None]
    return ccdiff_env.Scene.from_arrays(
        "slide",
        agent_ids=["ego"],
        agent_types=["vehicle"],
        sizes=np.array([(4.0, 2.0, 1.5)], np.float32),
        position=position.astype(np.float32),
        heading=np.zeros((1, STEPS), np.float32),
        velocity=np.tile(np.float32([10.0, lateral_mps]), (1, STEPS, 1)),
        valid=np.ones((1, STEPS), bool),
        dt=DT,
    )


@pytest.mark.parametrize("model", ["unicycle", "bicycle", "delta_pose"])
def test_the_error_is_the_way_that_the_model_cannot_go(monkeypatch, model):
    scenes = ccdiff_env.SceneSet([sliding(0.5)])
    monkeypatch.setattr("ccdiff_env.bench.tracking.scenes_of", lambda source, names: scenes)
    (row,) = evaluate(source={}, names=["slide"], model=model)
    # 10 s of sliding at 0.5 m/s, which only the delta pose has an action for
    expected = 0.0 if model == "delta_pose" else 5.0
    assert row["agent"] == "ego"
    # the speed is that along the velocity: 1.2 mm per step more than along the heading
    assert row["error_m"] == pytest.approx(expected, abs=0.03)
    assert row["worst_m"] >= row["error_m"]
    assert not row["collision"]
    assert not row["off_road"]


def test_the_command_writes_a_row_for_every_model(tmp_path):
    command = ["bench", "tracking", "--out", str(tmp_path), "--limit", "1", "--quiet"]
    assert cli.main(command) == 0
    table = (tmp_path / "table.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1].strip() for line in table.splitlines() if line.startswith("| ")][1:]
    assert rows == ["unicycle", "bicycle", "delta_pose"]


def test_unknown_models_are_refused(tmp_path):
    command = ["bench", "tracking", "--out", str(tmp_path), "--dynamics", "assisted"]
    assert cli.main(command) == 2
    with pytest.raises(UnknownNameError, match="no model 'rail'"):
        tracking_jobs("embedded/val", ["rail"])
