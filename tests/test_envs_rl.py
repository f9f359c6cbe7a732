"""The environments under wrappers and learners."""

import numpy as np
import pytest
from array_scenes import played
from stable_baselines3 import DQN, SAC
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

from ccdiff_env import EgoEnv


def test_processes_of_stable_baselines3_give_the_bits_of_one_process(scenes):
    def make():
        return EgoEnv(scenes=scenes[:2], traffic="ccdiff", criticality=1.0, horizon_steps=12)

    seen = []
    for form in (DummyVecEnv, SubprocVecEnv):
        env = form([make] * 2)
        env.seed(3)
        steps = [env.reset()]
        for t in range(15):  # over the end of an episode
            steps += env.step(np.full((2, 2), 0.1 * (t % 3), np.float32))[:3]
        env.close()
        seen.append(steps)
    for one, other in zip(*seen, strict=True):
        assert np.array_equal(one, other)


def test_a_collision_terminates_and_the_horizon_truncates(scenes):
    crash = EgoEnv(scenes=scenes, traffic="idm", on_off_road="ignore", horizon_steps=150)
    endings = set()
    for seed in range(12):
        *_, (_, _, info) = played(crash, np.array([1.0, 0.0], np.float32), seed=seed)
        caused = bool(info["collision"] or info["goal_reached"])
        assert (info["terminated"], info["truncated"]) == (caused, bool(info["time_limit"]))
        assert caused != info["truncated"]
        endings.add(caused)
    assert True in endings


@pytest.mark.parametrize(
    ("learner", "options"), [(SAC, {"dynamics": "bicycle"}), (DQN, {"discrete": True})]
)
def test_learners_with_a_memory_learn_on_it(learner, options, scenes):
    env = EgoEnv(scenes=scenes, traffic="idm", horizon_steps=20, **options)
    settings = {"learning_starts": 50, "batch_size": 32, "policy_kwargs": {"net_arch": [16]}}
    model = learner("MlpPolicy", env, seed=0, **settings).learn(200)
    assert len(model.ep_info_buffer) > 0
