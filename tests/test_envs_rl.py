"""The environments under wrappers and learners."""

import gymnasium
import numpy as np
import pytest
from array_scenes import played

from ccdiff_env import EgoEnv, EgoVectorEnv

ID = "ccdiff_env/Ego-v0"
RULES = {"traffic": "idm", "horizon_steps": 20}


def test_workers_of_gymnasium_run_it_when_spawned(scenes):
    options = {"scenes": list(scenes)[:2], **RULES}
    spawned = {"vectorization_mode": "async", "vector_kwargs": {"context": "spawn"}}
    env = gymnasium.make_vec(ID, num_envs=2, **spawned, **options)
    native = EgoVectorEnv(2, **options)
    obs, _ = env.reset(seed=3)
    assert np.array_equal(obs, native.reset(seed=3)[0])
    action = np.full((2, 2), 0.1, np.float32)
    assert np.array_equal(env.step(action)[0], native.step(action)[0])
    env.close()


def test_processes_of_stable_baselines3_give_the_bits_of_one_process(scenes):
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

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
    ("name", "options", "settings"),
    [
        ("PPO", {}, {"n_steps": 64, "batch_size": 64, "n_epochs": 2}),
        ("PPO", {"discrete": True, "observation": "dict"}, {"n_steps": 64, "batch_size": 64}),
        ("SAC", {"dynamics": "bicycle"}, {"learning_starts": 50, "batch_size": 32}),
        ("DQN", {"discrete": True}, {"learning_starts": 50, "batch_size": 32}),
    ],
    ids=lambda x: str(x),
)
def test_stable_baselines3_learns_on_it(name, options, settings, scenes):
    sb3 = pytest.importorskip("stable_baselines3")
    policy = "MultiInputPolicy" if options.get("observation") == "dict" else "MlpPolicy"
    env = EgoEnv(scenes=scenes, **RULES, **options)
    model = getattr(sb3, name)(
        policy, env, seed=0, device="cpu", policy_kwargs={"net_arch": [16]}, **settings
    )
    model.learn(200)
    action, _ = model.predict(env.reset(seed=0)[0], deterministic=True)
    env.step(action)
    assert model.num_timesteps >= 200
    assert len(model.ep_info_buffer) > 0
