"""Any vehicle as the ego, from any start."""

from __future__ import annotations

import collections

import numpy as np
import pytest
from array_scenes import played as episode
from episode_play import played, same

import ccdiff_env
from ccdiff_env import EgoEnv, EgoVectorEnv, Recorder, Scene, WorldConfig, embedded_scenes
from ccdiff_env.errors import ConfigError, UnknownNameError

HISTORY, HORIZON, LEAST_M = 30, 100, 10.0


@pytest.fixture(scope="module")
def scenes():
    return embedded_scenes("val")[:4]


def moving(scene: Scene, horizon: int = HORIZON) -> set[tuple[str, int]]:
    """Vehicles and steps from which the log goes on for 10 m, recomputed from the tracks."""
    tracks, found = scene.tracks(), set()
    position, valid = tracks["position"], tracks["valid"]
    for a, (name, kind) in enumerate(zip(scene.agent_ids, scene.agent_types, strict=True)):
        for t in np.flatnonzero(valid[a, HISTORY:-1]) + HISTORY:
            last = np.flatnonzero(valid[a, : t + horizon + 1])[-1]
            gap = np.linalg.norm(position[a, last] - position[a, t])
            if kind == "vehicle" and gap >= LEAST_M:
                found.add((name, int(t)))
    return found


def edited(scene: Scene, ego: str) -> Scene:
    """The scene with another vehicle called the ego, built anew from arrays."""
    names = {"ego": "the other", ego: "ego"} if ego != "ego" else {}
    return Scene.from_arrays(
        scene.name,
        agent_ids=[names.get(one, one) for one in scene.agent_ids],
        agent_types=scene.agent_types,
        agent_categories=scene.agent_categories,
        sizes=scene.sizes,
        **scene.tracks(),
        dt=scene.dt,
        token=scene.token,
        location=scene.location,
        source=scene.source,
        origin=scene.origin,
        map_layers=scene.map_layers(),
    )


def actions(steps: int) -> np.ndarray:
    return np.random.default_rng(5).uniform(-0.3, 0.5, (steps, 2)).astype(np.float32)


def test_the_seed_draws_a_vehicle_that_drives_on_and_a_start(scenes):
    scene = scenes[0]
    known, env = moving(scene), EgoEnv(scenes=[scene], ego="any")
    drawn = []
    for seed in range(300):
        _, info = env.reset(seed=seed)
        drawn.append((info["ego"], info["start_step"]))
        assert scene.agent_ids[info["ego_idx"]] == info["ego"]
        assert env.reset(seed=seed)[1] == info
    assert set(drawn) <= known
    vehicles = collections.Counter(name for name, _ in drawn)
    assert set(vehicles) == {name for name, _ in known}
    # vehicles are drawn evenly: five standard deviations of a binomial count
    share = 1 / len(vehicles)
    bound = 5 * np.sqrt(300 * share * (1 - share))
    assert all(abs(count - 300 * share) < bound for count in vehicles.values())
    for name in vehicles:
        starts = sorted(t for one, t in known if one == name)
        got = [t for one, t in drawn if one == name]
        middle = np.std(starts) / np.sqrt(len(got))
        assert abs(np.mean(got) - np.mean(starts)) <= 5 * middle + 1e-9


def test_the_spread_of_starts_and_the_horizon_bound_the_draw(scenes):
    scene = scenes[1]
    known = moving(scene, horizon=50)
    env = EgoEnv(scenes=[scene], ego="any", start_spread_steps=20, horizon_steps=50)
    for seed in range(60):
        _, info = env.reset(seed=seed)
        assert (info["ego"], info["start_step"]) in known
        assert info["start_step"] <= HISTORY + 20


@pytest.mark.parametrize(
    "options",
    [{}, {"traffic": "idm", "dynamics": "assisted"}, {"traffic": "ccdiff", "criticality": 1.0}],
    ids=str,
)
def test_it_is_the_world_of_a_scene_in_which_that_vehicle_is_the_ego(options, scenes):
    scene = scenes[2]
    for ego, start in sorted(moving(scene))[::57][:4]:
        env = EgoEnv(scenes=[scene], ego="any", **options)
        obs, info = env.reset(seed=3, options={"scene": 0, "ego": ego, "start": start})
        assert (info["ego"], info["start_step"]) == (ego, start)
        other = EgoEnv(scenes=[edited(scene, ego)], history_steps=start, **options)
        expected, _ = other.reset(seed=3)
        assert np.array_equal(obs, expected)
        for route, wanted in zip(
            env.worlds.native.route(0, 0), other.worlds.native.route(0, 0), strict=True
        ):
            assert np.array_equal(route, wanted)
        assert same(played(env, actions(40)), played(other, actions(40)))


