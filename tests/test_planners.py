"""Planners of every kind in the ego's seat: what they are given, what is refused, in one line."""

import copy
import functools
import json
from typing import ClassVar

import numpy as np
import pytest
import torch
from array_scenes import played
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize

import ccdiff_env
from ccdiff_env import EgoVectorEnv, WorldConfig
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.tape import Recorded
from ccdiff_env.config import BicycleLimits, ObservationConfig
from ccdiff_env.envs.sb3 import SB3VecEnv, save_policy
from ccdiff_env.errors import ConfigError, ShapeError
from ccdiff_env.planners import SHIPPED, load
from ccdiff_env.planners.built_in import BUILT_IN, ego_driver
from ccdiff_env.view import page_html
from ccdiff_env.view.sources import play_scene
from ccdiff_env.worlds import Worlds
from ccdiff_env_cli import main

REPLAY = TRAFFIC["replay"]


NUM_SCENES = 2


def trained(scenes, algorithm=PPO, policy="MlpPolicy", wrap=lambda env: env, **options):
    env = ccdiff_env.make_vec(2, scenes=scenes, autoreset_mode="same_step", **options)
    model = algorithm(policy, wrap(SB3VecEnv(env)), n_steps=8, batch_size=8, seed=0)
    return model.learn(16)


def test_an_ego_decides_on_what_the_step_wrote_or_on_what_was_restored(scenes, monkeypatch):
    seen, observed, observe = [], [], Worlds.observe
    monkeypatch.setattr(Worlds, "observe", lambda self, i: observed.append(i) or observe(self, i))

    def straight_on(obs):
        seen.append(obs.copy())
        return np.zeros((len(obs), 2))

    env = ccdiff_env.make_vec(2, scenes=scenes, traffic="idm", driver=straight_on)
    obs, _ = env.reset(seed=3)
    for _ in range(5):
        given = obs.copy()
        obs[:] = 0.0  # callers may change their arrays
        obs = env.step(np.zeros((2, 2)))[0]
        assert np.array_equal(seen[-1], given)
    assert not observed
    kept, there = env.snapshot(0), obs[0].copy()
    env.step(np.zeros((2, 2)))
    env.restore(0, kept)
    env.step(np.zeros((2, 2)))
    assert np.array_equal(seen[-1][0], there)


class Bicycle:
    env_options: ClassVar = {"dynamics": "bicycle", "decision_steps": 5}

    def __init__(self):
        self.calls = 0

    def __call__(self, obs):
        self.calls += 1
        return np.full((len(obs), 2), 0.1)


def test_a_planner_names_the_options_it_needs_and_its_actions_are_held(scenes):
    planner = Bicycle()
    rows, rollouts = drive(scenes, planner, REPLAY, record=scenes.names)
    steps = max(rollout.num_steps for rollout in rollouts.values())
    assert len(rows) == 2
    assert abs(planner.calls - steps / 5) <= 2
    config = rollouts[scenes[0].name].meta["config"]
    assert config["action"]["dynamics"].keys() == {"bicycle"}


class Sees:
    """Keeps what it was given first, and which episodes began."""

    def __init__(self, form, options):
        self.observation, self.env_options, self.first, self.began = form, options, None, set()

    def reset(self, worlds, indices):
        self.began |= {*indices}

    def __call__(self, obs):
        self.first = copy.deepcopy(obs) if self.first is None else self.first
        return np.zeros((2, 2))


def test_a_class_is_made_with_the_worlds_and_told_of_episodes(scenes):
    made = []

    class Made(Sees):
        def __init__(self, worlds):
            super().__init__("dict", {})
            made.append((self, worlds.num_worlds))

    drive(scenes, Made, REPLAY)
    assert all(planner.began == set(range(num_worlds)) for planner, num_worlds in made)


@pytest.mark.parametrize(
    ("form", "options"),
    [("flat", {}), ("dict", {}), ("dict", {"bev": {"size_px": 32}}), ("bev", {})],
)
def test_a_planner_is_given_what_an_environment_gives_in_that_form(scenes, form, options):
    planner = Sees(form, options)
    drive(scenes, planner, REPLAY)
    world = PROTOCOL.world(None, "", scenes[0].dt)
    config = world.with_options(traffic="replay", driver="external", **options)
    env = ccdiff_env.make_vec(2, scenes=scenes, config=config, observation=form)
    expected, _ = env.reset(seed=[0, 0], options={"scene": [0, 1]})
    if form != "dict":
        planner.first, expected = {form: planner.first}, {form: expected}
    assert planner.first.keys() == expected.keys()
    for name, array in expected.items():
        assert planner.first[name].dtype == array.dtype
        assert np.array_equal(planner.first[name], array), name


