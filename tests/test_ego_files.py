"""Ego policies of files: what they say, what they refuse, what they drive."""

import numpy as np
import pytest
import torch
from array_scenes import GOES_ON

import ccdiff_env
from ccdiff_env import WorldConfig, planners
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.config import AssistedLimits
from ccdiff_env.envs import ego_network
from ccdiff_env.errors import ConfigError, ShapeError
from ccdiff_env.planners.built_in import Seat
from ccdiff_env.planners.ego import save_ego
from ccdiff_env.worlds import Worlds

OPTIONS = {"dynamics": "assisted", "decision_steps": 3}


@pytest.fixture(scope="module")
def agent(scenes):
    """A network of random weights that has seen some observations."""
    torch.manual_seed(0)
    env = ccdiff_env.make_vec(8, scenes=scenes, config=WorldConfig().with_options(**OPTIONS))
    made = ego_network.Agent(env.worlds.layout, (0.5, 0.5))
    torch.nn.init.normal_(made.policy[-1].weight, std=0.1)
    made.see(torch.from_numpy(env.reset(seed=0)[0]))
    return made


@pytest.fixture
def path(agent, tmp_path):
    target = tmp_path / "own.safetensors"
    save_ego(target, agent.state_dict(), OPTIONS, {"decisions": 0})
    return target


def test_numpy_gives_the_actions_of_torch(agent, path, scenes):
    policy = planners.load(path)
    env = ccdiff_env.make_vec(16, scenes=scenes, traffic="idm", **policy.env_options)
    obs, _ = env.reset(seed=4)
    for _ in range(10):
        with torch.no_grad():
            expected = agent(agent.normalised(torch.from_numpy(obs)))[0].clamp(-1, 1).numpy()
        actions = policy.act(obs)
        assert actions.shape == (16, 2)
        assert actions.dtype == np.float32
        np.testing.assert_allclose(actions, expected, atol=1e-5)
        obs = env.step(actions)[0]
    assert env.config.decision_steps == 3


def test_the_gradient_is_that_of_the_greatest_over_all_rows(agent, scenes):
    env = ccdiff_env.make_vec(16, scenes=scenes, config=WorldConfig().with_options(**OPTIONS))
    x = agent.normalised(torch.from_numpy(env.reset(seed=2)[0]))
    mask = x[:, agent.mask]
    assert 0 < int((mask > 0).sum()) < mask.numel()
    encoded = agent.encoder(x[:, agent.rows].reshape(-1, *agent.shape))
    found = (encoded * (mask > 0).unsqueeze(-1)).amax(dim=1)
    expected = torch.cat([x[:, : agent.rows.start], x[:, agent.mask.stop :], found], dim=1)
    features, weights = agent.features(x), list(agent.encoder.parameters())
    torch.testing.assert_close(features, expected)
    weighing = torch.linspace(-1.0, 1.0, features.numel()).view_as(features)
    wanted, got = (torch.autograd.grad((f * weighing).sum(), weights) for f in (expected, features))
    for one, other in zip(wanted, got, strict=True):
        torch.testing.assert_close(one, other)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dynamics": "bicycle"}, 'the worlds have "bicycle"'),
        ({"action": {"max_yaw_rate_radps": 0.5}}, "action.max_yaw_rate_radps = 1.0"),
        ({"observation": {"num_neighbors": 3}}, "observation.num_neighbors = "),
        ({"decision_steps": 2}, "decision_steps = 3"),
    ],
)
def test_worlds_that_do_not_fit_are_refused_in_one_line(options, message, path, scenes):
    policy = planners.load(path)
    worlds = Worlds(scenes, policy.config.with_options(**options), num_worlds=1)
    with pytest.raises(ConfigError, match=message) as caught:
        Seat(policy, "policy").begin(worlds)
    assert "\n" not in str(caught.value)
    assert "env_options" in str(caught.value)


def test_limits_of_ones_own_are_kept(agent, tmp_path):
    limits = AssistedLimits(offset_m=(-0.75, 0.75))
    save_ego(tmp_path / "own.safetensors", agent.state_dict(), OPTIONS | {"dynamics": limits}, {})
    assert planners.load(tmp_path / "own.safetensors").config.action.dynamics == limits
    with pytest.raises(ConfigError, match="traffic"):
        save_ego(tmp_path / "own.safetensors", agent.state_dict(), OPTIONS | {"traffic": "idm"}, {})


def test_observations_of_another_width_are_refused(path):
    with pytest.raises(ShapeError, match="expected"):
        planners.load(path).act(np.zeros((2, 3), np.float32))


def test_planners_hold_actions_as_in_training(path, scenes):
    """A benchmark of single steps gives the episodes of worlds that hold actions themselves."""
    policy = planners.load(path)
    rows, _ = drive(scenes, str(path), TRAFFIC["idm"], seed=3)
    options = {**GOES_ON, "on_collision": "stop", "autoreset": "disabled", "traffic": "idm"}
    config = policy.config.with_options(**options)
    worlds = Worlds(scenes, config, num_worlds=len(scenes))
    act, out = Seat(policy, "policy"), worlds.arrays()
    everyone = list(range(len(scenes)))
    worlds.native.reset([3] * len(scenes), everyone, None, out)
    metrics = [None] * len(scenes)
    while any(m is None for m in metrics):
        worlds.native.step(act(out.obs[:, 0])[:, None], out)
        for i in np.flatnonzero(out.done):
            if metrics[i] is None:
                metrics[i] = worlds.native.ended_metrics([int(i)])[0, 0]
        if out.done.any():
            worlds.native.reset([3] * len(scenes), everyone, out.done.tolist(), out)
    names = worlds.metric_names
    for row, found in zip(rows, metrics, strict=True):
        assert row["success"] == found[names.index("is_success")]
        assert row["min_ttc_s"] == found[names.index("min_ttc")]


def test_the_shipped_egos_drive_unseen_scenes(scenes):
    for name, file in planners.SHIPPED.items():
        assert file.stat().st_size < 1_000_000
        rows, _ = drive(scenes, name, TRAFFIC["idm"], seed=0)
        assert np.mean([row["success"] for row in rows]) > 0.6
        assert planners.load(name).about
