"""The environments under wrappers and learners."""

import gymnasium
import numpy as np
import pytest
from array_scenes import played
from gymnasium import wrappers

from ccdiff_env import EgoEnv, EgoVectorEnv

ID = "ccdiff_env/Ego-v0"
RULES = {"traffic": "idm", "horizon_steps": 20}


def play(env, steps=45):
    """Steps with resets; returns the last info of each episode."""
    env.action_space.seed(0)
    env.reset(seed=0)
    infos = []
    for _ in range(steps):
        obs, _, terminated, truncated, info = env.step(env.action_space.sample() * np.float32(0.1))
        assert obs in env.observation_space
        if terminated or truncated:
            infos.append(info)
            env.reset()
    return infos


def test_episodes_are_recorded_as_video(scenes, tmp_path):
    pytest.importorskip("moviepy")
    import imageio.v2 as imageio

    drawn = {"render_mode": "rgb_array", "render_options": {"size": (64, 64)}}
    env = gymnasium.make(ID, scenes=scenes, terminate_at_goal=False, **drawn, **RULES)
    env = wrappers.RecordVideo(env, str(tmp_path), episode_trigger=lambda n: n == 0)
    play(env, 25)
    env.close()
    (video,) = tmp_path.glob("*.mp4")
    frames = imageio.mimread(video)
    assert 8 <= len(frames) <= 22
    assert min(frames[0].shape[:2]) == 64
    assert frames[0].std() > 1.0


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
