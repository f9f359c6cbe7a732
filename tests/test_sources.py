"""Data sources: texts, the argument block, coverage, and what scenes without a road do not have."""

import argparse
import csv
import json
import pickle
import re
import warnings

import gpudrive_scene
import numpy as np
import pytest
from array_scenes import GOES_ON, played, rebuilt
from test_scenes_scenarionet import save, scenario

import ccdiff_env
from ccdiff_env.bench.intervals import FEW, mean_interval
from ccdiff_env.bench.verify import replayed
from ccdiff_env.errors import ConfigError, UnknownNameError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import of_kinds
from ccdiff_env.scenes.arguments import (
    add_other_scenes,
    add_scene_arguments,
    other_place,
    place_from,
)
from ccdiff_env.scenes.embedded import VERSION, embedded_splits, unpack
from ccdiff_env.scenes.scenarionet_export import scenario_dict
from ccdiff_env.scenes.sources import SOURCES, Source, coverage, parse, settle, title
from ccdiff_env.system.table import Column
from ccdiff_env_cli import main

FOLDER, MINI = "/data/nuscenes", "v1.0-mini"
PLANNERS = ["bench", "planners", "--planners", "idm", "--traffic", "replay", "--quiet"]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("embedded", ("embedded", None, None, None, None)),
        ("embedded/val", ("embedded", None, None, "val", None)),
        ("embedded/train+val?limit=3", ("embedded", None, None, "train+val", 3)),
        (f"nuscenes:{FOLDER}", ("nuscenes", FOLDER, None, None, None)),
        (f"nuscenes:{FOLDER}/val", ("nuscenes", FOLDER, None, "val", None)),
        (f"nuscenes:{FOLDER}@{MINI}", ("nuscenes", FOLDER, MINI, None, None)),
        (f"nuscenes:{FOLDER}@{MINI}/mini_val", ("nuscenes", FOLDER, MINI, "mini_val", None)),
        ("nuscenes:/a@b/c/all?limit=2", ("nuscenes", "/a@b/c", None, "all", 2)),
        ("nuscenes:/data/val/val", ("nuscenes", "/data/val", None, "val", None)),
        ("scenarionet:/data/val", ("scenarionet", "/data/val", None, None, None)),
        ("embedded/val?window_s=8&limit=2", ("embedded", None, None, "val", 2)),
        ("scenarionet:a@b/c.pkl", ("scenarionet", "a@b/c.pkl", None, None, None)),
    ],
)
def test_texts_have_parts_and_places_give_them_back(text, parts):
    place = parse(text)
    assert (place.source, place.path, place.version, place.split, place.limit) == parts
    assert str(place) == text
    whole = settle(place)
    assert parse(str(whole)) == whole


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nuscene:/a", "no source 'nuscene' (did you mean 'nuscenes'?)"),
        (
            "/data/nuscenes",
            "no source ''; a folder or file needs one before it, as in nuscenes:/data",
        ),
        ("left-turn-00", "load(\"embedded\", names=['left-turn-00'])"),
        ("", "no source ''"),
        (
            "embedded/vall",
            "no split 'vall', expected one of train, val, city, train-lights, val-lights, "
            "city-lights, all (did you mean 'val'",
        ),
        ("embedded:/a", "':/a' after 'embedded'"),
        ("embedded/", "no split ''"),
        ("scenarionet", "no path"),
        ("nuscenes:", "no path"),
        ("nuscenes:/a@v1.0-mini/mini_vla", "no split 'mini_vla'"),
        ("nuscenes:/nowhere/mini_vla", "neither a folder nor a split 'mini_vla' (did you mean"),
        ("embedded?limit=0", "limit is 0, expected a whole number, at least 1"),
        ("embedded/val?limit=-1", "'limit=-1', expected limit, window_s"),
        ("embedded/val?limit=2&windows=8", "'limit=2&windows=8', expected limit, window_s"),
        ("gpudrive:/a/*.json?windows=8", "'windows=8', expected limit, window_s"),
        ("embedded?window_s=8&window_s=9", "an option twice"),
        ("embedded?window_s=0", "window_s is 0.0, expected seconds"),
        ("embedded?window_s=8&stride_s=no", "could not convert string to float: 'no'; expected"),
        ("embedded?stride_s=2", "stride_s=2': expected window_s in seconds, and stride_s"),
        ("embedded/val?limit=two", "limit is 'two', expected a whole number"),
    ],
)
def test_wrong_texts_are_told_with_the_sources_there_are(text, message):
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        ccdiff_env.load(text)
    for part in (repr(text), *(source.form for source in SOURCES.values())):
        assert part in str(caught.value)


