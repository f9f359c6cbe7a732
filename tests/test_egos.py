"""A policy's dial, and vehicles of the traffic that drive as the ego would."""

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import WorldConfig, planners
from ccdiff_env.config import EgosConfig, UnicycleLimits
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.planners.ego import load_ego, save_ego
from ccdiff_env.system.tensors import read_tensors, write_tensors
from ccdiff_env.worlds import Worlds

STYLES = {"progress": (0.5, 2.0), "comfort": (0.0, 4.0)}
UNICYCLE = {"dynamics": UnicycleLimits()}
CONFIG = WorldConfig().with_options(**UNICYCLE)


def agent_of(layout):
    torch = pytest.importorskip("torch")
    from ccdiff_env.envs.ego_network import Agent

    torch.manual_seed(0)
    made = Agent(layout, (0.5, 0.5))
    torch.nn.init.normal_(made.policy[-1].weight, std=0.1)
    return made


def test_a_dial_sets_what_the_network_observes_last(scenes, tmp_path):
    worlds = ccdiff_env.make_vec(8, scenes=scenes, style=STYLES, config=CONFIG)
    (entry,) = (e for e in worlds.worlds.layout.entries if e.name == "style")
    names = [getattr(column, "name", column) for column in entry.columns]
    agent = agent_of(worlds.worlds.layout)
    obs, _ = worlds.reset(seed=0)
    import torch

    agent.see(torch.from_numpy(obs))
    path = tmp_path / "dial.safetensors"
    save_ego(path, agent.state_dict(), UNICYCLE, {}, {name: STYLES[name] for name in names})
    seen = {}
    for style in ({}, {"comfort": 4.0}, {"comfort": 0.0, "progress": 2.0}):
        obs[:, entry.offset :] = [style.get(name, 1.0) for name in names]
        expected = agent.act(obs)
        policy = load_ego(path, style)
        assert policy.styles == {name: STYLES[name] for name in names}
        seen[str(style)] = policy.act(obs[:, : entry.offset])
        np.testing.assert_allclose(seen[str(style)], expected, atol=1e-5)
    assert len({found.tobytes() for found in seen.values()}) == 3
    named = planners.find_policy(f"{path}?comfort=4")
    np.testing.assert_array_equal(named.act(obs[:, : entry.offset]), seen["{'comfort': 4.0}"])
    # worlds of the benchmark, which have no dial, take it
    policy.check(Worlds(scenes[:1], policy.config, num_worlds=1))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("ego_replay?comfort=1", "style: comfort is 1, expected none"),
        ("ego?comfort", "expected option=value"),
        ("ego?comfort=much", "expected a number"),
    ],
)
def test_a_dial_that_is_not_there_is_refused(name, message):
    with pytest.raises(ConfigError, match=message):
        planners.find_policy(name)


def test_a_vehicle_of_the_traffic_drives_as_the_policy_would_in_its_seat(scenes, tmp_path):
    """A policy that decides at every step, and does not know how far its goal is."""
    layout = ccdiff_env.make_vec(1, scenes=scenes, config=CONFIG).worlds.layout
    tensors = {name: part.numpy().copy() for name, part in agent_of(layout).state_dict().items()}
    (ego,) = (entry for entry in layout.entries if entry.name == "ego")
    tensors["policy.0.weight"][:, ego.offset + ego.columns.index("route_remaining")] = 0.0
    path = tmp_path / "unicycle.safetensors"
    save_ego(path, tensors, UNICYCLE, {})
    policy, compared = load_ego(path), 0
    config = policy.config.with_options(
        traffic="replay", horizon_steps=60, on_traffic_collision="ignore", on_collision="ignore"
    )
    own = {"egos": EgosConfig(policy=str(path))}
    for i, scene in enumerate(scenes):
        log, vehicle = scene.tracks(), np.array(scene.agent_types) == "vehicle"
        moves = np.ptp(log["position"], axis=1).max(axis=1) > 15.0
        fit = np.flatnonzero(moves & vehicle & log["valid"][:, :50].all(axis=1))
        if len(fit) < 2:
            continue
        agent, name = fit[1], scene.agent_ids[fit[1]]  # the first is the ego
        made = {"driver": "replay", "drivers": {name: "egos"}, "named_drivers": own}
        seat, traffic = (
            Worlds(scenes[i : i + 1], config.with_options(**options), num_worlds=1)
            for options in ({"controlled": [name]}, made)
        )
        for worlds in (seat, traffic):
            worlds.native.reset([0], [0], None, worlds.arrays())
        act = policy.act
        for _ in range(30):
            seat.native.step(act(seat.last.obs[:, 0]).reshape(1, 1, 2), seat.last)
            traffic.native.step(np.zeros((1, 1, 2), np.float32), traffic.last)
            if seat.last.done[0] or traffic.last.done[0]:
                break
            places = [w.native.states(0)["position"][agent] for w in (seat, traffic)]
            np.testing.assert_allclose(*places, atol=2e-3)
            compared += 1
    assert compared > 100


def test_a_dial_drives_traffic_otherwise(scenes, tmp_path):
    worlds = ccdiff_env.make_vec(1, scenes=scenes, style=STYLES, config=CONFIG)
    agent = agent_of(worlds.worlds.layout)
    path = tmp_path / "dial.safetensors"
    save_ego(
        path, agent.state_dict(), UNICYCLE, {}, {n: STYLES[n] for n in ("progress", "comfort")}
    )
    ends = []
    for style in ({}, {"progress": 2.0}):
        own = {"egos": {"policy": str(path), "style": style}}
        env = ccdiff_env.make_vec(2, scenes=scenes, traffic="egos", **own)
        env.reset(seed=0)
        for _ in range(10):
            env.step(np.zeros((2, 2), np.float32))
        ends.append(env.worlds.native.states(0)["position"].copy())
        assert "egos" in {d for i in range(2) for d in env.worlds.native.drivers(i)}
    assert not np.array_equal(*ends)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"policy": "nobody"}, ConfigError, "nobody"),
        ({"policy": "nobody.safetensors"}, DatasetNotFoundError, "nobody.safetensors"),
        ({"style": {"comfort": 9.0}}, ConfigError, "style: comfort is 9.0, expected none"),
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
