"""How near ``expert_action`` stays to the log: which point of each model turns without slip."""

from __future__ import annotations

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env.scenes import Scene

MODELS = ("unicycle", "bicycle", "delta_pose")


def strayed(scene, dynamics):
    """Distance from the log after 3 s (m)."""
    env = ccdiff_env.EgoEnv(
        scenes=[scene],
        traffic="replay",
        dynamics=dynamics,
        on_collision="ignore",
        on_off_road="ignore",
        terminate_at_goal=False,
    )
    env.reset(seed=0)
    for _ in range(30):
        *_, info = env.step(env.expert_action())
    return float(info["log_distance"])


def test_a_log_whose_rear_axle_goes_round_a_bend_is_followed_by_the_bicycle():
    time, length, radius, speed = 0.1 * np.arange(80), 4.5, 15.0, 6.0
    turn, axle = speed * time / radius, 0.3 * length
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    place = radius * np.stack([np.sin(turn), 1 - np.cos(turn)], axis=1) + axle * along
    velocity = speed * along + speed / radius * axle * left
    scene = Scene.from_arrays(
        "bend",
        agent_ids=["ego"],
        agent_types=["vehicle"],
        sizes=np.float32([[length, 1.8, 1.5]]),
        position=place[None].astype(np.float32),
        heading=turn[None].astype(np.float32),
        velocity=velocity[None].astype(np.float32),
        valid=np.ones((1, 80), bool),
    )
    found = {name: strayed(scene, name) for name in MODELS}
    assert found["bicycle"] < 0.02
    assert found["delta_pose"] < 0.01
    # the slip of the centre in a turn by 1.2 rad has no action, nor has the turn within a step
    slip = (axle + 0.5 * speed * 0.1) * 2 * np.sin(0.6)
    assert found["unicycle"] == pytest.approx(slip, rel=0.01)


@pytest.mark.nuscenes
def test_real_turns_are_followed_by_the_bicycle(data_root):
    scenes = ccdiff_env.load(f"nuscenes:{data_root}/nuscenes@v1.0-trainval/val")
    turns = [
        scene
        for scene in scenes
        if scene.num_steps > 130 and np.abs(np.ptp(scene.tracks()["heading"][0, 30:61])) > 0.3
    ]
    assert len(turns) > 5
    found = {name: np.mean([strayed(scene, name) for scene in turns]) for name in MODELS}
    assert found["delta_pose"] < 0.01
    assert found["bicycle"] < 0.2
    assert found["unicycle"] > 3 * found["bicycle"]
