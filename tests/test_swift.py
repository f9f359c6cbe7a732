"""Swift traffic: what drives by a small network, its dial, and how it is taught."""

import json
from pathlib import Path

import numpy as np
import pytest
from array_scenes import TIMES_S, agent, array_scene, wide_road
from traffic_play import Play

import ccdiff_env
from ccdiff_env import _native
from ccdiff_env.config import CcdiffConfig
from ccdiff_env.errors import CcdiffError, CheckpointError, ConfigError
from ccdiff_env.models import shipped_weights
from ccdiff_env.system.tensors import read_tensors
from ccdiff_env.traffic import SWIFT, NamedDriver
from ccdiff_env.training import distil
from ccdiff_env_cli import main


def driven(scenes, **options):
    return Play(scenes, SWIFT, **{"driver": "idm", **options})


def same(a, b):
    steps = zip(a, b, strict=True)
    return all(np.array_equal(x, y) for s, t in steps for x, y in zip(s, t, strict=True))


def test_who_is_parked_or_walks_does_as_logged(scenes):
    moved = driven(scenes).positions(10)
    for i, scene in enumerate(scenes):
        tracks = scene.tracks()
        span = np.where(tracks["valid"][..., None], tracks["position"], np.nan)
        still = np.nanmax(np.nanmax(span, 1) - np.nanmin(span, 1), 1) < 0.5
        for a in np.flatnonzero(still & tracks["valid"][:, 30]):
            assert np.array_equal(moved[0][i][a], moved[-1][i][a])


def test_the_dial_is_whose_world_it_is(scenes):
    """A strength asked for is as one configured; guided vehicles may be named."""

    def after(criticality, guided=None, **options):
        play = driven(scenes[:1], seed=5, **options)
        play.native.override_plan(0, guided=guided, criticality=criticality)
        play.step(20)
        return play.states()["position"], play.worlds.explain(0)

    calm, _ = after(None)
    critical, plan = after(3.0)
    assert not np.array_equal(calm, critical)
    assert np.array_equal(calm, after(0.0)[0])
    last = int(plan.ranking[-1])
    named = after(3.0, [last])[1]
    assert named.agents[named.guided].tolist() == [last]
    assert np.array_equal(after(None, ccdiff={"criticality": 3.0})[0], critical)


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
        driven(scenes, **options).step()


DIAL = [[0.0, 0.0], [1.0, 2.0], [2.0, 5.0]]


def written(file, dial=DIAL, **changed):
    """Options of the shipped network with another dial and other tensors."""
    distil.save(file, read_tensors(shipped_weights(SWIFT))[0] | changed, dial, {})
    return {"weights": str(file)}


@pytest.mark.parametrize(("criticality", "strength"), [(0.5, 1.0), (1.5, 3.5), (4.0, 11.0)])
def test_the_dial_goes_through_its_pairs_and_on(scenes, tmp_path, criticality, strength):
    own = []
    for dial in (DIAL, [[0, 0], [criticality, strength]], [[0, 0], [criticality, strength + 3.0]]):
        options = {**written(tmp_path / "x.st", dial), "criticality": criticality}
        own.append(driven(scenes, ccdiff=options).positions(10))
    assert same(own[0], own[1])
    assert not same(own[0], own[2])


def test_only_guided_vehicles_are_told_of_the_ego(scenes, tmp_path):
    layer = read_tensors(shipped_weights(SWIFT))[0]["trunk.0.weight"].copy()
    layer[:, distil.OWN : distil.OWN + 2 * distil.EGO + 1] += 0.1
    options = [written(tmp_path / "a.st"), written(tmp_path / "b.st", **{"trunk.0.weight": layer})]
    for criticality in (0.0, 2.0):
        told = [{**o, "criticality": criticality} for o in options]
        own = [driven(scenes, ccdiff=ccdiff).positions(10) for ccdiff in told]
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
        driven(scenes, ccdiff=written(tmp_path / "own.safetensors", **changes)).step()


def test_a_learned_choice_guides_it_and_who_chooses_at_a_cost_is_refused(scenes):
    """A price on the moved plan is of networks whose finished plans are moved."""
    driven(scenes, ccdiff={"criticality": 1.0, "adversary_policy": "learned"}).step(10)
    env = ccdiff_env.envs.AdversarySelectionVectorEnv(1, scenes=scenes, traffic=SWIFT)
    env.reset(seed=0)
    assert env.action_masks()[0, 0]
    with pytest.raises(ConfigError, match="finished plans are moved"):
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


