"""Swift traffic: what drives by a small network, its dial, and how it is taught."""

from __future__ import annotations

import json
from pathlib import Path

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
from ccdiff_env_cli import main


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


DIAL = [[0.0, 0.0], [1.0, 2.0], [2.0, 5.0]]


def written(file, dial=DIAL, **changed):
    """Options of the shipped network with another dial and other tensors."""
    distil.save(file, read_tensors(shipped_weights(SWIFT))[0] | changed, dial, {})
    return {"weights": str(file)}


@pytest.mark.parametrize(("criticality", "strength"), [(0.5, 1.0), (1.5, 3.5), (4.0, 11.0)])
def test_the_dial_goes_through_its_pairs_and_on(scenes, tmp_path, criticality, strength):
    same_strength = [[0.0, 0.0], [criticality, strength]]
    own = [
        played(scenes, 10, ccdiff={**written(tmp_path / "x.st", dial), "criticality": criticality})[
            1
        ]
        for dial in (DIAL, same_strength, [[0.0, 0.0], [criticality, strength + 3.0]])
    ]
    assert same(own[0], own[1])
    assert not same(own[0], own[2])


def test_only_guided_vehicles_are_told_of_the_ego(scenes, tmp_path):
    layer = read_tensors(shipped_weights(SWIFT))[0]["trunk.0.weight"].copy()
    layer[:, distil.OWN : distil.OWN + 2 * distil.EGO + 1] += 0.1
    options = [written(tmp_path / "a.st"), written(tmp_path / "b.st", **{"trunk.0.weight": layer})]
    for criticality in (0.0, 2.0):
        own = [played(scenes, 10, ccdiff={**o, "criticality": criticality})[1] for o in options]
        assert same(*own) == (criticality == 0.0)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"by_speed": np.zeros((20, 64), np.float32)}, "by_speed"),
        ({"speed.bias": np.full(21, np.nan, np.float32)}, "finite"),
        ({"more": np.zeros(1, np.float32)}, "more"),
        ({"dial": [[0.0, 0.0], [1.0, -1.0]]}, "dial"),
        ({"dial": [[1.0, 1.0]]}, "dial"),
        ({"dial": "x"}, "dial"),
    ],
)
def test_damaged_files_are_named(scenes, tmp_path, changes, text):
    with pytest.raises(CheckpointError, match=text):
        played(scenes, 1, ccdiff=written(tmp_path / "own.safetensors", **changes))


def test_a_learned_choice_guides_it_and_who_chooses_at_a_cost_is_refused(scenes):
    """The shift of a plan in standard deviations is of networks that denoise."""
    played(scenes, 10, ccdiff={"criticality": 1.0, "adversary_policy": "learned"})
    env = ccdiff_env.envs.AdversarySelectionVectorEnv(1, scenes=scenes, traffic=SWIFT)
    env.reset(seed=0)
    assert env.action_masks()[0, 0]
    with pytest.raises(ConfigError, match="denoises"):
        env.step([0])
    env.close()


def test_labels_are_what_the_teacher_does(scenes):
    """They are sound, at all strengths, and who drives on straight has the middle bin."""
    labels = distil.collect(
        scenes, {"criticality": 4.0, "denoising_steps": 1}, episodes=8, seed=1, worlds=8
    )
    assert len(labels) > 200
    assert np.isfinite(labels).all()
    told, bins = labels[:, distil.ROW], labels[:, -2:]
    assert bins.min() >= 0
    assert bins.max() < distil.BINS
    assert 0 < (told > 0).mean() < 1
    assert np.median(bins[:, 1]) == distil.BINS // 2


def test_bins_are_mirrored_with_the_world():
    changes = [(0.4, 0.1), (0.4, -0.1), (-0.4, 0.3), (-0.4, -0.3)]
    bins = np.array(_native.swift_bins(changes))
    assert (bins[0::2, 1] + bins[1::2, 1] == distil.BINS - 1).all()
    assert (bins[0::2, 0] == bins[1::2, 0]).all()


def test_the_command_makes_traffic_and_goes_on(tmp_path, monkeypatch, capsys):
    """Rounds of teacher and student, trainings, dial; what a run has is not made again."""
    pytest.importorskip("torch")
    monkeypatch.setattr(distil, "FITTED", (1.0,))
    monkeypatch.setattr(distil, "TRIED", (0.0, 4.0))
    words = ["distil", "--scenes", "embedded/val", "--fit-scenes", "embedded/val", "--out"]
    words += [str(tmp_path), "--rounds", "2", "--episodes", "8", "--updates", "40", "--seeds", "2"]
    words += ["--teacher", '{"denoising_steps": 1}']
    assert main(words) == 0
    file = Path(capsys.readouterr().out.strip())
    assert json.loads(read_tensors(file)[1]["ccdiff_env"])["dial"][0] == [0.0, 0.0]
    log = (tmp_path / "log.txt").read_text().splitlines()
    assert sum("nats" in line for line in log) == 3
    first = file.read_bytes()
    file.unlink()
    assert main(words) == 0
    assert file.read_bytes() == first
    assert len((tmp_path / "log.txt").read_text().splitlines()) == len(log) + 1
    policies = {"own": NamedDriver(SWIFT, CcdiffConfig(weights=str(file)))}
    env = ccdiff_env.make_vec(2, scenes="embedded/val", traffic="own", named_drivers=policies)
    env.reset(seed=0)
    env.close()


def test_a_network_learns_what_is_told():
    """On labels that turn where the route does, more updates mean fewer nats."""
    pytest.importorskip("torch")
    rng = np.random.default_rng(0)
    labels = rng.normal(size=(512, distil.ROW + 3)).astype(np.float32)
    labels[:, distil.ROW - 1 : -2], labels[:, -2] = 0.0, distil.BINS // 2
    labels[:, -1] = distil.BINS // 2 + np.sign(labels[:, distil.OWN_MIRRORED[-1]])
    nats = [distil.train(labels, labels, n, width=32, batch=64)[1] for n in (1, 200)]
    assert nats[1] < 0.3 * nats[0]


def test_a_dial_is_fitted_on_enough_scenes(tmp_path, capsys):
    words = ["--scenes", "embedded/val", "--fit-scenes", "embedded/val?limit=3"]
    assert main(["distil", *words, "--out", str(tmp_path)]) == 2
    assert "at least 10" in capsys.readouterr().err


def test_egos_train_are_judged_and_shown_in_it(scenes, tmp_path):
    """``train-ego``, stable-baselines3 as in README.md, the benchmark of planners, pages."""
    pytest.importorskip("torch")
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO

    from ccdiff_env.envs.sb3 import SB3VecEnv

    out = ["--out", str(tmp_path / "ego")]
    assert main(["train-ego", "--smoke", "--traffic", SWIFT, "idm", "--threads", "1", *out]) == 0
    worlds = ccdiff_env.make_vec(4, scenes=scenes, traffic=SWIFT, decision_steps=3)
    PPO("MlpPolicy", SB3VecEnv(worlds), n_steps=8, batch_size=32, device="cpu").learn(32)
    words = ["bench", "planners", "--planners", "idm", "--traffic", "swift,swift-1", "--limit", "2"]
    assert main([*words, "--quiet", "--out", str(tmp_path / "bench")]) == 0
    words = ["view", scenes[0].name, "--traffic", SWIFT, "--criticality", "2"]
    assert main([*words, "--out", str(tmp_path / "page.html")]) == 0
