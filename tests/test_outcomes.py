"""How episodes end, and what logged drivers did."""

import sys

import numpy as np
import pytest
from array_scenes import STEPS, TIMES_S, agent, array_scene, rebuilt, wide_road

import ccdiff_env
from ccdiff_env import planners
from ccdiff_env.errors import ConfigError, DatasetError, MissingFeatureError
from ccdiff_env.planners.ego import save_ego
from ccdiff_env.training.cloning import demonstrations, export_demonstrations
from ccdiff_env.training.outcomes import OUTCOMES, Learning, play_episodes
from ccdiff_env.training.recipe import ROAD, Priced

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
    for steps, said in ((0, "at least 1"), (-1, "at least 1"), (51, "that last two decisions")):
        with pytest.raises(ConfigError, match=f"decision_steps is {steps}, expected .*{said}"):
            demonstrations([scene], 8, decision_steps=steps, dynamics="unicycle")
    assert len(demonstrations([scene], 8, decision_steps=40, dynamics="unicycle")[0]) == 8
    assert len(TIMES_S) == STEPS


@pytest.mark.parametrize(("driver", "traffic"), [("replay", "replay"), ("pdm", "idm")])
def test_an_exported_episode_is_repeated_by_its_seed_and_its_actions(driver, traffic, tmp_path):
    minari = pytest.importorskip("minari")
    given = {"episodes": 3, "seed": 5, "traffic": traffic, "ego": "any"}
    folder = export_demonstrations("embedded/val", driver, tmp_path / "shown", **given)
    found = minari.MinariDataset(folder)
    env = found.recover_environment()
    about = list(found.storage.get_episode_metadata(range(3)))
    assert [of["seed"] for of in about] == [5, 6, 7]
    for episode, of in zip(found.iterate_episodes(), about, strict=True):
        obs, info = env.reset(seed=int(of["seed"]), options=of["options"])
        steps = [(obs, *env.step(action)) for action in episode.actions]
        seen, rewards, *ends, _ = map(list, zip(*[step[1:] for step in steps], strict=True))
        np.testing.assert_array_equal([obs, *seen], episode.observations)
        np.testing.assert_array_equal(rewards, episode.rewards)
        np.testing.assert_array_equal(ends, [episode.terminations, episode.truncations])
        assert np.abs(episode.actions).max() <= 1.0
        assert info["scene"] == of["options"]["scene"]


def test_what_cannot_be_exported_is_refused(tmp_path, monkeypatch):
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "minari", None)
        with pytest.raises(MissingFeatureError, match=r"\[minari\]"):
            export_demonstrations("embedded/val", "replay", tmp_path / "shown")
    pytest.importorskip("minari")
    for driver, episodes, fault in (("idm", 1, "driver is 'idm'"), ("pdm", 0, "episodes is 0")):
        with pytest.raises(ConfigError, match=fault):
            export_demonstrations("embedded/val", driver, tmp_path / "shown", episodes=episodes)
    (tmp_path / "note").touch()
    with pytest.raises(DatasetError, match="not empty"):
        export_demonstrations("embedded/val", "pdm", tmp_path)


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


def test_a_clone_does_what_was_shown_and_its_file_drives_as_it_does(monkeypatch, tmp_path):
    stable_baselines3 = pytest.importorskip("stable_baselines3")

    from ccdiff_env.envs import sb3
    from ccdiff_env.training import ego_network
    from ccdiff_env.training.sb3 import PPO_SETTINGS, SetPolicy, clone

    monkeypatch.setattr(ego_network, "CLONE_STEPS", 150)
    env = sb3.SB3VecEnv(worlds(array_scene(STEADY)))
    model = stable_baselines3.PPO(SetPolicy, env, seed=0, **PPO_SETTINGS)
    rng = np.random.default_rng(0)
    obs = rng.normal(2.0, 3.0, (4_000, env.observation_space.shape[0])).astype(np.float32)
    actions = np.tanh(0.1 * obs[:, :2] - 0.2)
    before = model.policy.agent.log_std.detach().clone()
    clone(model, obs, actions)
    done = model.predict(obs, deterministic=True)[0]
    assert np.abs(done - actions).mean() < 0.5 * np.abs(actions - actions.mean(axis=0)).mean()
    assert (model.policy.agent.log_std.detach() == before).all()
    sb3.save_policy(model, tmp_path / "clone.zip")
    np.testing.assert_array_equal(planners.load(tmp_path / "clone.zip").act(obs), done)
    bare = stable_baselines3.PPO("MlpPolicy", env, device="cpu")
    with pytest.raises(ConfigError, match="expected SetPolicy"):
        clone(bare, obs, actions)


def test_the_set_policy_refuses_what_it_cannot_see():
    stable_baselines3 = pytest.importorskip("stable_baselines3")

    from ccdiff_env.envs import sb3
    from ccdiff_env.training.sb3 import PPO_SETTINGS, SetPolicy

    env = sb3.SB3VecEnv(worlds(array_scene(STEADY)))
    narrow = {"policy_kwargs": {"noise": (0.2,)}}
    with pytest.raises(ConfigError, match="actions 2 wide, expected 'flat' and 1"):
        stable_baselines3.PPO(SetPolicy, env, **PPO_SETTINGS | narrow)
    env = sb3.SB3VecEnv(worlds(array_scene(STEADY), observation="dict"))
    with pytest.raises(ConfigError, match="observations are 'dict'"):
        stable_baselines3.PPO(SetPolicy, env, **PPO_SETTINGS)


