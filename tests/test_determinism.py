"""The same seed gives the same bits: whatever the threads, the batch, the process."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import subprocess
import sys

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import embedded_scenes

STEPS = 60


def actions_of(num_envs: int, first: int = 0) -> np.ndarray:
    """Actions [T, E, 2] that depend on the number of the world and the step alone."""
    t = np.arange(STEPS)[:, None]
    i = np.arange(first, first + num_envs)[None, :]
    return np.stack([np.sin(0.3 * t + i), 0.1 * np.cos(0.2 * t * (i % 5))], -1).astype(np.float32)


def digests(num_envs: int, seed: int = 11, first: int = 0, **options) -> list[str]:
    """Digest of everything that each world returned over a rollout with resets."""
    env = ccdiff_env.make_vec(num_envs, scenes="val", horizon_steps=25, **options)
    hashes = [hashlib.blake2b(digest_size=8) for _ in range(num_envs)]
    obs, _ = env.reset(seed=seed + first)
    arrays = (obs,)
    for action in actions_of(num_envs, first):
        for i, hasher in enumerate(hashes):
            for array in arrays:
                hasher.update(np.ascontiguousarray(array[i]).tobytes())
            for _, states in sorted(env.worlds.native.states(i).items()):
                hasher.update(states.tobytes())
        *arrays, _ = env.step(action)
    return [hasher.hexdigest() for hasher in hashes]


@pytest.mark.parametrize("traffic", ["replay", "idm", "constant_velocity"])
@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_threads_change_nothing(traffic, mode):
    options = {"traffic": traffic, "autoreset_mode": mode}
    one = digests(40, num_threads=1, **options)
    assert digests(40, num_threads=2, **options) == one
    assert digests(40, num_threads=4, **options) == one


def test_the_other_worlds_of_the_batch_change_nothing():
    whole = digests(12, num_threads=2, traffic="idm")
    assert digests(1, traffic="idm") == whole[:1]
    assert digests(5, traffic="idm") == whole[:5]
    assert digests(4, first=8, traffic="idm") == whole[8:]


def test_runs_repeat_and_seeds_differ():
    assert digests(3) == digests(3)
    assert digests(3, seed=12) != digests(3, seed=11)
    assert digests(3, info="none", copy=False) == digests(3)


def _in_child(queue) -> None:
    queue.put(digests(3, num_threads=2, traffic="idm"))


def test_another_process_gets_the_same_bits():
    context = multiprocessing.get_context("spawn")
    queue = context.Queue()
    child = context.Process(target=_in_child, args=(queue,))
    child.start()
    assert queue.get(timeout=120) == digests(3, num_threads=2, traffic="idm")
    child.join(60)


def test_steps_after_a_restore_are_the_steps_before():
    env = ccdiff_env.make_vec(6, scenes="val", horizon_steps=30, traffic="idm", num_threads=2)
    env.reset(seed=4)
    actions = actions_of(6)
    for action in actions[:20]:
        env.step(action)
    saved = [env.snapshot(i) for i in range(6)]
    first = [env.step(action) for action in actions[20:50]]
    for i, snapshot in enumerate(saved):
        env.restore(i, snapshot)
    for before, action in zip(first, actions[20:50], strict=True):
        again = env.step(action)
        assert all(np.array_equal(a, b) for a, b in zip(before[:4], again[:4], strict=True))
        assert before[4].keys() == again[4].keys()


def test_scene_order_in_the_set_does_not_change_an_episode():
    scenes = embedded_scenes("val")
    name = scenes.names[3]
    rewards = []
    for given in (scenes, list(scenes)[::-1], scenes[name]):
        env = ccdiff_env.EgoEnv(scenes=given, traffic="idm")
        env.reset(seed=1, options={"scene": name})
        rewards.append([env.step(action[0])[1] for action in actions_of(1)[:10]])
    assert rewards[0] == rewards[1] == rewards[2]


#: Prints a digest of four worlds in CCDiff traffic, unguided and guided, and replays a certificate.
NETWORK = """
import hashlib, sys
import numpy as np
import ccdiff_env

for criticality in (0.0, 1.0):
    options = {"scenes": "val", "traffic": "ccdiff", "criticality": criticality}
    env = ccdiff_env.make_vec(4, num_threads=2, **options)
    env.reset(seed=5)
    digest = hashlib.blake2b(digest_size=8)
    for _ in range(8):
        digest.update(env.step(np.zeros((4, 2), np.float32))[0].tobytes())
        for i in range(4):
            digest.update(env.worlds.native.states(i)["position"].tobytes())
    print(digest.hexdigest())
ccdiff_env.replay(sys.argv[1])
"""


@pytest.mark.slow
def test_networks_repeat_their_bits_whatever_the_threads_of_torch(tmp_path):
    """Guided or not, in a batch of one size; a certificate is simulated again under any."""
    env = ccdiff_env.EgoEnv(traffic="ccdiff", criticality=1.0)
    env.reset(seed=3)
    for _ in range(12):
        env.step(np.zeros(2, np.float32))
    env.certificate().save(tmp_path / "c.json")
    said = [
        subprocess.run(
            [sys.executable, "-c", NETWORK, str(tmp_path / "c.json")],
            env={**os.environ, "OMP_NUM_THREADS": threads},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "2", "4")
    ]
    assert len(set(said[0].split())) == 2
    assert said[0] == said[1] == said[2]


@pytest.mark.parametrize("traffic", ["idm", "ccdiff"])
def test_a_world_of_a_batch_is_the_single_environment(traffic):
    """Bit for bit, with rules and with networks on own kernels."""
    worlds = ccdiff_env.make_vec(6, scenes="val", traffic=traffic)
    single = ccdiff_env.EgoEnv(scenes="val", traffic=traffic)
    rows, (row, _) = worlds.reset(seed=5)[0], single.reset(seed=5)
    for action in actions_of(6)[:10]:
        np.testing.assert_array_equal(rows[0], row)
        rows, row = worlds.step(action)[0], single.step(action[0])[0]
