"""The bird's-eye raster as an observation."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
import shapely
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env

import ccdiff_env
from ccdiff_env import EgoEnv, EgoVectorEnv
from ccdiff_env.config import BevConfig, ObservationConfig, WorldConfig
from ccdiff_env.errors import ConfigError

ID = "ccdiff_env/Ego-v0"
SMALL = {"size_px": 48, "metres_per_px": 0.75}
DRIVABLE = 0  #: Channel of the raster.


@pytest.mark.parametrize("form", ["bev", "dict"])
def test_checkers_accept_the_raster_without_warnings(form, scenes):
    from stable_baselines3.common.env_checker import check_env as sb3_check

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # stable-baselines3 remarks on the tables of the dictionary, which it flattens
        warnings.filterwarnings("ignore", message="Your observation (agents|map|route)")
        env = gymnasium.make(ID, scenes=scenes, observation=form, bev={}, traffic="idm")
        check_env(env.unwrapped, skip_render_check=True)
        sb3_check(EgoEnv(scenes=scenes, observation=form, bev={}))


def test_forms_and_spaces(scenes):
    alone = EgoEnv(scenes=scenes, observation="bev")
    assert alone.observation_space == spaces.Box(0, 255, (5, 84, 84), np.uint8)
    both = EgoEnv(scenes=scenes, observation="dict", bev=SMALL)
    assert both.observation_space["bev"].shape == (5, 48, 48)
    assert both.worlds.layout.channels == ("drivable", "lines", "route", "agents", "ego")
    obs, _ = both.reset(seed=0)
    assert obs in both.observation_space
    assert np.array_equal(obs["bev"], both.observation()["bev"])
    config = WorldConfig(observation=ObservationConfig(bev=BevConfig(size_px=48)))
    assert EgoEnv(config=config, observation="bev").observation_space.shape == (5, 48, 48)
    assert "bev" not in EgoEnv(scenes=scenes, observation="dict").observation_space.spaces
    for unseen in (EgoEnv, ccdiff_env.parallel_env):
        with pytest.raises(ConfigError, match="rasters are shown by"):
            unseen(scenes=scenes, bev={})
    with pytest.raises(ConfigError, match="size_px"):
        EgoEnv(scenes=scenes, observation="bev", bev={"size_px": 3})
    with pytest.raises(ConfigError, match="size"):
        EgoEnv(scenes=scenes, observation="bev", bev={"size": 64})


@pytest.mark.parametrize("name", ["left-turn-04", "hard-brake-03", "merge-in-03"])
def test_drivable_pixels_are_those_whose_centres_shapely_finds_on_the_road(name, scenes):
    env = EgoEnv(scenes=scenes, observation="bev", bev={"size_px": 100, "metres_per_px": 0.4})
    env.reset(seed=0, options={"scene": name})
    layers = env.scene.map_layers()["drivable_area"]
    # holes that the crop has cut open share edges with their shell: rings one by one
    area = [
        [shapely.make_valid(shapely.Polygon(r)) for r in (p["exterior"], *p["holes"])]
        for p in layers
    ]
    road = shapely.union_all([shell - shapely.union_all(holes) for shell, *holes in area])
    shapely.prepare(road)
    edge = road.boundary
    rows, columns = np.mgrid[:100, :100]
    ahead, left = (75 - rows - 0.5) * 0.4, (50 - columns - 0.5) * 0.4
    for _ in range(12):
        obs = env.step(env.expert_action())[0]
        states = env.worlds.native.states(0)
        ego = env.scene.agent_ids.index("ego")
        (x, y), heading = states["position"][ego].astype(float), float(states["heading"][ego])
        points = shapely.points(
            x + ahead * np.cos(heading) - left * np.sin(heading),
            y + ahead * np.sin(heading) + left * np.cos(heading),
        )
        on_road = shapely.contains(road, points)
        # the ground has pixels half as wide: no centre is farther off than half their diagonal
        sure = shapely.distance(edge, points) > 0.1 * np.sqrt(2.0) + 0.01
        assert sure.mean() > 0.9
        assert 0.1 < on_road.mean() < 0.99
        assert np.array_equal(obs[DRIVABLE][sure] == 255, on_road[sure])


def test_a_restored_environment_shows_the_same_raster(scenes):
    env = EgoEnv(scenes=scenes, observation="bev", bev=SMALL, traffic="idm")
    env.reset(seed=4)
    for _ in range(5):
        obs = env.step(env.action_space.sample())[0]
    saved, fork = env.snapshot(), env.fork()
    env.step(env.action_space.sample())
    assert np.array_equal(env.restore(saved), obs)
    assert np.array_equal(fork.observation(), obs)
    vector = EgoVectorEnv(2, scenes=scenes, observation="dict", bev=SMALL, traffic="idm")
    vector.reset(seed=4)
    state = vector.snapshot(0)
    here = vector.step(np.zeros((2, 2), np.float32))[0]["bev"][0]
    assert not np.array_equal(vector.restore(0, state)["bev"], here)
    assert np.array_equal(vector.step(np.zeros((2, 2), np.float32))[0]["bev"][0], here)


@pytest.mark.parametrize(("policy", "form"), [("CnnPolicy", "bev"), ("MultiInputPolicy", "dict")])
def test_ppo_learns_from_rasters(policy, form, scenes):
    import torch
    from stable_baselines3 import PPO

    from ccdiff_env.envs.sb3 import SB3VecEnv

    torch.set_num_threads(1)
    native = ccdiff_env.make_vec(
        2, scenes=scenes, observation=form, bev=SMALL, autoreset_mode="same_step"
    )
    model = PPO(policy, SB3VecEnv(native), n_steps=8, batch_size=8, n_epochs=1, device="cpu")
    before = {k: v.clone() for k, v in model.policy.state_dict().items()}
    model.learn(16)
    assert any(not torch.equal(v, before[k]) for k, v in model.policy.state_dict().items())