class Ahead:
    """Goes straight on at its speed: trajectories, or the actions that follow them."""

    def __init__(self, worlds):
        self.native = worlds.native

    def __call__(self, obs):
        found = []
        for i in range(self.native.num_worlds):
            states, ego = self.native.states(i), self.native.slot_agents(i)[0]
            heading = states["heading"][ego]
            way = 0.1 * np.arange(1, 9)[:, None] * states["speed"][ego]
            places = states["position"][ego] + way * [np.cos(heading), np.sin(heading)]
            found.append(np.column_stack([places, np.full(8, heading)]))
        return np.stack(found)


class AheadOfItself(Ahead):
    """The same in its own frame."""

    frame = "ego"

    def __call__(self, obs):
        found = np.zeros((self.native.num_worlds, 8, 3))
        for i in range(self.native.num_worlds):
            speed = self.native.states(i)["speed"][self.native.slot_agents(i)[0]]
            found[i, :, 0] = 0.1 * np.arange(1, 9) * speed
        return found


def test_trajectories_are_followed_and_their_actions_kept(scenes):
    rows, rollouts = drive(scenes, Ahead, REPLAY, record=scenes.names)
    assert rows == drive(scenes, Recorded(rows), REPLAY)[0]
    own = drive(scenes, AheadOfItself, REPLAY, record=scenes.names)[1]
    for name, rollout in rollouts.items():
        np.testing.assert_allclose(own[name].position, rollout.position, atol=1e-2)
    for rollout in rollouts.values():
        heading = rollout.heading[rollout.agent_ids.index("ego")][-rollout.num_steps :]
        assert np.abs(np.diff(heading)).max() < 1e-3
    Ahead.env_options = {"dynamics": "bicycle"}
    try:
        with pytest.raises(ConfigError, match="a tracker needs continuous actions of the unicycle"):
            drive(scenes, Ahead, REPLAY)
    finally:
        del Ahead.env_options


@pytest.mark.parametrize("name", [*BUILT_IN, *SHIPPED, "test_planners:Bicycle"])
def test_pages_and_adversaries_take_every_planner(scenes, name):
    rollout = play_scene(scenes[0], traffic="idm", driver=name)
    assert rollout.meta["planner"] == name
    assert len(page_html(rollout)) > 50_000
    env = ccdiff_env.AdversarySelectionEnv(scenes=scenes, ego=name)
    env.reset(seed=0)
    assert env.step(env.action_space.sample())[4] is not None


OF_THE_WORLD = ("idm", "replay", "constant_velocity")


@pytest.mark.parametrize("name", [*OF_THE_WORLD, *BUILT_IN, *SHIPPED, "test_planners:Bicycle"])
def test_environments_take_every_planner_as_driver(scenes, name):
    """Egos go where they do in a page, alone and in vectors; given actions do nothing."""
    rollout = play_scene(scenes[0], traffic="idm", driver=name, seed=3)
    path = rollout.position[rollout.agent_ids.index("ego")][-rollout.num_steps :]
    options = {"scenes": scenes[:1], "traffic": "idm", "driver": name}
    env = ccdiff_env.EgoEnv(**options)
    ones = np.ones(env.action_space.shape)
    way = [states["position"][0] for _, states, _ in played(env, ones, seed=3)]
    assert np.array_equal(way[:-1], path[1 : len(way)])
    if name in ("pdm", "lane_idm"):  # who keep nothing from before
        env.reset(seed=3)
        for _ in range(10):
            env.step(ones)
        copy_of = env.fork()
        for one in (env, copy_of):
            one.step(ones)
        assert copy_of.worlds.native.digest(0) == env.worlds.native.digest(0)
    vector = ccdiff_env.make_vec(2, autoreset_mode="same_step", **options)
    vector.reset(seed=[3, 4])
    for step in range(len(path) + 5):  # worlds that restarted are driven, too
        assert np.isfinite(vector.step([ones, ones])[1]).all()
        if step < 10:  # networks round by the size of the batch
            at = vector.worlds.native.states(0)["position"][0]
            assert np.allclose(at, path[step + 1], rtol=0.0, atol=1e-2 * (name in SHIPPED))


