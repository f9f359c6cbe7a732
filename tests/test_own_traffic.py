"""Custom traffic: Python models and their batches, mixes, styles, drivers of single vehicles."""

import collections
import dataclasses
import math

import numpy as np
import pytest
import shapely
from array_scenes import GOES_ON, played, rebuilt
from traffic_play import Play

import ccdiff_env
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import (
    CcdiffError,
    ConfigError,
    PolicyError,
    SceneError,
    ShapeError,
    UnknownNameError,
)
from ccdiff_env.models import shipped_weights
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.traffic import IdmConfig, PythonTraffic, TrafficBatch
from ccdiff_env.traffic.python import ROUTE_SPACING_M

NUM_SCENES = 6
STEPS = 8


def coast(batch: TrafficBatch) -> np.ndarray:
    """Neither accelerate nor turn."""
    return np.zeros((len(batch.kind), STEPS, 2), np.float32)


def wander(batch: TrafficBatch) -> np.ndarray:
    """Turn at random, by the seed of each world."""
    actions = np.zeros((len(batch.kind), STEPS, 2), np.float32)
    for world, seed in enumerate(batch.seed):
        rows = batch.world == world
        actions[rows, :, 1] = np.random.default_rng(seed).normal(0.0, 0.1, rows.sum())[:, None]
    return actions


def straight_on(batch: TrafficBatch) -> np.ndarray:
    """Poses at the present speed, straight on."""
    now, heading = batch.position_m[:, -1], batch.heading_rad[:, -1]
    way = batch.speed_mps[:, -1:] * batch.dt_s * np.arange(1, STEPS + 1)
    x = now[:, :1] + way * np.cos(heading)[:, None]
    y = now[:, 1:] + way * np.sin(heading)[:, None]
    return np.stack([x, y, np.repeat(heading[:, None], STEPS, 1)], axis=-1)


def steady(speed_mps):
    """A model that goes straight on at a speed."""

    def poses(batch: TrafficBatch) -> np.ndarray:
        return straight_on(dataclasses.replace(batch, speed_mps=0.0 * batch.speed_mps + speed_mps))

    return poses


def watching(**options):
    """Traffic that neither accelerates nor turns, and the batches that it is told."""
    seen: list[TrafficBatch] = []
    return PythonTraffic(lambda batch: seen.append(batch) or coast(batch), **options), seen


class Model:
    """A model that is found by its path."""

    def __call__(self, batch: TrafficBatch) -> np.ndarray:
        return wander(batch)


def env_of(traffic, num_envs=2, **options):
    options = {**GOES_ON, "driver": "replay", **options}
    return ccdiff_env.make_vec(num_envs, scenes="val", traffic=traffic, **options)


def walk(env, steps):
    zero = np.zeros(env.action_space.shape, np.float32)
    return [env.step(zero) for _ in range(steps)]


@pytest.mark.parametrize("model", [coast, straight_on])
def test_a_model_that_keeps_speed_and_heading_drives_as_constant_velocity(model):
    ours, theirs = env_of(PythonTraffic(model)), env_of("constant_velocity")
    for env in (ours, theirs):
        env.reset(seed=4)
    names = np.array(ours.worlds.native.drivers(0))
    start = ours.worlds.native.states(0)
    # the unicycle does not reverse
    rows = (names == "python") & start["active"] & (start["speed"] >= 0.0)
    assert rows.any()
    for env in (ours, theirs):
        walk(env, 23)
    mine, expected = ours.worlds.native.states(0), theirs.worlds.native.states(0)
    for name in ("position", "speed", "heading"):
        np.testing.assert_allclose(mine[name][rows], expected[name][rows], atol=5e-3)


