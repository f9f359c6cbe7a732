"""A truck and its trailer, two boxes that overlap and move together in the log, stay hitched."""

import numpy as np
import pytest
from array_scenes import TIMES_S, agent, array_scene, log_env, outline, played

import ccdiff_env
from ccdiff_env import EgoEnv
from ccdiff_env.envs.selection import AdversarySelectionVectorEnv
from ccdiff_env.errors import ConfigError

EGO = agent("ego", -60.0 + 6.0 * TIMES_S)
TRUCK = {"size": (6.0, 2.5, 3.2)}
TRAILER = {"size": (12.0, 2.5, 3.8)}


def hitched(x, y=20.0, **more):
    """A truck and its trailer 8 m behind: 1 m of overlap."""
    return [agent("truck", x, y, **TRUCK, **more), agent("trailer", x - 8.0, y, **TRAILER, **more)]


@pytest.mark.parametrize(
    "traffic", ["replay", "idm", "constant_velocity", "egos", "ccdiff", "tokens"]
)
@pytest.mark.parametrize("starts", [False, True])
def test_they_stay_hitched_whatever_drives(traffic, starts):
    x = 20.0 + (np.maximum(TIMES_S - 3.2, 0.0) ** 2 if starts else 8.0 * TIMES_S)
    for _, states, _ in played(log_env(EGO, *hitched(x), traffic=traffic)):
        assert states["active"][1] == states["active"][2]
        if states["active"][1]:
            gap = states["position"][1] - states["position"][2]
            assert np.hypot(*gap) == pytest.approx(8.0, abs=0.6)
            assert states["speed"][2] == pytest.approx(states["speed"][1], abs=0.5)
            assert abs(states["acceleration"][2] - states["acceleration"][1]) < 1.0


def test_a_recording_says_that_the_trailer_is_towed(tmp_path):
    env = log_env(EGO, *hitched(20.0 + 8.0 * TIMES_S), traffic="idm")
    env.reset(seed=0)
    recorder = ccdiff_env.Recorder(env)
    env.step(np.zeros(2, np.float32))
    recorder.step()
    rollout = recorder.rollout()
    assert list(rollout.driver_names) == ["replay", "idm", "towed"]
    rollout.save(tmp_path / "a.npz")
    assert ccdiff_env.Rollout.load(tmp_path / "a.npz").driver_names == rollout.driver_names


def test_a_towed_box_rolls_round_a_bend_like_a_trailer():
    # on a circle of 30 m the axle, 9 m behind the hitch, runs on one of sqrt(30.1² - 8.5²) m
    way = 8.0 * TIMES_S / 30.0
    x, y = 30.0 * np.sin(way), 30.0 - 30.0 * np.cos(way)
    x2, y2 = 30.0 * np.sin(way - 8.2 / 30.0), 30.0 - 30.0 * np.cos(way - 8.2 / 30.0)
    truck = agent("truck", x, y, heading=way, **TRUCK)
    trailer = agent("trailer", x2, y2, heading=way - 8.2 / 30.0, **TRAILER)
    ego = agent("ego", -60.0 + 0.6 * np.arange(160), -50.0)
    headings = []
    for _, states, _ in played(log_env(ego, truck, trailer, traffic="idm")):
        if states["active"][2]:
            turn = states["heading"][1] - states["heading"][2]
            headings.append((turn + np.pi) % (2.0 * np.pi) - np.pi)
    assert 0.15 < headings[-1] < 0.45
    assert max(np.abs(np.diff(headings))) < 0.03


def test_overlaps_of_parked_cars_and_of_neighbours_are_no_hitch():
    # annotation noise: parked boxes overlap, and cars side by side, and one that passes
    parked = [agent("a", 40.0, 9.0), agent("b", 43.0, 9.0)]
    beside = [agent("c", 8.0 * TIMES_S, 15.0), agent("d", 8.0 * TIMES_S - 0.5, 16.9)]
    passing = [agent("e", 8.0 * TIMES_S, 30.0), agent("f", 12.0 * TIMES_S - 20.0, 30.0)]
    scene = array_scene(EGO, *parked, *beside, *passing)
    env = ccdiff_env.parallel_env(scenes=[scene], agents="all", names="token")
    env.reset(seed=0)
    assert len(env.agents) == 7


