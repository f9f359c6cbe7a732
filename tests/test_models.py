"""Training and planning from Python: files, resume, errors, torch's own state."""

import csv
import json
import math
import re

import numpy as np
import pytest
import torch
from array_scenes import agent, array_scene, wide_road

from ccdiff_env import EgoEnv, embedded_scenes
from ccdiff_env.errors import CheckpointError, ConfigError, ShapeError
from ccdiff_env.models import (
    TrajectoryModel,
    guidance_preset,
    shipped_weights,
    weight_files,
)
from ccdiff_env.traffic import NETWORKS, SWIFT
from ccdiff_env.training import networks
from ccdiff_env.training.networks import Curves, train

QUICK = {"batch_scenes": 2, "warmup_steps": 0}


def road(num_steps=110):
    """A follower closing in on a slower leader."""
    t = 0.1 * np.arange(num_steps)
    dividers = [np.array([[-300, y], [600, y]], np.float32) for y in (-1.75, 1.75)]
    layers = {**wide_road(5.25), "lane_dividers": dividers}
    cars = agent("ego", 12.0 * t - 0.25 * t**2), agent("leader", 45.0 + 4.0 * t)
    return array_scene(*cars, name="road", layers=layers)


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def test_training_without_a_terminal_says_a_line_now_and_then(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(networks, "EVERY_S", 0.0)
    train([road()], out=tmp_path / "said", steps=4, settings=QUICK)
    *_, last = lines = capsys.readouterr().err.splitlines()
    assert all(re.fullmatch(r"step \d+, loss [\d.]+", line) for line in lines)
    assert last.startswith("step 4,")
    monkeypatch.setattr(networks, "EVERY_S", 1e9)
    train([road()], out=tmp_path / "silent", steps=4, settings=QUICK)
    assert capsys.readouterr().err == ""


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    options = {"held_out": [road()], "settings": QUICK, "notes": {"data": "synthetic"}}
    return train([road()], out=tmp_path_factory.mktemp("run"), steps=12, progress=False, **options)


def test_a_run_writes_weights_curves_and_a_header_that_rebuilds_the_network(weights):
    model = TrajectoryModel(weights)
    header = model.header
    assert header["step"] == 12
    assert header["notes"]["licence"] == "CC-BY-NC-SA-4.0"
    assert header["notes"]["data"] == "synthetic"
    assert header["model"]["preset"] == "fast"
    loss = rows(weights.parent / "loss.csv")
    assert loss[0] == ["step", "loss", "seconds"]
    assert int(loss[-1][0]) == 12
    validation = rows(weights.parent / "validation.csv")
    assert float(validation[1][validation[0].index("constant_velocity_ade_m")]) > 0.0


def test_plans_have_the_documented_shapes_and_start_at_the_vehicles(weights):
    scene = road()
    (plan,) = TrajectoryModel(weights).plan([scene], [40], num_samples=3)
    assert plan.actions.shape == (3, 2, 52, 2)
    assert plan.samples.shape == (3, 2, 52, 3)
    assert plan.speed_mps.shape == (3, 2, 52)
    assert plan.graph.tolist() == [[True, True], [True, True]]
    assert "samples=float32[3, 2, 52, 3]" in repr(plan)
    start = np.array([[12.0 * 4 - 0.25 * 16, 0.0], [45 + 16.0, 0.0]])
    assert np.abs(plan.samples[:, :, 0, :2] - start).max() < 3.0
    # places are those that the speeds lead to, along the headings
    way = np.stack([np.cos(plan.samples[..., 2]), np.sin(plan.samples[..., 2])], axis=-1)
    moved = np.diff(plan.samples[..., :2], axis=2)
    mean = (plan.speed_mps[..., 1:] + plan.speed_mps[..., :-1]) / 2.0
    assert np.abs(np.linalg.norm(moved, axis=-1) - 0.1 * mean).max() < 0.05
    assert (np.abs((moved * way[:, :, 1:]).sum(axis=-1) - 0.1 * mean) < 0.1).mean() > 0.95


def test_plans_are_repeatable_and_follow_their_seed():
    model, scene = TrajectoryModel(shipped_weights()), road()
    before = torch.get_rng_state()
    first, second, other = model.plan([scene] * 3, [40] * 3, seeds=[5, 5, 6])
    assert torch.equal(before, torch.get_rng_state())
    np.testing.assert_array_equal(first.actions, second.actions)
    assert not np.allclose(first.actions, other.actions, atol=1e-2)


def test_a_run_that_was_killed_and_goes_on_writes_the_bytes_of_one_that_was_not(
    tmp_path, monkeypatch
):
    """Header and numbers: constants of the data come back from the state to the last bit."""
    options = {"settings": {**QUICK, "seed": 3}, "progress": False, "steps": 10}
    monkeypatch.setattr(networks, "_CHUNK", 3)
    often = train([road()], out=tmp_path / "often", checkpoint_minutes=0.0, **options)
    train([road()], out=tmp_path / "whole", **options)
    write, left = Curves.write, [2]

    def dies(self, name, step, values):
        write(self, name, step, values)
        left[0] -= name == "loss"
        if not left[0]:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Curves, "write", dies)
        with pytest.raises(KeyboardInterrupt):
            train([road()], out=tmp_path / "parts", **options)
    assert rows(tmp_path / "parts" / "loss.csv")[-1][0] == "6"
    train([road()], out=tmp_path / "parts", progress=False, steps=10)
    whole, parts = (tmp_path / name / "weights.safetensors" for name in ("whole", "parts"))
    assert whole.read_bytes() == parts.read_bytes() == often.read_bytes()
    steps = [row[0] for row in rows(tmp_path / "parts" / "loss.csv")]
    assert steps[-1] == "10"
    assert len(set(steps)) == len(steps)


