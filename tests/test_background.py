"""Background vehicles: contacts stop them, parked ones stay, all leave where the map ends."""

import numpy as np
from array_scenes import agent, array_scene
from traffic_play import Play

STEPS = 131
CORNERS = [[-40.0, -30.0], [100.0, -30.0], [100.0, 30.0], [-40.0, 30.0]]
ROAD = {"exterior": np.array(CORNERS, np.float32), "holes": []}


def scene_of(tracks, valid=None, road=ROAD, walkers=0):
    """A scene of cars: an ego that stands aside, and others by positions [T, 2] and headings.

    The last ones of the tracks are pedestrians.
    """
    agents = [agent("ego", np.full(STEPS, -35.0), -25.0)]
    for i, (path, yaw) in enumerate(tracks, 1):
        x, y = np.broadcast_to(path, (STEPS, 2)).T
        there = np.ones(STEPS, bool)
        if i in (valid or {}):
            there[:] = False
            there[valid[i]] = True
        walks = i > len(tracks) - walkers
        more = {"kind": "pedestrian", "size": (0.6, 0.6, 1.8)} if walks else {}
        more["appears"] = True
        agents.append(agent(f"car-{i - 1}", x, y, heading=yaw, valid=there, **more))
    return array_scene(*agents, name="background", layers={"drivable_area": [road]})


def straight(start, velocity):
    time_s = 0.1 * np.arange(STEPS)[:, None]
    yaw = np.arctan2(velocity[1], velocity[0])
    return np.array(start) + time_s * np.array(velocity), yaw


def play(scene, steps=90, **options):
    """Positions [A, T, 2], speeds and presence [A, T] of an episode."""
    made = Play([scene], **options)
    states = [made.native.states(0)]
    for _ in range(steps):
        made.step()
        states.append(made.native.states(0))
    return {n: np.stack([s[n] for s in states], 1) for n in ("position", "speed", "active")}


def test_vehicles_that_touch_stop_there_unless_contacts_are_ignored():
    # two cars meet head on at x = 0, 8 m/s each, 1.2 s after the start
    pair = scene_of([straight((-36.0, 0.0), (8.0, 0.0)), straight((36.0, 0.0), (-8.0, 0.0))])
    stopped = play(pair, traffic="constant_velocity")
    gap = np.diff(stopped["position"][1:, :, 0], axis=0)[0]
    touch = int((gap <= 4.5).argmax())
    assert touch > 0
    # they overlap by less than a 32nd of the way of a step, and stand from the next step on
    assert (gap[touch:] > 4.5 - 0.06).all()
    assert (stopped["speed"][1:, touch] > 7.9).all()
    assert (stopped["speed"][1:, touch + 1 :] == 0.0).all()
    through = play(pair, traffic="constant_velocity", on_traffic_collision="ignore")
    assert np.allclose(through["speed"][1:], 8.0, atol=1e-3)
    # who follows the log goes on through whom it logs
    logged = play(pair, traffic="replay")
    assert np.allclose(logged["speed"][1:], 8.0, atol=1e-3)


def test_contacts_at_the_start_stop_nobody():
    pair = scene_of([straight((0.0, 0.0), (4.0, 0.0)), straight((2.0, 1.0), (4.0, 0.0))])
    played = play(pair, steps=30, traffic="constant_velocity")
    assert np.allclose(played["speed"][1:], 4.0, atol=1e-3)


def test_boxes_that_jitter_are_parked():
    time_s = 0.1 * np.arange(STEPS)
    jitter = np.stack([0.4 * np.sin(2.5 * time_s), np.zeros(STEPS)], axis=1)
    scene = scene_of([(jitter, 0.0), straight((-30.0, 10.0), (5.0, 0.0))])
    assert np.abs(np.gradient(jitter[:, 0], 0.1)).max() > 0.9
    played = play(scene, traffic="idm")
    assert np.ptp(played["position"][1], axis=0).max() == 0.0
    assert np.ptp(played["position"][2], axis=0).max() > 10.0


