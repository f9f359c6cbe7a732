"""Log replay shows the log: gaps, places that overlap, late arrivals."""

import numpy as np
import pytest
from array_scenes import GOES_ON, STEPS, TIMES_S, agent, log_env, played, wide_road

from ccdiff_env import EgoEnv, load_nuscenes

EGO = agent("ego", 6.0 * TIMES_S)
#: The log has lost somebody for a frame, for three, and for three seconds.
GAPS = np.ones(STEPS, bool)
GAPS[[50, 70, 71, 72]] = False
GAPS[90:120] = False


def seen(env, a, action=None):
    """Steps of the log at which an agent is in the world."""
    return {step for step, states, _ in played(env, action) if states["active"][a]}


def logged(valid, first=31, last=130):
    return {step for step in range(first, last + 1) if valid[step]}


@pytest.mark.parametrize("kind", ["vehicle", "pedestrian", "cyclist"])
@pytest.mark.parametrize("moves", [0.0, 8.0])
def test_replay_shows_an_agent_whenever_the_log_has_it(kind, moves):
    other = agent("other", 40.0 + moves * TIMES_S, 9.0, valid=GAPS, kind=kind)
    env = log_env(EGO, other)
    assert seen(env, 1) == logged(GAPS)


@pytest.mark.parametrize("traffic", ["idm", "constant_velocity", "egos"])
def test_gaps_of_the_log_take_nobody_whom_others_drive(traffic):
    other = agent("other", 40.0 + 8.0 * TIMES_S, 9.0, valid=GAPS)
    for vanish in (False, True):
        env = log_env(EGO, other, traffic=traffic, vanish_with_log=vanish)
        assert seen(env, 1) == set(range(31, 131))


@pytest.mark.parametrize("traffic", ["replay", "idm"])
def test_objects_stand_where_they_enter_and_stay(traffic):
    steps = np.arange(STEPS)
    seen = {"kind": "static", "valid": (steps >= 50) & (steps < 70)}
    env = log_env(
        agent("ego", 0.5 * steps), agent("cone", 0.01 * steps, 20.0, **seen), traffic=traffic
    )
    env.reset(seed=0)
    for step in range(31, 131):
        env.step([0.0, 0.0])
        states = env.worlds.native.states(0)
        assert states["active"][1] == (step >= 50)
        assert states["position"][1, 0] == (np.float32(0.5) if step >= 50 else 0.0)


def test_who_has_left_by_another_driver_than_its_log_does_not_come_back():
    # the route goes on for 80 m after the log: IDM is through that while the log still brakes
    x = 40.0 + np.minimum(20.0 * TIMES_S, 90.0)
    valid = np.ones(STEPS, bool)
    valid[60:125] = False
    other = agent("other", x, 9.0, valid=valid)
    env = log_env(EGO, other, traffic="idm", speed_limit_mps=40.0)
    there = seen(env, 1)
    assert 31 in there
    assert 100 not in there
    assert there == set(range(31, max(there) + 1))


def test_logged_places_that_overlap_are_the_log():
    walks = {"kind": "pedestrian", "size": (0.6, 0.6, 1.7)}
    walkers = [agent(f"p{i}", 50.0, 5.0 + 0.2 * i, **walks) for i in range(3)]
    late = np.arange(STEPS) >= 60
    walkers[1]["valid"] = walkers[2]["valid"] = late
    # one of them stands in a car that the log has parked there
    car = agent("car", 50.0, 5.0)
    for traffic in ("replay", "idm"):
        env = log_env(EGO, *walkers, car, traffic=traffic)
        for step, states, _ in played(env):
            expected = [True, True, late[step], late[step], True]
            assert list(states["active"]) == expected


def test_nobody_appears_in_an_ego_that_is_not_where_its_log_was():
    # the log drives on, the ego stops where a late arrival is to appear
    late = np.arange(STEPS) >= 45
    other = agent("other", 18.0 + 3.0 * np.maximum(TIMES_S - 8.0, 0.0), valid=late)
    ego = log_env(EGO, other, driver="external")
    brake = np.array([-1.0, 0.0], np.float32)
    for step, states, info in played(ego, brake):
        gap_m = states["position"][1, 0] - states["position"][0, 0]
        assert not info["collision"]
        assert not states["active"][1] or gap_m >= 4.5 - 1e-3, step
    assert states["active"][1]
    # where both follow the log it appears at once, and what it touches then is no collision
    log = log_env(agent("ego", 18.0), other, terminate_at_goal=True)
    for step, states, info in played(log):
        assert states["active"][1] == late[step]
        assert not info["collision"]


@pytest.mark.parametrize("lost", [(), (50,), (52, 53, 54)])
def test_a_lost_frame_changes_no_contact(lost):
    # an ego that brakes is run into from behind, however short the log loses who does it
    valid = np.ones(STEPS, bool)
    valid[list(lost)] = False
    behind = agent("behind", -20.0 + 10.0 * TIMES_S, valid=valid)
    env = log_env(agent("ego", 10.0 * TIMES_S), behind, driver="external")
    *_, (hit, _, info) = played(env, np.array([-1.0, 0.0], np.float32))
    assert info["collision"] == 1.0
    assert hit == max({52} - {*lost}, default=max(lost, default=0) + 1)