def test_a_run_that_cooled_down_goes_on_over_added_steps(tmp_path, monkeypatch):
    monkeypatch.setattr(networks, "_CHUNK", 3)
    spans = []
    for steps in (10, 14, 12):
        path = train([road()], out=tmp_path, steps=steps, settings=QUICK, progress=False)
        state = (tmp_path / "state.safetensors").read_bytes()
        metadata = json.loads(state[8 : 8 + int.from_bytes(state[:8], "little")])["__metadata__"]
        cooldown = json.loads(metadata["ccdiff_env"])["cooldown"]
        spans.append((TrajectoryModel(path).header["step"], cooldown["start"], cooldown["steps"]))
    assert spans == [(10, 9, 1), (14, 10, 4), (14, 10, 4)]


def test_rivals_are_resumed_as_what_they_are(tmp_path):
    options = {"model": "simnet", "settings": QUICK, "progress": False}
    train([road()], out=tmp_path, steps=2, **options)
    header = TrajectoryModel(train([road()], out=tmp_path, steps=3, **options)).header
    assert (header["kind"], header["step"]) == ("simnet", 3)
    with pytest.raises(ConfigError, match="another"):
        train([road()], out=tmp_path, steps=4, progress=False)


RIVALS = [name for name in NETWORKS if name not in ("ccdiff", "tokens", SWIFT)]
EQUAL = [name for name in (*RIVALS, "ccdiff_equal") if shipped_weights(name).is_file()]


@pytest.mark.parametrize("name", EQUAL)
def test_weights_that_are_compared_have_had_the_same_training(name):
    path = shipped_weights(name)
    assert path.stat().st_size < 2_000_000
    header = TrajectoryModel(path).header
    first = TrajectoryModel(shipped_weights(EQUAL[0])).header
    assert header["kind"] == name.removesuffix("_equal")
    assert header["step"] == first["step"]
    same = ("batch_scenes", "learning_rate", "warmup_steps", "ema_decay", "clip_norm", "seed")
    assert [header["training"][key] for key in same] == [first["training"][key] for key in same]
    assert header["notes"]["num_scenes"] == first["notes"]["num_scenes"] == 600


def test_what_cannot_be_trained_is_refused_with_the_facts(tmp_path):
    for scene, options, named in (
        (road(), {}, "steps or minutes"),
        (road(), {"steps": 1, "settings": {"bach_scenes": 3}}, "bach_scenes"),
        (road(40), {"steps": 1}, "no training sample"),
        (road(), {"steps": 1, "preset": "huge"}, "preset"),
        (road(), {"steps": 1, "device": "tpu"}, "device"),
    ):
        with pytest.raises(ConfigError, match=named):
            train([scene], out=tmp_path, progress=False, **options)


def test_damaged_weight_files_are_refused(weights, tmp_path):
    bad, data = tmp_path / "bad.safetensors", weights.read_bytes()
    for damaged, named in ((data[:-100], None), (data[:-1] + bytes([data[-1] ^ 1]), "checksum")):
        bad.write_bytes(damaged)
        with pytest.raises(CheckpointError, match=named):
            TrajectoryModel(bad)


@pytest.mark.parametrize(
    ("options", "error", "named"),
    [
        ({"steps": [40, 41]}, ShapeError, "2 steps"),
        ({"guidance_weight": 0.5}, ConfigError, "guidance_weight"),
        ({"num_samples": 0}, ConfigError, "num_samples"),
        ({"guidance": {"discount": 2.0}, "guided": [[0]]}, ConfigError, "guidance.discount"),
        ({"guidance": "rl"}, ConfigError, "guided"),
        ({"guidance": "rl", "guided": [[0], [1]]}, ShapeError, "lists of agents"),
        ({"guidance": "rl", "guided": [[0, 99]]}, ConfigError, r"guided\[0\] is 99, expected 0 to"),
        ({"guidance": "rl", "guided": [[-1]]}, ConfigError, r"guided\[0\] is -1"),
        ({"guidance": {"discount": math.nan}, "guided": [[0]]}, ConfigError, "discount is .nan"),
        ({"steps": [-1]}, ConfigError, r"steps\[0\] is -1, expected 0 to"),
        ({"steps": [100_000]}, ConfigError, r"steps\[0\] is 100000"),
        ({"seeds": [-1]}, ConfigError, r"seeds\[0\] is -1"),
    ],
)
def test_bad_requests_are_refused(weights, options, error, named):
    with pytest.raises(error, match=named):
        TrajectoryModel(weights).plan([road()], **{"steps": [40], **options})