def test_embedded_scenes_are_those_of_their_splits():
    splits = embedded_splits()
    for text, names in {
        "embedded/val": splits["val"],
        "embedded/val?limit=2": splits["val"][:2],
        "embedded/train+val": (*splits["train"], *splits["val"]),
        "embedded": (*splits["train"], *splits["val"]),
    }.items():
        assert ccdiff_env.load(text).names == tuple(names)
    few = ccdiff_env.load("embedded/val", limit=4, names=splits["val"][::-1])
    assert few.names == tuple(splits["val"][::-1][:4])
    one = ccdiff_env.load("embedded", names=splits["val"][0], kinds="pedestrian")
    assert one.names == splits["val"][:1]
    assert set(one[0].agent_types) == {"vehicle", "pedestrian"}
    every = [*ccdiff_env.load("embedded"), *ccdiff_env.load("embedded/city")]
    agents = [scene.num_agents for scene in every]
    assert (len(every), min(agents), max(agents)) == (241, 6, 17), "docs/data.md says so"
    with pytest.raises(UnknownNameError, match="nowhere"):
        ccdiff_env.load("embedded", names=["nowhere"])
    with pytest.raises(ConfigError, match="limit is 0"):
        ccdiff_env.load("embedded", limit=0)
    env = ccdiff_env.EgoEnv(scenes="embedded/val?limit=1")
    assert env.reset(seed=0)[1]["scene"] == splits["val"][0]


def are_parts(windows, scene):
    """Windows of 1 + 4 s of a log at 10 Hz, one every 2 s."""
    steps = range(0, scene.num_steps - 50, 20)
    assert [w.name for w in windows] == [f"{scene.name}@{start // 10}" for start in steps]
    for start, window in zip(steps, windows, strict=True):
        rows = [scene.agent_ids.index(ident) for ident in window.agent_ids]
        there = scene.tracks()["valid"][:, start : start + 51].any(axis=1)
        assert rows == list(np.flatnonzero(there))
        for name, values in window.tracks().items():
            assert np.array_equal(values, scene.tracks()[name][rows, start : start + 51])
        assert window.origin == scene.origin


@pytest.mark.filterwarnings("ignore:.*has 1 of the 150 scenes")
def test_files_of_every_source_are_cut_alike(nuscenes, tmp_path):
    kept = save(tmp_path, scenario_dict(ccdiff_env.load("embedded/val", limit=1)[0]))
    waymo = gpudrive_scene.save(tmp_path / "waymo.json")
    for place in (f"nuscenes:{nuscenes}/val", f"scenarionet:{kept}", f"gpudrive:{waymo}"):
        (scene,) = ccdiff_env.load(place)
        windows = ccdiff_env.load(f"{place}?window_s=4&stride_s=2&history_s=1")
        are_parts(windows, scene)
        assert len(windows) > 2


def test_windows_are_parts_of_the_log():
    """Against slices of its arrays: first steps, lengths, agents, names."""
    scene = ccdiff_env.load("embedded/val", limit=1)[0]
    text = "embedded/val?window_s=4&stride_s=2&history_s=1"
    found = ccdiff_env.load(text)
    first = [window for window in found if window.name.startswith(f"{scene.name}@")]
    are_parts(first, scene)
    last = tuple(w.name for w in first[:-3:-1])
    assert ccdiff_env.load(text, limit=2, names=[w.name for w in first[::-1]]).names == last
    options = {"window_s": 4, "stride_s": 2, "history_s": 1}
    assert ccdiff_env.load("embedded/val", **options) == found
    whole = ccdiff_env.load("embedded/val", limit=1, window_s=15, history_s=3)[0]
    assert (whole, whole.hash) == (scene, scene.hash)  # it has 18 s
    with pytest.raises(ConfigError, match="no scene has the 931 steps of a window"):
        ccdiff_env.load("embedded/val?window_s=90")
    for asked in ("window_s=8.04", "window_s=4&stride_s=0.25", "window_s=4&history_s=0.99"):
        name, seconds = asked.rpartition("&")[2].split("=")
        with pytest.raises(
            ConfigError, match=f"{name} is {seconds}, expected a whole number of st"
        ):
            ccdiff_env.load(f"embedded/val?{asked}")
    cut = ccdiff_env.load("embedded/val", limit=1, window_s=0.1 * 3, history_s=0)[0]
    assert cut.num_steps == 4
    env = ccdiff_env.EgoEnv(scenes="embedded/val?window_s=4&limit=3")
    assert env.reset(seed=0, options={"scene": f"{scene.name}@4"})[1]["scene"].endswith("@4")


