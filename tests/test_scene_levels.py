"""Scenes in which roads pass over each other: what the loaders keep of heights."""

import json
import pickle

import numpy as np
import pytest
from array_scenes import rebuilt
from shapely import Point, Polygon
from shapely.ops import unary_union

import ccdiff_env
from ccdiff_env import Scene
from ccdiff_env.errors import CcdiffError, DatasetError, SceneError, ShapeError
from ccdiff_env.scenes.scenarionet_export import scenario_dict, write_scenario
from tests import overpass

OBJECTS = [overpass.vehicle(1, overpass.on_bridge(0.0)), overpass.vehicle(2, overpass.below(-40.0))]


def load(path):
    return ccdiff_env.load_gpudrive(path, cache=False)[0]


@pytest.fixture
def scene(tmp_path):
    return load(overpass.write(tmp_path / "bridge.json", OBJECTS))


def area(scene, elevation_m):
    """Road at an elevation, as shapely has it."""
    layers = scene.map_layers()
    ranges = layers["elevation_m"]["drivable_area"]
    polygons = [
        Polygon(polygon["exterior"], polygon["holes"]).buffer(0)
        for polygon, (low, high) in zip(layers["drivable_area"], ranges, strict=True)
        if low - 1.25 <= elevation_m <= high + 1.25
    ]
    return unary_union(polygons)


def test_elevations_are_of_the_ground_and_roads_of_their_own_level(scene):
    np.testing.assert_allclose(scene.tracks()["elevation_m"][0], overpass.BRIDGE_M, atol=1e-5)
    np.testing.assert_allclose(scene.tracks()["elevation_m"][1], 0.0, atol=1e-5)
    layers = scene.map_layers()
    lanes = {lane["id"]: lane for lane in layers["lanes"]}
    expected = [overpass.ramp_height(x) for x in lanes["3"]["centreline"][:, 0]]
    np.testing.assert_allclose(lanes["3"]["elevation_m"], expected, atol=0.06)
    assert (lanes["6"]["elevation_m"] == 0).all()
    # beside the bridge there is road below alone, and beside the road below above alone
    upper, lower = area(scene, overpass.BRIDGE_M), area(scene, 0.0)
    for point, is_upper, is_lower in (
        ((40, 0), True, True),
        ((40, 12), False, True),
        ((60, 0), True, False),
        ((20, -12), False, False),
    ):
        assert (upper.contains(Point(point)), lower.contains(Point(point))) == (is_upper, is_lower)
    assert layers["elevation_m"]["road_dividers"].tolist() == [[0.0, 0.0]]


def test_a_scene_with_levels_is_told_of_and_kept(tmp_path):
    path = overpass.write(tmp_path / "bridge.json", OBJECTS)
    first, second = (ccdiff_env.load_gpudrive(path, cache=tmp_path / "cache") for _ in range(2))
    assert (first.report.cache.hits, second.report.cache.hits) == (0, 1)
    assert first[0] == second[0] == Scene.from_bytes(first[0].to_bytes())
    assert any("levels of roads" in note for note in second.report.scenes[0].notes)
    again = pickle.loads(pickle.dumps(first[0]))
    assert (again.tracks()["elevation_m"] == first[0].tracks()["elevation_m"]).all()


@pytest.mark.parametrize("height", [1e9, -10_000.0, 1e300])
def test_heights_that_are_none_on_earth_are_refused(tmp_path, height):
    objects = json.loads(json.dumps(OBJECTS))
    objects[1]["position"][7]["z"] = height
    with pytest.raises(DatasetError, match=r"objects\[1\].position\[7\].*z.*9 km"):
        load(overpass.write(tmp_path / "far.json", objects))
    roads = overpass.roads()
    roads[0]["geometry"][3]["z"] = height
    with pytest.raises(DatasetError, match="9 km in height"):
        load(overpass.write(tmp_path / "far.json", OBJECTS, roads=roads))


@pytest.mark.parametrize("of", ["object", "road"])
def test_without_all_heights_a_scene_is_flat_and_says_so(tmp_path, of):
    objects, roads = json.loads(json.dumps(OBJECTS)), overpass.roads()
    if of == "object":
        objects[1]["position"][7].pop("z")
    else:
        roads[0]["geometry"][3]["z"] = None
    path = overpass.write(tmp_path / "flat.json", objects, roads=roads)
    found = ccdiff_env.load_gpudrive(path, cache=False)
    assert "elevation_m" not in found[0].tracks()
    assert any("1 places without a height" in note for note in found.report.scenes[0].notes)


