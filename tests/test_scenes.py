"""Loading scenes from Python: the set, the report, arrays, pickling, errors."""

import json
import math
import pickle
from collections import defaultdict

import numpy as np
import pytest
from array_scenes import TIMES_S, played, rebuilt

import ccdiff_env
from ccdiff_env import EgoEnv, errors
from ccdiff_env.cli import main
from ccdiff_env.scenes import Scene, SceneSet, cache_directory
from ccdiff_env.scenes.embedded import VERSION as TOWN
from ccdiff_env.scenes.embedded import unpack

VERSION = "v1.0-tiny"
START_US = 1_531_883_530_000_000


def tables(num_scenes: int = 2, num_frames: int = 5) -> dict[str, list[dict]]:
    """A data set in the official schema: an ego at 10 m/s and a car at 4 m/s in each scene."""
    rows = defaultdict(list)

    def add(table: str, token: str, **row: object) -> None:
        rows[table].append({"token": token, **row})

    add("sensor", "s", channel="LIDAR_TOP", modality="lidar")
    add("calibrated_sensor", "c", sensor_token="s")
    add("category", "cat", name="vehicle.car")
    for s in range(num_scenes):
        add("log", f"log{s}", location="town")
        add("scene", f"t{s}", name=f"scene-000{s}", log_token=f"log{s}")
        add("instance", f"car{s}", category_token="cat")
        for k in range(num_frames):
            sample, pose, time = f"sample{s}-{k}", f"pose{s}-{k}", START_US + 500_000 * k
            yaw = 3.1 + 0.05 * k
            turned = [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
            add("sample", sample, timestamp=time, scene_token=f"t{s}")
            of = {"sample_token": sample, "calibrated_sensor_token": "c", "is_key_frame": True}
            add("sample_data", f"data{s}-{k}", ego_pose_token=pose, **of)
            at, here = [1000.0 + 5 * k, 500.0, 0.0], [1010.0, 500.0 + 2 * k, 1.0]
            add("ego_pose", pose, timestamp=time, translation=at, rotation=[1.0, 0.0, 0.0, 0.0])
            box = {"translation": here, "size": [1.9, 4.5, 1.6], "rotation": turned}
            of = {"sample_token": sample, "instance_token": f"car{s}"}
            add("sample_annotation", f"box{s}-{k}", **of, **box)
    return rows


def write(root, rows):
    folder = root / VERSION
    folder.mkdir(exist_ok=True)
    for name, records in rows.items():
        (folder / f"{name}.json").write_text(json.dumps(records))
    return root


@pytest.fixture
def root(tmp_path):
    return write(tmp_path, tables())


@pytest.fixture
def scenes(root):
    return ccdiff_env.load_nuscenes(root, VERSION, cache=False)


def test_scene_gives_arrays_in_its_own_frame(scenes):
    scene = scenes[0]
    assert (scene.name, scene.token, scene.location) == ("scene-0000", "t0", "town")
    assert scene.source == "nuscenes v1.0-tiny"
    assert (scene.dt, scene.num_steps, scene.origin) == (0.1, 21, (1001.0, 500.0))
    assert scene.agent_ids == ["ego", "car0"]
    assert scene.agent_types == ["vehicle", "vehicle"]
    assert scene.agent_categories == ["vehicle.ego", "vehicle.car"]
    assert scene.sizes.shape == (2, 3)
    assert np.allclose(scene.sizes[1], [4.5, 1.9, 1.6])
    tracks = scene.tracks()
    assert {k: (v.shape, v.dtype.name) for k, v in tracks.items()} == {
        "position": ((2, 21, 2), "float32"),
        "heading": ((2, 21), "float32"),
        "velocity": ((2, 21, 2), "float32"),
        "valid": ((2, 21), "bool"),
    }
    assert np.allclose(tracks["position"][0, :, 0], 0.385 + np.arange(21))
    assert np.allclose(tracks["velocity"][1], [0, 4], atol=1e-4)
    # past half a turn without a jump
    assert np.allclose(tracks["heading"][1], 3.1 + 0.01 * np.arange(21), atol=1e-5)
    tracks["position"][:] = 77
    assert not (scene.tracks()["position"] == 77).any(), "arrays are copies"


def test_an_ego_pose_is_the_middle_of_the_rear_axle_unless_told_otherwise(root):
    """``test_scenes_oracle.py`` has the poses of the default."""

    def places(**options):
        (scene, _) = ccdiff_env.load_nuscenes(root, VERSION, cache=root / "cache", **options)
        return scene.tracks()["position"][0] + np.array(scene.origin)

    assert np.allclose(places() - places(ego_reference="centre"), [1.385, 0.0], atol=1e-3)
    with pytest.raises(errors.ConfigError, match="rear_axle"):
        places(ego_reference="bumper")


def test_set_is_a_sequence_with_names(scenes):
    assert len(scenes) == 2
    assert scenes.names == ("scene-0000", "scene-0001")
    assert scenes["scene-0001"] is scenes[1] or scenes["scene-0001"] == scenes[1]
    assert isinstance(scenes[1:], SceneSet)
    assert scenes[1:].names == ("scene-0001",)
    assert "scene-0000" in scenes
    assert "scene-9" not in scenes
    assert [s.name for s in reversed(scenes)] == ["scene-0001", "scene-0000"]
    with pytest.raises(errors.UnknownNameError, match="scene-9"):
        scenes["scene-9"]
    with pytest.raises(IndexError):
        scenes[2]
    with pytest.raises(errors.ConfigError, match="same name, 'scene-0000'"):
        SceneSet([scenes[0], scenes[0]])


def test_a_map_without_lanes_is_warned_of_from_the_cache_too(tmp_path):
    """As map expansion 1.1 has it: no centre lines."""
    unpack(tmp_path)
    path = next((tmp_path / "maps" / "expansion").glob("*.json"))
    town = json.loads(path.read_text())
    for name in ("arcline_path_3", "connectivity", "lane_connector"):
        town.pop(name)
    path.write_text(json.dumps(town))
    for hits in (0, 1):
        with pytest.warns(UserWarning, match=r"1 of 1 scenes have a map without lanes \(left"):
            found = ccdiff_env.load_nuscenes(
                tmp_path, TOWN, scenes=["left-turn-00"], cache=tmp_path / "cache"
            )
        assert found.report.cache.hits == hits


def test_report_can_be_read_tested_and_printed(scenes):
    report = scenes.report
    assert [s.tracks for s in report.scenes] == [{"vehicle.car": 1, "vehicle.ego": 1}] * 2
    assert [s.annotations for s in report.scenes] == [5, 5]
    assert report.missing_maps == ("town",)
    assert [s.dropped for s in report.scenes] == [{}, {}]
    text = str(report)
    for words in ("tracks kept", "vehicle.car", "maps missing", "town", "LIDAR_TOP in 2 scenes"):
        assert words in text


def test_scene_is_pickled_compared_and_hashed_by_content(scenes, root):
    with pytest.warns(UserWarning, match="no map file"):
        again = ccdiff_env.load_nuscenes(root, VERSION, cache=False)
    copy = pickle.loads(pickle.dumps(scenes[0]))
    assert copy == scenes[0] == again[0]
    assert hash(copy) == hash(again[0])
    assert scenes[0] != scenes[1]
    assert len(scenes[0].hash) == 32
    assert copy.hash == scenes[0].hash != scenes[1].hash
    assert Scene.from_bytes(scenes[0].to_bytes()) == scenes[0]
    with pytest.raises(errors.DatasetError):
        Scene.from_bytes(scenes[0].to_bytes()[:40])
    for scene in (scenes[0], ccdiff_env.embedded_scenes("city-lights")[0]):
        whole = scene.to_bytes()
        for wrong in (whole[:-1], whole + b"\0", whole + b"\1", whole + whole):
            with pytest.raises(errors.DatasetError, match="scene bytes"):
                Scene.from_bytes(wrong)


def test_help_says_which_arrays_make_a_scene(scenes):
    for name, array in scenes[0].tracks().items():
        assert f"`{name}` [A, T{', 2' * (array.ndim == 3)}]" in Scene.tracks.__doc__
    assert "MapLayers" in Scene.map_layers.__doc__
    assert "`tracks()` and `map_layers()`" in Scene.from_arrays.__doc__


def test_arrays_make_the_same_scene_again(scenes):
    scene = scenes[0]
    assert rebuilt(scene) == scene
    line = np.array([[0, 0], [1, 0]], np.float32)
    lanes = [
        {"id": "a", "kind": "lane", "centreline": line, "successors": [1]},
        {"id": "b", "kind": "connector", "centreline": line + 1, "speed_limit_mps": 13.5},
    ]
    ring = np.array([[0, 0], [9, 0], [9, 9]], np.float32)
    area = {"exterior": ring, "holes": [ring / 9 + 1]}
    layers = {"drivable_area": [area], "lane_dividers": [line], "lanes": lanes}
    mapped = rebuilt(scene, map_layers=layers)
    back = mapped.map_layers()
    assert back["lanes"][1]["speed_limit_mps"] == 13.5
    assert back["lanes"][0]["successors"] == [1]
    assert back["drivable_area"][0]["holes"][0].shape == (3, 2)
    assert rebuilt(mapped) == mapped
    assert mapped.has_lanes
    bad = scene.tracks()["position"]
    bad[0, 3] = np.nan
    for changes, error, named in (
        ({"position": np.zeros((2, 20, 2), np.float32)}, errors.ShapeError, "position"),
        ({"agent_types": ["vehicle", "tram"]}, errors.UnknownNameError, "tram"),
        ({"agent_ids": ["a", "a"]}, errors.SceneError, "twice"),
        ({"position": bad}, errors.SceneError, "step 3"),
        ({"map_layers": {"rivers": []}}, errors.UnknownNameError, "rivers"),
        ({"map_layers": {"lanes": [{**lanes[0], "successors": [5]}]}}, errors.SceneError, "lanes"),
    ):
        with pytest.raises(error, match=named):
            rebuilt(scene, **changes)
    for limit in (np.nan, 0.0, -3.0, np.inf, 1e300):
        with pytest.raises(errors.SceneError, match=r"lanes\[1\] \"b\" speed_limit_mps is"):
            rebuilt(scene, map_layers={"lanes": [lanes[0], {**lanes[1], "speed_limit_mps": limit}]})


def _lane(**changes):
    line = np.array([[0, 0], [1, 0]], np.float32)
    return {"lanes": [{"id": "a", "kind": "lane", "centreline": line, **changes}]}


@pytest.mark.parametrize(
    ("layers", "error", "words"),
    [
        (_lane(successors=["a"]), errors.DatasetError, r"successors of lane \"a\" is \['a'\]"),
        (_lane(predecessors=[-1]), errors.DatasetError, r"\[-1\], expected a list of indices"),
        (_lane(speed_limit_mps="fast"), errors.DatasetError, "'fast', expected a number or None"),
        (_lane(speed_limit=3.0), errors.UnknownNameError, "did you mean 'speed_limit_mps'"),
        (_lane(polygon=np.zeros((3, 2))), errors.DatasetError, "polygon of lane.*a dictionary"),
        (_lane(id=3), errors.DatasetError, "id of a lane is 3, expected a text"),
        ({"lanes": None}, errors.DatasetError, "lanes is None, expected a list"),
        ({"lanes": [[]]}, errors.DatasetError, r"lane is \[\], expected a dictionary"),
        ({"walkways": [np.zeros((3, 2))]}, errors.DatasetError, "walkways is .*a dictionary"),
        ({"walkways": [{"exterior": []}]}, errors.ShapeError, "exterior of walkways is list"),
        ({"walkway": []}, errors.UnknownNameError, "did you mean 'walkways'"),
        ({3: []}, errors.DatasetError, "a key of map_layers is 3"),
        ([], errors.DatasetError, r"map_layers is \[\], expected a dictionary"),
        ({**_lane(), "lights": [{"lane": -1}]}, errors.DatasetError, "lane of a light is -1"),
        ({"elevation_m": 3.0}, errors.DatasetError, "elevation_m is 3.0"),
    ],
)
def test_layers_of_a_wrong_form_are_named(scenes, layers, error, words):
    with pytest.raises(error, match=words):
        rebuilt(scenes[0], map_layers=layers)


@pytest.mark.parametrize("name", ["sizes", "position", "heading", "velocity", "valid"])
def test_arrays_of_a_wrong_form_are_named(scenes, name):
    right = {**scenes[0].tracks(), "sizes": scenes[0].sizes}[name]
    for wrong in (right.astype(np.int64), right[0], None, right.tolist()):
        with pytest.raises(errors.ShapeError, match=f"{name} is .*expected a (float32|bool)"):
            rebuilt(scenes[0], **{name: wrong})
    for mask in (False, np.isnan(right)):
        with pytest.raises(errors.ShapeError, match=f"{name} has a mask, expected .* without one"):
            rebuilt(scenes[0], **{name: np.ma.array(right, mask=mask)})
    with pytest.raises(errors.ShapeError, match=r"heading is float64 \(.*expected a float32 array"):
        rebuilt(scenes[0], heading=scenes[0].tracks()["heading"].astype(float))


@pytest.mark.parametrize("step", [-1, 10**6, 2**70, 0.5, None])
def test_steps_that_a_scene_has_not_are_named(scenes, step):
    with pytest.raises(errors.ConfigError, match=r"step = .*, expected a whole number from 0 to"):
        scenes[0].ranked_vehicles(step, "ccdiff")


def test_mistakes_have_their_own_exceptions(root):
    rows = tables()
    for i in (0, 3):
        rows["sample_annotation"][i]["size"] = [0.0, 4.5, 1.6]
    (damaged := root / "damaged").mkdir()
    write(damaged, rows)
    for place, version, options, error, match in (
        (root / "elsewhere", VERSION, {}, FileNotFoundError, "elsewhere"),
        (root, "v7", {}, errors.DatasetNotFoundError, rf"there are {VERSION}\).*v7"),
        (root / VERSION, VERSION, {}, errors.DatasetNotFoundError, "the folder above"),
        (root, VERSION, {"split": "tests"}, errors.UnknownNameError, "ccdiff100"),
        (root, VERSION, {"scenes": ["scene-0007"]}, errors.UnknownNameError, "scene-0007"),
        (root, VERSION, {"split": "val"}, errors.DatasetError, "no scene to load"),
        (root, VERSION, {"split": "val", "scenes": ["scene-0000"]}, errors.ConfigError, "both"),
        (root, VERSION, {"dt": 0.3}, errors.ConfigError, "divides"),
        (root, VERSION, {"interpolation": "cubic"}, errors.ConfigError, "linear"),
        (root, VERSION, {"kinds": ["tram"]}, errors.UnknownNameError, "tram"),
        (root, VERSION, {"map_margin": -1.0}, errors.ConfigError, "map_margin"),
        (damaged, VERSION, {}, errors.DatasetError, r"size is \[0\.0, 4\.5, 1\.6\].*sample_annot"),
    ):
        with pytest.raises(error, match=match):
            ccdiff_env.load_nuscenes(place, version, cache=False, **options)


def test_cache_goes_where_the_environment_says(root, tmp_path, monkeypatch):
    monkeypatch.setenv("CCDIFF_CACHE", str(tmp_path / "cache"))
    assert cache_directory() == tmp_path / "cache"
    first = ccdiff_env.load_nuscenes(root, VERSION)
    second = ccdiff_env.load_nuscenes(root, VERSION, scenes=["scene-0001"])
    assert (first.report.cache.built, second.report.cache.hits) == (2, 1)
    assert second[0] == first[1]
    other = ccdiff_env.load_nuscenes(root, VERSION, cache=tmp_path / "other")
    assert other.report.cache.directory.startswith(str(tmp_path / "other"))
    monkeypatch.delenv("CCDIFF_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/x")
    assert str(cache_directory()) == "/x/ccdiff_env"


def test_a_user_without_a_home_has_no_cache(root, monkeypatch, capsys):
    for name in ("CCDIFF_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", lambda uid: {}[uid])
    assert cache_directory() is None
    found = ccdiff_env.load_nuscenes(root, VERSION).report.cache
    assert (found.directory, found.built) == (None, 2)
    assert "you have no home" in found.notes[0]
    assert not ccdiff_env.load_nuscenes(root, VERSION, cache=False).report.cache.notes
    assert main(["doctor"]) == 0
    assert "none, as you have no home" in capsys.readouterr().out


def test_scenes_of_which_nobody_is_annotated_are_named(tmp_path, capsys):
    rows = tables()
    del rows["sample_annotation"][5:]
    write(tmp_path, rows)
    with pytest.warns(UserWarning, match=r"1 of 2 scenes have nobody but the ego \(scene-0001, "):
        found = ccdiff_env.load_nuscenes(tmp_path, VERSION, cache=False)
    notes = ["nobody but the ego: no annotations" in report.notes for report in found.report.scenes]
    assert notes == [False, True]
    write(tmp_path, rows | {"sample_annotation": []})
    words = ["--scenes", f"nuscenes:{tmp_path}@{VERSION}", "--out", str(tmp_path / "out")]
    with pytest.warns(UserWarning, match="2 of 2 scenes have nobody"):
        assert main(["bench", "realism", *words]) == 2
    assert "nobody but the ego is in any of the 2" in capsys.readouterr().err


@pytest.mark.parametrize("at", [(4e5, 1.5e5), (-6e5, 9e5), (5e5, 4.4e6)])
def test_a_drive_does_not_depend_on_where_its_scene_lies(at):
    line = np.stack([np.arange(-100.0, 401.0), np.zeros(501)], axis=1)
    area = np.array([[-200.0, -20.0], [500.0, -20.0], [500.0, 20.0], [-200.0, 20.0]])

    def drive(x, y, kind):
        there = np.array([x, y])
        lane = {"id": "a", "kind": "lane", "centreline": (line + there).astype(kind)}
        place = np.zeros((2, 160, 2)) + there
        place[:, :, 0] += 3.0 * TIMES_S + [[0.0], [60.0]]
        scene = Scene.from_arrays(
            "far",
            agent_ids=["ego", "b"],
            agent_types=["vehicle"] * 2,
            sizes=np.tile(np.float32([4.5, 2.0, 1.6]), (2, 1)),
            position=place.astype(kind),
            heading=np.zeros((2, 160), np.float32),
            velocity=np.tile(np.float32([3.0, 0.0]), (2, 160, 1)),
            valid=np.ones((2, 160), bool),
            origin=(7.0, 0.5),
            map_layers={
                "drivable_area": [{"exterior": (area + there).astype(kind), "holes": []}],
                "lanes": [lane],
            },
        )
        origin = np.array(scene.origin) - [7.0, 0.5]
        # global places come back
        back = scene.tracks()["position"] + origin
        np.testing.assert_allclose(back, place.astype(kind), rtol=0, atol=1e-3)
        back = scene.map_layers()["lanes"][0]["centreline"] + origin
        np.testing.assert_allclose(back, lane["centreline"], rtol=0, atol=1e-3)
        env = EgoEnv(scenes=[scene], traffic="idm", driver="idm")
        return np.array([s["position"].copy() for _, s, _ in played(env)]) + origin - there

    near = drive(0.0, 0.0, np.float64)
    np.testing.assert_allclose(drive(*at, np.float64), near, rtol=0, atol=0.01)
    if max(at) < 2**20:
        with pytest.warns(UserWarning, match="single precision"):
            drive(*at, np.float32)
    else:  # the next number in single precision is half a metre away
        with pytest.raises(errors.SceneError, match=r"rounded to 0\.\d+ m; give float64"):
            drive(*at, np.float32)