def test_the_shipped_network_follows_a_straight_road():
    model = TrajectoryModel(shipped_weights())
    assert model.header["notes"]["licence"] == "CC-BY-NC-SA-4.0"
    assert shipped_weights().stat().st_size < 15_000_000
    (plan,) = model.plan([road()], [30], num_samples=8)
    end = plan.samples[:, :, -1] - plan.samples[:, :, 0].mean(axis=0)
    assert (np.abs(end[..., 1]) < 3.0).all()
    assert (end[..., 0] > 5.0).all()
    assert (end[..., 0] < 80.0).all()


@pytest.mark.parametrize("routes", [False, True])
def test_one_step_of_the_taught_network_is_near_to_five_of_its_teacher(routes):
    taught, teacher = (
        TrajectoryModel(shipped_weights(one_step=True, routes=routes)),
        TrajectoryModel(shipped_weights(routes=routes)),
    )
    scenes = list(embedded_scenes("val"))
    steps = [30] * len(scenes)

    def ends(model, solver_steps, seed):
        options = {"solver_steps": solver_steps, "num_samples": 4, "follow_route": routes}
        seeds = [100 * seed + i for i in range(len(scenes))]
        plans = model.plan(scenes, steps, seeds=seeds, **options)
        return np.concatenate([plan.samples[:, :, -1, :2] for plan in plans], axis=1)

    five = ends(teacher, 5, 0)
    near = np.linalg.norm(ends(taught, 1, 0) - five, axis=-1).mean()
    untaught = np.linalg.norm(ends(teacher, 1, 0) - five, axis=-1).mean()
    other_noise = np.linalg.norm(ends(teacher, 5, 1) - five, axis=-1).mean()
    assert near < 0.5 * untaught
    assert near < 0.5 * other_noise
    with pytest.raises(ConfigError, match="taught to plan in one step"):
        taught.plan(scenes[:1], [30])


def test_one_denoising_step_takes_the_taught_network():
    def plan(**ccdiff):
        env = EgoEnv(traffic="ccdiff", ccdiff={"denoising_steps": 1, **ccdiff})
        env.reset(seed=3)
        env.step(np.zeros(2, np.float32))
        found = env.explain()
        assert found is not None
        return found.samples

    own = plan()
    np.testing.assert_array_equal(own, plan(weights=str(shipped_weights(one_step=True))))
    assert not np.allclose(own, plan(weights=str(shipped_weights())), atol=0.1)
    with pytest.raises(ConfigError, match="taught to plan in one step"):
        EgoEnv(
            traffic="ccdiff",
            ccdiff={"weights": str(shipped_weights(one_step=True)), "denoising_steps": 5},
        )


@pytest.mark.parametrize("model", ["ccdiff", *(name for name in EQUAL if name in RIVALS)])
def test_guided_plans_seek_or_avoid_contact_by_the_sign_of_the_weights(model):
    loaded = TrajectoryModel(shipped_weights(model))
    settings = guidance_preset("rl")
    names = [objective["kind"] for objective in settings["objectives"]]
    closeness = {}
    for sign in (-1.0, 0.0, 1.0):
        changed = dict(settings, gradient_steps=0 if sign == 0.0 else 2)
        for objective in changed["objectives"]:
            if objective["kind"] != "map_collision":
                objective["weight"] = abs(objective["weight"]) * (sign or -1.0)
        (plan,) = loaded.plan([road()], [40], guidance=changed, guided=[[0]], num_samples=4)
        losses = plan.guidance["losses"]
        assert losses.shape == (3, 4, 2)
        # of all samples: which one is chosen depends on the other objectives, too
        closeness[sign] = losses[names.index("approach"), :, 0].mean()
    assert closeness[-1.0] > closeness[0.0] > closeness[1.0]


def test_a_guided_vehicle_takes_the_best_of_its_draws_and_one_beside_it_its_first():
    loaded = TrajectoryModel(shipped_weights("tokens"))
    settings = guidance_preset("rl")
    weights = [objective["weight"] for objective in settings["objectives"]]
    options = {"guidance": settings, "guided": [[0]], "follow_route": True}
    (plan,) = loaded.plan([road()], [40], num_samples=16, **options)
    assert plan.guidance is not None
    score = np.tensordot(weights, plan.guidance["losses"], 1)
    assert plan.selected_sample.tolist() == [score[:, 0].argmin(), 0]
    assert score[0, 0] > score[:, 0].min()
    # draws do not depend on their number
    (one,) = loaded.plan([road()], [40], num_samples=1, follow_route=True)
    np.testing.assert_array_equal(one.samples[0], plan.samples[0])


def test_every_shipped_file_of_weights_names_its_licence():
    for file in weight_files():
        data = file.read_bytes()
        header = data[8 : 8 + int.from_bytes(data[:8], "little")]
        assert b"CC-BY-NC-SA-4.0" in header, file.name