def test_scenarionet_files_hand_heights_on(scene, tmp_path):
    write_scenario(scene, tmp_path / "own.pkl")
    again = ccdiff_env.load_scenarionet(tmp_path / "own.pkl")[0]
    np.testing.assert_allclose(
        again.tracks()["elevation_m"], scene.tracks()["elevation_m"], atol=1e-5
    )
    ours, theirs = scene.map_layers(), again.map_layers()
    assert ours["elevation_m"].keys() == theirs["elevation_m"].keys()
    for one, other in zip(ours["lanes"], theirs["lanes"], strict=True):
        np.testing.assert_allclose(one["elevation_m"], other["elevation_m"], atol=0.06)
    # a file of others: no layers of our own, edges of roads with heights
    description = scenario_dict(scene)
    description["metadata"] = {**description["metadata"], "dataset": "waymo"}
    description["metadata"].pop("ccdiff_env")
    features = description["map_features"]
    for key in [key for key in features if key.startswith("drivable_area")]:
        features.pop(key)
    for road in overpass.roads():
        line = np.array([[p["x"], p["y"], p["z"]] for p in road["geometry"]])
        if road["type"] == "road_edge":
            features[f"edge {road['id']}"] = {"type": "ROAD_EDGE_BOUNDARY", "polyline": line}
        elif road["type"] == "road_line":
            features["road_dividers_0"] = {
                "type": "ROAD_LINE_SOLID_SINGLE_YELLOW",
                "polyline": line,
            }
    (tmp_path / "waymo.pkl").write_bytes(pickle.dumps(description, protocol=4))
    loaded = ccdiff_env.load_scenarionet(tmp_path / "waymo.pkl")
    other = loaded[0]
    assert any("levels of roads" in note for note in loaded.report.scenes[0].notes)
    np.testing.assert_allclose(
        other.tracks()["elevation_m"], scene.tracks()["elevation_m"], atol=1e-5
    )
    for elevation_m in (0.0, overpass.BRIDGE_M):
        difference = area(other, elevation_m).symmetric_difference(area(scene, elevation_m))
        assert difference.area < 0.02 * area(scene, elevation_m).area
    # headings in the place of heights, as nuScenes' lanes have them, and heights of no use
    description["metadata"]["dataset"] = "nuscenes"
    (tmp_path / "nuscenes.pkl").write_bytes(pickle.dumps(description, protocol=4))
    told = ccdiff_env.load_scenarionet(tmp_path / "nuscenes.pkl")[0]
    assert "elevation_m" in told.tracks()
    assert "elevation_m" not in told.map_layers()
    description["tracks"]["2"]["state"]["position"][3, 2] = np.nan
    (tmp_path / "nan.pkl").write_bytes(pickle.dumps(description, protocol=4))
    flat = ccdiff_env.load_scenarionet(tmp_path / "nan.pkl")
    assert "elevation_m" not in flat[0].tracks()
    assert any("flat" in note for note in flat.report.scenes[0].notes)


def test_arrays_with_heights_that_do_not_fit_are_refused(scene):
    good = scene.tracks()["elevation_m"]
    assert (rebuilt(scene).tracks()["elevation_m"] == good).all()
    for wrong in (np.nan, np.inf, 1e30, -9001.0):
        bad = good.copy()
        bad[1, 3] = wrong
        with pytest.raises(SceneError, match=r"tracks.elevation_m\[94\]"):
            rebuilt(scene, elevation_m=bad)
    with pytest.raises(ShapeError, match="elevation_m has shape"):
        rebuilt(scene, elevation_m=good[:, :-1])
    for of, wrong, message in (
        ("lane", {"elevation_m": np.zeros(3, np.float32)}, r"lanes\[0\].elevation_m"),
        ("lane", {"elevation_m": "high"}, "elevation_m"),
        ("map", {"road_dividers": np.zeros((9, 2), np.float32)}, "road_dividers"),
        ("map", {"road_dividers": np.full((1, 2), np.nan, np.float32)}, "road_dividers"),
        ("map", {"roofs": np.zeros((1, 2), np.float32)}, "roofs"),
    ):
        layers = scene.map_layers()
        (layers["lanes"][0] if of == "lane" else layers["elevation_m"]).update(wrong)
        with pytest.raises(CcdiffError, match=message):
            rebuilt(scene, map_layers=layers)


def test_bytes_of_an_earlier_format_are_refused(scene):
    data = bytearray(scene.to_bytes())
    assert data[8] == 4
    data[8] = 3
    with pytest.raises(
        DatasetError, match="not of format 4: load the scene from its data set"
    ) as error:
        Scene.from_bytes(bytes(data))
    assert "\n" not in str(error.value)
