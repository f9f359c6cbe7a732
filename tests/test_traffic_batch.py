"""Batches from logs: what a model is told for training is what it is told when it drives."""

import dataclasses

import numpy as np
import pytest
import shapely
from array_scenes import GOES_ON, rebuilt
from traffic_play import Play

import ccdiff_env
from ccdiff_env.errors import ConfigError, SceneError, ShapeError
from ccdiff_env.traffic import PythonTraffic, TrafficBatch
from ccdiff_env.traffic.python import ROUTE_SPACING_M

STATES, POINTS = 11, 24
#: Arrays by agent; the others are of worlds.
BY_AGENT = (
    "position_m", "heading_rad", "speed_mps", "valid", "size_m", "kind", "agent", "world",
    "route_m", "route_valid",
)  # fmt: skip
OPTIONS = {**GOES_ON, "autoreset_mode": "disabled", "scene_order": "sequential"}


@pytest.fixture(scope="module")
def scenes():
    return list(ccdiff_env.embedded_scenes("val"))[:6]


class Watch:
    """A model that keeps what it is told, and lets everybody stand."""

    def __init__(self):
        self.batches: list[TrafficBatch] = []

    def __call__(self, batch):
        self.batches.append(batch)
        return np.zeros((len(batch.kind), 5, 2), np.float32)

    def traffic(self):
        return PythonTraffic(self, replan_steps=5, history_states=STATES, route_points=POINTS)


def equal(batch: TrafficBatch, other: TrafficBatch, names=BY_AGENT) -> None:
    for name in names:
        mine, theirs = getattr(batch, name), getattr(other, name)
        assert mine.dtype == theirs.dtype, name
        assert mine.tobytes() == theirs.tobytes(), name


def from_log(scenes, steps, **options):
    options = {"history_states": STATES, "route_points": POINTS, "future_steps": 8, **options}
    return TrafficBatch.from_log(scenes, steps, **options)


@pytest.mark.parametrize("start", [0, 4, 10, 55])
def test_a_batch_of_a_log_is_that_of_an_episode_which_starts_there(scenes, start):
    watch = Watch()
    env = ccdiff_env.make_vec(
        len(scenes), scenes=scenes, traffic=watch.traffic(), driver="python",
        history_steps=start, **OPTIONS,
    )  # fmt: skip
    env.reset(seed=3)
    env.step(np.zeros(env.action_space.shape, np.float32))
    (told,) = watch.batches
    batch, _ = from_log(scenes, [start] * len(scenes))
    # late arrivals apart, whom an episode has not yet
    equal(batch, told, (*BY_AGENT, "drives", "elapsed_steps", "scene_idx"))
    assert batch.scenes == told.scenes
    assert batch.dt_s == told.dt_s
    assert batch.route_valid[batch.drives, 0].all()
    assert not batch.route_valid[~batch.drives].any()


def test_batches_of_worlds_that_replay_the_log_are_those_of_the_log(scenes):
    watch = Watch()
    env = ccdiff_env.make_vec(
        len(scenes), scenes=scenes, traffic={"python": 0.0, "replay": 1.0},
        named_drivers={"python": watch.traffic()}, driver="replay", history_steps=10, **OPTIONS,
    )  # fmt: skip
    env.reset(seed=3)
    for _ in range(81):
        env.step(np.zeros(env.action_space.shape, np.float32))
    assert len(watch.batches) == 17
    compared = 0
    for told in watch.batches:
        step = 10 + int(told.elapsed_steps[0])
        batch, _ = from_log(scenes, [step] * len(scenes))
        # who comes again after a gap, or where somebody stands, is not let in
        key = [tuple(k) for k in zip(batch.world.tolist(), batch.agent.tolist(), strict=True)]
        there = set(zip(told.world.tolist(), told.agent.tolist(), strict=True))
        rows = np.array([k in there for k in key])
        kept = {name: getattr(batch, name)[rows] for name in BY_AGENT}
        equal(dataclasses.replace(batch, **kept), told)
        assert not told.drives.any()
        compared += rows.sum()
    assert compared > 500