def test_episodes_in_windows_are_those_that_were_asked_for():
    """First step and length, as asked for in seconds; whole sets can be pickled."""
    still = {"driver": "replay", **GOES_ON}
    for text, history, horizon, more in (
        ("window_s=8&history_s=1", 10, 80, {}), ("window_s=4", 30, 40, {}),
        ("window_s=2&history_s=0", 0, 20, {}), ("window_s=5&history_s=6", 60, 50, {}),
        ("window_s=8&history_s=1", 20, 30, {"history_steps": 20, "horizon_steps": 30}),
    ):  # fmt: skip
        scenes = pickle.loads(pickle.dumps(ccdiff_env.load(f"embedded/val?{text}&limit=2")))
        for given in (scenes, f"embedded/val?{text}&limit=2", scenes[1:]):
            env = ccdiff_env.EgoEnv(scenes=given, **still, **more)
            assert env.reset(seed=0)[1]["start_step"] == history
            steps = sum(1 for _ in played(env))
            assert steps == horizon
    parts = {"scenes": scenes, "traffic": "idm"}
    assert ccdiff_env.parallel_env(agents=2, **parts).worlds.config.horizon_steps == 80
    for driver in ("pdm", "ego"):
        config = ccdiff_env.EgoEnv(driver=driver, **parts).worlds.config
        assert (config.history_steps, config.horizon_steps) == (10, 80)
    choice = ccdiff_env.AdversarySelectionEnv(scenes=scenes)
    assert choice.worlds.config.history_steps == 10


@pytest.mark.parametrize("verb", ["traffic", "realism"])
def test_windows_that_a_protocol_cannot_play_are_refused(tmp_path, capsys, verb):
    words = ["bench", verb, "--methods", "replay", "--out", str(tmp_path)]
    assert main([*words, "--scenes", "embedded/val?window_s=8&limit=2"]) != 0
    assert "expected window_s=10&history_s=3 or" in capsys.readouterr().err


def test_a_window_is_viewed_as_the_benchmark_plays_it(tmp_path):
    scenes = "embedded/val?window_s=8&stride_s=6&limit=1"
    planned = [*PLANNERS, "--seeds", "0", "--scenes", scenes, "--out", str(tmp_path / "run")]
    assert main(planned) == 0
    (name,) = ccdiff_env.load(scenes).names
    ((_, again),) = replayed(tmp_path / "run", name)
    words = ["view", name, "--scenes", scenes, "--traffic", "replay", "--driver", "idm"]
    kept = tmp_path / "kept.npz"
    assert main([*words, "--save", str(kept), "-o", str(tmp_path / "page.html")]) == 0
    rollout = Rollout.load(kept)
    assert (rollout.start_step, rollout.num_steps) == (30, 81)
    assert np.array_equal(rollout.position, again.position)


