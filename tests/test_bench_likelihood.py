"""Likelihood of the log: features, histograms, scores of methods that are known."""

import csv

import numpy as np
import pytest
from array_scenes import agent, array_scene, outline

from ccdiff_env import cli
from ccdiff_env.bench.likelihood import (
    FEATURES,
    GROUPS,
    RANK_BINS,
    RANK_SECONDS,
    STRIDE,
    WEIGHTS,
    Feature,
    _features,
    box_gaps,
    evaluate,
    likelihood,
    likelihood_jobs,
    motion_features,
    ranks,
)
from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.bench.traffic import PAPER_WINDOW, episodes, traffic_jobs, window_of
from ccdiff_env.errors import ConfigError, UnknownNameError
from ccdiff_env.metrics import causal
from ccdiff_env.scenes import SceneSet

VAL = "embedded/val"
NAMES = ["cut-in-03", "left-turn-04"]


def test_gaps_of_boxes_agree_with_shapely():
    rng = np.random.default_rng(0)
    for _ in range(20):
        position, heading = rng.uniform(-12, 12, (7, 2)), rng.uniform(-4, 4, 7)
        sizes = rng.uniform([2.0, 1.0], [8.0, 3.0], (7, 2))
        boxes = [
            outline(*place, yaw, size)
            for place, yaw, size in zip(position, heading, sizes, strict=True)
        ]
        found = box_gaps(position, heading, sizes)
        for i, one in enumerate(boxes):
            for j, other in enumerate(boxes):
                wanted = np.inf if i == j else one.distance(other)
                assert found[i, j] == pytest.approx(wanted, abs=1e-9)


def test_motion_on_a_circle_is_known_and_gaps_in_time_are_left_out():
    t = 0.1 * np.arange(60)
    yaw = 0.5 * t + 3.0
    position = 10.0 * np.stack([np.sin(yaw), -np.cos(yaw)], axis=-1)[None]
    wrapped = np.angle(np.exp(1j * yaw))[None]
    valid = np.ones((1, 60), bool)
    valid[0, 30] = False
    found = motion_features(position, wrapped, valid, 0.1)
    np.testing.assert_allclose(found["speed"][0, 1:29], 5.0, rtol=1e-3)
    np.testing.assert_allclose(found["yaw_rate"][0, 1:29], 0.5, atol=1e-9)
    np.testing.assert_allclose(found["acceleration"][0, 2:28], 0.0, atol=1e-9)
    np.testing.assert_allclose(found["yaw_acceleration"][0, 2:28], 0.0, atol=1e-6)
    assert np.isnan(found["speed"][0, [0, 29, 31, 59]]).all()


def test_likelihoods_by_hand():
    feature = Feature(0.0, 4.0, 4)
    samples = [np.array([[0.5, 0.6, 9.0], [1.5, np.nan, 1.0]])]
    log = np.array([[0.1, -3.0], [3.5, np.nan]])
    first, second = 2.1 / 3.4, 0.1 / 2.4
    assert likelihood(feature, samples, log) == pytest.approx((first * first * second) ** (1 / 3))
    # a sample that counts four times is four samples
    assert likelihood(feature, samples, log, 4.0) == pytest.approx(
        likelihood(feature, samples * 4, log)
    )
    assert np.isnan(likelihood(feature, [np.full((1, 2), np.nan)], log[:1]))


def test_the_log_replayed_is_the_ceiling():
    arguments = {"source": VAL, "names": NAMES, "num_samples": 4, "seed": 0}
    replayed = evaluate(**arguments, method="replay")
    for method in ("constant_velocity", "ccdiff_one_sample"):
        for best, row in zip(replayed, evaluate(**arguments, method=method), strict=True):
            assert best["kinematic"] > row["kinematic"]
            assert best["interactive"] > row["interactive"]
            assert best["ade_m"] == 0.0 < row["min_ade_m"] <= row["ade_m"]
            for name in (*FEATURES, *GROUPS):
                assert 0.0 < row[name] <= 1.0


