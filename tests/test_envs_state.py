"""The single environment's state: snapshots, forks, pickles, processes, threads, memory."""

from __future__ import annotations

import copy
import gc
import multiprocessing
import os
import pickle
import threading
import weakref

import gymnasium
import numpy as np
import pytest
from test_envs import ID, assert_same_trace, same

import ccdiff_env
from ccdiff_env import EgoEnv, embedded_scenes
from ccdiff_env.errors import ForkError, SnapshotError


@pytest.fixture(scope="module")
def scenes():
    return embedded_scenes("val")


ACTIONS = [np.array([np.sin(i / 3.0), 0.1 * np.cos(i)], np.float32) for i in range(60)]


@pytest.mark.parametrize("traffic", ["idm", "replay", "constant_velocity"])
def test_restored_environments_go_on_bit_for_bit(traffic, scenes):
    env = EgoEnv(scenes=scenes, traffic=traffic, on_collision="ignore", on_off_road="ignore")
    obs, _ = env.reset(seed=8)
    for action in ACTIONS[:20]:
        obs, *_ = env.step(action)
    saved, digest = env.snapshot(), env.worlds.native.digest(0)
    rest = [env.step(action) for action in ACTIONS[20:40]]
    after = env.reset()
    assert same(env.restore(saved), obs)
    assert env.worlds.native.digest(0) == digest
    assert_same_trace([env.step(action) for action in ACTIONS[20:40]], rest)
    assert same(env.reset()[0], after[0])


def test_forks_are_independent(scenes):
    env = EgoEnv(scenes=scenes, on_off_road="ignore", on_collision="ignore")
    env.reset(seed=1)
    for action in ACTIONS[:5]:
        obs, *_ = env.step(action)
    fork = env.fork()
    assert same(fork.observation(), obs)
    moved = [fork.step(action) for action in ACTIONS[5:15]]
    assert same(env.observation(), obs)
    assert_same_trace([env.step(action) for action in ACTIONS[5:15]], moved)


@pytest.mark.parametrize("make", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
def test_copies_and_pickles_go_on_where_the_original_stands(make, scenes):
    env = gymnasium.make(ID, scenes=scenes, traffic="idm").unwrapped
    env.action_space.seed(5)
    env.reset(seed=3)
    env.step(ACTIONS[0])
    twin = make(env)
    assert twin.spec == env.spec
    assert_same_trace([twin.step(ACTIONS[1])], [env.step(ACTIONS[1])])
    assert same(twin.reset()[0], env.reset()[0])
    assert np.array_equal(twin.action_space.sample(), env.action_space.sample())


def test_copies_of_an_environment_that_was_never_reset_work(scenes):
    env = copy.deepcopy(EgoEnv(scenes=scenes))
    assert same(env.reset(seed=1)[0], EgoEnv(scenes=scenes).reset(seed=1)[0])


def test_snapshots_that_do_not_belong_are_refused_and_change_nothing(scenes):
    env = EgoEnv(scenes=scenes)
    env.reset(seed=0)
    env.step(ACTIONS[0])
    saved = env.snapshot()
    other = EgoEnv(scenes=scenes, traffic="idm")
    other.reset(seed=0)
    digest, obs = other.worlds.native.digest(0), other.observation()
    tail = saved[:-1]
    for wrong in (saved, b"", b"x" * 400, tail, saved[:40], saved[:6] + b"\xff\xff" + saved[8:], 3):
        with pytest.raises(SnapshotError):
            other.restore(wrong)
    assert other.worlds.native.digest(0) == digest
    assert same(other.observation(), obs)
    fewer = EgoEnv(scenes=list(scenes)[::-1])
    with pytest.raises(SnapshotError):
        fewer.restore(saved)


# ---------------------------------------------------------------------- threads and processes


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
    env = EgoEnv(scenes=scenes)
    env.reset(seed=0)
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
            except RuntimeError as error:
                seen.append(error)

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all("borrowed" in str(error) for error in seen)
    env.step(actions)


def test_environments_go_when_nobody_holds_them(scenes):
    env = EgoEnv(scenes=scenes)
    env.reset(seed=0)
    trace = weakref.ref(env)
    env.close()
    del env
    gc.collect()
    assert trace() is None