def test_a_benchmark_drives_windows(tmp_path, capsys):
    scenes = "embedded/val?window_s=2&stride_s=6&history_s=1&limit=6"
    assert main([*PLANNERS, "--seeds", "0", "--scenes", scenes, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "20 steps after 10" in said
    assert "6 windows of 2 logs" in said
    with (tmp_path / "episodes.csv").open(newline="") as file:
        driven = {row["scene"] for row in csv.DictReader(file)}
    assert driven == set(ccdiff_env.load(scenes).names)


def test_agents_of_some_kinds_stay_with_their_tracks():
    scene = next(s for s in ccdiff_env.load("embedded") if "pedestrian" in s.agent_types)
    (kept,) = of_kinds(ccdiff_env.SceneSet([scene]), ["pedestrian"])
    expected = [i for i, kind in enumerate(scene.agent_types) if kind == "pedestrian" or i == 0]
    assert kept.agent_ids == [scene.agent_ids[i] for i in expected]
    for name, values in scene.tracks().items():
        assert np.array_equal(kept.tracks()[name], values[expected])
    (same,) = of_kinds(ccdiff_env.SceneSet([kept]), ["pedestrian"])
    assert same is kept
    with pytest.warns(UserWarning, match="2 of 2 scenes have nobody but the ego"):
        ccdiff_env.load("embedded/val", limit=2, kinds=[])
    for kind in ("vehicles", "Vehicle", ""):
        with pytest.raises(UnknownNameError, match=f"type '{kind}', expected one of vehi"):
            ccdiff_env.load("embedded/val", limit=2, kinds=["vehicle", kind])


@pytest.mark.parametrize("limit", [0, 2.0, "2", float("nan")])
def test_a_limit_is_a_whole_number(limit):
    with pytest.raises(ConfigError, match=f"limit is {limit!r}, expected a whole number, at least"):
        ccdiff_env.load("embedded/val", limit=limit)


@pytest.fixture
def nuscenes(tmp_path):
    """A folder in the schema of nuScenes whose version is looked for, with one scene of val."""
    unpack(tmp_path)
    (tmp_path / VERSION).rename(tmp_path / MINI)
    table = tmp_path / MINI / "scene.json"
    table.write_text(table.read_text().replace(f'"{embedded_splits()["val"][0]}"', '"scene-0003"'))
    return tmp_path


def test_folders_may_have_an_at_sign_in_their_names(tmp_path):
    for name in ("me@lab", "set@2026-11", "a@b@c"):
        (folder := tmp_path / name).mkdir()
        for text, version, split in (
            ("", None, None), ("/mini_val", None, "mini_val"), (f"@{MINI}", MINI, None),
            (f"@{MINI}/mini_val", MINI, "mini_val"), ("/train+val", None, "train+val"),
        ):  # fmt: skip
            found = parse(f"nuscenes:{folder}{text}?limit=1")
            assert (found.path, found.version, found.split) == (str(folder), version, split)
            assert parse(str(found)) == found


def test_a_folder_that_is_called_as_options_are_is_refused_where_it_would_be_read_as_them(tmp_path):
    (folder := tmp_path / "a?limit=2").mkdir()
    assert parse(f"nuscenes:{folder}/val").path == str(folder)
    for more in ("", "?limit=1"):
        with pytest.raises(ConfigError, match=r"rename it|'limit=2', expected limit"):
            parse(f"nuscenes:{folder}{more}")


def test_coverage_is_said_everywhere(nuscenes, tmp_path, capsys):
    place = settle(parse(f"nuscenes:{nuscenes}/val"))
    assert place.version == MINI  # the only one that is there
    with pytest.warns(UserWarning, match="has 1 of the 150 scenes"):
        scenes = ccdiff_env.load(place)
    assert len(scenes.report.missing) == 149
    said = coverage(place, scenes.names)
    assert said == "1 of 150 scenes of val"
    assert title(place, said) == f"nuScenes {MINI}, 1 of 150 scenes of val"
    out = tmp_path / "run"
    with pytest.warns(UserWarning, match="has 1 of the 150 scenes"):
        assert main([*PLANNERS, "--scenes", str(place), "--out", str(out)]) == 0
    settings = json.loads((out / "run.json").read_text())
    assert settings["source"] == str(place)
    assert settings["coverage"] == said
    assert said in (out / "report.html").read_text()
    assert FEW in (out / "table.md").read_text()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert ccdiff_env.load(f"nuscenes:{nuscenes}", names=["scene-0003"]).names == (
            "scene-0003",
        )
    names = list("abc")
    assert coverage(parse("embedded/val"), 4 * names) == "12 of 12 scenes of val"
    assert coverage(parse("embedded/train+val"), names) == "3 of 41 scenes of train+val"
    assert coverage(parse("embedded"), names) == "3 scenes"
    cut = parse("embedded?window_s=8")
    assert coverage(cut, ["a@0", "a@8", "b"]) == "3 windows of 2 logs"


def arguments(words, use="test"):
    parser = argparse.ArgumentParser()
    add_scene_arguments(parser, use)
    add_other_scenes(parser, "train")
    return parser.parse_args(words)


NO = "nuscenes:/no"


@pytest.mark.parametrize(
    ("words", "played", "trained"),
    [
        ("", "embedded/val", "embedded/train"),
        ("--scenes embedded/all --limit 2", "embedded/all?limit=2", "embedded/train?limit=2"),
        ("--scenes embedded", "embedded/val", "embedded/train"),
        (
            f"--scenes {NO}",
            f"{NO}@v1.0-trainval/ccdiff100",
            f"{NO}@v1.0-trainval/train+train_val",
        ),
        (f"--scenes {NO}@{MINI}", f"{NO}@{MINI}/mini_val", f"{NO}@{MINI}/mini_train"),
        (
            "--scenes scenarionet:/a --train-scenes scenarionet:/b",
            "scenarionet:/a",
            "scenarionet:/b",
        ),
    ],
)
def test_places_are_settled_by_their_use(words, played, trained):
    args = arguments(words.split())
    assert str(place_from(args)) == played
    assert str(other_place(args)) == trained


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--scenes", "nuscenes:/a@mini/vla"], "no split 'vla'"),
        (["--limit", "0"], "limit is 0"),
        (["--scenes", "scenarionet:/a"], "scenarionet:/a has no split to train on"),
        (["--scenes", "nuscenes:/a@mine"], "no split to train on"),
    ],
)
def test_contradictions_are_refused(words, message, capsys):
    trains = "train" in message
    with pytest.raises(ConfigError, match=message):
        (other_place if trains else place_from)(arguments(words))
    if not trains:
        assert main(["scenes", *words]) == 2
        assert message in capsys.readouterr().err