def test_a_model_is_called_once_for_all_worlds_that_are_due():
    traffic, seen = watching(replan_steps=4, history_states=11)
    env = env_of(traffic, num_envs=3)
    env.reset(seed=1)
    walk(env, 9)
    assert [batch.elapsed_steps.tolist() for batch in seen] == [[0] * 3, [4] * 3, [8] * 3]
    batch = seen[0]
    m = len(batch.kind)
    assert batch.position_m.shape == (m, 11, 2)
    for array in (batch.heading_rad, batch.speed_mps, batch.valid):
        assert array.shape == (m, 11)
    assert batch.world.tolist() == sorted(batch.world)
    assert len(set(batch.seed.tolist())) == 3
    assert (batch.kind[batch.drives] == 0).all()
    # the history is that of the log up to the start of the episode
    for row in range(m):
        scene, agent = batch.scenes[batch.world[row]], batch.agent[row]
        tracks, past = scene.tracks(), slice(20, 31)
        there = batch.valid[row]
        np.testing.assert_array_equal(there, tracks["valid"][agent, past])
        logged = tracks["position"][agent, past][there]
        np.testing.assert_allclose(batch.position_m[row, there], logged, atol=1e-5)
        np.testing.assert_allclose(batch.size_m[row], scene.sizes[agent, :2])
        assert scene.agent_types[agent] == "vehicle" or batch.kind[row]


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (lambda b: np.zeros((len(b.kind), 3, 2)), ShapeError, "T of at least 5"),
        (lambda b: np.zeros((len(b.kind), 8, 4)), ShapeError, "expected"),
        (lambda b: np.zeros((len(b.kind) + 1, 8, 2)), ShapeError, "expected"),
        (lambda b: np.zeros(len(b.kind)), ShapeError, "expected"),
        (lambda _: None, CcdiffError, "lambda"),
        (lambda _: "left", ShapeError, "left"),
        (lambda b: np.full((len(b.kind), 8, 2), math.nan), PolicyError, "nan"),
        (lambda b: np.full((len(b.kind), 8, 3), 1e30), PolicyError, "below 1e6"),
        (lambda b: b.nothing, PolicyError, "AttributeError.*nothing"),
    ],
)
def test_answers_that_do_not_fit_are_refused_and_nothing_moves(answer, error, message):
    env = env_of(PythonTraffic(answer))
    env.reset(seed=0)
    before = env.worlds.native.digest(0)
    with pytest.raises(error, match=message):
        walk(env, 1)
    assert env.worlds.native.digest(0) == before


def test_models_come_by_path_and_bad_ones_are_named():
    env = env_of(f"{__name__}:Model")
    env.reset(seed=0)
    walk(env, 1)
    assert env.explain(0).samples.shape[2] == STEPS
    assert env.worlds.config.named_drivers["python"].options.described == f"{__name__}:Model"
    for path, message in (
        ("nowhere:Model", "nowhere"),
        (f"{__name__}:Nobody", "Nobody"),
        (f"{__name__}:np", "expected a function"),
    ):
        with pytest.raises(ConfigError, match=message):
            env_of(path)
    for wrong in ({"replan_steps": 0}, {"history_states": 1.5}):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            PythonTraffic(coast, **wrong)
    with pytest.raises(ConfigError, match="expected a function"):
        PythonTraffic(3)


def test_files_do_not_import_code():
    text = WorldConfig().with_options(traffic=PythonTraffic(coast)).to_json()
    with pytest.raises(ConfigError, match="files do not import code"):
        ccdiff_env.EgoEnv(scenes="val", config=WorldConfig.from_json(text))