def test_noise_goes_on_from_one_decision_to_the_next():
    torch = pytest.importorskip("torch")
    from ccdiff_env.training.ego_network import Agent
    from ccdiff_env.training.recipe import CORRELATION

    torch.manual_seed(0)
    layout = worlds(array_scene(STEADY)).worlds.layout
    agent, noise = Agent(layout, (0.3, 0.1)), torch.randn(20_000, 2)
    with torch.no_grad():
        first, second = (agent.noisy(torch.zeros(20_000, 2), noise) for _ in range(2))
    assert second.std(0).tolist() == pytest.approx([0.3, 0.1], rel=0.03)
    share = (first * second).mean(0) / (first**2).mean(0)
    assert share.tolist() == pytest.approx([CORRELATION] * 2, abs=0.03)
    with torch.no_grad():
        agent.log_std.fill_(-9.0)
    agent.calm((0.3, 0.1), 0.5)
    assert agent.log_std.exp().tolist() == pytest.approx([0.15, 0.05])


@pytest.mark.parametrize("by_speed", [False, True])
def test_prices_are_charged_for_close_calls_faults_and_jerks(by_speed):
    scene = array_scene(STEADY, agent("other", 80.0))
    bare, priced = worlds(scene), Priced(worlds(scene), by_speed=by_speed)
    seen = [env.reset(seed=0)[0] for env in (bare, priced)]
    np.testing.assert_array_equal(*seen)
    close = 0
    for step in range(99):
        # steady; once braking with 4 m/s², and a jerk of at least 6 m/s³ before and after
        action = np.array([[-0.5 if step == 3 else 0.0, 0.0]], np.float32)
        _, reward, terminated, _, infos = bare.step(action)
        charged = priced.step(action)[1] - reward
        if terminated[0]:
            break
        wanted = -0.3 * np.clip((1.6 - infos["ttc"][0]) / 0.6, 0.0, 1.0)
        speed_mps = float(infos["speed"][0])
        wanted *= min(speed_mps / 4.0, 2.0) if by_speed else 1.0
        close += wanted < 0.0
        wanted -= 0.1 * (step in (3, 4)) + 0.1 * (step == 3)
        assert charged[0] == pytest.approx(wanted, abs=2e-3), step
    assert close > 5
    assert infos["final_info"]["metrics"]["at_fault"][0] == 1.0
    times = 0.5 + speed_mps / 5.0 if by_speed else 1.0
    assert charged[0] == pytest.approx(-6.0 * times, abs=1e-3)
    with pytest.raises(ConfigError, match="flat observations with rows of agents"):
        Priced(worlds(scene, observation="dict"))


def in_a_mirror(scene):
    """The scene with left and right exchanged, by its arrays."""
    log, turn = scene.tracks(), np.array([1.0, -1.0], np.float32)

    def turned(value):
        if isinstance(value, dict):
            return {name: turned(part) for name, part in value.items()}
        if isinstance(value, list):
            return [turned(part) for part in value]
        is_points = isinstance(value, np.ndarray) and value.ndim == 2 and value.shape[1] == 2
        return value * turn if is_points else value

    moved = {name: log[name] * turn for name in ("position", "velocity")}
    layers = turned(scene.map_layers())
    return rebuilt(scene, **moved, heading=-log["heading"], map_layers=layers, mend=False)


@pytest.mark.parametrize("even", [False, True])
def test_an_even_policy_drives_in_a_mirror_as_it_does_without(even, scenes, tmp_path):
    torch = pytest.importorskip("torch")
    from ccdiff_env.training.ego_network import Agent, reflection

    scene = scenes["left-turn-04"]
    sees = {"ego_columns": ["default", *ROAD], "agent_columns": ["default", "yaw_rate"]}
    fitting = {"dynamics": "unicycle", "decision_steps": 3, "observation": sees}
    given = {"traffic": "idm", "terminate_at_goal": False, **fitting}
    plain, mirrored = (
        ccdiff_env.make_vec(1, scenes=s, **given) for s in (scene, in_a_mirror(scene))
    )
    layout = plain.worlds.layout
    torch.manual_seed(0)
    made = Agent(layout, (0.2, 0.1), even=even)
    torch.nn.init.normal_(made.policy[-1].weight, std=0.3)
    here, there = plain.reset(seed=0)[0], mirrored.reset(seed=0)[0]
    made.see(torch.from_numpy(here))
    save_ego(tmp_path / "ego.safetensors", made.tensors(), fitting, {})
    policy = planners.load(tmp_path / "ego.safetensors")
    places, signs = reflection(layout)
    random, sides, differences = np.random.default_rng(0), np.array([1.0, -1.0]), []
    for _ in range(30):
        np.testing.assert_allclose(here[:, places] * signs.numpy(), there, atol=2e-3)
        np.testing.assert_allclose(policy.act(here), made.act(here), atol=1e-5)
        differences.append(np.abs(policy.act(here) - policy.act(there) * sides).max())
        action = random.uniform([-0.3, -0.1], [0.6, 0.1], (1, 2)).astype(np.float32)
        here, there = plain.step(action)[0], mirrored.step(action * sides)[0]
    assert max(differences) < 0.01 if even else max(differences) > 0.1
    if even:
        tensors = {**policy.tensors, "mirror": np.full(layout.size, 1.5, np.float32)}
        tensors["var"] = tensors.pop("std") ** 2
        save_ego(tmp_path / "bad.safetensors", tensors, fitting, {})
        with pytest.raises(DatasetError, match=r"mirror.* 1\.5, expected a place, 1 to"):
            planners.load(tmp_path / "bad.safetensors")
