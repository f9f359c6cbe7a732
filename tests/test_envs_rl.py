"""The environments under wrappers and learners."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from array_scenes import played
from gymnasium import wrappers
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as vector_wrappers

import ccdiff_env
from ccdiff_env import EgoEnv, EgoVectorEnv

ID = "ccdiff_env/Ego-v0"
RULES = {"traffic": "idm", "horizon_steps": 20}


# -------------------------------------------------------------------------------- wrappers


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


def test_episode_statistics_agree_with_the_metrics(scenes):
    env = wrappers.RecordEpisodeStatistics(gymnasium.make(ID, scenes=scenes, **RULES))
    infos = play(env)
    assert infos
    for info in infos:
        assert info["episode"]["r"] == pytest.approx(info["metrics"]["return"], abs=1e-4)
        assert info["episode"]["l"] == info["metrics"]["length"]


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_vector_episode_statistics_agree_with_the_metrics(mode, scenes):
    version = tuple(int(part) for part in gymnasium.__version__.split(".")[:2])
    if mode is AutoresetMode.SAME_STEP and version < (1, 4):
        pytest.skip("this wrapper counts SAME_STEP episodes rightly from Gymnasium 1.4 on")
    native = EgoVectorEnv(4, scenes=scenes, autoreset_mode=mode, **RULES)
    env = vector_wrappers.RecordEpisodeStatistics(native)
    env.reset(seed=0)
    found = 0
    for _ in range(45):
        *_, terminated, truncated, infos = env.step(np.full((4, 2), 0.05, np.float32))
        done = terminated | truncated
        if not done.any():
            continue
        ended = infos["final_info"] if mode is AutoresetMode.SAME_STEP else infos
        metrics = ended["metrics"]
        assert np.allclose(infos["episode"]["r"][done], metrics["return"][done], atol=1e-4)
        assert np.array_equal(infos["episode"]["l"][done], metrics["length"][done])
        assert np.array_equal(metrics["_length"], done)
        found += done.sum()
        if mode is AutoresetMode.DISABLED:
            env.reset(options={"reset_mask": done})
    assert found >= 4


def test_observations_can_be_normalised_stacked_and_flattened(scenes):
    env = wrappers.NormalizeObservation(gymnasium.make(ID, scenes=scenes, **RULES))
    (width,) = env.observation_space.shape
    env = wrappers.FrameStackObservation(env, 3)
    assert env.observation_space.shape == (3, width)
    play(env, 10)
    parts = gymnasium.make(ID, scenes=scenes, observation="dict", **RULES)
    assert wrappers.FlattenObservation(parts).observation_space.shape == (width,)
    native = EgoVectorEnv(3, scenes=scenes, **RULES)
    normal = vector_wrappers.NormalizeObservation(native)
    normal.reset(seed=0)
    normal.step(normal.action_space.sample())
    raster = gymnasium.make(ID, scenes=scenes, observation="bev", bev={"size_px": 16}, **RULES)
    stacked = wrappers.FrameStackObservation(raster, 4)
    assert stacked.observation_space.shape == (4, 5, 16, 16)
    play(stacked, 5)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_vector_wrappers_scale_and_list_what_the_worlds_give(mode, scenes):
    native = EgoVectorEnv(3, scenes=scenes, autoreset_mode=mode, **RULES)
    env = vector_wrappers.NormalizeReward(vector_wrappers.ClipReward(native, -1.0, 1.0))
    env = vector_wrappers.DictInfoToList(env)
    env.reset(seed=0)
    lengths = np.zeros(3, dtype=int)
    for _ in range(25):
        obs, reward, terminated, truncated, infos = env.step(np.zeros((3, 2), np.float32))
        assert obs in env.observation_space
        assert np.isfinite(reward).all()
        assert len(infos) == 3
        lengths += 1
        done = terminated | truncated
        for i in np.flatnonzero(done):
            ended = infos[i]["final_info"] if mode is AutoresetMode.SAME_STEP else infos[i]
            assert 1 <= ended["metrics"]["length"] <= lengths[i]
        lengths[done] = -1 if mode is AutoresetMode.NEXT_STEP else 0
        if mode is AutoresetMode.DISABLED and done.any():
            env.reset(options={"reset_mask": done})


@pytest.mark.parametrize("vector", [False, True])
def test_episodes_are_recorded_as_video(vector, scenes, tmp_path):
    pytest.importorskip("moviepy")
    import imageio.v2 as imageio

    videos = tmp_path / "videos"
    options = {
        "scenes": scenes,
        "render_mode": "rgb_array",
        "render_options": {"size": (64, 64)},
        "terminate_at_goal": False,
        **RULES,
    }
    if vector:
        env = vector_wrappers.RecordVideo(EgoVectorEnv(2, **options), str(videos), video_length=9)
        env.reset(seed=0)
        for _ in range(12):
            env.step(np.zeros((2, 2), np.float32))
    else:
        env = gymnasium.make(ID, **options)
        env = wrappers.RecordVideo(env, str(videos), episode_trigger=lambda n: n == 0)
        play(env, 25)
    env.close()
    (video,) = videos.glob("*.mp4")
    frames = imageio.mimread(video)
    assert 8 <= len(frames) <= 22
    assert min(frames[0].shape[:2]) == 64
    assert frames[0].std() > 1.0


def test_workers_of_gymnasium_run_it_when_spawned(scenes):
    env = gymnasium.make_vec(
        ID,
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
        scenes=list(scenes)[:2],
        **RULES,
    )
    native = EgoVectorEnv(2, scenes=list(scenes)[:2], **RULES)
    obs, _ = env.reset(seed=3)
    assert np.array_equal(obs, native.reset(seed=3)[0])
    action = np.full((2, 2), 0.1, np.float32)
    assert np.array_equal(env.step(action)[0], native.step(action)[0])
    env.close()


@pytest.mark.parametrize("options", [{}, {"criticality": 1.0}])
def test_processes_of_stable_baselines3_give_the_bits_of_one_process(options, scenes):
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

    def make():
        return EgoEnv(scenes=scenes, traffic="ccdiff", horizon_steps=12, **options)

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


# ------------------------------------------------------------- termination and truncation


def returns_by_bootstrap(rewards, terminated, truncated, values, last_values, gamma=0.9):
    """Discounted return-to-go that bootstraps where an episode is cut off, and only there."""
    result = np.zeros_like(rewards)
    ahead = last_values.copy()
    for t in reversed(range(len(rewards))):
        ahead = np.where(truncated[t], values[t], ahead)
        ahead = np.where(terminated[t], 0.0, ahead)
        ahead = rewards[t] + gamma * ahead
        result[t] = ahead
    return result


def test_no_return_leaks_over_the_end_of_an_episode(scenes):
    """Bootstrapped returns of a batch are those of its episodes, computed one by one."""
    num_envs, steps = 6, 40
    rules = {"traffic": "idm", "horizon_steps": 9}
    env = EgoVectorEnv(num_envs, scenes=scenes, autoreset_mode="same_step", **rules)

    def value(obs):
        return obs[..., :5].sum(-1).astype(float)

    obs, _ = env.reset(seed=1)
    single = [EgoEnv(scenes=scenes, **rules) for _ in range(num_envs)]
    actions = np.random.default_rng(0).normal(-0.3, 0.3, (steps, num_envs, 2)).astype(np.float32)
    rewards, terms, truncs, values = [], [], [], []
    for action in actions:
        obs, reward, terminated, truncated, infos = env.step(action)
        assert not (terminated & truncated).any()
        last = [value(o) if o is not None else 0.0 for o in infos.get("final_obs", [None] * 6)]
        rewards.append(reward.astype(float))
        terms.append(terminated)
        truncs.append(truncated)
        values.append(np.array(last))
    got = returns_by_bootstrap(np.array(rewards), terms, truncs, values, value(obs))
    assert np.any(terms)
    assert np.any(truncs)
    for i, one in enumerate(single):
        one.reset(seed=1 + i)
        start = 0
        while start < steps:
            episode, t, ahead = [], start, 0.0
            while t < steps:
                last, reward, terminated, truncated, _ = one.step(actions[t, i])
                episode.append(reward)
                t += 1
                ahead = 0.0 if terminated else value(last)
                if terminated or truncated:
                    one.reset()
                    break
            for k in reversed(range(len(episode))):
                ahead = episode[k] + 0.9 * ahead
                assert got[start + k, i] == pytest.approx(ahead, abs=1e-5)
            start = t


def test_a_collision_terminates_and_the_horizon_truncates(scenes):
    crash = EgoEnv(scenes=scenes, traffic="idm", on_off_road="ignore", horizon_steps=150)
    endings = {"terminated": 0, "truncated": 0}
    for seed in range(12):
        *_, (_, _, info) = played(crash, np.array([1.0, 0.0], np.float32), seed=seed)
        caused = bool(info["collision"] or info["goal_reached"])
        assert (info["terminated"], info["truncated"]) == (caused, bool(info["time_limit"]))
        assert caused != info["truncated"]
        endings["terminated" if caused else "truncated"] += 1
    assert endings["terminated"] > 0


# -------------------------------------------------------------------------------- learners


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


def test_success_is_reported_to_learners(scenes):
    env = ccdiff_env.EgoEnv(scenes=scenes, driver="replay", terminate_at_goal=False)
    *_, (_, _, info) = played(env)
    assert info["is_success"] == info["metrics"]["is_success"]
    assert info["metrics"]["route_completion"] == pytest.approx(1.0, abs=0.05)