def test_mixed_traffic_repeats_and_is_recorded_by_name(tmp_path):
    def drivers(seed, num_envs=1):
        policies = {"calm": IdmConfig(headway_s=2.0), "python": PythonTraffic(coast)}
        env = env_of({"calm": 0.5, "python": 0.3, "replay": 0.2}, num_envs, named_drivers=policies)
        env.reset(seed=seed, options={"scene": "cut-in-03"})
        return env, env.worlds.native.drivers(0)

    env, names = drivers(3)
    assert names == drivers(3, num_envs=3)[1]
    assert any(drivers(seed)[1] != names for seed in range(4, 8))
    assert {"calm", "python", "replay"} >= set(names[1:])
    recorder = ccdiff_env.Recorder(env.worlds)
    recorder.start()
    for _ in range(7):
        walk(env, 1)
        recorder.step()
    rollout = recorder.rollout()
    assert list(rollout.driver_names) == names
    kinds = {"calm": "idm", "python": "python", "replay": "replay"}
    assert list(rollout.driver_kinds) == [kinds[name] for name in names]
    rollout.save(tmp_path / "run.npz")
    again = Rollout.load(tmp_path / "run.npz")
    assert again.driver_names == rollout.driver_names
    assert again.driver_kinds == rollout.driver_kinds
    assert again.meta["traffic"] == "50% calm + 30% python + 20% replay"


def test_several_models_plan_in_one_world_and_each_is_followed():
    speeds = {"slow": 3.0, "fast": 9.0}
    models = {n: PythonTraffic(steady(v), replan_steps=4) for n, v in speeds.items()}
    env = env_of(dict.fromkeys(speeds, 0.5), named_drivers=models)
    env.reset(seed=3)
    native = env.worlds.native
    assert sorted(native.planners) == sorted(speeds)
    assert native.explain(0, "fast") is None
    for t in range(9):
        walk(env, 1)
        drivers, states = np.array(native.drivers(0)), native.states(0)
        for name, speed_mps in speeds.items():
            plan = native.explain(0, name)
            assert plan["made_at"] == t // 4 * 4
            agents = plan["agents"]
            assert len(agents) > 0
            assert (drivers[agents] == name).all()
            there = agents[states["active"][agents]]
            np.testing.assert_allclose(states["speed"][there], speed_mps, atol=1e-3)


