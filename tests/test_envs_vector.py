"""The vector environment against Gymnasium's ``SyncVectorEnv`` of single ones, bit for bit."""

import gymnasium
import numpy as np
import pytest
from array_scenes import TIMES_S, agent, log_env, played
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from ccdiff_env import EgoEnv, EgoVectorEnv
from ccdiff_env.envs import as_vector
from ccdiff_env.errors import (
    ConfigError,
    ResetNeededError,
    ShapeError,
    SnapshotError,
    UnknownNameError,
)

ID = "ccdiff_env/Ego-v0"
MODES = list(AutoresetMode)
NUM_ENVS = 5
RULES = {"traffic": "idm", "horizon_steps": 25}  #: Episodes end by themselves and by time.


def assert_same(one, other, path="") -> None:
    """Equal values, in arrays, dictionaries and object arrays."""
    if isinstance(one, dict):
        assert one.keys() == other.keys(), path
        for key in one:
            assert_same(one[key], other[key], f"{path}/{key}")
        return
    one, other = np.asarray(one), np.asarray(other)
    assert one.shape == other.shape, path
    if one.dtype == object:
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            assert (a is None) == (b is None), path
            if a is not None:
                assert_same(a, b, f"{path}[{i}]")
    else:
        assert np.array_equal(one, other), path


def assert_same_infos(one, other) -> None:
    """Infos agree in masks that name a row, and in the values of these."""
    unnamed = {name for name in one.keys() - other.keys() if not one[f"_{name.lstrip('_')}"].any()}
    assert one.keys() - unnamed == other.keys()
    one = {name: one[name] for name in other}
    for key in one:
        if key.startswith("_"):
            assert_same(one[key], other[key], key)
        elif isinstance(one[key], dict):
            assert_same_infos(one[key], other[key])
        else:
            mask = one[f"_{key}"]
            assert_same(np.asarray(one[key])[mask], np.asarray(other[key])[mask], key)


def pair(scenes, mode, **options):
    """The native environment and Gymnasium's, of the same worlds."""
    options = {**RULES, **options}
    native = EgoVectorEnv(NUM_ENVS, scenes=scenes, autoreset_mode=mode, **options)
    singles = [lambda: EgoEnv(scenes=scenes, **options) for _ in range(NUM_ENVS)]
    return native, SyncVectorEnv(singles, autoreset_mode=mode)


def actions_of(native, steps):
    """Random actions, weak in steering so that episodes last."""
    native.action_space.seed(0)
    for _ in range(steps):
        action = native.action_space.sample()
        yield action if action.dtype != np.float32 else action * np.float32([0.8, 0.08])


@pytest.mark.parametrize("seed", [0, -3, 2**64, [5, 1, 2**63 - 1, -9, 0]], ids=str)
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"observation": "dict"},
        {"discrete": True},
        {"info": "end"},
        {"info": "none"},
        {"decision_steps": 3},
    ],
    ids=str,
)
@pytest.mark.parametrize("mode", MODES)
def test_it_is_gymnasiums_vector_of_single_environments(mode, options, seed, scenes):
    native, sync = pair(scenes, mode, **options)
    assert native.single_observation_space == sync.single_observation_space
    assert native.observation_space == sync.observation_space
    assert native.single_action_space == sync.single_action_space
    assert native.action_space == sync.action_space
    (obs, infos), (expected, expected_infos) = native.reset(seed=seed), sync.reset(seed=seed)
    assert_same(obs, expected)
    assert_same_infos(infos, expected_infos)
    ended = 0
    for action in actions_of(native, 60):
        got, want = native.step(action), sync.step(action)
        for one, other in zip(got[:4], want[:4], strict=True):
            assert_same(one, other)
        assert_same_infos(got[4], want[4])
        assert got[0] in native.observation_space
        done = got[2] | got[3]
        ended += done.sum()
        if mode is AutoresetMode.DISABLED and done.any():
            got = native.reset(options={"reset_mask": done.copy()})
            want = sync.reset(options={"reset_mask": done.copy()})
            assert_same(got[0], want[0])
            assert_same_infos(got[1], want[1])
    assert ended > NUM_ENVS


@pytest.mark.parametrize("mode", MODES)
def test_metadata_and_registry(mode):
    env = gymnasium.make_vec(ID, num_envs=3, autoreset_mode=mode, **RULES)
    assert type(env) is EgoVectorEnv
    assert env.metadata["autoreset_mode"] is mode
    assert env.spec.id == ID
    assert EgoVectorEnv.metadata.get("autoreset_mode") is None
    assert gymnasium.make_vec(env.spec).num_envs == 3
    sync = gymnasium.make_vec(ID, num_envs=2, vectorization_mode="sync", **RULES)
    assert isinstance(sync, SyncVectorEnv)


