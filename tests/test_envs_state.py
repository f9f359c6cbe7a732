"""The single environment's state: snapshots, forks, pickles, certificates, processes, threads."""

import copy
import dataclasses
import json
import multiprocessing
import os
import pickle
import threading

import numpy as np
import pytest
from array_scenes import begun, played
from episode_play import same

import ccdiff_env
from ccdiff_env import Certificate, EgoEnv, replay
from ccdiff_env.errors import ConfigError, ForkError, ResetNeededError, SnapshotError, ThreadError

ACTIONS = [np.array([np.sin(i / 3.0), 0.1 * np.cos(i)], np.float32) for i in range(60)]


def test_snapshots_that_do_not_belong_are_refused_and_change_nothing(scenes):
    env = begun(scenes=scenes)
    env.step(ACTIONS[0])
    saved = env.snapshot()
    other = begun(scenes=scenes, traffic="idm")
    digest, obs = other.worlds.native.digest(0), other.observation()
    tail = saved[:-1]
    for wrong in (saved, b"", b"x" * 400, tail, saved[:40], saved[:6] + b"\xff\xff" + saved[8:], 3):
        with pytest.raises(SnapshotError):
            other.restore(wrong)
    assert other.worlds.native.digest(0) == digest
    assert np.array_equal(other.observation(), obs)
    before, drives = env.worlds.native.digest(0), ccdiff_env.parallel_env(agents=2, scenes=scenes)
    vector = ccdiff_env.make_vec(1, scenes=scenes)
    drives.reset(seed=0)
    vector.reset(seed=0)
    for restore, kept in (
        (env.restore, saved),
        (lambda wrong: env.worlds.native.restore(0, wrong), env.worlds.native.snapshot(0)),
        (lambda wrong: vector.restore(0, wrong), vector.snapshot(0)),
        (drives.restore, drives.snapshot()),
    ):
        for wrong in (kept[:-1], kept + b"\0", kept + kept):
            with pytest.raises(SnapshotError, match="damaged bytes"):
                restore(wrong)
    assert env.worlds.native.digest(0) == before
    for options in ({"scenes": list(scenes)[::-1]}, {"scenes": scenes, "observation": "bev"}):
        with pytest.raises(SnapshotError):
            EgoEnv(**options).restore(saved)


@pytest.mark.parametrize("traffic", ["ccdiff", "idm"])
def test_another_seed_is_another_future_of_the_same_state(traffic, scenes):
    options = {"traffic": traffic, "on_off_road": "ignore", "on_collision": "ignore"}
    options["terminate_at_goal"] = False
    options["ccdiff"] = {"denoising_steps": 1} if traffic == "ccdiff" else {}
    env = EgoEnv(scenes=scenes, **options)
    env.reset(seed=0)
    for action in ACTIONS[:7]:
        obs, *_ = env.step(action)
    saved = env.snapshot()

    def future(of, count=25):
        trace = []
        for action in ACTIONS[7 : 7 + count]:
            row, *_ = of.step(action)
            trace.append(np.concatenate([row, of.worlds.native.states(0)["position"].ravel()]))
        return np.array(trace)

    forks = [env.fork(seed=1), env.fork(seed=4), env.fork()]
    one, other, own = (future(fork) for fork in forks)
    assert np.array_equal(env.restore(saved), obs)
    assert np.array_equal(future(env), own), "without a seed nothing is sampled again"
    assert (traffic == "idm") == np.array_equal(one, other) == np.array_equal(one, own)
    assert np.array_equal(one[:3], own[:3]), "the present plan stays until the next one"
    assert np.array_equal(env.restore(saved, seed=1), obs)
    assert np.array_equal(future(env), one)
    with pytest.raises(SnapshotError, match="seed"):
        env.certificate()
    assert np.array_equal(env.reset()[0], EgoEnv(scenes=scenes, **options).reset(seed=1)[0])
    assert env.certificate().seed == 1
    worlds = ccdiff_env.make_vec(2, scenes=scenes, autoreset_mode="disabled", **options)
    worlds.reset(seed=0)
    assert np.array_equal(worlds.restore(1, saved, seed=1), obs)
    for action, first in zip(ACTIONS[7:], one, strict=False):
        assert np.array_equal(worlds.step(np.tile(action, (2, 1)))[0][1], first[: len(obs)])


def test_seeds_of_futures_are_checked(scenes):
    env = EgoEnv(scenes=scenes)
    fresh = env.snapshot()
    with pytest.raises(ResetNeededError):
        env.restore(fresh, seed=1)
    env.reset(seed=0)
    env.step(ACTIONS[0])
    digest, saved = env.worlds.native.digest(0), env.snapshot()
    env.step(ACTIONS[1])
    for wrong in ("1", 1.5):
        with pytest.raises(ConfigError, match="seed"):
            env.restore(saved, seed=wrong)
    assert env.worlds.native.digest(0) != digest, "nothing was restored"
    env.restore(saved, seed=-(2**70))
    game = ccdiff_env.parallel_env(agents=2, traffic="ccdiff", ccdiff={"denoising_steps": 1})
    game.reset(seed=0)
    digests = [fork.worlds.native.digest(0) for fork in (game.fork(seed=5), game.fork(), game)]
    assert digests[0] != digests[1] == digests[2]
    game.restore(game.snapshot(), seed=5)
    assert game.worlds.native.digest(0) == digests[0]


CALLS = {
    "step": lambda env: env.step(np.zeros(2, np.float32)),
    "digest": lambda env: env.worlds.native.digest(0),
    "explain": lambda env: env.worlds.native.explain(0),
    "snapshot": lambda env: env.snapshot(),
}