def test_contacts_given_at_the_start_stay_given_through_a_lost_frame():
    valid = np.ones(STEPS, bool)
    valid[40] = False
    other = agent("other", 3.0 + 6.0 * TIMES_S, valid=valid)
    for driver in ("replay", "external"):
        env = log_env(EGO, other, driver=driver, traffic="replay")
        action = np.zeros(2, np.float32)
        assert not any(info["collision"] for _, _, info in played(env, action))


def test_no_acceleration_is_invented_where_agents_enter_or_come_back():
    # 1 m/s² all along: bounds of all rates are those of the log
    x = 20.0 + 2.0 * TIMES_S + 0.5 * TIMES_S**2
    late = GAPS & (np.arange(STEPS) >= 40)
    agents = [
        agent("ego", x - 18.0, valid=GAPS),
        agent("gaps", x, 9.0, valid=GAPS),
        agent("late", x, 18.0, valid=late),
        agent("walker", x, 27.0, valid=GAPS, kind="pedestrian"),
    ]
    env = log_env(*agents)
    for step, states, info in played(env):
        there = states["active"]
        assert there[0]
        np.testing.assert_allclose(states["yaw_rate"][there], 0.0)
        follows = there & [GAPS[step], True, True, True]
        np.testing.assert_allclose(states["acceleration"][follows], 1.0, atol=2e-2)
        if GAPS[step - 1] and GAPS[step]:
            assert abs(info["jerk"]) < 0.3, step
        # through a gap the ego goes straight on
        assert info["acceleration"] == pytest.approx(1.0 if GAPS[step] else 0.0, abs=2e-2)


def test_who_has_a_slot_waits_where_its_log_ends_without_braking_for_it():
    x, logged = 6.0 * TIMES_S, np.arange(STEPS) < 100
    env = log_env(agent("ego", x, valid=logged))
    rows = list(played(env))
    assert len(rows) == 100
    assert max(abs(info["acceleration"]) for *_, info in rows) < 1e-2
    assert rows[-1][1]["position"][0, 0] == pytest.approx(x[99])


def test_episodes_start_with_the_accelerations_of_the_log():
    x = 2.0 * TIMES_S + 0.5 * TIMES_S**2
    env = log_env(agent("ego", x))
    env.reset(seed=0)
    assert env.worlds.native.states(0)["acceleration"][0] == pytest.approx(1.0, abs=1e-2)
    (_, _, info), *_ = played(env)
    assert abs(info["jerk"]) < 0.2


@pytest.mark.nuscenes
def test_replay_of_real_scenes_shows_their_logs(data_root):
    for scene in load_nuscenes(data_root / "nuscenes", "v1.0-mini"):
        valid = scene.tracks()["valid"]
        for step, states, _ in played(EgoEnv(scenes=[scene], driver="replay", **GOES_ON)):
            assert states["active"][valid[:, step]].all()


def long_steps(dt_s, history_s):
    """Times of 16 s and options of worlds that begin after a while and take 6 s."""
    window = {"history_steps": round(history_s / dt_s), "horizon_steps": round(6.0 / dt_s)}
    return np.arange(round(16.0 / dt_s)) * dt_s, {"dt_s": dt_s, **window}


@pytest.mark.parametrize("dt_s", [0.1, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("traffic", ["replay", "constant_velocity"])
def test_long_steps_find_the_contacts_of_short_ones(dt_s, traffic):
    # two cars cross at 15 m/s; at the full steps they are far from each other
    times, options = long_steps(dt_s, 3.0)
    at_s = 5.25
    way = 15.0 * (times - at_s)
    ego, cross = agent("ego", way), agent("cross", 0.0, way, heading=np.pi / 2)
    *_, (step, _, info) = played(log_env(ego, cross, traffic=traffic, **options))
    assert info["collision"] == 1.0
    assert step * dt_s == pytest.approx(at_s, abs=max(0.3, dt_s))
    assert info["metrics"]["collision"] == 1.0
    if traffic == "constant_velocity":
        # others that touch stop there
        bystander = agent("ego", 100.0, 50.0)
        env = log_env(bystander, {**ego, "id": "a"}, cross, traffic=traffic, **options)
        *_, (_, states, _) = played(env)
        np.testing.assert_allclose(states["speed"][1:], 0.0)
        assert np.abs(states["position"][1:]).max() < 5.0


@pytest.mark.parametrize("dt_s", [0.1, 0.5])
def test_long_steps_find_the_gap_in_the_road_that_short_ones_find(dt_s):
    times, options = long_steps(dt_s, 1.0)
    ego = agent("ego", 20.0 * times, size=(1.5, 1.0, 1.0))
    ends = [(-200.0, 53.0), (57.0, 500.0)]  # the ego is at 50 m and at 60 m at the long steps
    layers = wide_road()
    layers["drivable_area"] = [
        {"exterior": np.float32([[a, -20], [b, -20], [b, 20], [a, 20]]), "holes": []}
        for a, b in ends
    ]
    env = log_env(ego, layers=layers, on_off_road="ignore", **options)
    steps = [step for step, _, info in played(env) if info["off_road"]]
    assert steps[0] * dt_s == pytest.approx(2.7, abs=dt_s)
    assert steps[-1] * dt_s == pytest.approx(2.8, abs=dt_s)
