"""Experiments of the traffic benchmark: over-speed, correlation, conflict of gradients, speed."""

from __future__ import annotations

import csv
import json
import re

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import cli, models
from ccdiff_env.bench.correlation import correlations, write_correlations
from ccdiff_env.bench.episode import features, relations
from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.bench.speed import Timing, choose_moments, fit, write_speed
from ccdiff_env.bench.tables import Condition
from ccdiff_env.bench.traffic import START_STEP, episodes, evaluate
from ccdiff_env.metrics import speed_limit

VAL = "embedded/val"
NAMES = ["cut-in-03", "left-turn-04"]


def played(method, num_controlled=2):
    return episodes(scenes_of(VAL, NAMES), METHODS[method], num_controlled=num_controlled)


def measured(method):
    return evaluate(
        source=VAL, names=NAMES, method=method, num_controlled=2, replan_steps=5, seed=0
    )


def test_guidance_for_over_speed_makes_vehicles_faster_than_no_guidance():
    fast, calm = measured("ccdiff_over_speed"), measured("ccdiff_unguided")
    for one, other in zip(fast, calm, strict=True):
        assert one["excess_mps"] > 2.0 * other["excess_mps"]
        assert one["over_speed"] >= other["over_speed"]
        # the same vehicles in the same log
        assert one["over_speed_log"] == other["over_speed_log"]
    assert all(row["over_speed"] for row in fast)


def test_excess_speed_is_that_of_the_log_where_the_log_is_replayed():
    rows = measured("replay")
    for row, episode in zip(rows, played("replay"), strict=True):
        tracks = episode.scene.tracks()
        agents = episode.agents
        speed = np.linalg.norm(tracks["velocity"][agents], axis=-1)
        limit = speed_limit(np.where(tracks["valid"][agents], speed, np.nan))
        chosen = tracks["position"][episode.chosen, START_STEP : START_STEP + 101].astype(float)
        valid = tracks["valid"][episode.chosen, START_STEP : START_STEP + 101]
        moved = np.linalg.norm(np.diff(chosen, axis=1), axis=-1) / episode.scene.dt
        wanted = np.maximum(moved[valid[:, 1:] & valid[:, :-1]] - limit, 0.0).mean()
        assert row["excess_mps"] == pytest.approx(wanted, abs=1e-4)
        assert row["over_speed"] == row["over_speed_log"]


def test_cliques_are_counted_as_networkx_counts_them():
    networkx = pytest.importorskip("networkx")
    for episode in played("replay"):
        found = features(episode)
        history = relations(episode.scene, episode.agents, START_STEP)
        for name, measure in (("ttc_cliques", history.ttc), ("distance_cliques", history.distance)):
            cliques = []
            for matrix in measure:
                joined = np.maximum(np.nan_to_num(matrix), np.nan_to_num(matrix.T)) > 0.0
                np.fill_diagonal(joined, False)
                graph = networkx.from_numpy_array(joined)
                cliques += [c for c in networkx.enumerate_all_cliques(graph) if len(c) > 1]
            assert found[name] == len(cliques)
            if name == "ttc_cliques":
                counts = [sum(a in c for c in cliques) for a in range(len(episode.agents))]
                assert found["of_vehicle"] == counts
        assert found["vehicles"] == len(episode.agents)


def row(scene, cliques, hits):
    return {
        "scene": scene,
        "collision": {"new": any(hits)},
        "vehicle_collided": hits,
        "features": {
            "vehicles": len(hits), "ttc_cliques": sum(cliques), "distance_cliques": 3,
            "of_vehicle": cliques,
        },
    }  # fmt: skip


ROWS = [
    row("a", [5, 1, 0], [True, False, False]),
    row("b", [2, 2], [False, False]),
    row("c", [9, 4, 1, 0], [True, True, False, False]),
    row("d", [0, 1], [False, True]),
]


