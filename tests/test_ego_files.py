"""Ego policies of files: what they say, what they refuse, what they drive, in traffic, too."""

import json

import numpy as np
import pytest
import torch
from array_scenes import GOES_ON
from traffic_play import Play

import ccdiff_env
from ccdiff_env import WorldConfig, planners
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.config import AssistedLimits, EgosConfig
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError, ShapeError
from ccdiff_env.planners.built_in import Seat
from ccdiff_env.planners.ego import save_ego
from ccdiff_env.system.tensors import read_tensors, write_tensors
from ccdiff_env.training import ego_network
from ccdiff_env.worlds import Worlds
from ccdiff_env.worlds.fit import schema_digest

OPTIONS = {"dynamics": "assisted", "decision_steps": 3}


def agent_of(layout):
    """A network of random weights."""
    torch.manual_seed(0)
    made = ego_network.Agent(layout, (0.5, 0.5))
    torch.nn.init.normal_(made.policy[-1].weight, std=0.1)
    return made


@pytest.fixture(scope="module")
def agent(scenes):
    """A network that has seen some observations."""
    env = ccdiff_env.make_vec(8, scenes=scenes, config=WorldConfig().with_options(**OPTIONS))
    made = agent_of(env.worlds.layout)
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


def test_descriptions_of_columns_are_no_part_of_a_digest():
    columns = [{"name": "speed", "unit": "m/s", "scale": 20.0, "doc": "how fast"}]

    def digest(**change):
        return schema_digest(json.dumps({"entries": [{"columns": [columns[0] | change]}]}))

    assert digest(doc="speed of the centre") == digest()
    others = [digest(**change) for change in ({"name": "v"}, {"unit": "km/h"}, {"scale": 30.0})]
    assert len({digest(), *others}) == 4


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


def test_policies_of_other_observations_are_refused(path, scenes):
    tensors, metadata = read_tensors(path)
    worlds = Worlds(scenes, planners.load(path).config, num_worlds=1)
    write_tensors(path, tensors, metadata | {"schema": "95d993079874e7cc"})
    with pytest.raises(ConfigError, match="observations that this version does not have"):
        Seat(planners.load(path), "policy").begin(worlds)


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
    """Single steps give the states of worlds that hold actions themselves."""
    policy = planners.load(path)
    held = ccdiff_env.EgoEnv(scenes=scenes, traffic="idm", **policy.env_options, **GOES_ON)
    single = ccdiff_env.EgoEnv(scenes=scenes, traffic="idm", driver=str(path), **GOES_ON)
    obs, _ = held.reset(seed=3)
    single.reset(seed=3)
    for _ in range(20):
        obs, *_ = held.step(policy.act(obs[None])[0])
        for _ in range(3):
            single.step(np.zeros(2, np.float32))
        assert single.worlds.native.digest(0) == held.worlds.native.digest(0)


def test_the_shipped_egos_drive_unseen_scenes(scenes):
    for name, file in planners.SHIPPED.items():
        assert file.stat().st_size < 1_000_000
        rows, _ = drive(scenes, name, TRAFFIC["idm"], seed=0)
        assert np.mean([row["success"] for row in rows]) > 0.6
        assert planners.load(name).about


def test_a_vehicle_of_the_traffic_drives_as_the_policy_would_in_its_seat(scenes, tmp_path):
    """A policy that decides at every step, and does not know how far its goal is, and how long."""
    layout = ccdiff_env.EgoEnv(scenes=scenes).worlds.layout
    tensors = {name: part.numpy().copy() for name, part in agent_of(layout).state_dict().items()}
    (ego,) = (entry for entry in layout.entries if entry.name == "ego")
    of_goal = ("route_remaining", "goal_near", "goal_speed", "goal_braking")
    for column in (*of_goal, "time_remaining", "pace"):
        tensors["policy.0.weight"][:, ego.offset + ego.columns.index(column)] = 0.0
    path = tmp_path / "unicycle.safetensors"
    save_ego(path, tensors, {}, {})
    policy, compared = planners.load(path), 0
    own = {"egos": EgosConfig(policy=str(path))}
    for scene in scenes:
        log, vehicle = scene.tracks(), np.array(scene.agent_types) == "vehicle"
        moves = np.ptp(log["position"], axis=1).max(axis=1) > 15.0
        fit = np.flatnonzero(moves & vehicle & log["valid"][:, :50].all(axis=1))
        if len(fit) < 2:
            continue
        agent, name = fit[1], scene.agent_ids[fit[1]]  # the first is the ego
        seat, traffic = (
            Play([scene], "replay", horizon_steps=60, on_traffic_collision="ignore", **options)
            for options in (
                {"controlled": [name], "driver": "external"},
                {"drivers": {name: "egos"}, "named_drivers": own},
            )
        )
        for _ in range(30):
            seat.native.step(policy.act(seat.out.obs[:, 0])[:, None], seat.out)
            traffic.step()
            places = [play.states()["position"][agent] for play in (seat, traffic)]
            np.testing.assert_allclose(*places, atol=2e-3)
            compared += 1
    assert compared > 100


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"policy": "nobody"}, ConfigError, "nobody"),
        ({"policy": "nobody.safetensors"}, DatasetNotFoundError, "nobody.safetensors"),
        ({"named_drivers": "ego"}, ConfigError, "named_drivers"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(options, error, message, scenes):
    with pytest.raises(error, match=message):
        ccdiff_env.make_vec(1, scenes=scenes, traffic="egos", egos=options)


def test_weights_that_are_not_finite_or_have_other_shapes_are_refused(scenes, tmp_path):
    tensors, metadata = read_tensors(planners.SHIPPED["ego"])
    path = tmp_path / "bad.safetensors"
    for change in ({"mean": np.zeros(3, np.float32)}, {"policy.0.bias": np.zeros(3, np.float32)}):
        write_tensors(path, {**tensors, **change}, metadata)
        with pytest.raises((ConfigError, DatasetError), match=r"mean|policy\.0"):
            ccdiff_env.make_vec(1, scenes=scenes, traffic="egos", egos={"policy": str(path)})
