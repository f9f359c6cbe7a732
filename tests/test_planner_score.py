"""The score of planners by hand, beside scipy, and beside nuPlan's own classes where they are."""

import json
import os

import numpy as np
import pytest
from array_scenes import agent, array_scene, wide_road
from scipy.signal import savgol_filter

import ccdiff_env
from ccdiff_env import _native
from ccdiff_env.bench.planner_score import (
    COMFORT,
    TTC_BOUND_S,
    comfort,
    no_at_fault,
    progress_share,
    right_way,
    savitzky_golay,
    score_of,
)
from ccdiff_env.bench.planners import TRAFFIC, drive, usual_window
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.errors import ConfigError
from ccdiff_env.scenes import SceneSet

REPLAY = TRAFFIC["replay"]


@pytest.mark.parametrize(
    ("dt_s", "num_steps", "steps"),
    [
        (0.1, 131, [30, 100]),
        (0.1, 130, [10, 80]),
        (0.2, 80, [15, 50]),
        (0.2, 65, [5, 40]),
        (0.05, 261, [60, 200]),
    ],
)
def test_windows_are_of_seconds(dt_s, num_steps, steps):
    scene = array_scene(agent("ego", 5.0 * dt_s * np.arange(num_steps)), dt_s=dt_s)
    assert list(usual_window(scene).values()) == steps


@pytest.mark.parametrize(
    ("window", "degree", "derivative", "n"),
    [
        (*filtered, n)
        for filtered in [(8, 2, 0), (15, 2, 1), (5, 3, 2)]
        for n in (3, 5, 8, 9, 15, 20, 101)
        if n > filtered[1]  # scipy needs more values than the degree
    ],
)
def test_smoothing_is_that_of_scipy(window, degree, derivative, n):
    values = np.random.default_rng(n).normal(size=n)
    expected = savgol_filter(values, min(window, n), degree, derivative, 0.1)
    found = savitzky_golay(values, window, degree, derivative, 0.1)
    assert found == pytest.approx(np.round(expected, 8), abs=2e-8)


def test_two_states_are_smoothed_without_an_error():
    assert savitzky_golay(np.array([1.0, 2.0]), 8, 2) == pytest.approx([1.0, 2.0])
    assert comfort(np.array([1.0]), np.zeros(1), np.zeros(2), 0.1).all()


@pytest.mark.parametrize(
    ("name", "size", "limit"),
    [
        ("acceleration", 20, 2.4),
        ("braking", 20, -4.05),
        ("lateral", 20, 4.89),
        ("yaw rate", 20, 0.95),
        ("yaw acceleration", 9, 1.93),
        ("longitudinal jerk", 11, 4.13),
        ("jerk", 6, 8.37),
    ],
)
def test_each_of_the_six_limits_of_comfort_counts_by_itself(name, size, limit):
    """Steady accelerations and turns, and ramps, within the limit and beyond it."""
    for share, fine in ((0.95, True), (1.1, False)):
        at = share * limit
        time = 0.1 * np.arange(size)
        ramp = time - time.mean()
        zero = np.zeros(size)
        ahead = {"acceleration": zero + at, "braking": zero + at, "longitudinal jerk": at * ramp}
        across = {"lateral": zero + at, "jerk": 0.1 + at * time}
        heading = {"yaw rate": at * time, "yaw acceleration": 0.5 * at * ramp**2}
        calm = comfort(
            ahead.get(name, zero)[1:], across.get(name, zero)[1:], heading.get(name, zero), 0.1
        )
        assert calm[2:-2].all() == fine, (name, share)


def against(speed_mps, steps=30):
    """A lane that is driven backwards."""
    return [(3, 100.0 - 0.1 * speed_mps * k) for k in range(steps)]