def _call_in_child(env, name, queue):
    try:
        CALLS[name](env)
        queue.put("done")
    except ForkError as error:
        env.close()  # a child may close what it cannot use
        queue.put(str(error))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", CALLS)
def test_a_forked_child_is_told_to_spawn(scenes, name):
    env = begun(scenes=scenes)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_call_in_child, args=(env, name, queue))
    child.start()
    assert "spawn" in queue.get(timeout=60)
    child.join(60)
    assert child.exitcode == 0


def test_threads_that_share_an_environment_get_an_error_not_a_crash(scenes):
    env = ccdiff_env.make_vec(64, scenes=scenes, num_threads=1, info="none")
    env.reset(seed=0)
    actions = np.zeros((64, 2), np.float32)
    seen: list[BaseException] = []

    def work() -> None:
        for _ in range(30):
            try:
                env.step(actions)
            except ThreadError as error:
                seen.append(error)

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all("environment of its own" in str(error) for error in seen)
    env.step(actions)


@pytest.mark.parametrize("make", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_copies_of_many_worlds_go_on_where_the_original_stands(mode, make, scenes):
    env = ccdiff_env.make_vec(
        5, scenes=scenes, traffic="idm", autoreset_mode=mode, horizon_steps=12, info="end"
    )
    early = make(env)
    env.set_scene_weights(np.arange(1.0, len(scenes) + 1.0))
    obs, _ = env.reset(seed=4)
    assert not np.array_equal(early.reset(seed=4)[0], obs)  # by weights
    assert early.worlds.scene_weights is None
    rng = np.random.default_rng(0)

    def step(one, action):
        found = one.step(action)
        ended = found[2] | found[3]
        if mode == "disabled" and ended.any():
            return *found, one.reset(options={"reset_mask": ended})[0]
        return found

    for _ in range(30):
        twin = make(env)
        assert twin.action_space.sample().tolist() == env.action_space.sample().tolist()
        for _ in range(2):
            action = rng.uniform(-1, 1, (5, 2)).astype(np.float32)
            mine, theirs = step(env, action), step(twin, action)
            assert same(mine[:4] + mine[5:], theirs[:4] + theirs[5:])
        native = [one.worlds.native for one in (env, twin)]
        assert [native[0].digest(i) for i in range(5)] == [native[1].digest(i) for i in range(5)]
    assert np.array_equal(make(env).reset()[0], env.reset()[0])


def driven(scenes, *, episodes=1, **options) -> tuple[EgoEnv, list[float]]:
    """An environment at the end of an episode, and that episode's rewards."""
    env = EgoEnv(scenes=scenes, **options)
    action = 33 if options.get("discrete") else np.full(env.action_space.shape, 0.05, np.float32)
    for seed in (2**70 + 1, *[None] * (episodes - 1)):
        rewards = [info["reward"] for *_, info in played(env, action, seed)]
    return env, rewards


@pytest.mark.parametrize(
    "options",
    [
        {"discrete": True, "dynamics": "bicycle", "horizon_steps": 30},
        {"episodes": 3, "traffic": "constant_velocity", "dynamics": "delta_pose"},
    ],
    ids=str,
)
def test_episodes_are_simulated_again_from_a_small_file(options, scenes, tmp_path):
    env, rewards = driven(scenes, **options)
    path = tmp_path / "episode.json"
    env.certificate().save(path)
    again = replay(path)
    assert again.rewards.tolist() == rewards
    assert again.env.scene == env.scene
    # files from before an option existed mean its default
    fields = json.loads(path.read_text())
    del fields["config"]["start_spread_steps"]
    del fields["config"]["observation"]["bev"]
    path.write_text(json.dumps(fields))
    assert replay(path).rewards.tolist() == rewards
    assert Certificate.load(path).config == env.certificate().config


def test_an_unfinished_episode_has_a_certificate_and_forks_keep_it(scenes):
    env = EgoEnv(scenes=scenes)
    with pytest.raises(ResetNeededError):
        env.certificate()
    env.reset(seed=1)
    env.step(np.array([0.5, 0.0], np.float32))
    fork = env.fork()
    fork.step(np.array([-0.5, 0.0], np.float32))
    assert len(replay(fork.certificate(), scenes).rewards) == 2
    assert len(replay(env.certificate(), scenes).rewards) == 1


def test_a_changed_certificate_is_found_out(scenes):
    certificate = driven(scenes, horizon_steps=8)[0].certificate()
    actions = certificate.actions.copy()
    actions[0, 0] = 0.5 - actions[0, 0]
    config = certificate.config.with_options(reward={"goal": 3.0, "progress": 0.2})
    changes = [
        {"actions": certificate.actions[:-1]},
        {"seed": certificate.seed + 1},
        {"episode_idx": 1},
        {"config": config},
        {"digest": "0" * 32},
        {"scene": "nowhere"},
        {"scene_hash": "0" * 32},
        {"schema": "0" * 16},
        {"actions": actions},
    ]
    for change in changes:
        with pytest.raises(SnapshotError):
            replay(dataclasses.replace(certificate, **change), scenes)
    replay(certificate, scenes)


def test_actions_before_a_foreign_snapshot_are_missed(scenes):
    env = EgoEnv(scenes=scenes)
    vector = ccdiff_env.EgoVectorEnv(1, scenes=scenes, autoreset_mode="disabled")
    vector.reset(seed=0)
    env.restore(vector.snapshot(0))
    with pytest.raises(SnapshotError, match="actions"):
        env.certificate()
    env.reset()
    env.certificate()
