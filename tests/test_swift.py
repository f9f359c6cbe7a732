"""Swift traffic: what drives by a small network, its dial, and how it is taught."""

from __future__ import annotations

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import _native
from ccdiff_env.config import CcdiffConfig, WorldConfig
from ccdiff_env.envs import distil
from ccdiff_env.errors import CcdiffError, CheckpointError, ConfigError
from ccdiff_env.models import shipped_weights
from ccdiff_env.system.tensors import read_tensors
from ccdiff_env.traffic import SWIFT, NamedDriver
from ccdiff_env.worlds import Worlds


@pytest.fixture(scope="module")
def scenes():
    return ccdiff_env.embedded_scenes("val")


def played(scenes, steps=30, *, num_threads=1, seed=3, **options):
    """Positions [W, steps, A, 2] of all agents, worlds of every scene side by side."""
    goes_on = {"on_collision": "ignore", "on_off_road": "ignore", "terminate_at_goal": False}
    config = WorldConfig().with_options(traffic=SWIFT, driver="idm", **goes_on, **options)
    worlds = Worlds(scenes, config, num_worlds=len(scenes), num_threads=num_threads)
    native, out = worlds.native, worlds.arrays()
    native.reset([seed] * len(scenes), list(range(len(scenes))), None, out)
    actions = np.zeros((len(scenes), 1, native.action_width), np.float32)
    tracks = []
    for _ in range(steps):
        native.step(actions, out, None)
        tracks.append([native.states(i)["position"].copy() for i in range(len(scenes))])
    return worlds, tracks


def same(a, b):
    steps = zip(a, b, strict=True)
    return all(np.array_equal(x, y) for s, t in steps for x, y in zip(s, t, strict=True))


def test_bits_depend_on_seed_alone(scenes):
    _, one = played(scenes)
    assert same(one, played(scenes, num_threads=3)[1])
    assert not same(one, played(scenes, seed=4)[1])
    alone = ccdiff_env.scenes.SceneSet([scenes[2]])
    assert same([[step[2]] for step in one], played(alone)[1])


def test_plans_are_explained_and_snapshots_go_on(scenes):
    worlds, _ = played(scenes, steps=12, ccdiff={"criticality": 2.0})
    native = worlds.native
    plan = worlds.explain(0)
    assert plan is not None
    assert plan.made_at == 10
    assert plan.samples.shape[2] == 5
    assert plan.guided.any()
    out = worlds.last
    state, actions = native.snapshot(0), np.zeros((len(scenes), 1, native.action_width), np.float32)
    first = []
    for _ in range(8):
        native.step(actions, out, None)
        first.append(native.states(0)["position"].copy())
    native.restore(0, state)
    for expected in first:
        native.step(actions, out, None)
        assert np.array_equal(native.states(0)["position"], expected)


def test_who_is_parked_or_walks_does_as_logged(scenes):
    for scene, i in zip(scenes, range(len(scenes)), strict=True):
        del i
        tracks = scene.tracks()
        span = np.where(tracks["valid"][..., None], tracks["position"], np.nan)
        still = np.nanmax(np.nanmax(span, 1) - np.nanmin(span, 1), 1) < 0.5
        _, moved = played(ccdiff_env.scenes.SceneSet([scene]), steps=10)
        for a in np.flatnonzero(still & tracks["valid"][:, 30]):
            assert np.array_equal(moved[0][0][a], moved[-1][0][a])


def test_the_dial_is_whose_world_it_is(scenes):
    """A strength asked for is as one configured; guided vehicles may be named."""
    config = WorldConfig().with_options(traffic=SWIFT, driver="idm")
    worlds = Worlds(scenes, config, num_worlds=1, num_threads=1)
    native, out = worlds.native, worlds.arrays()
    actions = np.zeros((1, 1, native.action_width), np.float32)

    def after(criticality, guided=None):
        native.reset([5], [0], None, out)
        native.override_plan(0, guided=guided, criticality=criticality)
        for _ in range(20):
            native.step(actions, out, None)
        return native.states(0)["position"].copy(), worlds.explain(0)

    calm, _ = after(None)
    critical, plan = after(3.0)
    assert not np.array_equal(calm, critical)
    assert np.array_equal(calm, after(0.0)[0])
    last = int(plan.ranking[-1])
    named = after(3.0, [last])[1]
    assert named.agents[named.guided].tolist() == [last]
    configured = played(
        ccdiff_env.scenes.SceneSet([scenes[0]]), 20, seed=5, ccdiff={"criticality": 3.0}
    )[1]
    assert np.array_equal(configured[-1][0], critical)