def test_disabled_refuses_to_step_an_ended_world(scenes):
    env = EgoVectorEnv(2, scenes=scenes, horizon_steps=1, autoreset_mode="disabled")
    env.reset(seed=0)
    env.step(np.zeros((2, 2)))
    with pytest.raises(ResetNeededError):
        env.step(np.zeros((2, 2)))
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeededError, match="world 1"):
        env.step(np.zeros((2, 2)))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("copy", [True, False])
def test_active_worlds_run_as_single_ones_while_the_others_rest(mode, copy, scenes):
    env = EgoVectorEnv(3, scenes=scenes, autoreset_mode=mode, copy=copy, **RULES)
    singles = [EgoVectorEnv(1, scenes=scenes, autoreset_mode=mode, **RULES) for _ in range(3)]
    shown = env.reset(seed=5)[0].copy()
    for i, single in enumerate(singles):
        single.reset(seed=5 + i)
    draw, rested = np.random.default_rng(0), 0
    ended = np.zeros(3, bool)
    for action in actions_of(env, 40):
        active = draw.random(3) < 0.6
        if mode is AutoresetMode.DISABLED:
            active &= ~ended
        before = [env.snapshot(i) for i in range(3)]
        obs, reward, terminated, truncated, infos = env.step(action, active=active)
        for i, single in enumerate(singles):
            if active[i]:
                got = single.step(action[i : i + 1])
                assert np.array_equal(obs[i], got[0][0])
                assert (reward[i], terminated[i], truncated[i]) == tuple(
                    part[0] for part in got[1:4]
                )
                assert infos["_speed"][i] == got[4]["_speed"][0]
            else:
                rested += 1
                assert np.array_equal(obs[i], shown[i])
                assert env.snapshot(i) == before[i]
                assert not any(part[i] for part in (reward, terminated, truncated))
                assert not any(infos[name][i] for name in infos if name.startswith("_"))
        ended |= terminated | truncated
        shown = obs.copy()
    assert rested > 20
    assert ended.any()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("copy", [True, False])
def test_partial_resets_leave_the_other_worlds_alone(mode, copy, scenes):
    env = EgoVectorEnv(3, scenes=scenes, autoreset_mode=mode, copy=copy, **RULES)
    env.reset(seed=0)
    obs = env.step(np.zeros((3, 2)))[0].copy()
    digests = [env.worlds.native.digest(i) for i in range(3)]
    options = {"reset_mask": np.array([False, True, False]), "scene": scenes.names[4]}
    after, infos = env.reset(seed=7, options=options)
    assert set(options) == {"reset_mask", "scene"}
    assert np.array_equal(after[[0, 2]], obs[[0, 2]])
    assert [env.worlds.native.digest(i) == d for i, d in enumerate(digests)] == [True, False, True]
    assert infos["scene"][1] == scenes.names[4]
    assert infos["_scene"].tolist() == [False, True, False]
    assert infos["seed"][1] == 8


def test_bad_masks_are_refused(scenes):
    env = EgoVectorEnv(3, scenes=scenes, autoreset_mode="disabled")
    with pytest.raises(ConfigError, match="first reset"):
        env.reset(options={"reset_mask": np.array([True, False, True])})
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="at least one True"):
        env.reset(options={"reset_mask": np.zeros(3, bool)})
    actions, digest = np.zeros((3, 2), np.float32), env.worlds.native.digest(0)
    flat, column = np.ones(2, bool), np.ones((3, 1), bool)
    for mask in ([True, False, True], np.array([1, 0, 1]), flat, column, "all"):
        with pytest.raises(ShapeError, match="reset_mask is"):
            env.reset(options={"reset_mask": mask})
        with pytest.raises(ShapeError, match="active is"):
            env.step(actions, active=mask)
        with pytest.raises(ShapeError, match="active is"):
            env.worlds.native.step(actions[:, None], env.worlds.arrays(), mask)
    assert env.worlds.native.digest(0) == digest


def test_each_world_gets_a_scene_of_its_own(scenes):
    env = EgoVectorEnv(3, scenes=scenes)
    _, infos = env.reset(seed=0, options={"scene": [2, scenes.names[0], None]})
    assert infos["scene"][:2].tolist() == [scenes.names[2], scenes.names[0]]
    assert set(env.reset(options={"scene": 1})[1]["scene"]) == {scenes.names[1]}
    with pytest.raises(ConfigError, match="expected num_envs=3"):
        env.reset(options={"scene": [0, 1]})
    with pytest.raises(UnknownNameError):
        env.reset(options={"scene": [0, 1, "nowhere"]})
    with pytest.raises(ConfigError, match="expected num_envs=3"):
        env.reset(seed=[1, 2])


@pytest.mark.parametrize("mode", MODES)
def test_copies_are_never_overwritten(mode, scenes):
    env = EgoVectorEnv(4, scenes=scenes, autoreset_mode=mode)
    returned = [env.reset(seed=0)[0]]
    kept = [returned[0].copy()]
    for _ in range(5):
        for array in env.step(np.full((4, 2), 0.1))[:4]:
            assert not any(np.shares_memory(array, other) for other in returned)
            returned.append(array)
            kept.append(array.copy())
    for array, copy in zip(returned, kept, strict=True):
        assert np.array_equal(array, copy)


