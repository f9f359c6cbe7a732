"""The single environment: Gymnasium's contract, options, hostile input, pictures."""

import re
import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from array_scenes import begun, played
from gymnasium.utils.env_checker import check_env
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import ccdiff_env
from ccdiff_env import EgoEnv, embedded_scenes
from ccdiff_env.config import BevConfig, ObservationConfig, WorldConfig
from ccdiff_env.errors import (
    ActionError,
    CcdiffError,
    ConfigError,
    SceneError,
    ShapeError,
    UnknownNameError,
)
from ccdiff_env.scenes.map_queries import road_distance

ID = "ccdiff_env/Ego-v0"
TASKS = (Path(__file__).parents[1] / "docs/tasks.md").read_text("utf-8")
FORMS = [
    {},
    {"observation": "dict"},
    {"discrete": True},
    {"observation": "dict", "discrete": True, "dynamics": "bicycle", "traffic": "idm"},
    {"dynamics": "delta_pose", "info": "end"},
    {"observation": "bev"},
    {"observation": "dict", "bev": {}, "traffic": "idm"},
]


@pytest.mark.filterwarnings("error", "ignore:pkg_resources is deprecated")
@pytest.mark.parametrize("form", FORMS, ids=str)
def test_gymnasium_checker_passes_without_warnings(form, scenes):
    env = gymnasium.make(ID, scenes=scenes, render_mode="rgb_array", **form)
    check_env(env.unwrapped)


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_stable_baselines3_checker_passes_without_warnings(form, scenes):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # rows of agents and of map pieces are tables: the checker would rather see them flat
        warnings.filterwarnings("ignore", message=".*has an unconventional shape")
        checker.check_env(EgoEnv(scenes=scenes, **form), warn=True)


def test_make_gives_the_env_and_its_spec_makes_another():
    env = gymnasium.make(ID, traffic="idm")
    assert isinstance(env.unwrapped, EgoEnv)
    again = gymnasium.make(env.spec)
    assert again.unwrapped.config == env.unwrapped.config
    assert env.unwrapped.scenes.names == embedded_scenes("train").names


def test_dict_and_flat_observations_hold_the_same_numbers(scenes):
    flat, parts = EgoEnv(scenes=scenes), EgoEnv(scenes=scenes, observation="dict")
    row, _ = flat.reset(seed=3)
    entries, _ = parts.reset(seed=3)
    assert np.array_equal(row, np.concatenate([entries[k].ravel() for k in entries]))
    assert entries["agents_mask"].dtype == np.int8
    assert not entries["agents"][entries["agents_mask"] == 0].any()


def test_every_step_returns_arrays_of_its_own(scenes):
    env = EgoEnv(scenes=scenes)
    obs, _ = env.reset(seed=0)
    kept = obs.copy()
    later = [env.step(np.zeros(2, np.float32))[0] for _ in range(3)]
    assert np.array_equal(obs, kept)
    later[0][:] = 9.0
    assert not np.shares_memory(later[0], later[1])
    assert later[1].max() <= 1.0


def test_unseeded_environments_differ_and_can_be_repeated_by_the_seed_in_info(scenes):
    infos = [EgoEnv(scenes=scenes).reset()[1] for _ in range(3)]
    assert len({info["seed"] for info in infos}) == 3
    env = EgoEnv(scenes=scenes)
    assert env.reset(seed=infos[0]["seed"])[1] == infos[0]
    for seed in (1.5, "one", [1]):
        with pytest.raises(ConfigError, match="seed"):
            env.reset(seed=seed)


def test_scenes_are_chosen_by_name_or_index(scenes):
    env = EgoEnv(scenes=scenes)
    assert env.reset(options={"scene": scenes.names[2]})[1]["scene"] == scenes.names[2]
    assert env.reset(options={"scene": 1})[1]["scene_token"] == scenes[1].token
    assert env.scene == scenes[1]
    for missing in ("nowhere", len(scenes), -1, 10**30):
        with pytest.raises(UnknownNameError):
            env.reset(options={"scene": missing})
    for wrong in (1.5, True, ["a"]):
        with pytest.raises(ConfigError):
            env.reset(options={"scene": wrong})
    with pytest.raises(ConfigError, match="did you mean 'scene'"):
        env.reset(options={"scenes": 1})


def test_sequential_order_plays_every_scene_once_a_round(scenes):
    env = EgoEnv(scenes=scenes, scene_order="sequential")
    names = [env.reset(seed=0)[1]["scene"]] + [env.reset()[1]["scene"] for _ in scenes]
    assert names == [*scenes.names, scenes.names[0]]


