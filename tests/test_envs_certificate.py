"""Replay certificates."""

import dataclasses
import json

import numpy as np
import pytest
from array_scenes import played

import ccdiff_env
from ccdiff_env import Certificate, EgoEnv, replay
from ccdiff_env.errors import ResetNeededError, SnapshotError


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
    assert again.frames == []
    # files from before an option existed mean its default
    fields = json.loads(path.read_text())
    del fields["config"]["start_spread_steps"]
    del fields["config"]["observation"]["bev"]
    path.write_text(json.dumps(fields))
    assert replay(path).rewards.tolist() == rewards
    assert Certificate.load(path).config == env.certificate().config


def test_images_are_kept_on_request(scenes):
    env, rewards = driven(scenes, horizon_steps=3)
    again = replay(env.certificate(), scenes, render_mode="rgb_array", size=(32, 32))
    assert len(again.frames) == len(rewards) + 1
    assert again.frames[0].shape == (32, 32, 3)


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