def test_contacts_between_them_never_count_and_the_trailer_is_no_agent_of_its_own():
    truck, trailer = hitched(8.0 * TIMES_S)
    env = log_env({**truck, "id": "ego"}, trailer, driver="external")
    scene = env.scenes[0]
    for _, states, info in played(env, np.array([0.1, 0.2], np.float32)):
        assert not info["collision"]
        assert info["ttc"] == 10.0
        gap = states["position"][0] - states["position"][1]
        assert np.hypot(*gap) == pytest.approx(8.0, abs=1.0)
    assert scene.ranked_vehicles(30, "nearest") == [0]
    rows = ccdiff_env.parallel_env(scenes=[scene], agents="all", start_spread_steps=5)
    rows.reset(seed=0)
    assert rows.agents == ["ego"]


def test_drivers_are_named_for_the_truck_alone():
    made = {"scenes": [array_scene(EGO, *hitched(20.0 + 8.0 * TIMES_S))], "traffic": "idm"}
    with pytest.raises(ConfigError, match=r"trailer.*no other one tows"):
        EgoEnv(drivers={"trailer": "replay"}, **made)
    env = EgoEnv(**made)
    with pytest.raises(ConfigError, match="'trailer' of own is towed by 'truck'"):
        env.reset(seed=0, options={"drivers": {"trailer": "replay"}})
    env.reset(seed=0, options={"drivers": {"truck": "replay"}})
    assert env.worlds.native.drivers(0)[1:] == ["replay", "replay"]


def test_a_trailer_leaves_with_its_truck_at_the_goal():
    env = ccdiff_env.parallel_env(
        scenes=[array_scene(EGO, *hitched(8.0 * TIMES_S))], agents="all", traffic="idm"
    )
    env.reset(seed=0)
    native, left = env.unwrapped.worlds.native, False
    while env.agents:
        env.step({name: np.float32([0.2, 0.0]) for name in env.agents})
        there = native.states(0)["active"]
        assert there[1] == there[2]
        left |= not there[1]
    assert left


@pytest.mark.parametrize("driver", ["external", "replay"])
def test_what_its_trailer_touches_an_ego_has_touched(driver):
    x = 8.0 * TIMES_S
    truck, trailer = hitched(x)
    # a post that appears between the truck's rear and the trailer's
    shown = np.arange(160) >= 60
    post = agent("post", x[60] - 8.0, 20.0, size=(0.4, 0.4, 1.0), kind="static", valid=shown)
    ego, zero = {**truck, "id": "ego"}, np.zeros(2, np.float32)
    options = {"driver": driver, "terminate_at_goal": True}
    env = log_env(ego, trailer, post, on_collision="ignore", **options)
    # given: it is in the trailer when it appears
    assert not any(info["collision"] for _, _, info in played(env, zero))
    ahead = agent("post", x[60] - 4.0, 21.4, size=(0.4, 0.4, 1.0), kind="static")
    wide = {**trailer, "size": (12.0, 3.2, 3.8)}  # the truck passes the post, its trailer does not
    *_, (_, _, info) = played(log_env(ego, wide, ahead, **options), zero)
    assert info["collision"] == 1.0
    assert info["collision_partner"] == 3.0


def test_a_truck_that_is_stopped_by_a_contact_stops_with_its_trailer():
    agents = EGO, *hitched(8.0 * TIMES_S), agent("car", 90.0, 20.0)
    *_, (_, states, _) = played(log_env(*agents, traffic="constant_velocity"))
    assert states["speed"][1] == states["speed"][2] == 0.0
    assert states["position"][1, 0] - states["position"][2, 0] == pytest.approx(8.0, abs=1e-3)


@pytest.mark.parametrize("behind_m", [-60.0, 8.0, 15.0])
def test_what_its_trailer_touches_an_adversary_has_touched(behind_m):
    """The log of the ego turns into nobody, into both boxes, and into the trailer alone."""
    x = 20.0 + 8.0 * TIMES_S
    y = 30.0 - 5.0 * np.clip(TIMES_S - 4.0, 0.0, 2.0)
    scene = array_scene(agent("ego", x - behind_m, y), *hitched(x))
    env = AdversarySelectionVectorEnv(1, scenes=[scene], ego="replay")
    env.reset(seed=0)
    counted = 0.0
    while not env.ended.all():
        counted += env.decide([([1], 1.0)])[1]["collisions"][0]
    states = env.worlds.native.states(0)
    ego, *boxes = map(outline, *states["position"].T, states["heading"], scene.sizes)
    touched = [box.intersects(ego) for box in boxes]
    assert touched == [behind_m == 8.0, behind_m > 0.0]
    assert counted == any(touched)