def test_scenes_come_as_set_list_single_scene_or_split(scenes):
    for form in (scenes, list(scenes), "val"):
        assert EgoEnv(scenes=form).scenes.names == scenes.names
    assert EgoEnv(scenes=scenes[0]).scenes.names == (scenes[0].name,)
    for wrong in ([], [1], 7):
        with pytest.raises((ConfigError, TypeError)):
            EgoEnv(scenes=wrong)
    with pytest.raises(ConfigError, match="no source 'nowhere'"):
        EgoEnv(scenes="nowhere")


def test_metrics_at_the_end_sum_up_the_steps(scenes):
    env = EgoEnv(scenes=scenes, on_off_road="ignore", on_collision="ignore")
    action = np.array([0.1, 0.0], np.float32)
    infos = [info for *_, info in played(env, action, seed=2, options={"scene": 0})]
    assert ["metrics" in info for info in infos] == [False] * (len(infos) - 1) + [True]
    metrics = infos[-1]["metrics"]
    assert metrics["length"] == len(infos)
    assert metrics["return"] == pytest.approx(sum(info["reward"] for info in infos))
    assert metrics["min_ttc"] == min(i["ttc"] for i in infos)
    assert metrics["mean_speed"] == pytest.approx(np.mean([i["speed"] for i in infos]))
    events = ("collision", "at_fault", "off_road", "wrong_way", "goal_reached")
    for name in events:
        assert metrics[name] == max(i[name] > 0 for i in infos)
    for name in ("progress", "route_completion", "is_success"):
        assert metrics[name] == infos[-1][name]
    said = re.search(r'`info\["metrics"\]` has (.+) and 1 for (.+) that ever happened', TASKS)
    assert set(re.findall(r"`(\w+)`", said[2])) == set(events)
    named = {name for name in metrics if not name.startswith("reward_")}
    assert set(re.findall(r"`(\w+)`", said[0])) == named


@pytest.mark.parametrize(("level", "keys"), [("none", 0), ("end", 0), ("full", None)])
def test_info_levels(level, keys, scenes):
    env = EgoEnv(scenes=scenes, info=level)
    _, info = env.reset(seed=0)
    # without strings, for tools that make tensors of all there is
    names = set() if level == "none" else {"scene", "scene_token"}
    assert set(info) == {"scene_idx", "seed", "episode_idx", "start_step"} | names
    expected = len(env.unwrapped.worlds.columns) if keys is None else keys
    assert len(env.step(np.zeros(2, np.float32))[4]) == expected


@pytest.mark.parametrize(
    ("action", "error"),
    [
        (np.zeros(3, np.float32), ShapeError),
        (np.zeros((1, 2), np.float32), ShapeError),
        (0.0, ShapeError),
        ([[0.0], [1.0, 2.0]], CcdiffError),
        (np.array([np.nan, 0.0]), ActionError),
        (np.array([np.inf, 0.0], np.float32), ActionError),
        (np.array([1e300, 0.0]), ActionError),
        (["a", "b"], ActionError),
        ("left", CcdiffError),
        (None, CcdiffError),
        ([None, None], ActionError),
        (np.array([1j, 0]), ActionError),
        (np.array([True, False]), ActionError),
        ({"a": 1}, CcdiffError),
    ],
)
def test_hostile_actions_are_refused_and_change_nothing(action, error, scenes):
    env = begun(scenes=scenes)
    before = env.worlds.native.digest(0)
    with pytest.raises(error):
        env.step(action)
    assert env.worlds.native.digest(0) == before
    env.step(np.zeros(2, np.float32))


@pytest.mark.parametrize("action", [-1, 63, 10**12, 0.5, 1.0, np.nan, "a", None, [1], True])
def test_hostile_indices_are_refused(action, scenes):
    env = begun(scenes=scenes, discrete=True)
    assert env.action_space == gymnasium.spaces.Discrete(63)
    with pytest.raises(CcdiffError):
        env.step(action)
    with pytest.raises(ActionError, match="63, expected an index of the action grid, 0 to 62"):
        env.step(63)
    for good in (0, np.int64(62), np.array(3), np.uint8(7)):
        env.step(good)


