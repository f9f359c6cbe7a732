"""Vehicles that back up in the log: who drives them, and what no driver may do with them."""

import numpy as np
import pytest
from array_scenes import GOES_ON, TIMES_S, agent, array_scene, begun, wide_road

LAYERS = wide_road(lanes=(0, 12))


def out_of_a_drive(radius_m=6.0):
    """Backs out of a drive along y at 1.5 m/s, round to a road along x, and drives on there."""
    way_m = 1.5 * np.minimum(TIMES_S, 9.0)
    turn = np.minimum(way_m / radius_m, np.pi / 2)
    x = -radius_m * (1 - np.cos(turn)) - np.maximum(way_m - radius_m * np.pi / 2, 0.0)
    return x + 4.0 * np.maximum(TIMES_S - 9.0, 0.0), radius_m * (1 - np.sin(turn)), np.pi / 2 - turn


def paths():
    """Place and heading of vehicles that back up."""
    t, still = TIMES_S, np.zeros_like(TIMES_S)
    yield "all along", (40 - 1.5 * t, still, still)
    yield "slowly, then stands", (40 - 0.6 * np.minimum(t, 9), still, still)
    yield "and drives on", (np.where(t < 7, 40 - 1.5 * t, 29.5 + 5 * (t - 7)), still, still)
    yield (
        "after it drove",
        (np.where(t < 8, 6 * t - 0.3 * t**2, 28.8 - 1.5 * (t - 8)), still, still),
    )
    yield "after it stood", (40 - 1.5 * np.maximum(t - 6, 0), still, still)
    yield "out of a drive", out_of_a_drive()


CASES = dict(paths())


def play(scene, row, **options):
    env = begun(scenes=[scene], **GOES_ON, **options)
    native, found = env.worlds.native, []
    for _ in range(101):
        states = native.states(0)
        if states["active"][row]:
            found.append([*states["position"][row], states["heading"][row], states["speed"][row]])
        if len(found) <= 100:
            env.step(np.zeros(env.action_space.shape, np.float32))
    return np.array(found[:101])


def moves_as_a_car(found):
    way = np.linalg.norm(np.diff(found[:, :2], axis=0), axis=1)
    turn = np.abs(np.angle(np.exp(1j * np.diff(found[:, 2]))))
    fastest = np.maximum(np.abs(found[1:, 3]), np.abs(found[:-1, 3]))
    assert (way <= 0.1 * fastest + 0.3).all()
    assert (turn <= 0.3 * np.maximum(way, 0.05)).all()


@pytest.mark.parametrize("lanes", [True, False], ids=["lanes", "no lanes"])
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize(
    ("traffic", "options"),
    [
        ("idm", {}),
        ("swift", {}),
        ("ccdiff", {"ccdiff": {"follow_route": True, "denoising_steps": 1}}),
        ("tokens", {"ccdiff": {"follow_route": True}}),
    ],
)
def test_who_follows_a_route_goes_back_with_the_log_or_waits_and_never_turns_on_the_spot(
    traffic, options, name, lanes
):
    layers = LAYERS if lanes else wide_road()
    x, y, heading = CASES[name]
    other = agent("r", x, y, heading=heading)
    scene = array_scene(agent("ego", -60.0 + 5.0 * TIMES_S, 12.0), other, layers=layers)
    found = play(scene, 1, traffic=traffic, **options)
    moves_as_a_car(found)
    log = np.stack([x, y], -1)[30:131]
    back = np.gradient(x, 0.1) * np.cos(heading) + np.gradient(y, 0.1) * np.sin(heading) < -0.1
    steps = np.flatnonzero(back[30:131])
    if name == "after it drove":  # and is elsewhere: it waits
        assert np.abs(found[-1, 3]) < 0.1
    else:  # it goes with its log for as long as that backs up
        np.testing.assert_allclose(found[: steps[-1] + 1, :2], log[: steps[-1] + 1], atol=1e-3)
    assert np.linalg.norm(found[-1, :2] - log[-1]) < 40.0


@pytest.mark.parametrize("driver", ["idm", "lane_idm", "pdm", "assisted"])
def test_egos_wait_until_their_log_drives_on(driver):
    ego = agent("ego", np.where(TIMES_S < 7, 40 - 1.5 * TIMES_S, 29.5 + 5 * (TIMES_S - 7)))
    scene = array_scene(ego, layers=LAYERS)
    options = {"dynamics": "assisted"} if driver == "assisted" else {"driver": driver}
    found = play(scene, 0, traffic="replay", **options)
    moves_as_a_car(found)
    assert found[:41, 0].max() <= found[0, 0] + 0.1
    assert found[-1, 0] > found[41, 0] + 10.0
    backing = array_scene(agent("ego", 40 - 1.5 * TIMES_S), layers=LAYERS)
    found = play(backing, 0, traffic="replay", **options)
    moves_as_a_car(found)
    assert found[:, 0].max() <= found[0, 0] + 0.1