def test_without_copies_the_same_memory_comes_back_with_the_same_numbers(scenes):
    fast, safe = (EgoVectorEnv(4, scenes=scenes, copy=copy, **RULES) for copy in (False, True))
    first, _ = fast.reset(seed=1)
    safe.reset(seed=1)
    for action in actions_of(fast, 40):
        got, want = fast.step(action), safe.step(action)
        assert np.shares_memory(got[0], first)
        for one, other in zip(got[:4], want[:4], strict=True):
            assert_same(one, other)
        assert_same_infos(got[4], want[4])


def test_native_arrays_must_fit_exactly(scenes):
    worlds = EgoVectorEnv(2, scenes=scenes).worlds
    good = worlds.arrays()
    worlds.native.reset([0, 1], [None, None], None, good)
    actions = np.zeros((2, 1, 2), np.float32)
    size = worlds.layout.size
    read_only = np.zeros_like(good.reward)
    read_only.flags.writeable = False
    wrong = {
        "obs": [np.zeros((2, 1, size)), np.zeros((2, size), np.float32), None, [0.0]],
        "reward": [np.zeros((2, 1), np.float64), read_only],
        "done": [np.zeros(2, np.uint8), np.zeros(4, bool)[::2]],
        "truncated": [good.terminated],
        "final_obs": [np.zeros((2, 1, size), np.float32)],
    }
    digest = worlds.native.digest(0)
    for name, arrays in wrong.items():
        for array in arrays:
            with pytest.raises(ShapeError, match=name):
                worlds.native.step(actions, good._replace(**{name: array}))
    for bad in (np.zeros((2, 2), np.float32), np.zeros((2, 1, 2)), None):
        with pytest.raises(ShapeError, match="actions"):
            worlds.native.step(bad, good)
    assert worlds.native.digest(0) == digest
    worlds.native.step(actions, good)


def test_snapshots_of_no_world_are_refused(scenes):
    env = EgoVectorEnv(3, scenes=scenes)
    env.reset(seed=0)
    saved = env.snapshot(0)
    with pytest.raises(SnapshotError):
        env.restore(0, saved[:-3])
    for missing in (3, -1, 1.5):
        with pytest.raises(UnknownNameError):
            env.restore(missing, saved)
        with pytest.raises(UnknownNameError):
            env.snapshot(missing)


def test_images_of_all_worlds(scenes):
    env = EgoVectorEnv(2, scenes=scenes, render_mode="rgb_array", render_options={"size": (64, 48)})
    env.reset(seed=0)
    env.step(np.zeros((2, 2)))
    frames = env.render()
    assert len(frames) == 2
    assert {frame.shape for frame in frames} == {(48, 64, 3)}
    assert EgoVectorEnv(1, scenes=scenes).render() is None


class Cautious(gymnasium.Wrapper):
    """A reward of one's own from the information of a step."""

    def step(self, action):
        obs, reward, terminated, truncated, info = self.env.step(action)
        return obs, reward - 0.5 * (info["ttc"] < 9.0), terminated, truncated, info


class CautiousWorlds(gymnasium.vector.VectorWrapper):
    """The same, written for rows without a thought of their ends."""

    step = Cautious.step


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("num_envs", [1, NUM_ENVS])
def test_a_reward_of_ones_own_is_that_of_single_environments(mode, num_envs, scenes):
    options = {"scenes": scenes, **RULES}
    native = CautiousWorlds(EgoVectorEnv(num_envs, autoreset_mode=mode, **options))
    sync = SyncVectorEnv([lambda: Cautious(EgoEnv(**options))] * num_envs, autoreset_mode=mode)
    for env in (native, sync):
        env.reset(seed=1)
    ended = charged = 0
    for action in actions_of(native, 60):
        got, want = native.step(action), sync.step(action)
        np.testing.assert_allclose(got[1], want[1], atol=1e-6)
        assert np.array_equal(got[2], want[2])
        ended += int((got[2] | got[3]).sum())
        charged += int((got[1] < -0.4).sum())
    assert ended > num_envs
    assert charged > 0


def test_where_nobody_is_near_time_to_contact_is_that_of_rows_without_a_step():
    *_, (_, _, info) = played(log_env(agent("ego", 10.0 * TIMES_S)))
    assert info["ttc"] == as_vector._NOBODY_NEAR_S


def test_actions_of_the_log_are_those_of_single_environments(scenes):
    for options in ({}, {"discrete": True}, {"decision_steps": 3}):
        worlds, single = (
            kind(scenes=scenes, **options) for kind in (lambda **o: EgoVectorEnv(3, **o), EgoEnv)
        )
        worlds.reset(seed=4)
        for i, action in enumerate(worlds.expert_action()):
            single.reset(seed=4 + i)
            assert np.array_equal(action, single.expert_action())
        assert worlds.expert_action() in worlds.action_space