def test_nobody_plans_for_a_world_that_rests():
    traffic, told = watching(replan_steps=4)
    some, alone = env_of(traffic, 3), env_of(PythonTraffic(coast, replan_steps=4), 1)
    some.reset(seed=3, options={"scene": "cut-in-03"})
    alone.reset(seed=4, options={"scene": "cut-in-03"})
    for t in range(9):
        # worlds 0 and 2 go on in the first two steps alone
        active = np.array([t < 2, True, t < 2])
        obs = some.step(np.zeros((3, 2), np.float32), active=active)[0]
        assert np.array_equal(obs[1], walk(alone, 1)[0][0][0])
        made = [some.explain(i).made_at for i in range(3)]
        assert made == [0, t // 4 * 4, 0]
    assert [len(batch.scenes) for batch in told] == [3, 1, 1]


def test_mixed_traffic_has_its_shares():
    shares = {"idm": 0.5, "constant_velocity": 0.3, "replay": 0.2}
    env, counts = env_of(shares, 64), collections.Counter[str]()
    for seed in range(6):
        env.reset(seed=1000 * seed)
        for world in range(64):
            native = env.worlds.native
            scene = env.worlds.scenes[native.status(world).scene_idx]
            drawn = zip(scene.agent_types, native.drivers(world), strict=True)
            counts.update([name for kind, name in drawn if kind == "vehicle"][1:])
    total = counts.total()
    assert total > 2000
    for name, share in shares.items():
        # five standard deviations
        assert abs(counts[name] / total - share) < 5.0 * math.sqrt(0.25 / total), counts


def test_single_vehicles_have_drivers_of_their_own():
    env = ccdiff_env.EgoEnv(scenes="val", traffic="idm", driver="idm")
    env.reset(seed=0, options={"scene": "cut-in-03"})
    ids = env.scene.agent_ids
    other = next(i for i, kind in enumerate(env.scene.agent_types) if kind == "vehicle" and i)
    options = {"scene": "cut-in-03", "drivers": {ids[other]: "replay"}}
    assert len(list(played(env, options=options))) > 10
    names = env.worlds.native.drivers(0)
    assert (names[0], names[other]) == ("idm", "replay")
    # what the reset chose is part of the certificate
    assert ccdiff_env.replay(env.certificate()).rewards.size
    env.reset(seed=0, options={"scene": "cut-in-03"})
    assert env.worlds.native.drivers(0)[other] == "idm"
    configured = ccdiff_env.EgoEnv(scenes="val", drivers={ids[other]: "constant_velocity"})
    configured.reset(seed=0, options={"scene": "cut-in-03"})
    assert configured.worlds.native.drivers(0)[other] == "constant_velocity"
    for drivers, error in (
        ({"nobody": "idm"}, UnknownNameError),
        ({ids[other]: "ccdiff"}, UnknownNameError),
        ("idm", ConfigError),
    ):
        with pytest.raises(error):
            env.reset(options={"scene": "cut-in-03", "drivers": drivers})
    with pytest.raises(UnknownNameError, match="nobody"):
        ccdiff_env.EgoEnv(scenes="val", drivers={"nobody": "idm"})


def test_weights_of_another_kind_are_refused():
    with pytest.raises(ConfigError, match='expected those of "simnet"'):
        env_of("simnet", simnet={"weights": str(shipped_weights("ccdiff"))})


def test_a_model_is_told_the_ego_who_is_parked_and_how_critical_it_shall_be():
    traffic, told = watching()
    scenes = ccdiff_env.embedded_scenes("val")[:3]
    env = ccdiff_env.make_vec(3, scenes=scenes, traffic=traffic, criticality=(1.0, 3.0))
    _, info = env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, np.float32))
    batch = told[0]
    np.testing.assert_allclose(batch.criticality, info["criticality"], rtol=1e-6)
    assert (batch.criticality >= 1.0).all()
    assert np.array_equal(batch.is_ego, batch.agent == 0)
    for w, scene in enumerate(batch.scenes):
        rows = (batch.world == w) & (batch.kind == 0)
        p, valid = scene.tracks()["position"], scene.tracks()["valid"]
        first = p[np.arange(len(p)), valid.argmax(1)]
        reach = np.where(valid, np.linalg.norm(p - first[:, None], axis=-1), 0.0).max(1)
        speeds = np.where(valid, np.linalg.norm(scene.tracks()["velocity"], axis=-1), 0.0).max(1)
        parked = (reach <= 1.0) | (speeds <= 0.5)
        assert np.array_equal(batch.is_parked[rows], parked[batch.agent[rows]])
    logged, _ = TrafficBatch.from_log(scenes, [30] * 3, future_steps=1)
    assert (logged.criticality == 0.0).all()
    assert np.array_equal(logged.is_ego, logged.agent == 0)


STATES, POINTS = 11, 24
#: Arrays by agent; the others are of worlds.
BY_AGENT = (
    "position_m", "heading_rad", "speed_mps", "valid", "size_m", "kind", "agent", "world",
    "route_m", "route_valid",
)  # fmt: skip


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
    traffic, batches = watching(history_states=STATES, route_points=POINTS)
    env = ccdiff_env.make_vec(
        len(scenes), scenes=scenes, traffic=traffic, driver="python", history_steps=start,
        autoreset_mode="disabled", scene_order="sequential", **GOES_ON,
    )  # fmt: skip
    env.reset(seed=3)
    env.step(np.zeros(env.action_space.shape, np.float32))
    (told,) = batches
    batch, _ = from_log(scenes, [start] * len(scenes))
    # late arrivals apart, whom an episode has not yet
    equal(batch, told, (*BY_AGENT, "drives", "elapsed_steps", "scene_idx"))
    assert batch.scenes == told.scenes
    assert batch.dt_s == told.dt_s
    assert batch.route_valid[batch.drives, 0].all()
    assert not batch.route_valid[~batch.drives].any()


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
