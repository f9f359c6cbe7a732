"""What wrappers and learners of others ask of environments."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import ccdiff_env
from ccdiff_env.envs.agent_vector import AgentVectorEnv
from ccdiff_env.envs.sb3 import SB3VecEnv
from ccdiff_env.errors import ConfigError, ResetNeededError


@pytest.fixture(scope="module")
def scenes():
    return ccdiff_env.embedded_scenes("val")[:2]


def test_vector_environments_answer_as_gymnasiums_own(scenes):
    env = ccdiff_env.make_vec(
        3, scenes=scenes, autoreset_mode="same_step", criticality=(0, 1), traffic="ccdiff"
    )
    assert env.autoreset_mode is AutoresetMode.SAME_STEP
    assert env.call("set_progress", 0.5) == (None, None, None)
    assert env.get_attr("num_envs") == (3, 3, 3)
    env.set_attr("note", "mine")
    env.set_attr("note", ["ours"] * 3)
    assert env.get_attr("note") == ("ours",) * 3
    for values in (["a", "b", "c"], ["a"]):
        with pytest.raises(ConfigError, match="share their attributes"):
            env.set_attr("note", values)
    with pytest.raises(AttributeError):
        env.call("fly")


def test_a_learner_chooses_when_worlds_begin_anew(scenes):
    options = {"scenes": scenes, "horizon_steps": 3, "traffic": "idm"}
    worlds = ccdiff_env.make_vec(2, **options)
    played = []
    for env in (worlds, ccdiff_env.make_vec(2, autoreset_mode="same_step", **options)):
        learner = SB3VecEnv(env)
        learner.seed(7)
        out = [learner.reset()]
        for _ in range(5):
            obs, rewards, dones, _ = learner.step(np.zeros((2, 2), np.float32))
            out += [obs, rewards, dones]
        played.append(out)
    assert played[0][9].all()  # the third step ends the episodes
    assert all(np.array_equal(a, b) for a, b in zip(*played, strict=True))
    assert worlds.autoreset_mode is AutoresetMode.SAME_STEP
    assert worlds.config.autoreset == "same_step"
    begun = ccdiff_env.make_vec(2, **options)
    begun.reset(seed=0)
    for env in (begun, gymnasium.vector.VectorWrapper(ccdiff_env.make_vec(2, **options))):
        with pytest.raises(ConfigError, match="expected SAME_STEP: make_vec"):
            SB3VecEnv(env)
    with pytest.raises(ConfigError, match="have begun"):
        begun.set_autoreset_mode("disabled")


def test_an_unknown_keyword_is_a_type_error_too():
    ids = lambda **o: gymnasium.make("ccdiff_env/Ego-v0", **o)  # noqa: E731
    for make in (ccdiff_env.EgoEnv, ids, ccdiff_env.WorldConfig):
        with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
            make(frameskip=4)
        with pytest.raises(ConfigError, match="unknown option 'trafic'; did you mean 'traffic'"):
            make(trafic="idm")


def is_numeric(value):
    if isinstance(value, dict):
        return all(map(is_numeric, value.values()))
    return np.asarray(value).dtype.kind in "biuf"


def test_without_information_there_are_numbers_alone(scenes):
    single = ccdiff_env.EgoEnv(scenes=scenes, info="none")
    assert is_numeric(single.reset(seed=0)[1])
    assert is_numeric(single.step(single.action_space.sample())[4])
    vector = ccdiff_env.make_vec(2, scenes=scenes, info="none")
    infos = vector.reset(seed=0, options={"scene": [1, 0]})[1]
    assert is_numeric(infos)
    assert infos["scene_idx"].tolist() == [1, 0]
    game = ccdiff_env.parallel_env(scenes=scenes, agents=2, info="none")
    assert is_numeric(game.reset(seed=0)[1])
    rows = AgentVectorEnv(2, agents=2, scenes=scenes, info="none")
    assert is_numeric(rows.reset(seed=0)[1])


def test_a_recorder_made_after_a_reset_has_started(scenes):
    env = ccdiff_env.EgoEnv(scenes=scenes, traffic="idm", driver="idm")
    env.reset(seed=0)
    recorder = ccdiff_env.Recorder(env)
    with pytest.raises(ResetNeededError, match="no step is recorded"):
        recorder.rollout()
    env.step(env.action_space.sample())
    recorder.step()
    assert recorder.rollout().num_steps == 2
    env = ccdiff_env.AdversarySelectionEnv(scenes=scenes)
    env.reset(seed=0)
    recorder = ccdiff_env.Recorder(env)
    env.step(0)
    assert recorder.rollout().num_steps == env.unwrapped.worlds.config.ccdiff.replan_steps + 1