def test_environments_curricula_and_shares_take_it(scenes):
    env = ccdiff_env.make_vec(
        4, scenes=scenes, traffic={SWIFT: 0.5, "idm": 0.5}, criticality=(0.0, 2.0)
    )
    env.reset(seed=0)
    for _ in range(6):
        obs, *_ = env.step(env.action_space.sample())
    assert np.isfinite(obs).all()
    env.close()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"ccdiff": {"denoising_steps": 1}}, "denoising_steps"),
        ({"ccdiff": {"num_samples": 4}}, "num_samples"),
        ({"ccdiff": {"weights": str(shipped_weights("tokens"))}}, "kind"),
        ({"ccdiff": {"weights": "nowhere.safetensors"}}, "nowhere"),
        ({"dt_s": 0.05}, "dt_s"),
    ],
)
def test_what_it_cannot_do_is_refused(scenes, options, text):
    with pytest.raises(CcdiffError, match=text):
        played(scenes, 1, **options)


def test_damaged_files_are_named(scenes, tmp_path):
    tensors, _ = read_tensors(shipped_weights(SWIFT))
    file = tmp_path / "own.safetensors"
    distil.save(file, tensors, [[0.0, 0.0], [1.0, 3.0]], {})
    assert len(played(scenes, 1, ccdiff={"weights": str(file)})[1]) == 1
    distil.save(file, {**tensors, "by_speed": tensors["by_speed"][1:]}, [[0.0, 0.0]], {})
    with pytest.raises(CheckpointError, match="by_speed"):
        played(scenes, 1, ccdiff={"weights": str(file)})
    tensors["speed.bias"][0] = np.nan
    distil.save(file, tensors, [[0.0, 0.0]], {})
    with pytest.raises(CheckpointError, match="finite"):
        played(scenes, 1, ccdiff={"weights": str(file)})


def test_labels_are_what_the_teacher_does(scenes):
    """A vehicle that follows the bins of its labels is where CCDiff's is half a second later."""
    pytest.importorskip("torch")
    labels = distil.collect(
        scenes, {"criticality": 4.0, "denoising_steps": 1}, episodes=8, seed=1, worlds=8
    )
    n = len(labels["bins"])
    assert n > 200
    assert {len(array) for array in labels.values()} == {n}
    assert labels["bins"].min() >= 0
    assert labels["bins"].max() < distil.BINS
    assert (labels["c"] > 0).any()
    assert (labels["c"] == 0).any()
    assert all(np.isfinite(array).all() for array in labels.values())
    # who drives on at its speed has the middle bin
    assert np.median(labels["bins"][:, 1]) == distil.BINS // 2


def test_bins_are_mirrored_with_the_world():
    changes = [(0.4, 0.1), (0.4, -0.1), (-0.4, 0.3), (-0.4, -0.3)]
    bins = np.array(_native.swift_bins(changes))
    assert (bins[0::2, 1] + bins[1::2, 1] == distil.BINS - 1).all()
    assert (bins[0::2, 0] == bins[1::2, 0]).all()


def test_a_network_learns_what_is_told(scenes, tmp_path):
    """On labels that turn left where the route does, more updates mean fewer nats."""
    pytest.importorskip("torch")
    labels = distil.collect(
        scenes, {"criticality": 1.0, "denoising_steps": 1}, episodes=12, seed=2, worlds=12
    )
    labels["scene"] = np.arange(len(labels["scene"])) % 12
    _, before = distil.train([labels], 1, width=32, batch=64)
    tensors, after = distil.train([labels], 150, width=32, batch=64)
    assert after < 0.8 * before
    file = tmp_path / "own.safetensors"
    distil.save(file, tensors, [[0.0, 0.0], [1.0, 3.0]], {}, temperature=0.5)
    policies = {"own": NamedDriver(SWIFT, CcdiffConfig(weights=str(file)))}
    env = ccdiff_env.make_vec(2, scenes=scenes, traffic="own", named_drivers=policies)
    env.reset(seed=0)
    env.close()


def test_a_dial_is_fitted_on_enough_scenes(scenes):
    with pytest.raises(ConfigError, match="at least 10"):
        distil.fitted_dial(ccdiff_env.scenes.SceneSet(list(scenes)[:3]), shipped_weights(SWIFT))