def test_the_future_is_that_of_the_tracks(scenes):
    steps = [40, 0, 33, 120, 10, 60]
    batch, future = from_log(scenes, steps, future_steps=30)
    assert future.position_m.shape == (len(batch.kind), 30, 2)
    for row, (world, agent) in enumerate(zip(batch.world, batch.agent, strict=True)):
        log = scenes[world].tracks()
        after = slice(steps[world] + 1, steps[world] + 31)
        valid = np.zeros(30, bool)
        logged = log["valid"][agent, after]
        valid[: len(logged)] = logged
        np.testing.assert_array_equal(future.valid[row], valid)
        here = np.flatnonzero(valid)
        position, heading = log["position"][agent, after], log["heading"][agent, after]
        np.testing.assert_array_equal(future.position_m[row, here], position[here])
        np.testing.assert_array_equal(future.heading_rad[row, here], heading[here])
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        speed = (log["velocity"][agent, after] * ahead).sum(axis=-1)
        np.testing.assert_allclose(future.speed_mps[row, here], speed[here], atol=1e-5)
        assert not future.position_m[row, ~valid].any()


def test_routes_are_the_worlds_own_from_where_the_vehicles_are(scenes):
    vehicles = [scene.agent_types.count("vehicle") for scene in scenes]
    options = {"controlled": "vehicles", "num_slots": max(vehicles), "driver": "idm"}
    native = Play(scenes, "replay", **options).native
    batch, _ = from_log(scenes, [30] * len(scenes))
    compared = 0
    for row in np.flatnonzero(batch.drives):
        world, agent = int(batch.world[row]), int(batch.agent[row])
        slot = native.slot_agents(world).index(agent)
        path = shapely.LineString(native.route(world, slot)[0])
        start = path.project(shapely.Point(batch.position_m[row, -1]))
        for k in range(POINTS):
            s_m = start + k * ROUTE_SPACING_M
            if abs(s_m - path.length) > 0.01:
                assert batch.route_valid[row, k] == (s_m < path.length)
            if batch.route_valid[row, k]:
                expected = path.interpolate(s_m)
                gap = np.hypot(*(batch.route_m[row, k] - (expected.x, expected.y)))
                assert gap < 0.01, (world, agent, k)
                compared += 1
    assert compared > 800
    # where the vehicles go then is on their routes
    batch, future = from_log(scenes, [30] * len(scenes), route_points=60, future_steps=40)
    for row in np.flatnonzero(batch.drives & (batch.speed_mps[:, -1] > 2.0)):
        line = shapely.LineString(batch.route_m[row][batch.route_valid[row]])
        for at in future.position_m[row][future.valid[row]]:
            assert line.distance(shapely.Point(at)) < 0.5


def test_seeds_differ_between_worlds_and_by_the_seed_alone(scenes):
    first, _ = from_log(scenes, [30] * len(scenes), seed=1)
    again, _ = from_log(scenes, [30] * len(scenes), seed=1)
    other, _ = from_log(scenes, [30] * len(scenes), seed=-2)
    assert len(set(first.seed.tolist())) == len(scenes)
    np.testing.assert_array_equal(first.seed, again.seed)
    assert not set(first.seed.tolist()) & set(other.seed.tolist())


def test_what_makes_no_batch_is_refused(scenes):
    for arguments, options, error, match in (
        (([], []), {}, ConfigError, "scenes: empty"),
        ((scenes[:2], [3]), {}, ShapeError, "expected 2, one for each scene"),
        ((scenes[:1], [10**6]), {}, ConfigError, scenes[0].name),
        ((scenes[:1], [-1]), {}, ConfigError, "at least 0"),
        ((scenes[:1], [1.5]), {}, ConfigError, "integers"),
        ((scenes[:1], [3]), {"history_states": 0}, ConfigError, "history_states"),
        ((scenes[:1], [3]), {"route_points": -1}, ConfigError, "route_points"),
        ((scenes[:1], [3]), {"future_steps": 10**9}, ConfigError, "future_steps"),
    ):
        with pytest.raises(error, match=match):
            from_log(*arguments, **options)
    with pytest.raises(SceneError, match="fast"):
        from_log([scenes[0], rebuilt(scenes[0], "fast", dt=0.05)], [3, 3])
