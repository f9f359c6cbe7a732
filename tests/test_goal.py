"""Progress, the goal and success: near the route, near the logged place, by one account."""

from __future__ import annotations

import numpy as np
import pytest
from array_scenes import STEPS, TIMES_S, agent, array_scene, played

from ccdiff_env import EgoEnv
from ccdiff_env.config import RewardConfig


def driven(scene, path, **options):
    """Infos of an episode whose ego goes along a path [T, 3] of the scene, step by step."""
    env = EgoEnv(scenes=[scene], dynamics="delta_pose", on_collision="ignore", **options)
    env.reset(seed=0)
    native, infos = env.worlds.native, []
    low, high = (np.array(bound) for bound in list(zip(*native.action_bounds, strict=True))[1:])
    done = False
    while not done:
        k, states = native.status(0).step_idx, native.states(0)
        (x, y), h = states["position"][0], states["heading"][0]
        dx, dy = path[k + 1, 0] - x, path[k + 1, 1] - y
        cos, sin = np.cos(h), np.sin(h)
        local = np.array([dx * cos + dy * sin, dy * cos - dx * sin, path[k + 1, 2] - h])
        act = np.where(local >= 0, local / high, -local / low).astype(np.float32)
        _, reward, terminated, truncated, info = env.step(act)
        done = terminated or truncated
        infos.append({**info, "reward": reward, "at": native.states(0)["position"][0].copy()})
        infos[-1]["active"] = native.states(0)["active"][0]
    return env, infos


def line(x, y=0.0, heading=0.0):
    return np.stack(np.broadcast_arrays(x, y, heading), -1).astype(float)


@pytest.mark.parametrize(("aside", "reaches"), [(0, 1), (3.5, 1), (8, 0), (12, 0), (60, 0)])
def test_the_goal_is_reached_and_progress_counts_near_the_route_only(aside, reaches):
    scene = array_scene(agent("ego", 10.0 * TIMES_S))
    # 1 m to the side with every step
    y = np.clip(np.arange(STEPS) - 31.0, 0.0, aside)
    env, infos = driven(scene, line(10.0 * TIMES_S, y), terminate_at_goal=False)
    last = infos[-1]
    goal = env.worlds.native.route(0, 0)[1]
    np.testing.assert_allclose(goal, [130.0, 0.0], atol=1e-3)
    assert last["metrics"]["goal_reached"] == last["is_success"] == reaches
    assert sum(info["goal_reached"] for info in infos) == reaches
    assert sum(info["reward_goal"] for info in infos) == pytest.approx(
        RewardConfig().goal * reaches
    )
    assert (last["route_completion"] == 1.0) == bool(reaches)
    for info in infos:
        assert not info["goal_reached"] or np.linalg.norm(info["at"] - goal) <= 5.0
    if not reaches:
        assert last["metrics"]["progress"] <= 10.0
    # rewards, info and metrics are one account
    reward = sum(info["reward_progress"] for info in infos)
    assert reward == pytest.approx(RewardConfig().progress * last["progress"], rel=1e-4)
    assert last["metrics"]["progress"] == pytest.approx(last["progress"])
    assert last["metrics"]["route_completion"] == last["route_completion"]


def test_a_detour_counts_when_the_route_is_reached_again():
    scene = array_scene(agent("ego", 10.0 * TIMES_S))
    k = np.arange(STEPS)
    y = np.where(k < 60, np.clip(k - 31.0, 0.0, 12.0), np.clip(72.0 - k, 0.0, 12.0))
    _, infos = driven(scene, line(10.0 * TIMES_S, y))
    progress = np.array([info["progress"] for info in infos])
    away = np.array([abs(info["route_distance"]) > 7.0 for info in infos])
    assert away.any()
    assert (np.diff(progress)[away[1:]] == 0.0).all()
    assert infos[-1]["metrics"]["goal_reached"] == 1.0


@pytest.mark.parametrize(("stop_m", "reaches"), [(np.inf, 0), (90.0, 1), (93.0, 1), (80.0, 0)])
def test_a_stop_of_the_log_is_reached_by_who_stops_there(stop_m, reaches):
    # the log stops at 90 m
    x = np.minimum(10.0 * TIMES_S, 90.0)
    _, infos = driven(array_scene(agent("ego", x)), line(np.minimum(10.0 * TIMES_S, stop_m)))
    assert infos[-1]["metrics"]["goal_reached"] == reaches
    assert infos[-1]["is_success"] == reaches
    assert (infos[-1]["route_completion"] == 1.0) == bool(reaches)


