"""Rewards, goals and roles against their formulas; the action that follows the log."""

import numpy as np
import pytest
from array_scenes import (
    GOES_ON,
    STEPS,
    TIMES_S,
    agent,
    array_scene,
    begun,
    driven,
    line,
    log_env,
    outline,
    played,
)

import ccdiff_env
from ccdiff_env import AgentVectorEnv, EgoEnv
from ccdiff_env.bench.planner_score import COMFORT
from ccdiff_env.config import RewardConfig

WEIGHTS = RewardConfig()


def worth(info, limit_mps):
    """Factors of new progress: comfort, time to contact, speed, distance from the route."""
    limits = (COMFORT[name] for name in ("acceleration", "lateral_acceleration", "jerk"))
    figures = (info[name] for name in ("acceleration", "lateral_acceleration", "jerk"))
    calm = all(low <= x <= high for x, (low, high) in zip(figures, limits, strict=True))
    slow = 1.0 - max(info["speed"] - limit_mps, 0.0) / 5.0
    beside = min(abs(info["route_distance"]), 3.0) / 3.0
    return (0.5 + 0.5 * calm) * (0.5 + 0.5 * (info["ttc"] >= 0.95)) * slow * (1.0 - 0.5 * beside)


def test_new_progress_is_worth_less_where_driving_is_bad(scenes):
    options = {"scenes": scenes, "traffic": "idm", "speed_limit_mps": 5.0}
    env = EgoEnv(reward="product", on_off_road="ignore", **options)
    speed_limit = env.worlds.layout.entries[0].columns.index("speed_limit")
    seen = set()
    for seed in range(8):
        obs, _ = env.reset(seed=seed)
        rng, before, done = np.random.default_rng(seed), 0.0, False
        while not done:
            action = rng.uniform(-1, 1, 2) * [0.6, 0.05]
            obs, reward, terminated, truncated, info = env.step(action.astype(np.float32))
            limit = float(obs[speed_limit]) * 20.0
            factor = worth(info, limit)
            expected = WEIGHTS.progress * (info["progress"] - before) * max(factor, 0.0)
            assert info["reward_progress"] == pytest.approx(expected, abs=2e-4)
            assert info["reward_collision"] == WEIGHTS.collision * info["at_fault"]
            for name in ("comfort", "speed_limit", "lane_keeping"):
                assert info[f"reward_{name}"] == 0.0
            parts = sum(v for name, v in info.items() if name.startswith("reward_"))
            assert reward == pytest.approx(parts, abs=1e-4)
            before, done = info["progress"], terminated or truncated
            seen.add(round(factor, 1))
    assert len(seen) > 4


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


def test_a_speed_too_low_to_be_in_time_is_priced_on_a_free_road_before_the_goal():
    # the log drives 60 m; the ego waits for 3 s first, and is there in time
    x = np.interp(TIMES_S, [0.0, 3.0, 13.0], [0.0, 0.0, 60.0])
    waits = np.interp(TIMES_S, [0.0, 6.0, 12.0], [0.0, 0.0, 60.0])
    options = {"terminate_at_goal": False, "reward": {"lagging": -0.5}}
    free, behind = (
        driven(array_scene(agent("ego", x), *others), line(waits), **options)[1]
        for others in ([], [agent("other", 10.0)])
    )
    paid = np.array([info["reward_lagging"] for info in free])
    speed = np.array([info["speed"] for info in free])
    left_m = 60.0 - np.array([info["at"][0] for info in free])
    left_s = np.maximum(10.0 - 0.1 * np.arange(1, 101), 1.0)
    late = (left_m > 3.0) & (np.arange(100) < 80)
    want = np.where(late, -0.5 * np.maximum(left_m / left_s - speed, 0.0), 0.0)
    np.testing.assert_allclose(paid[:80], want[:80], atol=2e-2)
    assert paid[0] == pytest.approx(-0.5 * 60.0 / 9.9, abs=1e-2)
    assert (paid[-10:] == 0.0).all()
    # from bumper to bumper it is 5.5 m, which is no free road
    assert all(info["reward_lagging"] == 0.0 for info in behind[:29])