def test_it_starts_where_its_log_is_and_the_data_s_ego_is_traffic(scenes):
    env = EgoEnv(scenes=scenes, ego="any", traffic="idm")
    for seed in range(12):
        _, info = env.reset(seed=seed)
        scene, ego, step = env.scene, info["ego_idx"], info["start_step"]
        states, tracks = env.worlds.native.states(0), scene.tracks()
        there = tracks["valid"][:, step]
        assert np.array_equal(states["position"][there], tracks["position"][there, step])
        drivers = env.worlds.native.drivers(0)
        assert drivers[ego] == "external"
        assert drivers.count("external") == 1
        assert env.worlds.native.slot_agents(0) == [ego]


def test_recordings_call_it_the_ego(scenes):
    env = EgoEnv(scenes=scenes, ego="any", driver="idm", traffic="idm")
    seed = next(s for s in range(50) if env.reset(seed=s)[1]["ego"] != "ego")
    _, info = env.reset(seed=seed)
    recorder = Recorder(env)
    while env.step(np.zeros(2, np.float32))[2:4] == (False, False):
        recorder.step()
    recorder.step()
    rollout = recorder.rollout()
    assert rollout.agent_ids.index("ego") == info["ego_idx"]
    assert rollout.meta["ego"] == info["ego"]
    assert rollout.start_step == info["start_step"]
    other = EgoEnv(scenes=[rollout.to_scene()], history_steps=rollout.start_step)
    other.reset(seed=0)
    at = other.scene.agent_ids.index("ego")
    assert np.array_equal(
        other.worlds.native.states(0)["position"][at], rollout.position[info["ego_idx"], 0]
    )


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"ego": "ego"}, ConfigError, "without a scene"),
        ({"start": 40}, ConfigError, "without a scene"),
        ({"scene": 0, "ego": "nobody"}, UnknownNameError, "nobody"),
        ({"scene": 0, "ego": 3}, UnknownNameError, "3"),
        ({"scene": 0, "start": 29}, ConfigError, "start is 29, expected 30 to"),
        ({"scene": 0, "start": 10**6}, ConfigError, "start is 1000000"),
        ({"scene": 0, "start": -1}, ConfigError, "start is -1"),
        ({"scene": 0, "start": 1.5}, ConfigError, "start is 1.5"),
        ({"scene": 0, "start": True}, ConfigError, "start is True"),
    ],
    ids=str,
)
def test_starts_that_do_not_fit_are_refused_and_nothing_moves(options, error, words, scenes):
    env = EgoVectorEnv(2, scenes=scenes, ego="any")
    env.reset(seed=0)
    before = [env.worlds.native.digest(i) for i in range(2)]
    with pytest.raises(error, match=words):
        env.reset(options=options)
    assert [env.worlds.native.digest(i) for i in range(2)] == before


def test_an_ego_must_be_a_vehicle_that_is_there(scenes):
    scene = next(s for s in embedded_scenes("all") if "pedestrian" in s.agent_types)
    env = EgoEnv(scenes=[scene], ego="any")
    walker = scene.agent_ids[scene.agent_types.index("pedestrian")]
    with pytest.raises(ConfigError, match="expected a vehicle of"):
        env.reset(options={"scene": 0, "ego": walker})
    plain = EgoEnv(scenes=[scene])
    with pytest.raises(ConfigError, match="ego is given, expected nothing"):
        plain.reset(options={"scene": 0, "ego": "ego"})
    tracks, at = dict(scene.tracks()), scene.agent_types.index("vehicle", 1)
    tracks["valid"][at, HISTORY:60] = False
    gone = EgoEnv(scenes=[ccdiff_env.scenes.with_tracks(scene, tracks)], ego="any")
    with pytest.raises(ConfigError, match="logged at step 40"):
        gone.reset(options={"scene": 0, "ego": scene.agent_ids[at], "start": 40})


def test_it_is_an_option_of_one_ego_per_world():
    assert WorldConfig().with_options(ego="any").controlled == "any"
    assert WorldConfig.from_json(WorldConfig(controlled="any").to_json()).controlled == "any"
    with pytest.raises(ConfigError, match="ego is 'all', expected one of ego, any"):
        EgoEnv(ego="all")
    with pytest.raises(ConfigError, match="num_slots"):
        ccdiff_env.worlds.Worlds(
            embedded_scenes("val"), WorldConfig(controlled="any", num_slots=2), num_worlds=1
        )
    with pytest.raises(ConfigError, match="ego is not an option"):
        ccdiff_env.parallel_env(agents=2, ego="any")


@pytest.mark.nuscenes
def test_drawn_logs_stay_on_the_road(data_root):
    scenes = ccdiff_env.load_nuscenes(data_root / "nuscenes", "v1.0-mini", cache=False)
    env = EgoEnv(scenes=scenes, ego="any", driver="replay")
    for seed in range(60):
        *_, (_, _, info) = episode(env, seed=seed)
        assert not info["off_road"]