def test_late_arrivals_take_their_velocity_from_their_path():
    path, yaw = straight((0.0, 0.0), (6.0, 0.0))
    # the first pair of annotations steps backwards
    path[40] = path[41] + (0.5, 0.0)
    scene = scene_of([(path, yaw)], valid={1: slice(40, STEPS)})
    assert scene.tracks()["velocity"][1, 40, 0] < 0.0
    played = play(scene, traffic="constant_velocity")
    entered = int(played["active"][1].argmax())
    assert entered == 10
    assert np.allclose(played["speed"][1, entered:], 4.9, atol=0.01)
    # replay has the log's own
    assert play(scene, traffic="replay")["speed"][1, entered] < 0.0


def test_ccdiff_traffic_leaves_where_the_map_ends():
    # logged up to x = 50; the map ends at 62, the raster of the network at 50 + 113
    path, yaw = straight((-20.0, 0.0), (14.0, 0.0))
    corners = np.array([[min(x, 62.0), y] for x, y in CORNERS], np.float32)
    road = {"exterior": corners, "holes": []}
    played = play(scene_of([(path, yaw)], {1: slice(0, 51)}, road), traffic="ccdiff")
    there = played["active"][1]
    assert not there.all()
    last = played["position"][1, there][-1]
    assert 60.0 < last[0] <= 62.0, last


def walked(scene, **options):
    """Positions [T, A, 2] of an episode in which cars keep their speed."""
    options |= {"traffic": "constant_velocity", "on_traffic_collision": "ignore"}
    return play(scene, 100, driver="external", **options)["position"].swapaxes(0, 1)


def test_pedestrians_give_way_to_cars_and_walk_on():
    # both would be at the origin 2.5 s after the start: the car at 8 m/s, the walker at 1.4 m/s
    car = straight((-44.0, 0.0), (8.0, 0.0))
    walker = straight((0.0, 7.7), (0.0, -1.4))
    scene = scene_of([car, walker], walkers=1)
    into, gives = (walked(scene, pedestrians=who) for who in ("replay", "social_force"))

    def least_gap(seen):
        along, across = np.abs(seen[:, 2] - seen[:, 1]).T
        return np.hypot(np.maximum(along - 2.25, 0), np.maximum(across - 1.0, 0)).min()

    assert least_gap(into) == 0.0
    assert least_gap(gives) > 0.5
    # it waits, then makes up for it
    late = np.linalg.norm(gives[:, 2] - into[:, 2], axis=1)
    assert late[-1] < 2.0 < late.max()
    speed = np.linalg.norm(np.diff(gives[:, 2], axis=0), axis=1) / 0.1
    assert speed.max() <= 1.3 * 1.4 + 1e-3
    np.testing.assert_array_equal(gives[:, 1], into[:, 1])


def test_pedestrians_whom_nobody_meets_walk_as_logged_and_beside_a_car_too():
    alone = scene_of([straight((0.0, 7.7), (0.0, -1.4))], walkers=1)
    np.testing.assert_allclose(walked(alone, pedestrians="social_force"), walked(alone), atol=0.3)
    beside = scene_of(
        [straight((-44.0, 0.0), (8.0, 0.0)), straight((0.0, 3.0), (1.4, 0.0))], walkers=1
    )
    apart = walked(beside, pedestrians="social_force") - walked(beside)
    assert np.abs(apart[:, 2]).max() < 0.3


def test_pedestrians_keep_apart():
    one, two = straight((-8.0, 0.1), (1.2, 0.0)), straight((8.0, -0.1), (-1.2, 0.0))
    scene = scene_of([one, two], walkers=2)
    gaps = [
        np.linalg.norm(seen[:, 1] - seen[:, 2], axis=1).min()
        for seen in (walked(scene), walked(scene, pedestrians="social_force"))
    ]
    assert gaps[0] < 0.25
    assert gaps[1] > gaps[0]
