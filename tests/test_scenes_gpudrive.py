"""Waymo scenes in GPUDrive's JSON: against what they were drawn from, and hostile ones."""

import base64
import json
import math
import os
import warnings

import numpy as np
import pytest
import shapely
from array_scenes import begun, played, rebuilt
from gpudrive_scene import CENTRE, DRIVEWAY, STEPS, inside, save, scene

import ccdiff_env
from ccdiff_env import errors
from ccdiff_env.cli import main
from ccdiff_env.view.sources import log_rollout
from ccdiff_env.view.video import Video


@pytest.fixture
def loaded(tmp_path):
    return ccdiff_env.load_gpudrive(save(tmp_path / "waymo_1.json"), cache=False)


def test_a_file_becomes_a_scene(loaded):
    waymo = loaded["waymo_1"]
    assert (waymo.token, waymo.location, waymo.source) == ("a1b2c3", "waymo", "gpudrive")
    assert (waymo.dt, waymo.num_steps) == (0.1, STEPS)
    assert waymo.agent_ids == ["ego", "11", "12", "13"], "the ego first; one step is no track"
    assert waymo.agent_types == ["vehicle", "vehicle", "cyclist", "pedestrian"]
    tracks = waymo.tracks()
    assert tracks["valid"].sum(axis=1).tolist() == [STEPS, 58, STEPS, STEPS]
    assert (tracks["position"][~tracks["valid"]] == 0).all(), "-10000 is nowhere"
    turned = math.radians(8.0) + 5.0 / 35.0 * 0.1 * np.arange(STEPS)
    place = np.array(CENTRE) - waymo.origin + 35.0 * np.stack([np.cos(turned), np.sin(turned)], 1)
    assert np.allclose(tracks["position"][0], place, atol=1e-3)
    assert np.allclose(np.unwrap(tracks["heading"][0]), tracks["heading"][0], atol=1e-6)
    (report,) = loaded.report.scenes
    assert report.road == "edges"
    assert list(report.dropped) == ["vehicle: fewer than 2 steps"]
    notes = sorted(note.split('"')[1] for note in report.notes)
    assert notes == ["lane", "speed_bump", "stop_sign"]
    # lanes follow where one ends and another begins
    lanes = waymo.map_layers()["lanes"]
    assert [lane["successors"] for lane in lanes] == [[1], [], []]
    assert [lane["predecessors"] for lane in lanes] == [[], [0], []]


def test_lights_of_a_file(tmp_path):
    """States of Waymo's names at the steps where the light is seen; from the cache, too."""
    data, names = scene(), ["stop", "arrow_caution", "go", "flashing_stop", "unknown"]
    seen = list(range(10, 60))
    place = data["roads"][1]["geometry"][0]
    data["tl_states"] = {
        lane: {
            "state": [names[i % 5] for i in seen],
            "time_index": seen,
            **{axis: [place[axis]] * len(seen) for axis in "xyz"},
        }
        for lane in ("1", "3")
    }
    save(tmp_path / "waymo_1.json", data)
    for _ in range(2):
        loaded = ccdiff_env.load_gpudrive(tmp_path, cache=tmp_path / "cache")
        (light,) = loaded[0].map_layers()["lights"]
        codes = [3, 2, 1, 3, 0]
        assert light["states"].tolist() == [codes[i % 5] if i in seen else 0 for i in range(STEPS)]
        assert light["lane"] == 1
        middle = light["stop_line"].mean(axis=0) + loaded[0].origin
        assert np.allclose(middle, [place["x"], place["y"]], atol=0.01)
        assert any("a light of lane 3" in note for note in loaded.report.scenes[0].notes)
    assert loaded.report.cache.hits == 1
    data["tl_states"]["1"]["time_index"][0] = STEPS
    save(tmp_path / "waymo_1.json", data)
    with pytest.raises(errors.DatasetError, match="time_index"):
        ccdiff_env.load_gpudrive(tmp_path, cache=False)


