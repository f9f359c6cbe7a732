"""Training and planning from Python: files, resume, errors, torch's own state."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from ccdiff_env.errors import CheckpointError, ConfigError, ShapeError
from ccdiff_env.models import Planner, train
from ccdiff_env.scenes import Scene

QUICK = {"batch_scenes": 2, "warmup_steps": 0}


def road(num_steps: int = 110) -> Scene:
    """A follower closing in on a slower leader."""
    t = 0.1 * np.arange(num_steps, dtype=np.float32)
    x = np.stack([12.0 * t - 0.25 * t**2, 45.0 + 4.0 * t])
    speed = np.stack([12.0 - 0.5 * t, np.full_like(t, 4.0)])
    zeros = np.zeros_like(x)
    return Scene.from_arrays(
        "road",
        position=np.stack([x, zeros], axis=-1),
        heading=zeros,
        velocity=np.stack([speed, zeros], axis=-1),
        valid=np.ones(x.shape, dtype=bool),
        sizes=np.array([[4.5, 2.0, 1.5], [4.5, 2.0, 1.5]], dtype=np.float32),
        agent_ids=["ego", "leader"],
        agent_types=["vehicle", "vehicle"],
    )


def rows(path: Path) -> list[list[str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run")
    return train(
        [road()],
        out=out,
        held_out=[road()],
        steps=12,
        settings=QUICK,
        progress=False,
        notes={"data": "synthetic"},
    )


def test_a_run_writes_weights_curves_and_a_header_that_rebuilds_the_network(weights: Path) -> None:
    planner = Planner(weights)
    header = planner.header
    assert header["step"] == 12
    assert header["notes"]["licence"] == "CC-BY-NC-SA-4.0"
    assert header["notes"]["data"] == "synthetic"
    assert header["model"]["preset"] == "fast"
    loss = rows(weights.parent / "loss.csv")
    assert loss[0] == ["step", "loss", "seconds"]
    assert int(loss[-1][0]) == 12
    validation = rows(weights.parent / "validation.csv")
    assert float(validation[1][validation[0].index("constant_velocity_ade_m")]) > 0.0


def test_plans_have_the_documented_shapes_and_roll_out_from_where_the_vehicles_are(
    weights: Path,
) -> None:
    scene = road()
    (plan,) = Planner(weights).plan([scene], [40], num_samples=3)
    assert plan.actions.shape == (3, 2, 52, 2)
    assert plan.states.shape == (3, 2, 52, 6)
    assert plan.graph.tolist() == [[True, True], [True, True]]
    np.testing.assert_allclose(plan.states[..., 4:], plan.actions, atol=1e-6)
    start = np.array([[12.0 * 4 - 0.25 * 16, 0.0], [45 + 16.0, 0.0]])
    np.testing.assert_allclose(plan.poses[:, :2], start, atol=1e-3)
    assert np.abs(plan.positions()[:, :, 0] - start).max() < 3.0


def test_plans_are_repeatable_and_follow_their_seed(weights: Path) -> None:
    planner, scene = Planner(weights), road()
    before = torch.get_rng_state()
    first, second, other = planner.plan([scene] * 3, [40] * 3, seeds=[5, 5, 6])
    assert torch.equal(before, torch.get_rng_state())
    np.testing.assert_allclose(first.actions, second.actions, atol=1e-5)
    assert not np.allclose(first.actions, other.actions, atol=1e-2)


def test_checkpoints_do_not_change_a_run_and_a_later_call_goes_on_from_the_last(
    tmp_path: Path,
) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    settings = {**QUICK, "seed": 3}
    options = {"settings": settings, "progress": False}
    train([road()], out=whole, steps=10, **options)
    train([road()], out=parts, steps=10, **options, checkpoint_minutes=0.0)
    assert (whole / "weights.safetensors").read_bytes() == (
        parts / "weights.safetensors"
    ).read_bytes()
    # a later call with more steps goes on from there
    train([road()], out=whole, steps=12, progress=False)
    assert rows(whole / "loss.csv")[-1][0] == "12"
    assert len({row[0] for row in rows(whole / "loss.csv")}) == len(rows(whole / "loss.csv"))


def test_training_leaves_torchs_generator_and_gradient_mode_alone(tmp_path: Path) -> None:
    state = torch.get_rng_state()
    with torch.no_grad():
        train([road()], out=tmp_path, steps=1, settings=QUICK, progress=False)
        assert not torch.is_grad_enabled()
    assert torch.equal(state, torch.get_rng_state())


def test_what_cannot_be_trained_is_refused_with_the_facts(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="steps or minutes"):
        train([road()], out=tmp_path)
    with pytest.raises(ConfigError, match="bach_scenes"):
        train([road()], out=tmp_path, steps=1, settings={"bach_scenes": 3})
    with pytest.raises(ConfigError, match="no training sample"):
        train([road(40)], out=tmp_path, steps=1, progress=False)
    with pytest.raises(ConfigError, match="preset"):
        train([road()], out=tmp_path, steps=1, preset="huge")
    with pytest.raises(ConfigError, match="device"):
        train([road()], out=tmp_path, steps=1, device="tpu")


def test_damaged_weight_files_are_refused(weights: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.safetensors"
    data = weights.read_bytes()
    bad.write_bytes(data[:-100])
    with pytest.raises(CheckpointError):
        Planner(bad)
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    name = next(key for key in header if key != "__metadata__")
    header["renamed"] = header.pop(name)
    text = json.dumps(header).encode()
    bad.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + length :])
    with pytest.raises(CheckpointError, match="missing"):
        Planner(bad)
    with pytest.raises(OSError, match="absent"):
        Planner(tmp_path / "absent.safetensors")


def test_bad_requests_are_refused(weights: Path) -> None:
    planner = Planner(weights)
    with pytest.raises(ShapeError, match="2 steps"):
        planner.plan([road()], [40, 41])
    with pytest.raises(ConfigError, match="guidance_weight"):
        planner.plan([road()], [40], guidance_weight=0.5)
    with pytest.raises(ConfigError, match="num_samples"):
        planner.plan([road()], [40], num_samples=0)
