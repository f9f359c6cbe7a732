"""Spaces belong to the worlds: wrappers of Gymnasium and stable-baselines3 get copies."""

from __future__ import annotations

import copy

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces, wrappers
from gymnasium.wrappers import vector
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

import ccdiff_env
from ccdiff_env import AdversarySelectionVectorEnv, AgentVectorEnv, EgoEnv
from ccdiff_env.envs.sb3 import AgentSB3VecEnv, SB3VecEnv, SelectionSB3VecEnv
from ccdiff_env.errors import ConfigError
from ccdiff_env.planners.built_in import Seat
from ccdiff_env.worlds import Worlds
from ccdiff_env.worlds.fit import ATTRIBUTE

RASTER = {"observation": "dict", "bev": {"size_px": 36}}


def own(env):
    """All spaces of an environment and of its worlds, as they are."""
    names = ("observation_space", "action_space", "single_observation_space", "single_action_space")
    found = {name: getattr(env, name) for name in names if hasattr(env, name)}
    return found | {"worlds": env.worlds.action_space}


def spoil(space):
    """Change a space in place, as wrappers do."""
    if isinstance(space, spaces.Dict):
        for name in list(space.spaces):
            space.spaces[name] = spaces.Discrete(2)
    elif isinstance(space, spaces.Box):
        space.low[:], space.high[:] = -3.0, 3.0
    elif isinstance(space, spaces.MultiBinary):
        space.n, space._shape = 1, (1,)


def test_statistics_of_rasters_change_the_wrappers_space_alone(scenes):
    env = ccdiff_env.make_vec(2, scenes=scenes, **RASTER)
    before, vec = copy.deepcopy(own(env)), SB3VecEnv(env)
    norm = VecNormalize(vec, norm_obs_keys=["bev", "ego"])
    norm.reset()
    assert norm.observation_space["bev"].dtype == np.float32
    assert own(env) == before
    assert env.single_observation_space["bev"].dtype == np.uint8
    assert getattr(env.single_observation_space, ATTRIBUTE)


@pytest.mark.parametrize("form", [{}, RASTER])
def test_wrappers_of_gymnasium_leave_spaces_alone(scenes, form):
    for wrap in (
        lambda env: wrappers.RescaleAction(env, -2.0, 2.0),
        lambda env: wrappers.FrameStackObservation(env, 2),
        wrappers.FlattenObservation,
        wrappers.TimeAwareObservation if not form else wrappers.ClipAction,
    ):
        env = EgoEnv(scenes=scenes, **form)
        before = copy.deepcopy(own(env))
        wrapped = wrap(gymnasium.wrappers.TimeLimit(env, 5))
        wrapped.reset(seed=0)
        wrapped.step(wrapped.action_space.sample())
        assert own(env) == before
    env = ccdiff_env.make_vec(2, scenes=scenes, **form)
    before = copy.deepcopy(own(env))
    wrapped = vector.RescaleAction(vector.FlattenObservation(env), -2.0, 2.0)
    wrapped.reset(seed=0)
    wrapped.step(wrapped.action_space.sample())
    assert own(env) == before


def test_worlds_go_on_whatever_is_done_to_a_space_that_was_handed_out(scenes):
    rows = AgentVectorEnv(2, scenes=scenes, agents=2)
    selection = AdversarySelectionVectorEnv(2, scenes=scenes, horizon_steps=10)
    for env, vec in (
        (ccdiff_env.make_vec(2, scenes=scenes), SB3VecEnv),
        (ccdiff_env.make_vec(2, scenes=scenes, **RASTER), SB3VecEnv),
        (rows, AgentSB3VecEnv),
        (selection, SelectionSB3VecEnv),
    ):
        before = copy.deepcopy(own(env))
        made = vec(env)
        actions = np.stack([made.action_space.sample() for _ in range(made.num_envs)])
        spoil(made.observation_space)
        spoil(made.action_space)
        assert own(env) == before
        for space in own(env).values():
            spoil(space)
        made.reset()
        made.step(actions)
    env = EgoEnv(scenes=scenes)
    spoil(env.action_space)
    env.reset(seed=0)
    assert env.step(np.zeros(2, np.float32))[0].shape == env.observation_space.shape
    assert env.expert_action().shape == (2,)


def test_a_policy_of_changed_observations_is_refused(scenes):
    """stable-baselines3 changes the raster's space of an environment of one world in place."""
    env = DummyVecEnv([lambda: EgoEnv(scenes=scenes, **RASTER)])
    norm = VecNormalize(env, norm_obs_keys=["bev"], norm_reward=False)
    model = PPO("MultiInputPolicy", norm, n_steps=4, batch_size=4, n_epochs=1, seed=0)
    worlds = EgoEnv(scenes=scenes, **RASTER).worlds
    assert isinstance(worlds, Worlds)
    worlds.native.reset([0], [0], None, worlds.arrays())
    seat = Seat(*_as_planner(model))
    with pytest.raises(ConfigError, match="another space"):
        seat.begin(worlds)
    plain = PPO("MultiInputPolicy", SB3VecEnv(ccdiff_env.make_vec(1, scenes=scenes, **RASTER)))
    Seat(*_as_planner(plain)).begin(worlds)


def _as_planner(model):
    from ccdiff_env.planners.built_in import _Sb3

    return _Sb3(model, "mine"), "mine"


def test_stacked_observations_have_a_space_of_their_own(scenes):
    env = ccdiff_env.make_vec(2, scenes=scenes)
    before = copy.deepcopy(own(env))
    stacked = VecFrameStack(SB3VecEnv(env), 3)
    assert stacked.reset().shape == (2, 3 * env.single_observation_space.shape[0])
    assert own(env) == before