def test_the_ego_sees_when_and_how_fast_the_log_is_at_the_goal():
    # 10 m/s to 80 m, then 4 m/s; the other one drives 3 m/s ahead
    x = np.where(TIMES_S < 8.0, 10.0 * TIMES_S, 80.0 + 4.0 * (TIMES_S - 8.0))
    scene = array_scene(agent("ego", x), agent("other", 60.0 + 3.0 * TIMES_S))
    goal_m = x[130]
    env = EgoEnv(scenes=[scene], dynamics="unicycle", terminate_at_goal=False)
    obs, _ = env.reset(seed=0)
    columns = env.worlds.layout.entries[0].columns
    for step in range(60):
        seen = dict(zip(columns, obs, strict=False))
        state = env.worlds.native.states(0)
        (at_m, _), (other_m, _) = state["position"]
        v = state["speed"][0]
        left_s, way_m = 10.0 - 0.1 * step, goal_m - at_m
        assert seen["time_remaining"] == pytest.approx(left_s / 10.0, abs=1e-5)
        assert seen["goal_speed"] * 20.0 == pytest.approx(4.0, abs=0.1)
        assert seen["pace"] * 20.0 == pytest.approx(min(way_m / left_s, 20.0), abs=0.05)
        brakes = max(v**2 - (20.0 * seen["goal_speed"]) ** 2, 0.0) / (2.0 * way_m)
        assert seen["goal_braking"] * 10.0 == pytest.approx(brakes, abs=0.02)
        if seen["leader_gap"] < 1.0:
            room_m = other_m - at_m - 4.5 - 2.0
            brakes = min(max(v - 3.0, 0.0) ** 2 / (2.0 * max(room_m, 0.1)), 10.0)
            assert seen["leader_braking"] * 10.0 == pytest.approx(brakes, abs=0.05)
        obs, *_ = env.step(np.array([-0.05, 0.0], np.float32))
    assert seen["leader_braking"] > 0.0


def test_a_stop_of_the_log_is_a_goal_to_stop_at_and_the_clock_ends_with_the_log():
    scene = array_scene(agent("ego", np.minimum(10.0 * TIMES_S, 90.0)))
    columns = EgoEnv(scenes=[scene]).worlds.layout.entries[0].columns
    for horizon, left_s in ((100, 10.0), (1000, 12.9)):
        obs, _ = EgoEnv(scenes=[scene], horizon_steps=horizon).reset(seed=0)
        seen = dict(zip(columns, obs, strict=False))
        assert seen["goal_speed"] == 0.0
        assert seen["time_remaining"] == 1.0
        assert seen["pace"] * 20.0 == pytest.approx(60.0 / left_s, abs=0.02)
        assert seen["goal_braking"] * 10.0 == pytest.approx(100.0 / (2.0 * 60.0), abs=0.01)


def test_a_goal_that_was_reached_asks_for_nothing_more():
    scene = array_scene(agent("ego", np.minimum(10.0 * TIMES_S, 90.0)), agent("other", 500.0))
    env = EgoEnv(scenes=[scene], dynamics="unicycle", terminate_at_goal=False)
    obs, _ = env.reset(seed=0)
    columns, reached = env.worlds.layout.entries[0].columns, False
    for step in range(95):
        seen = dict(zip(columns, obs, strict=False))
        assert seen["goal_speed"] == float(reached)
        if reached:
            assert seen["goal_near"] == seen["goal_braking"] == seen["pace"] == 0.0
        # it stops at the goal, and drives on
        acceleration = 0.2 if reached else 0.0 if step < 40 else -2.5 / 8.0
        obs, _, _, _, info = env.step(np.array([acceleration, 0.0], np.float32))
        reached |= bool(info["goal_reached"])
    assert reached
    assert seen["speed"] > 0.0


def test_each_partner_is_a_contact_of_its_own():
    """Against outlines: one comes while another one stays, and comes again."""
    behind, ahead = -14.0 + np.minimum(2.0 * TIMES_S, 10.0), 6.0 + 2.0 * np.cos(2.0 * TIMES_S)
    others = {1: behind, 2: ahead}
    scene = [agent("ego", 0.0 * TIMES_S), agent("behind", behind), agent("ahead", ahead)]
    size = (4.5, 2.0)
    touch = [
        {
            j
            for j, x in others.items()
            if outline(0, 0, 0, size).intersects(outline(x[k], 0, 0, size))
        }
        for k in range(STEPS)
    ]
    expected = [(k, j) for k in range(31, 131) for j in touch[k] - touch[k - 1]]
    assert {j for _, j in expected} == {1, 2}
    assert any(touch[k] == {1, 2} for k, j in expected)
    found, paid = [], 0.0
    for k, _, info in played(log_env(*scene, traffic="replay", on_collision="ignore")):
        paid += info["reward_collision"]
        if info["collision"]:
            found.append((k, int(info["collision_partner"]) - 1))
    assert found == expected
    assert paid == pytest.approx(WEIGHTS.collision * len(expected))


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
    scenes = ccdiff_env.load_nuscenes(data_root / "nuscenes", "v1.0-trainval", "val")
    options = {"scene_order": "sequential", "autoreset_mode": "disabled", "horizon_steps": 80}
    worlds = ccdiff_env.make_vec(len(scenes), scenes=scenes, driver="replay", **options, **GOES_ON)
    worlds.reset(seed=0)
    for _ in range(80):
        *_, infos = worlds.step(np.zeros(worlds.action_space.shape, np.float32))
    for figure in ("route_completion", "goal_reached"):
        assert (infos["metrics"][figure] == 1.0).all()