def test_edges_bound_the_road(loaded):
    waymo = loaded[0]
    assert waymo.has_road
    areas = [
        shapely.Polygon(area["exterior"], area["holes"])
        for area in waymo.map_layers()["drivable_area"]
    ]
    assert all(area.is_valid for area in areas)
    road = shapely.union_all(areas)
    generator = np.random.default_rng(0)
    places = generator.uniform((0, 0), (60, 45), (20_000, 2))
    expected = inside(places)
    points = shapely.points(places + np.array(CENTRE) - waymo.origin)
    near = shapely.distance(points, road.boundary) < 0.1
    for corner in DRIVEWAY:  # they are blunt, by less than a cell
        near |= np.hypot(*(places - corner).T) < 0.5
    told = ~np.isnan(expected) & ~near
    found = shapely.contains(road, points)
    assert told.mean() > 0.3
    assert (found[told] == expected[told].astype(bool)).all()


def test_who_leaves_the_road_is_off_it(loaded):
    options = {"scenes": loaded, "history_steps": 10, "horizon_steps": 80}
    for turn in (0.0, 0.6):  # straight on over the kerb, or a turn over the median
        action = np.array([1.0, turn], np.float32)
        *_, (_, _, info) = played(ccdiff_env.EgoEnv(traffic="idm", **options), action)
        assert info["off_road"]
    log = ccdiff_env.EgoEnv(driver="replay", **options)
    assert not any(info["off_road"] for *_, info in played(log))


def test_folders_and_patterns_are_read(tmp_path):
    for i in range(40):
        save(tmp_path / f"s{i:02}.json")
    assert len(ccdiff_env.load_gpudrive(tmp_path / "s1?.json", cache=False)) == 10
    (odd := tmp_path / "[a]*").mkdir()
    save(odd / "t.json")
    assert ccdiff_env.load_gpudrive(odd / "t*.json", cache=False).names == ("t",)
    (odd / "t.json").unlink()
    for limit in (0, -1, 1.5):
        with pytest.raises(errors.ConfigError, match=f"limit is {limit}, expected"):
            ccdiff_env.load_gpudrive(tmp_path, limit=limit)
    everything = ccdiff_env.load_gpudrive(tmp_path, cache=False)
    assert everything.names == tuple(f"s{i:02}" for i in range(40))
    assert everything["s07"].name == everything[7].name == "s07"
    (tmp_path / "s40.json").write_text("{", encoding="utf-8")
    chosen = ccdiff_env.load(f"gpudrive:{tmp_path}", 1, names=["s38", "s07"])
    assert chosen.names == ("s38",), "others are not read"
    with pytest.raises(errors.UnknownNameError, match="s77"):
        ccdiff_env.load(f"gpudrive:{tmp_path}", names=["s77"])
    with pytest.raises(errors.DatasetError, match=r"invalid JSON at byte \d.*s40\.json"):
        ccdiff_env.load_gpudrive(tmp_path, cache=False)
    (tmp_path / "sub").mkdir()
    save(tmp_path / "sub" / "s01.json")
    with pytest.raises(errors.ConfigError, match="two scenes have the same name"):
        ccdiff_env.load_gpudrive(tmp_path)
    with pytest.raises(errors.DatasetNotFoundError, match="no scenes of GPUDrive"):
        ccdiff_env.load_gpudrive(tmp_path / "none")


@pytest.mark.parametrize("verb", ["scenes", "view", "train", "bench"])
def test_files_open_everywhere(tmp_path, verb):
    save(tmp_path / "waymo_1.json")
    save(tmp_path / "waymo_2.json")
    out = str(tmp_path / "out")
    words = {
        "scenes": [],
        "view": ["waymo_1", "--traffic", "idm", "-o", f"{out}.html"],
        "train": ["--steps", "1", "--batch-scenes", "1", "--quiet", "--out", out],
        "bench": [
            *("planners", "--planners", "idm,replay", "--traffic", "idm", "--seeds", "0"),
            *("--quiet", "--out", out),
        ],
    }[verb]
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # such as one of a scene without a road
        assert main([verb, *words, "--scenes", f"gpudrive:{tmp_path}/waymo_?.json"]) == 0
    if verb == "bench":
        table = (tmp_path / "out" / "table.md").read_text(encoding="utf-8")
        assert "n/a" not in table, "the road bounds planners"
        raw = next((tmp_path / "out" / "raw").glob("*.json")).read_text(encoding="utf-8")
        assert json.loads(raw)["arguments"]["window"] == {"history_steps": 10, "horizon_steps": 80}