def test_the_goal_of_a_route_that_crosses_itself_is_on_its_own_branch():
    # a loop of 120 m that ends 10 m after where it began, across the first piece of the route
    s = 12.0 * TIMES_S - 36.0
    turn = np.clip((s - 15.0) / 15.0, 0.0, 1.5 * np.pi)
    x = np.where(s < 15, s, 15 + 15 * np.sin(turn))
    y = np.where(s < 15, 0.0, 15 - 15 * np.cos(turn)) - np.maximum(s - 15.0 - 22.5 * np.pi, 0.0)
    scene = array_scene(agent("ego", x, y, heading=turn))
    env, infos = driven(scene, np.stack([x, y, turn], -1))
    goal = env.worlds.native.route(0, 0)[1]
    np.testing.assert_allclose(goal, [x[130], y[130]], atol=1e-3)
    assert np.linalg.norm(goal) < 20.0
    assert infos[-1]["metrics"]["goal_reached"] == 1.0
    assert infos[-1]["metrics"]["progress"] == pytest.approx(120.0, rel=0.02)
    # who waits on the first piece, near the end of the loop, has not arrived
    waits = line(np.minimum(s, x[130]))
    _, infos = driven(scene, waits)
    assert infos[-1]["metrics"]["goal_reached"] == 0.0
    assert infos[-1]["route_completion"] < 0.2


def test_who_goes_on_after_the_goal_stays_and_gets_nothing_twice():
    scene = array_scene(agent("ego", np.minimum(10.0 * TIMES_S, 100.0 + 0.1 * TIMES_S)))
    _, infos = driven(scene, line(np.minimum(10.0 * TIMES_S, 100.0)))
    assert len(infos) < 75
    x = np.where(TIMES_S < 11.0, np.minimum(10.0 * TIMES_S, 100.0), 100.0 + 10.0 * (TIMES_S - 11.0))
    _, infos = driven(scene, line(x), terminate_at_goal=False)
    assert len(infos) == 100
    assert all(info["active"] for info in infos)
    assert infos[-1]["at"][0] == pytest.approx(x[130], abs=0.1)
    assert sum(info["goal_reached"] for info in infos) == 1
    assert sum(info["reward_goal"] for info in infos) == pytest.approx(RewardConfig().goal)
    first = next(i for i, info in enumerate(infos) if info["goal_reached"])
    assert all(info["route_completion"] == 1.0 for info in infos[first:])
    assert all(info["reward_progress"] == 0.0 for info in infos[first + 1 :])
    assert infos[-1]["metrics"]["goal_reached"] == infos[-1]["is_success"] == 1.0


def test_who_reaches_the_goal_in_the_last_step_of_a_world_that_goes_on_is_still_there():
    scene = array_scene(agent("ego", 2.5 + 0.05 * np.arange(STEPS) ** 1.5))
    *_, (_, states, info) = played(EgoEnv(scenes=[scene], driver="replay", terminate_at_goal=False))
    assert states["active"][0]
    assert info["metrics"]["goal_reached"] == 1.0


@pytest.mark.nuscenes
def test_logged_drivers_reach_their_goals(data_root):
    from ccdiff_env import load_nuscenes, make_vec

    scenes = load_nuscenes(data_root / "nuscenes", "v1.0-trainval", "val")
    worlds = make_vec(
        len(scenes),
        scenes=scenes,
        driver="replay",
        scene_order="sequential",
        on_collision="ignore",
        on_off_road="ignore",
        terminate_at_goal=False,
        horizon_steps=80,
        autoreset_mode="disabled",
    )
    worlds.reset(seed=0)
    for _ in range(80):
        *_, infos = worlds.step(np.zeros(worlds.action_space.shape, np.float32))
    assert (infos["metrics"]["route_completion"] == 1.0).all()
    moves = infos["metrics"]["progress"] >= 2.0
    assert (infos["metrics"]["goal_reached"] == moves).all()
