"""Custom traffic: Python models, mixes, styles of a kind, drivers of single vehicles."""

import math

import numpy as np
import pytest
from array_scenes import GOES_ON

import ccdiff_env
from ccdiff_env import _native
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import CcdiffError, ConfigError, PolicyError, ShapeError, UnknownNameError
from ccdiff_env.models import shipped_weights
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.traffic import KINDS, IdmConfig, PythonTraffic, TrafficBatch

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
    seen: list[TrafficBatch] = []

    def look(batch):
        seen.append(batch)
        return coast(batch)

    env = env_of(PythonTraffic(look, replan_steps=4, history_states=11), num_envs=3)
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
        (lambda _: None, CcdiffError, "python"),
        (lambda _: "left", ShapeError, "left"),
        (lambda b: np.full((len(b.kind), 8, 2), math.nan), PolicyError, "nan"),
        (lambda b: np.full((len(b.kind), 8, 3), 1e30), PolicyError, "below 1e6"),
        (lambda b: b.nothing, AttributeError, "nothing"),
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


def test_single_vehicles_have_drivers_of_their_own():
    env = ccdiff_env.EgoEnv(scenes="val", traffic="idm", driver="idm")
    env.reset(seed=0, options={"scene": "cut-in-03"})
    ids = env.scene.agent_ids
    other = next(i for i, kind in enumerate(env.scene.agent_types) if kind == "vehicle" and i)
    env.reset(seed=0, options={"scene": "cut-in-03", "drivers": {ids[other]: "replay"}})
    names = env.worlds.native.drivers(0)
    assert names[other] == "replay"
    assert names[0] == "idm"
    done = False
    while not done:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        done = terminated or truncated
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


def test_kinds_are_those_of_rust_and_weights_of_another_kind_are_refused():
    titles = [name for name, *_ in _native.drivers()]
    assert set(KINDS) <= set(titles)
    with pytest.raises(ConfigError, match='expected those of "simnet"'):
        env_of("simnet", simnet={"weights": str(shipped_weights("ccdiff"))})


def test_a_model_is_told_the_ego_who_is_parked_and_how_critical_it_shall_be():
    told = []

    def look(batch):
        told.append(batch)
        return coast(batch)

    scenes = ccdiff_env.embedded_scenes("val")[:3]
    env = ccdiff_env.make_vec(3, scenes=scenes, traffic=PythonTraffic(look), criticality=(1.0, 3.0))
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
    env.close()
    logged, _ = TrafficBatch.from_log(scenes, [30] * 3, future_steps=1)
    assert (logged.criticality == 0.0).all()
    assert np.array_equal(logged.is_ego, logged.agent == 0)