def test_a_run_drives_as_long_as_it_was_asked_to_or_refuses_the_scene(tmp_path, capsys):
    save(tmp_path / "waymo_1.json")
    words = ["bench", "planners", "--planners", "noop", "--traffic", "replay", "--seeds", "0"]
    words += ["--quiet", "--scenes", f"gpudrive:{tmp_path}/waymo_?.json"]
    for given, driven in (([], 80), (["--history-steps", "30", "--horizon", "60"], 60)):
        out = tmp_path / f"run-{driven}"
        assert main([*words, *given, "--out", str(out)]) == 0
        assert f"{driven} steps after {90 - driven}" in capsys.readouterr().out
        assert main(["bench", "verify", str(out)]) == 0
        assert "1 of 1 episodes come out the same" in capsys.readouterr().out
        (row,) = json.loads(next((out / "raw").glob("*.json")).read_text())["result"]
        assert len(base64.b64decode(row["actions"])) == driven * 2 * 4
    for given in (["--horizon", "81"], ["--history-steps", "30"], ["--horizon", "0"]):
        assert main([*words, *given, "--out", str(tmp_path / "no")]) == 2
    assert "waymo_1" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize("kind", ["traffic", "realism"])
def test_traffic_is_measured_for_eight_seconds_after_one(tmp_path, capsys, kind):
    save(tmp_path / "waymo_1.json")
    words = ["bench", kind, "--scenes", f"gpudrive:{tmp_path}/waymo_?.json", "--quiet", "--keep"]
    words += {"traffic": ["--k", "Full"], "realism": ["--samples", "2"]}[kind]
    words += ["--methods", "constant_velocity,ccdiff_one_sample", "--out", str(tmp_path / "run")]
    assert main(words) == 0
    assert f"{kind}, 80 steps after 10" in capsys.readouterr().out
    assert ", 80 steps after 10</title>" in (tmp_path / "run/report.html").read_text("utf-8")
    kept = json.loads((tmp_path / "run/run.json").read_text("utf-8"))["window"]
    assert kept == {"history_steps": 10, "horizon_steps": 80}
    found = [
        (given["arguments"]["method"], row)
        for file in (tmp_path / "run" / "raw").glob("*.json")
        for given in [json.loads(file.read_text("utf-8"))]
        for row in given["result"]
    ]
    (row,) = (row for method, row in found if method == "constant_velocity")
    # those who are there at step 10 keep their speed for 8 s, or as long as they are logged
    rollout = ccdiff_env.Rollout.load(tmp_path / "run/rollouts" / row["kept"][0])
    assert (rollout.start_step, rollout.num_steps) == (10, 81)
    tracks = ccdiff_env.load_gpudrive(tmp_path / "waymo_1.json")[0].tracks()
    errors = []
    for name, last in (("ego", 90), ("11", 60)):
        at = rollout.agent_ids.index(name)
        position, velocity = tracks["position"][at], tracks["velocity"][at]
        straight = position[10] + velocity[10] * 0.1 * (last - 10)
        errors.append(np.linalg.norm(straight - position[last]))
        assert np.linalg.norm(rollout.position[at, last - 10] - straight) < 0.1
    if kind == "traffic":
        assert row["fde"] == pytest.approx(np.mean(errors), abs=0.1)
    else:
        (sampled,) = (row for method, row in found if method == "ccdiff_one_sample")
        assert "ranks_5s" in sampled
        assert "ranks_10s" not in sampled
    assert main(["bench", "verify", str(tmp_path / "run")]) == 0