def test_misspelt_planners_are_guessed_everywhere(scenes, tmp_path, capsys):
    for make in (
        lambda: ccdiff_env.EgoEnv(scenes=scenes, driver="pdmm"),
        lambda: ccdiff_env.make_vec(2, scenes=scenes, driver="pdmm"),
        lambda: ccdiff_env.AdversarySelectionEnv(scenes=scenes, ego="pdmm"),
        lambda: play_scene(scenes[0], driver="pdmm"),
        lambda: drive(scenes, "pdmm", REPLAY),
    ):
        with pytest.raises(ConfigError, match=r"'pdmm'; did you mean 'pdm'\?"):
            make()
    for words in (
        ["view", scenes[0].name, "--traffic", "idm", "--driver", "pdmm"],
        ["bench", "planners", "--planners", "pdmm", "--out", str(tmp_path / "b")],
    ):
        assert main(words) == 2
        assert "did you mean 'pdm'?" in capsys.readouterr().err
    assert main([*words[:3], "pdm", *words[4:], "--traffic", ""]) == 2
    assert "traffic ''" in capsys.readouterr().err


class Short:
    """Looks less far ahead than to its next decision."""

    env_options: ClassVar = {"decision_steps": 5}

    def __call__(self, obs):
        return np.zeros((2, 3, 3))


@pytest.mark.parametrize(
    ("planner", "error", "words"),
    [
        (lambda obs: np.zeros(2), ShapeError, r"lambda.*\[2\] for 2 worlds, expected.*\[2, 2\]"),
        (lambda obs: np.full((2, 2), np.nan), ShapeError, "lambda.*not finite"),
        (lambda obs: np.full((2, 20, 3), np.nan), ShapeError, "lambda.*not finite"),
        (lambda obs: np.full((2, 20, 3), None), ShapeError, "lambda.*returned object"),
        (lambda obs: np.full((2, 2), 4.0), UserWarning, r"lambda.*4: actions beyond \[-1, 1\]"),
        (lambda obs: "left", ShapeError, "lambda"),
        (lambda obs: np.zeros((2, 5, 4)), ShapeError, r"lambda.*or trajectories \[2, T, 3\]"),
        (lambda obs: np.zeros((2, 0, 3)), ShapeError, "lambda.*returned trajectories"),
        (Short, ShapeError, r"Short.*of 3 poses, expected 5 \(decision_steps\)"),
        (3, ConfigError, "int cannot be called"),
        ("robot", ConfigError, "robot"),
    ],
)
def test_mistakes_name_the_planner(scenes, planner, error, words):
    with pytest.raises(error, match=words):
        drive(scenes, planner, REPLAY)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"dynamics": "bicycle"},
        {"discrete": True},
        {"decision_steps": 5},
        {"config": WorldConfig(observation=ObservationConfig(num_neighbors=4))},
        {"policy": "MultiInputPolicy", "observation": "dict"},
        {"policy": "CnnPolicy", "observation": "bev", "bev": {"size_px": 36}},
        {"algorithm": RecurrentPPO, "policy": "MlpLstmPolicy"},
    ],
    ids=lambda options: "-".join(map(str, options)) or "default",
)
def test_policies_are_driven_as_they_were_trained(scenes, tmp_path, options):
    trained(scenes, **options).save(tmp_path / "ego.zip")
    config = load(tmp_path / "ego.zip").config
    rows, rollouts = drive(scenes, str(tmp_path / "ego.zip"), REPLAY, record=scenes.names[:1])
    assert len(rows) == 2
    played_in = rollouts[scenes[0].name].meta["config"]
    for name in ("action", "observation"):
        assert played_in[name] == json.loads(config.to_json())[name]


@pytest.mark.parametrize("steps", [1, 3])
def test_a_page_shows_a_policy_of_a_file(scenes, tmp_path, steps):
    file = tmp_path / "ego.zip"
    trained(scenes, decision_steps=steps, dynamics="bicycle").save(file)
    rollout = play_scene(scenes[0], traffic="idm", driver=str(file))
    planned = drive(scenes[:1], str(file), TRAFFIC["idm"], record=scenes.names[:1])[1]
    same = slice(None, rollout.num_steps - 1)
    paths = [r.position[0, same] for r in (rollout, planned[scenes[0].name])]
    assert np.array_equal(*paths, equal_nan=True)
    page = tmp_path / "page.html"
    words = ["--traffic", "idm", "--driver", str(file), "-o", str(page)]
    assert main(["view", scenes[0].name, *words]) == 0
    assert page.stat().st_size > 50_000


def test_a_bicycle_policy_is_no_unicycle(scenes, tmp_path):
    trained(scenes, dynamics="bicycle").save(tmp_path / "ego.zip")
    with pytest.raises(ConfigError, match=r'dynamics = "bicycle", the worlds have "unicycle"'):
        drive(scenes, str(tmp_path / "ego.zip"), REPLAY, options={"dynamics": "unicycle"})
    chosen = {"scenes": scenes, "ego": tmp_path / "ego.zip"}
    env = ccdiff_env.AdversarySelectionEnv(**chosen, dynamics="unicycle")
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="bicycle"):
        env.step(0)
    fitting = ccdiff_env.AdversarySelectionEnv(**chosen)
    fitting.reset(seed=0)
    assert isinstance(fitting.worlds.config.action.dynamics, BicycleLimits)