@pytest.mark.parametrize(
    ("speed_mps", "score"), [(1.8, 1.0), (1.9, 0.5), (5.4, 0.5), (5.5, 0.0), (-9.0, 1.0)]
)
def test_two_metres_against_a_lane_within_a_second_cost_half_six_all(speed_mps, score):
    """nuPlan sums up eleven steps of 0.1 s."""
    assert right_way(against(speed_mps), 0.1) == score


def test_ways_against_lanes_count_within_one_lane():
    assert right_way([None] * 30, 0.1) == 1.0
    # 3 m backwards in half a second, then away: from the third step in a lane on
    short = against(6.0, 6)
    assert right_way([*short, *[None] * 20], 0.1) == 0.5
    assert right_way([None, (1, 0.0), *short, *[None] * 20], 0.1) == 0.5
    assert right_way([(1, 0.0), *short[:4]], 0.1) == 1.0
    # forwards makes up for backwards within the second
    assert right_way([*against(6.0, 4), *[(3, 98.2 + 2.0 * k) for k in range(9)]], 0.1) == 1.0


def test_the_score_is_the_product_and_the_weighted_mean():
    # progress is a share of the log's of two metres at least; the third log stands
    ways = [(30.0, 60.0), (90.0, 60.0), (0.0, 0.5), (0.0, 8.0), (-1.9, 8.0), (-2.1, 0.0)]
    assert [progress_share(*way) for way in ways] == [0.5, 1.0, 1.0, 0.25, 0.25, 0.0]
    # one object costs half, a road user all
    hits = [{}, {"static": 1}, {"static": 2}, {"vehicle": 1}, {"pedestrian": 1}, {"cyclist": 1}]
    assert [no_at_fault(hit) for hit in hits] == [1.0, 0.5, 0.0, 0.0, 0.0, 0.0]
    parts = dict.fromkeys(PROTOCOL.fields["score"]["gates"], 1.0)
    graded = {"ttc": 0.0, "progress": 0.5, "speed_limit": 0.5, "comfort": 1.0}
    assert score_of({**parts, **graded}) == pytest.approx((2.5 + 2.0 + 2.0) / 16)
    assert score_of({**parts, **graded, "right_way": 0.5}) == pytest.approx(6.5 / 32)
    assert score_of({**parts, **graded, "on_road": 0.0}) == 0.0
    without_road = score_of({**parts, **graded, "on_road": None})
    assert without_road == score_of({**parts, **graded, "on_road": 1.0})


def street(*others, steps=150, ego_mps=None):
    """A street along x, a lane each way, 3.5 m wide, whose ego drives in the right-hand one.

    `others`: kind, x, y, heading, speed of each, straight on. `ego_mps` are speeds by step.
    """
    speeds = np.full(steps, 8.0) if ego_mps is None else np.asarray(ego_mps)
    agents = [agent("ego", np.concatenate([[0.0], np.cumsum(0.1 * speeds[:-1])]), -1.75)]
    for i, (kind, x, y, heading, speed) in enumerate(others):
        way = speed * 0.1 * np.arange(steps)
        x, y = x + np.cos(heading) * way, y + np.sin(heading) * way
        agents.append(agent(f"{i}", x, y, heading=heading, kind=kind))
    layers = wide_road(3.5, (-1.75, 1.75))
    layers["lanes"][1]["centreline"] = layers["lanes"][1]["centreline"][::-1].copy()
    for one in agents:
        one["size"] = (4.0, 2.0, 1.5)
    return array_scene(*agents, name="street", layers=layers)


def row_of(scene, planner="constant_velocity"):
    ((row,), _) = drive(SceneSet([scene]), planner, REPLAY)
    return row


def test_an_episode_goes_on_after_the_goal_to_the_horizon():
    """The log stops 60 m on; who passes there meets a car that stands 20 m further."""
    speeds = np.concatenate([np.full(100, 8.0), np.zeros(50)])
    scene = street(("vehicle", 104.0, -1.75, 0.0, 0.0), ego_mps=speeds)
    stops, passes = row_of(scene, "replay"), row_of(scene)
    assert stops["score"] > 0.8
    assert stops["no_at_fault_collision"] == stops["progress"] == 1.0
    assert passes["progress"] == 1.0
    assert passes["no_at_fault_collision"] == passes["ttc"] == passes["score"] == 0.0