def test_networks_and_images_see_the_road(loaded):
    env = begun(scenes=loaded, history_steps=10, horizon_steps=20, traffic="ccdiff")
    states = [env.step(env.action_space.sample() * 0)[0] for _ in range(10)]
    assert np.isfinite(np.stack(states)).all()
    without = rebuilt(loaded[0], map_layers=loaded[0].map_layers() | {"drivable_area": []})
    both = [Video(log_rollout(s), size=(300, 300)).frame(10) for s in (loaded[0], without)]
    assert (both[0] != both[1]).any(axis=-1).mean() > 0.05, "the road's surface is drawn"


def ego(number):
    """Say that another object is the ego."""
    return lambda d: d["metadata"].update(sdc_track_index=number)


def first(change):
    """Change the first object."""
    return lambda d: change(d["objects"][0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.pop("objects"), "missing field `objects`"),
        (ego(9), "sdc_track_index is 9, expected the ind"),
        (ego(-1), "sdc_track_index is -1"),
        (ego(4), "sdc_track_index is fewer than 2 steps"),
        (first(lambda o: o["heading"].pop()), r"objects\[0\].*heading is 90 entries long"),
        (first(lambda o: o["position"].append({"x": 0, "y": 0})), "position is 92 entries long"),
        (first(lambda o: o["position"][9].update(x=-10000)), r"\[0\]\.position\[9\].*x is -1"),
        (first(lambda o: o["velocity"][9].update(y=1e9)), r"velocity\[9\].*y is 1000000000"),
        (first(lambda o: o.update(length=0)), "size is 0 x 2"),
        (first(lambda o: o.update(id=7)), "id of an object .7. is there twice"),
        (lambda d: d["roads"][0]["geometry"][3].update(x=1e300), r"roads\[0\].*geometry is 1"),
        (lambda d: d["roads"][0].update(geometry=3), "invalid JSON"),
        (lambda d: d.update(scenario_id="a\nb"), "scenario_id is a"),
        (lambda d: d.update(objects=[]), "sdc_track_index is 1"),
    ],
)
def test_fields_that_break_a_rule_are_named(tmp_path, change, words):
    data = scene()
    change(data)
    with pytest.raises(errors.DatasetError, match=words):
        ccdiff_env.load_gpudrive(save(tmp_path / "bad.json", data), cache=False)[0]


def test_damaged_and_odd_files_are_refused(tmp_path):
    path = save(tmp_path / "bad.json")
    whole = path.read_text(encoding="utf-8")
    for text in (
        whole[: len(whole) // 2],
        '{"objects":' + "[" * 100_000,
        whole.replace('"heading": [', '"heading": [NaN, ', 1),
        whole.replace('"length": 4.6', '"length": 1e999', 1),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(errors.DatasetError, match=r"invalid JSON at byte .*bad\.json"):
            ccdiff_env.load_gpudrive(path, cache=False)[0]
    deep = '"more": ' + "[" * 100_000 + "]" * 100_000
    path.write_text(whole.replace("{", "{" + deep + ", ", 1), encoding="utf-8")
    assert len(ccdiff_env.load_gpudrive(path, cache=False)[0].agent_ids) == 4, "passed over"
    os.truncate(path, 1 << 40)
    with pytest.raises(errors.DatasetError, match="bytes long, expected at most"):
        ccdiff_env.load_gpudrive(path, cache=False)[0]


def test_a_million_roads_and_far_ones_cost_little_more_than_their_bytes(tmp_path):
    data = scene()
    data["roads"] += [{"type": "lane", "geometry": [{"x": 0, "y": 0}]}] * 1_000_000
    line = [{"x": CENTRE[0] + 9e5, "y": CENTRE[1] + 9e5}, data["roads"][4]["geometry"][0]]
    data["roads"].append({"type": "road_edge", "map_element_id": 15, "geometry": line})
    waymo = ccdiff_env.load_gpudrive(save(tmp_path / "many.json", data), cache=False)[0]
    assert len(waymo.map_layers()["lanes"]) == 3
    assert waymo.has_road


def test_a_scene_without_lines_has_no_road(tmp_path):
    data = {**scene(), "roads": []}
    loaded = ccdiff_env.load_gpudrive(save(tmp_path / "bare.json", data), cache=False)
    assert not loaded[0].has_road
    assert loaded.report.scenes[0].road == "none"