def of_rows(scenes, model=None):
    """Worlds for learners, under the statistics of a model."""
    env = SB3VecEnv(ccdiff_env.make_vec(2, scenes=scenes, horizon_steps=20))
    env.seed(7)
    if model is None:
        return env
    norm = VecNormalize(env, training=False, norm_reward=False)
    norm.obs_rms = model.get_vec_normalize_env().obs_rms
    return norm


def test_normalised_observations_are_not_forgotten(scenes, tmp_path):
    model = trained(scenes, wrap=VecNormalize)
    model.save(tmp_path / "bare.zip")
    with pytest.raises(ConfigError, match=r"VecNormalize.*save_policy"):
        load(tmp_path / "bare.zip")
    save_policy(model, tmp_path / "whole.zip")
    policy = load(tmp_path / "whole.zip")
    env = ccdiff_env.make_vec(2, scenes=scenes)
    obs, _ = env.reset(seed=5)
    normalised = model.get_vec_normalize_env().normalize_obs(obs)
    expected = model.predict(normalised, deterministic=True)[0]
    np.testing.assert_allclose(policy.act(obs), expected, atol=1e-5)
    np.testing.assert_allclose(policy.predict(obs)[0], expected, atol=1e-5)
    np.testing.assert_allclose(ego_driver(policy)[1](obs), expected, atol=1e-5)
    # as the algorithm in the worlds that it was trained in
    rates = [
        evaluate_policy(one, env, n_eval_episodes=4, warn=False)
        for one, env in ((model, of_rows(scenes, model)), (policy, of_rows(scenes)))
    ]
    assert rates[0] == pytest.approx(rates[1], abs=1e-4)
    assert not hasattr(model, "ccdiff_env_statistics")
    # policies that say nothing are refused
    del model.observation_space.ccdiff_env
    model.save(tmp_path / "old.zip")
    with pytest.raises(ConfigError, match="the policy does not say what it was trained in"):
        save_policy(model, tmp_path / "none.zip")
    with pytest.raises(ConfigError, match=r"old\.zip does not say what it was trained in"):
        load(tmp_path / "old.zip")


def test_torch_has_one_thread_unless_told_otherwise(scenes):
    worlds, before = EgoVectorEnv(2, scenes=scenes), torch.get_num_threads()
    try:
        for threads, found in ((3, 3), (None, 3), (1, 1)):
            SB3VecEnv(worlds, torch_threads=threads)
            assert torch.get_num_threads() == found
        torch.set_num_threads(3)
        SB3VecEnv(worlds)
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(before)


def test_what_cannot_be_driven_is_refused_when_it_is_saved(scenes, tmp_path):
    file = tmp_path / "ego.zip"
    raster = {"observation": "bev", "bev": {"size_px": 36}}
    parts = {"observation": "dict", "policy": "MultiInputPolicy"}
    of_ego = functools.partial(VecNormalize, norm_obs_keys=["ego"])
    for options, words in (
        ({"wrap": lambda env: VecFrameStack(env, 2)}, "a wrapper that changes observations"),
        ({"wrap": VecNormalize, **raster}, "a wrapper that changes observations"),
        ({"wrap": of_ego, **parts}, "observation is 'dict', expected 'flat'"),
    ):
        with pytest.raises(ConfigError, match=words):
            save_policy(trained(scenes, **options), file)
    model = trained(scenes)
    model.policy_class = type("Own", (), {"__module__": "mine.nets"})
    with pytest.raises(ConfigError, match=r"mine\.nets cannot be driven, expected one of A2C.*TQC"):
        save_policy(model, file)
    assert not file.exists()


def test_actors_of_tqc_are_driven_and_traffic_names_the_files_that_it_takes(scenes, tmp_path):
    env = SB3VecEnv(ccdiff_env.make_vec(2, scenes=scenes, horizon_steps=20))
    settings = {"learning_starts": 8, "batch_size": 8, "policy_kwargs": {"net_arch": [8]}}
    model = TQC("MlpPolicy", VecNormalize(env, norm_reward=False), seed=0, **settings).learn(32)
    save_policy(model, tmp_path / "tqc.zip")
    assert len(drive(scenes, str(tmp_path / "tqc.zip"), REPLAY)[0]) == len(scenes)
    with pytest.raises(ConfigError, match=r"tqc.zip' is one of stable-baselines3, expected ego,"):
        ccdiff_env.make_vec(1, traffic="egos", egos={"policy": str(tmp_path / "tqc.zip")})