def test_figures_of_the_road_are_not_available_without_one(monkeypatch, tmp_path):
    def bare(place):
        town = ccdiff_env.embedded_scenes("val")[:2]
        return ccdiff_env.SceneSet(
            rebuilt(s, map_layers={**s.map_layers(), "drivable_area": []}) for s in town
        )

    assert not bare(None)[0].has_road
    monkeypatch.setitem(SOURCES, "town", Source("town", "Town", bare, path="COUNT"))
    common = ["--scenes", "town:2", "--quiet"]
    out = tmp_path / "planners"
    assert main([*PLANNERS, "--out", str(out), *common]) == 0
    head, row = (out / "figures.csv").read_text().splitlines()[:2]
    cells = dict(zip(head.split(","), row.split(","), strict=True))
    assert cells["on_road"] == ""
    assert float(cells["score"]) > 0.0
    out = tmp_path / "traffic"
    command = ["bench", "traffic", "--methods", "constant_velocity", "--k", "2", "--out", str(out)]
    assert main([*command, *common]) == 0
    text = (out / "table.md").read_text()
    head, _, floor, row = text.splitlines()[:4]
    for line, missing in ((floor, [" ORR % "]), (row, [" ORR % ", " RS "])):
        cells = dict(zip(head.split("|"), line.split("|"), strict=True))
        assert {name for name, cell in cells.items() if cell == " n/a "} == {*missing}
    assert "nan" not in text
    rows = json.loads(next((out / "raw").glob("constant_velocity-*.json")).read_text())["result"]
    assert all(row["orr"] is None and row["num_agents"] > 1 for row in rows)


def test_intervals_need_ten_scenes_and_known_figures():
    rows = [{"scene": str(i), "x": float(i % 2)} for i in range(10)]
    mean, low, high = mean_interval(rows, "x")
    assert low < mean == 0.5 < high
    assert Column("").text((mean, low, high)) == f"0.50 [{low:.2f}, {high:.2f}]"
    few = mean_interval(rows[:9], "x")
    assert Column("").text(few) == "0.44"
    # several rows of a scene are one scene
    assert Column("").text(mean_interval([{**row, "scene": "a"} for row in rows], "x")) == "0.50"
    # scenes that lack the figure are none
    assert np.isnan(mean_interval([*rows[:9], {"scene": "b", "x": None}], "x")[1])
    assert Column("").text(mean_interval([{"scene": "a", "x": None}], "x")) == "n/a"


def test_a_load_without_roads_warns_once(tmp_path):
    for name in "ab":
        made = scenario()
        made["map_features"] = {}
        made["id"] = made["metadata"]["scenario_id"] = name
        (tmp_path / f"{name}.pkl").write_bytes(pickle.dumps(made))
    with pytest.warns(UserWarning, match="2 of 2 scenes have no road") as caught:
        ccdiff_env.load(f"scenarionet:{tmp_path}")
    assert len([w for w in caught if w.category is UserWarning]) == 1