def test_actions_of_any_real_dtype_and_layout_are_taken(scenes):
    single, wide = np.full(2, 0.5, np.float32), np.full((2, 4), 0.5, np.float32)
    read_only = single.copy()
    read_only.flags.writeable = False
    env, digests = EgoEnv(scenes=scenes), set()
    for action in (
        single,
        read_only,
        wide[0, ::2],
        single.astype("f8"),
        single.astype("f2"),
        [0.5, 0.5],
    ):
        env.reset(seed=4)
        env.step(action)
        digests.add(env.worlds.native.digest(0))
    assert len(digests) == 1


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"traffic": "external"}, ConfigError),
        ({"driver": "me"}, ConfigError),
        ({"controlled": "vehicles"}, ConfigError),
        ({"observation": "image"}, ConfigError),
        ({"info": "all"}, ConfigError),
        ({"render_mode": "ansi"}, ConfigError),
        ({"render_options": {"zoom": 2}}, ConfigError),
        ({"history_steps": 10**4}, SceneError),
        ({"dt_s": 0.2}, SceneError),
        ({"scenes": ""}, ConfigError),
        ({"scenes": 3}, ConfigError),
        ({"scenes": [3]}, ConfigError),
    ],
)
def test_wrong_options_are_refused(options, error, scenes):
    with pytest.raises(error):
        EgoEnv(**{"scenes": scenes, **options})


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_random_calls_never_crash(data, scenes):
    env = EgoEnv(scenes=scenes, horizon_steps=20, traffic="idm")
    env.reset(seed=data.draw(st.integers()))
    saved = env.snapshot()
    for _ in range(data.draw(st.integers(1, 12))):
        call = data.draw(st.sampled_from(["step", "step", "step", "reset", "restore", "noise"]))
        try:
            if call == "step":
                numbers = st.floats(width=32, allow_nan=True)
                action = np.array(data.draw(st.lists(numbers, min_size=2, max_size=2)), np.float32)
                obs, reward, *_ = env.step(action)
                assert obs in env.observation_space
                assert np.isfinite(reward)
            elif call == "reset":
                seed = data.draw(st.none() | st.integers())
                assert env.reset(seed=seed)[0] in env.observation_space
            elif call == "restore":
                assert env.restore(saved) in env.observation_space
            else:
                blob = bytearray(saved)
                at = data.draw(st.integers(0, len(blob) - 1))
                blob[at] ^= data.draw(st.integers(1, 255))
                env.restore(bytes(blob))
        except CcdiffError:
            continue


def test_human_mode_opens_a_window(scenes, monkeypatch):
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = begun(scenes=scenes, render_mode="human", render_options={"size": (64, 64)})
    env.step(np.zeros(2, np.float32))
    assert pygame.display.get_caption()[0] == f"ccdiff-env: {env.scene.name}"
    assert env.render() is None
    env.close()
    env.close()


SMALL = {"size_px": 48, "metres_per_px": 0.75}
DRIVABLE = 0  #: Channel of the raster.


def test_forms_and_spaces_of_rasters(scenes):
    alone = EgoEnv(scenes=scenes, observation="bev")
    assert alone.observation_space == gymnasium.spaces.Box(0, 255, (5, 84, 84), np.uint8)
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
def test_drivable_pixels_are_those_whose_centres_are_on_the_road(name, scenes):
    env = EgoEnv(scenes=scenes, observation="bev", bev={"size_px": 100, "metres_per_px": 0.4})
    env.reset(seed=0, options={"scene": name})
    rows, columns = np.mgrid[:100, :100]
    ahead, left = (75 - rows - 0.5) * 0.4, (50 - columns - 0.5) * 0.4
    for _ in range(12):
        obs = env.step(env.expert_action())[0]
        states = env.worlds.native.states(0)
        ego = env.scene.agent_ids.index("ego")
        (x, y), heading = states["position"][ego].astype(float), float(states["heading"][ego])
        x, y = (
            x + ahead * np.cos(heading) - left * np.sin(heading),
            y + ahead * np.sin(heading) + left * np.cos(heading),
        )
        inside_m = road_distance(env.scene, np.stack([x, y], -1).reshape(-1, 2)).reshape(x.shape)
        # the ground has pixels half as wide: no centre is farther off than half their diagonal
        sure = np.abs(inside_m) > 0.1 * np.sqrt(2.0) + 0.01
        assert sure.mean() > 0.9
        assert 0.1 < (inside_m > 0.0).mean() < 0.99
        assert np.array_equal(obs[DRIVABLE][sure] == 255, inside_m[sure] > 0.0)