def test_labels_of_the_log_are_its_motion():
    """A car that brakes and turns: what it does in half a second, as its polynomials say."""
    speed, yaw = 12.0 - 0.5 * TIMES_S, 0.003 * TIMES_S**2
    way = np.cumsum(np.stack([np.cos(yaw), np.sin(yaw)]) * speed * 0.1, axis=1)
    car = agent("car", *way, heading=yaw)
    stands = agent("stands", -40.0)
    scene = array_scene(agent("ego", 10.0 * TIMES_S, -50.0), car, stands)
    labels = distil.logged(ccdiff_env.SceneSet([scene]), starts=20)
    assert len(labels) == 20
    assert (labels[:, distil.ROW] == 0).all()
    told = _native.swift_bins([(-0.25, 0.0)])[0][0]
    assert (labels[:, -2] == told).mean() > 0.8
    # the car is on its route and goes with it
    seconds = (12.0 - 10.0 * labels[:, 0]) / 0.5
    expected = np.array(_native.swift_bins([(0.0, y) for y in 0.006 * (seconds + 0.25)]))[:, 1]
    assert np.abs(labels[:, -1] - expected).max() <= 1


def test_unguided_vehicles_are_taught_the_way_back_to_their_routes():
    """Beside a straight route and turned from it, they come back in some seconds, hardly beyond."""
    edges = np.linspace(-0.7, 0.7, 1401)
    bins = np.array(_native.swift_bins([(0.0, y) for y in edges]))[:, 1]
    centres = np.array([edges[bins == b].mean() for b in range(distil.BINS)])
    speed, beside_m, heading, way = 8.0, 1.5, 0.1, []
    for _ in range(24):
        row = np.zeros((1, distil.ROW), np.float32)
        row[0, [0, 11]] = speed / 10.0, beside_m / 3.0
        places = row[0, distil.FIRST_PLACE : distil.OWN].reshape(-1, 4)
        places[:, 2], places[:, 3] = 1.0, -np.sin(heading)
        told = [distil._rows(row, np.array([c]), np.zeros(1), np.full(1, 0.2)) for c in (0.0, 1.0)]
        assert told[1][0, -1] == _native.swift_bins([(0.0, 0.4)])[0][1]
        yaw_rate = centres[int(told[0][0, -1])]
        beside_m += 0.5 * speed * np.sin(heading + 0.25 * yaw_rate)
        heading += 0.5 * yaw_rate
        way.append(beside_m)
    assert np.abs(way[-8:]).max() < 0.3
    assert min(way) > -0.3


def test_draws_that_leave_the_road_are_passed_over(tmp_path):
    """Vehicles that turn at random stay on a narrow road; on a wide one they go beyond it."""
    cars = [agent(f"car-{k}", 40.0 * k + 8.0 * TIMES_S) for k in range(8)]
    tensors = read_tensors(shipped_weights(SWIFT))[0]
    any_turn = {name: 0.0 * tensors[name] for name in ("yaw_rate.weight", "yaw_rate.bias")}
    ccdiff, off = written(tmp_path / "own.safetensors", **any_turn), []
    for half_m in (5.0, 100.0):
        scene = array_scene(agent("ego", -200.0), *cars, layers=wide_road(half_m))
        play = driven([scene], driver="replay", ccdiff=ccdiff)
        y = np.array([p[0][1:, 1] for p in play.positions(60)])
        off.append((np.abs(y) > 4.0).mean())
    assert off[1] > 0.2
    assert off[0] < 0.3 * off[1]


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
    words += [str(tmp_path), "--rounds", "2", "--episodes", "8", "--updates", "40"]
    words += ["--teacher", '{"denoising_steps": 1}']
    assert main(words) == 0
    file = Path(capsys.readouterr().out.strip())
    assert json.loads(read_tensors(file)[1]["ccdiff_env"])["dial"][0] == [0.0, 0.0]
    log = (tmp_path / "log.txt").read_text().splitlines()
    assert sum("nats" in line for line in log) == 2
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