def test_ranks_are_flat_for_samples_of_the_log_and_low_for_faster_ones():
    rng = np.random.default_rng(0)
    samples, log = rng.normal(size=(9, 4000)), rng.normal(size=4000)
    masses = ranks(list(samples), log)
    assert masses.sum() == pytest.approx(4000)
    np.testing.assert_allclose(masses / 4000, 1 / RANK_BINS, atol=0.02)
    # scipy's ranks of the log among ten values, cut into fifths of two places
    stats = pytest.importorskip("scipy.stats")
    places = stats.rankdata(np.vstack([log, samples]), axis=0)[0]
    np.testing.assert_allclose(masses, np.bincount((places - 1).astype(int) // 2), atol=1e-9)
    assert ranks(list(samples + 9.0), log)[0] == pytest.approx(4000)
    # equal values, as of vehicles that stand, say nothing
    np.testing.assert_allclose(ranks([np.zeros(5)] * 4, np.zeros(5)), 1.0)
    assert ranks([np.array([np.nan, 1.0])], np.array([0.0, np.nan])).sum() == 0.0


def test_the_single_figure_is_the_weighted_mean_and_samples_rank_themselves():
    assert sum(WEIGHTS.values()) == pytest.approx(0.95)  # 1 less the lights of the challenge
    row = evaluate(source=VAL, names=NAMES[:1], num_samples=4, seed=0, method="ccdiff_one_sample")[
        0
    ]
    wanted = sum(row[name] * weight for name, weight in WEIGHTS.items()) / 0.95
    assert row["realism"] == pytest.approx(wanted)
    assert 0.0 < row["own_kinematic"] <= 1.0
    assert {f"ranks_{s}s" for s in RANK_SECONDS} <= set(row)
    assert row["processor_s"] > 0.0
    replayed = evaluate(source=VAL, names=NAMES[:1], num_samples=4, seed=0, method="replay")[0]
    assert replayed["own_kinematic"] is None
    assert (replayed["scr"], replayed["orr"]) == (0.0, 0.0)


def test_times_to_contact_are_those_of_the_causal_graph():
    episode = episodes(scenes_of(VAL, NAMES[:1]), METHODS["replay"], num_controlled=0)[0]
    found = _features(episode, episode.motion)
    look = 4
    step = STRIDE * (look + 1)
    tracks = episode.scene.tracks()
    agents = episode.agents
    there = found["speed"][:, step] >= 0.0
    assert there.sum() > 2
    seconds = causal.ttc(
        tracks["position"][agents, PAPER_WINDOW["history_steps"] + step],
        tracks["heading"][agents, PAPER_WINDOW["history_steps"] + step],
        np.nan_to_num(found["speed"][:, step]),
        episode.scene.sizes[agents][:, :2],
        there,
        normalised=False,
    )
    np.fill_diagonal(seconds, np.inf)
    wanted = np.minimum(seconds.min(axis=1), 10.0)
    np.testing.assert_allclose(found["ttc"][there, look], wanted[there], rtol=1e-5)


def test_shares_of_speeds_are_those_of_the_log():
    (row,) = evaluate(source=VAL, names=NAMES[:1], num_samples=1, seed=0, method="replay")
    (episode,) = episodes(scenes_of(VAL, NAMES[:1]), METHODS["replay"], num_controlled=0)
    way = np.diff(episode.log.position, axis=1)
    speed = np.linalg.norm(way[:, 1:] + way[:, :-1], axis=-1) / (2 * episode.scene.dt)
    both = episode.log.valid[:, 2:] & episode.log.valid[:, :-2]
    counts, _ = np.histogram(speed[both], np.arange(26.0))
    np.testing.assert_allclose(row["log_speed_shares"], counts / counts.sum(), atol=1e-3)
    assert row["speed_shares"] == pytest.approx(row["log_speed_shares"], abs=0.01)
    assert sum(row["log_gap_shares"]) == pytest.approx(1.0)


def test_samples_of_a_scene_differ_and_unknown_methods_are_refused():
    arguments = {"source": VAL, "names": NAMES[:1], "method": "ccdiff_one_sample", "seed": 0}
    one, two = (evaluate(**arguments, num_samples=n)[0] for n in (1, 2))
    assert one["min_ade_m"] == one["ade_m"]
    assert two["min_ade_m"] < two["ade_m"]
    assert two["min_ade_m"] <= one["ade_m"]
    with pytest.raises(UnknownNameError, match="no method 'nobody'"):
        likelihood_jobs(VAL, ["nobody"])
    with pytest.raises(ConfigError, match="samples"):
        likelihood_jobs(VAL, ["idm"], num_samples=0)


@pytest.mark.parametrize("jobs", [likelihood_jobs, traffic_jobs])
@pytest.mark.parametrize(("dt_s", "num_steps"), [(0.2, 160), (0.1, 130), (0.1, 33), (0.05, 400)])
def test_scenes_that_hold_no_episode_are_named(monkeypatch, jobs, dt_s, num_steps):
    short = array_scene(agent("ego", np.arange(float(num_steps))), name="short", dt_s=dt_s)
    scenes = SceneSet([*scenes_of(VAL, NAMES), short])
    monkeypatch.setattr("ccdiff_env.bench.traffic.scenes_of", lambda source: scenes)
    words = f"'short' has {num_steps} steps of {dt_s} s, expected at least 131 of 0.1 s, or 91 to 1"
    with pytest.raises(ConfigError, match=words):
        jobs(VAL, ["idm"])


@pytest.mark.parametrize("num_steps", [(90,), (91, 90), (91, 131)])
def test_short_scenes_are_all_short_and_hold_eight_seconds(monkeypatch, num_steps):
    scenes = [array_scene(agent("ego", np.arange(float(n))), name=f"of-{n}") for n in num_steps]
    monkeypatch.setattr("ccdiff_env.bench.traffic.scenes_of", lambda source: SceneSet(scenes))
    last = num_steps[-1]
    words = f"'of-{last}' has {last} steps of 0.1 s, expected .* 91 to 130 in every scene"
    with pytest.raises(ConfigError, match=words):
        window_of("any")


def test_the_command_compares_methods(tmp_path, capsys):
    command = ["bench", "realism", "--out", str(tmp_path), "--quiet", "--limit", "2"]
    assert cli.main([*command, "--methods", "replay,idm", "--samples", "2"]) == 0
    assert "Log replay  " in capsys.readouterr().out
    with (tmp_path / "figures.csv").open(encoding="utf-8") as file:
        rows = {row["method"]: row for row in csv.DictReader(file)}
    assert float(rows["replay"]["kinematic"]) > float(rows["idm"]["kinematic"])
    assert (tmp_path / "report.html").stat().st_size > 0
