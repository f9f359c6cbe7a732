"""Vehicles of the traffic that drive as the ego would."""

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import WorldConfig, planners
from ccdiff_env.config import EgosConfig, UnicycleLimits
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.planners.ego import save_ego
from ccdiff_env.system.tensors import read_tensors, write_tensors
from ccdiff_env.worlds import Worlds

UNICYCLE = {"dynamics": UnicycleLimits()}
CONFIG = WorldConfig().with_options(**UNICYCLE)


def agent_of(layout):
    torch = pytest.importorskip("torch")
    from ccdiff_env.envs.ego_network import Agent

    torch.manual_seed(0)
    made = Agent(layout, (0.5, 0.5))
    torch.nn.init.normal_(made.policy[-1].weight, std=0.1)
    return made


def test_a_vehicle_of_the_traffic_drives_as_the_policy_would_in_its_seat(scenes, tmp_path):
    """A policy that decides at every step, and does not know how far its goal is."""
    layout = ccdiff_env.make_vec(1, scenes=scenes, config=CONFIG).worlds.layout
    tensors = {name: part.numpy().copy() for name, part in agent_of(layout).state_dict().items()}
    (ego,) = (entry for entry in layout.entries if entry.name == "ego")
    tensors["policy.0.weight"][:, ego.offset + ego.columns.index("route_remaining")] = 0.0
    path = tmp_path / "unicycle.safetensors"
    save_ego(path, tensors, UNICYCLE, {})
    policy, compared = planners.load(path), 0
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
