"""How episodes end, and what logged drivers did."""

import numpy as np
import pytest
from array_scenes import STEPS, TIMES_S, agent, array_scene, wide_road

import ccdiff_env
from ccdiff_env.envs.cloning import demonstrations
from ccdiff_env.envs.outcomes import OUTCOMES, Learning, play_episodes
from ccdiff_env.errors import ConfigError

STEADY = agent("ego", 10.0 * TIMES_S)
STOPS = agent("ego", np.minimum(10.0 * TIMES_S, 90.0))
#: Scene, acceleration that is held, and how the episode ends.
CASES = {
    "arrives": ([STEADY], 0.0, "success"),
    "goes past a stop": ([STOPS], 0.0, "past"),
    "stops too soon": ([STEADY], -0.5, "stopped"),
    "is too slow": ([STEADY], -0.02, "late"),
    "drives into another": ([STEADY, agent("other", 80.0)], 0.0, "drove into"),
    "is run into": ([STEADY, agent("other", 15.0 * TIMES_S - 30.0)], -0.02, "was hit"),
}


def worlds(*scenes, **options):
    options = {"dynamics": "unicycle", "autoreset_mode": "same_step", **options}
    return ccdiff_env.make_vec(
        len(scenes), scenes=list(scenes), scene_order="sequential", **options
    )


@pytest.mark.parametrize("case", CASES)
def test_an_episode_ends_in_one_of_seven_ways(case):
    agents, acceleration, outcome = CASES[case]
    env = worlds(array_scene(*agents))
    shares = play_episodes(env, lambda obs: np.full((len(obs), 2), [acceleration, 0.0], np.float32))
    assert OUTCOMES[int(shares.argmax())] == outcome
    assert shares.sum() == 1.0


def test_who_leaves_the_road_is_told_and_drivers_are_counted_as_policies_are():
    scene = array_scene(STEADY, layers=wide_road(half_m=4.0))
    shares = play_episodes(worlds(scene), lambda obs: np.full((len(obs), 2), [0, 0.2], np.float32))
    assert shares[OUTCOMES.index("off the road")] == 1.0
    scenes = [array_scene(STEADY), array_scene(STOPS, name="stops")]
    assert play_episodes(worlds(*scenes, driver="replay"))[0] == 1.0
    shares = play_episodes(worlds(*scenes, driver="constant_velocity"))
    assert shares[0] == shares[OUTCOMES.index("past")] == 0.5
    with pytest.raises(ConfigError, match="goal_near"):
        play_episodes(worlds(*scenes, driver="replay", observation={"ego_columns": ["speed"]}))


def test_how_episodes_end_is_said_while_an_ego_learns(tmp_path, monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    learning = Learning(tmp_path)
    learning.say(8, "then", last=True)  # no episode has ended
    for seconds, decisions in ((5.0, 16), (11.0, 32)):
        now[0] = seconds
        learning.add(np.array([0, 0, 1, 4]))
        learning.say(decisions, f"{seconds:.0f} s")
    learning.add(np.array([6]))
    learning.say(40, "end", last=True)
    assert capsys.readouterr().out == (
        "11 s 32 decisions, of 8 episodes: success 50.0%, drove into 25.0%, past 25.0%\n"
        "end 40 decisions, of 1 episodes: late 100.0%\n"
    )
    events = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    board = events.EventAccumulator(str(tmp_path))
    board.Reload()
    said = [(one.step, one.value) for one in board.Scalars("outcomes/drove into")]
    assert said == [(32, 0.25), (40, 0.0)]


def test_demonstrations_drive_as_the_log_does():
    turn = np.clip(0.1 * (TIMES_S - 6.0), 0.0, 0.5)
    speed = np.clip(2.0 + 1.0 * (TIMES_S - 3.0), 2.0, 8.0)
    x, y = (np.cumsum(0.1 * speed * f(turn)) for f in (np.cos, np.sin))
    scene = array_scene(agent("ego", x, y, heading=turn))
    obs, actions = demonstrations([scene], 25_000, decision_steps=3, dynamics="unicycle")
    assert obs.shape == (25_000, worlds(scene).single_observation_space.shape[0])
    columns = worlds(scene).worlds.layout.entries[0].columns
    v = 20.0 * obs[:, columns.index("speed")]
    # 1 m/s² of 4 up to 8 m/s, 0.1 rad/s between 6 and 11 s of the log
    gains = (v > 2.2) & (v < 7.5)
    np.testing.assert_allclose(actions[gains, 0], 0.25, atol=0.03)
    assert np.abs(actions[v > 7.9, 0]).max() < 0.2
    assert {0, 10} <= set(np.round(100.0 * actions[:, 1]).astype(int))
    before = obs[:, [columns.index("last_action_0"), columns.index("last_action_1")]]
    np.testing.assert_allclose(before[gains, 0], 0.25, atol=0.26)
    with pytest.raises(ConfigError, match="number"):
        demonstrations([scene], 0)
    assert len(TIMES_S) == STEPS


@pytest.mark.parametrize("clock_ends", [False, True])
def test_an_episode_that_runs_out_of_time_may_have_ended(clock_ends):
    pytest.importorskip("stable_baselines3")
    from ccdiff_env.envs import sb3

    env = sb3.SB3VecEnv(worlds(array_scene(STEADY), horizon_steps=20), clock_ends=clock_ends)
    env.reset()
    for step in range(20):
        _, _, dones, infos = env.step(np.array([[-1.0, 0.0]], np.float32))
        assert bool(dones[0]) == (step == 19)
    assert infos[0]["TimeLimit.truncated"] is not clock_ends


def test_a_clone_does_what_was_shown(monkeypatch):
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import VecNormalize

    from ccdiff_env.envs import ego_network, sb3

    monkeypatch.setattr(ego_network, "CLONE_STEPS", 150)
    env = VecNormalize(sb3.SB3VecEnv(worlds(array_scene(STEADY))), norm_reward=False)
    model = stable_baselines3.PPO("MlpPolicy", env, seed=0, device="cpu", **sb3.PPO_SETTINGS)
    rng = np.random.default_rng(0)
    obs = rng.normal(2.0, 3.0, (4_000, env.observation_space.shape[0])).astype(np.float32)
    actions = np.tanh(0.1 * obs[:, :2] - 0.2)
    before = model.policy.log_std.detach().clone()
    sb3.clone(model, obs, actions)
    done = model.predict(env.normalize_obs(obs), deterministic=True)[0]
    assert np.abs(done - actions).mean() < 0.5 * np.abs(actions - actions.mean(axis=0)).mean()
    np.testing.assert_allclose(env.obs_rms.mean, obs.mean(axis=0), rtol=1e-5)
    assert (model.policy.log_std.detach() == before).all()
    bare = stable_baselines3.PPO("MlpPolicy", env.venv, device="cpu")
    with pytest.raises(ConfigError, match="VecNormalize"):
        sb3.clone(bare, obs, actions)