def test_an_obstacle_costs_half_and_no_driver_stands_in_for_it():
    row = row_of(street(("static", 80.0, -1.75, 0.0, 0.0)))
    assert (row["no_at_fault_collision"], row["ttc"]) == (0.5, 0.0)
    assert row_of(street(("vehicle", 80.0, -1.75, 0.0, 0.0)))["no_at_fault_collision"] == 0.0


def test_who_stands_or_is_hit_from_behind_keeps_ttc():
    """A car drives into the ego from behind: nuPlan expects nobody to look back."""
    behind = street(("vehicle", -40.0, -1.75, 0.0, 10.0), ego_mps=np.full(150, 4.0))
    row = row_of(behind)
    assert row["collision"] == 1.0
    assert (row["no_at_fault_collision"], row["ttc"], row["min_ttc_s"]) == (1.0, 1.0, 0.0)


def swerves(obs):
    """Into the other lane, and straight on there."""
    swerves.calls += 1
    turn = 0.5 * (4 <= swerves.calls < 12) - 0.5 * (15 <= swerves.calls < 23)
    return np.tile([0.0, turn], (len(obs), 1))


def test_the_oncoming_lane_is_the_wrong_way_by_its_surface():
    swerves.calls = 0
    row = row_of(street(), swerves)
    assert row["right_way"] == 0.0
    assert row["on_road"] == 1.0
    # nobody goes against the own lane
    assert row_of(street())["right_way"] == 1.0


def test_wider_limits_of_motion_than_the_default_ones_are_refused():
    def planner(obs):
        return np.zeros((len(obs), 3))

    for dynamics, words in (
        ({"delta_pose": {"dx_m": [-100.0, 100.0]}}, "dx_m of DeltaPoseLimits"),
        ({"unicycle": {"speed_mps": [0.0, 60.0]}}, "speed_mps of UnicycleLimits"),
        ({"unicycle": {"max_curvature_1pm": 2.0}}, "lets a planner choose at most 0.5"),
        ({"bicycle": {"wheelbase_share": 0.1}}, "at least 0.6"),
    ):
        planner.env_options = {"dynamics": dynamics}
        with pytest.raises(ConfigError, match=words):
            drive(ccdiff_env.embedded_scenes("val")[:1], planner, REPLAY)
    planner.env_options = {"dynamics": {"delta_pose": {"dx_m": [-0.5, 2.0]}}}
    assert drive(ccdiff_env.embedded_scenes("val")[:1], planner, REPLAY)[0]


@pytest.mark.skipif(
    "CCDIFF_NUPLAN" not in os.environ, reason="CCDIFF_NUPLAN names no checkout of nuplan-devkit"
)
@pytest.mark.parametrize("planner", ["lane_idm", "constant_velocity"])
def test_parts_are_those_of_nuplans_own_metrics(planner):
    from nuplan_metrics import SAME, compare

    scenes = ccdiff_env.embedded_scenes("val")[:6]
    rows, rollouts = drive(scenes, planner, REPLAY, record=scenes.names)
    for row in rows:
        for part, (ours, theirs, *more) in compare(rollouts[row["scene"]], row).items():
            assert ours == pytest.approx(theirs, abs=SAME), (row["scene"], part, more)


def test_limits_of_rewards_and_of_pdm_are_those_of_the_score():
    limits = json.loads(_native.schema("limits"))
    assert limits.pop("ttc_s") == pytest.approx(TTC_BOUND_S)
    both = {k: of if isinstance(of, list) else [-of, of] for k, of in limits.items()}
    assert both == {name: pytest.approx(ends) for name, ends in COMFORT.items()}