def expected(columns, played, adversary, names, shaping):
    """Rewards [E, C]: of adversaries minus the mean of the egos', plus their own costs."""
    own = columns[..., [name.startswith("reward_") for name in names]].sum(axis=-1)
    egos = played & ~adversary
    num_egos = np.maximum(egos.sum(axis=-1, keepdims=True), 1)
    against = np.where(egos, own, 0.0).sum(axis=-1, keepdims=True) / num_egos
    cost = columns[..., [names.index("reward_off_road"), names.index("reward_comfort")]]
    return np.where(played & adversary, shaping * cost.sum(axis=-1) - against, own)


@pytest.mark.parametrize("shaping", [0.0, 0.7])
@pytest.mark.parametrize("threads", [1, 2])
def test_adversaries_are_paid_what_the_egos_lose(scenes, shaping, threads):
    options = {"agents": 6, "adversaries": 2, "adversary_shaping": shaping, "traffic": "idm"}
    env = AgentVectorEnv(9, scenes=scenes, num_threads=threads, horizon_steps=40, **options)
    _, infos = env.reset(seed=3)
    names = env.worlds.column_names
    shape = (env.num_worlds, env.num_slots)
    role = np.array(infos["role"]).reshape(shape)
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(90):
        played = env.active_masks().reshape(shape)
        adversary = role == "adversary"
        actions = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        actions[adversary.ravel()] *= 0.05  # they outlast the egos
        _, rewards, terminated, truncated, infos = env.step(actions)
        out = env.worlds.last
        want = expected(out.columns, played, adversary, names, shaping)
        np.testing.assert_allclose(rewards.reshape(shape), want, atol=1e-5)
        # an episode without an ego is over at once
        over = (terminated | truncated).reshape(shape)
        left = played & ~over
        alone = (left & adversary).any(axis=1) & ~(left & ~adversary).any(axis=1)
        assert not alone.any()
        egos_end = (played & ~adversary).any(axis=1) & ~(left & ~adversary).any(axis=1)
        assert out.done[egos_end].all()
        cut = truncated.reshape(shape) & played & (out.columns[..., names.index("time_limit")] == 0)
        assert not (cut & ~adversary).any()
        ends += cut.sum()
        for e in np.flatnonzero(out.done):
            role[e] = np.array(infos["role"]).reshape(shape)[e]
    assert ends > 0


MODELS = ("unicycle", "bicycle", "delta_pose")


def strayed(scene, dynamics):
    """Distance from the log after 3 s (m)."""
    env = begun(scenes=[scene], traffic="replay", dynamics=dynamics, **GOES_ON)
    for _ in range(30):
        *_, info = env.step(env.expert_action())
    return float(info["log_distance"])


def test_a_log_whose_rear_axle_goes_round_a_bend_is_followed_by_the_bicycle():
    time, length, radius, speed = 0.1 * np.arange(80), 4.5, 15.0, 6.0
    turn, axle = speed * time / radius, 0.3 * length
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    place = radius * np.stack([np.sin(turn), 1 - np.cos(turn)], axis=1) + axle * along
    ego = agent("ego", *place.T, heading=turn, size=(length, 1.8, 1.5))
    found = {name: strayed(array_scene(ego), name) for name in MODELS}
    assert found["bicycle"] < 0.02
    assert found["delta_pose"] < 0.01
    # the slip of the centre in a turn by 1.2 rad has no action, nor has the turn within a step
    slip = (axle + 0.5 * speed * 0.1) * 2 * np.sin(0.6)
    assert found["unicycle"] == pytest.approx(slip, rel=0.01)


BRAKES = np.array([-0.8, 0.0], np.float32)


def test_a_reward_component_has_a_weight_a_column_and_a_metric(scenes):
    plain, weighted = (
        [info for *_, info in played(EgoEnv(scenes=scenes, reward=RewardConfig(jerk=jerk)), BRAKES)]
        for jerk in (0.0, -0.01)
    )
    for info, other in zip(plain, weighted, strict=True):
        expected = -0.01 * min(abs(float(info["jerk"])), 10.0)
        assert info["reward_jerk"] == 0.0
        np.testing.assert_allclose(other["reward_jerk"], expected, rtol=1e-5)
        np.testing.assert_allclose(other["reward"] - info["reward"], expected, atol=1e-5)


def test_an_info_column_says_by_how_much_the_limit_is_exceeded(scenes):
    env, ahead = EgoEnv(scenes=scenes[:3], **GOES_ON), np.array([1.0, 0.0], np.float32)
    found = [(info["speeding"], info["reward_speed_limit"]) for *_, info in played(env, ahead)]
    speeding, rewards = np.array(found).T
    np.testing.assert_allclose(speeding, rewards / RewardConfig().speed_limit, rtol=1e-5)
    assert speeding.min() == 0.0 < speeding.max()