def test_correlations_agree_with_scipy(tmp_path):
    stats = pytest.importorskip("scipy.stats")
    found = correlations([*ROWS, {"scene": "e", "collision": {"new": True}}])
    cliques = [c for r in ROWS for c in r["features"]["of_vehicle"]]
    hits = [float(h) for r in ROWS for h in r["vehicle_collided"]]
    wanted = stats.pearsonr(cliques, hits)
    assert found["of_vehicle"] == (11, pytest.approx(wanted[0]), pytest.approx(wanted[1]))
    wanted = stats.pearsonr([6, 4, 14, 1], [1.0, 0.0, 1.0, 1.0])
    assert found["ttc_cliques"] == (4, pytest.approx(wanted[0]), pytest.approx(wanted[1]))
    # what does not vary tells nothing
    assert np.isnan(found["distance_cliques"][1])
    table = {Condition("idm", 5, 5): ROWS, Condition("replay", 0, 5): ROWS}
    write_correlations(table, tmp_path)
    text = (tmp_path / "correlation.md").read_text(encoding="utf-8")
    assert text.count("| IDM | 5 | 0.5 |") == 1
    assert "Log replay" not in text
    with (tmp_path / "correlation.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 4


def test_conflict_is_that_of_the_guided_vehicles_of_all_plans():
    rows = measured("ccdiff")
    told = episodes(scenes_of(VAL, NAMES), METHODS["ccdiff"], num_controlled=2, explain=True)
    for row, episode in zip(rows, told, strict=True):
        assert len(episode.plans) > 10
        pairs = [
            (cosine, share)
            for plan in episode.plans
            if plan.guided.any()
            for cosine, share, guided in zip(
                plan.realism_cosine, plan.conflict_share, plan.guided, strict=True
            )
            if guided and cosine != 0.0
        ]
        if not pairs:  # guidance has nothing to ask for in this scene
            assert row["gradient_cosine"] is row["conflict_share"] is None
            continue
        cosine, share = np.array(pairs).mean(axis=0)
        assert row["gradient_cosine"] == pytest.approx(cosine)
        assert row["conflict_share"] == pytest.approx(share)
        assert -1.0 <= row["gradient_cosine"] <= 1.0
        assert 0.0 <= row["conflict_share"] <= 1.0
    for row in measured("ccdiff_unguided"):
        assert row["gradient_cosine"] is None
        assert row["conflict_share"] is None


def test_plans_say_how_gradients_agree_where_asked_and_are_the_same_plans():
    for one, other in zip(
        played("ccdiff"),
        episodes(scenes_of(VAL, NAMES), METHODS["ccdiff"], num_controlled=2, explain=True),
        strict=True,
    ):
        assert one.position.tobytes() == other.position.tobytes()
        for plan, told in zip(one.plans, other.plans, strict=True):
            assert plan.realism_cosine is None
            assert plan.conflict_share is None
            assert plan.samples.tobytes() == told.samples.tobytes()
            if not told.guided.any():
                assert told.realism_cosine is None
                continue
            assert len(told.realism_cosine) == len(told.agents)
            cosine, share = told.realism_cosine, told.conflict_share
            assert (cosine[share == 1.0] < 0.0).all()
            assert (cosine[share == 0.0] >= 0.0).all()


def test_moments_cover_the_numbers_of_vehicles_and_times_are_fitted(tmp_path):
    scenes = ccdiff_env.embedded_scenes("val")
    counts = [
        int((np.array(scene.agent_types) == "vehicle")[scene.tracks()["valid"][:, step]].sum())
        for scene, step in choose_moments(scenes)
    ]
    assert counts == sorted(counts)
    assert len(set(counts)) > 4
    assert max(counts.count(c) for c in counts) <= 2

    timings = [
        Timing(kind, n, start + slope * n, 0.0)
        for kind, start, slope in (("guided", 0.02, 0.004), ("not guided", 0.01, 0.001))
        for n in (2, 5, 9)
    ]
    assert fit(timings, "guided") == pytest.approx((0.02, 0.004))
    assert fit(timings[:1], "guided") == (pytest.approx(0.028), 0.0)
    write_speed(timings, tmp_path)
    text = (tmp_path / "table.md").read_text(encoding="utf-8")
    assert "| 5 | 40.0 | 15.0 |" in text
    assert "guided: 20.0 ms + 4.00 ms per vehicle." in text
    assert (tmp_path / "speed.png").stat().st_size > 0


def test_the_command_times_plans(tmp_path, capsys):
    assert (
        cli.main(["bench", "speed", "--out", str(tmp_path), "--limit", "1", "--rounds", "1"]) == 0
    )
    assert "ms per vehicle" in capsys.readouterr().out
    with (tmp_path / "speed.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {r["kind"] for r in rows} == {"guided", "not guided"}
    assert all(float(r["seconds"]) > 0.0 for r in rows)


def test_weights_of_ones_own_drive_the_methods_of_their_network(tmp_path, capsys):
    of = {name: models.shipped_weights(name) for name in ("ccdiff", "ccdiff_equal", "ctg")}
    command = ["bench", "traffic", "--quiet", "--k", "2", "--limit", "2"]

    def rows(folder, *more):
        given = ["--out", str(tmp_path / folder), "--methods", "ccdiff,ccdiff_equal,ctg", *more]
        assert cli.main([*command, *given]) == 0
        raw = (tmp_path / folder / "raw").glob("*-K2-*.json")
        return {f.name.split("-")[0]: json.loads(f.read_text())["result"] for f in raw}

    shipped = rows("shipped")
    own = rows("own", "--weights", f"ccdiff={of['ccdiff_equal']}")
    assert own["ccdiff"] == shipped["ccdiff_equal"] != shipped["ccdiff"]
    assert own["ctg"] == shipped["ctg"]
    capsys.readouterr()
    for text, said in (
        (f"ccdiff={of['ctg']}", "another run|other settings: own_weights"),
        ("ccdiff", "NETWORK=FILE"),
        (f"idm={of['ctg']}", "NETWORK=FILE"),
        (f"ccdiff={tmp_path}/no", "no weights for ccdiff"),
    ):
        given = ["--out", str(tmp_path / "own"), "--methods", "ccdiff", "--weights", text]
        assert cli.main([*command, *given]) == 2
        assert re.search(said, capsys.readouterr().err), text
    given = ["--out", str(tmp_path / "kind"), "--methods", "ccdiff"]
    assert cli.main([*command, *given, "--weights", f"ccdiff={of['ctg']}"]) == 2
    assert "ctg" in capsys.readouterr().err
