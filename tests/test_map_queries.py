"""What maps say of places, against shapely and brute force."""

import itertools

import numpy as np
import pytest
import shapely
from array_scenes import agent, array_scene, begun
from shapely.ops import unary_union

import ccdiff_env
from ccdiff_env.errors import ConfigError, SceneError, ShapeError, UnknownNameError
from ccdiff_env.scenes import map_queries

NUM_SCENES = 5


@pytest.fixture(scope="module", params=["town", pytest.param("real", marks=pytest.mark.nuscenes)])
def maps(request, scenes):
    """Scenes of the embedded town or of nuScenes."""
    if request.param == "town":
        return scenes
    root = request.getfixturevalue("data_root") / "nuscenes"
    return list(ccdiff_env.load_nuscenes(root, scenes=["scene-0103", "scene-0916"]))


def places(scene, count, seed=0):
    """Poses about the logged ones, 30 m off at most."""
    draw = np.random.default_rng(seed)
    log = scene.tracks()
    rows = np.argwhere(log["valid"])
    agent, step = rows[draw.integers(len(rows), size=count)].T
    position = log["position"][agent, step] + draw.normal(0.0, 8.0, (count, 2)).clip(-30, 30)
    return position.astype(np.float32), draw.uniform(-4, 4, count).astype(np.float32)


def polygons(layer):
    found = [shapely.Polygon(p["exterior"], p["holes"]) for p in layer if len(p["exterior"]) > 2]
    # parts of a polygon that was cut out are joined by edges without an area
    mended = [p if p.is_valid else p.buffer(0) for p in found]
    assert all(abs(p.area - q.area) < 1e-2 for p, q in zip(found, mended, strict=True))
    return mended


def road(scene):
    layers = scene.map_layers()
    own = polygons(layers["drivable_area"])
    return unary_union(own or polygons([lane["polygon"] for lane in layers["lanes"]]))


def test_the_distance_to_the_roads_edge_is_that_of_shapely(maps):
    for scene in maps:
        points, _ = places(scene, 400)
        found = map_queries.road_distance(scene, points)
        assert found.dtype == np.float32
        assert (found > 0.5).any()
        assert (found < -0.5).any()
        # cracks of less than two millimetres are none
        area = road(scene).buffer(1e-3).buffer(-1e-3)
        for at, distance in zip(points, found, strict=True):
            point = shapely.Point(at)
            expected = area.boundary.distance(point) * (1.0 if area.covers(point) else -1.0)
            assert abs(distance - expected) < 5e-3, (at, distance, expected)


def test_the_road_is_that_of_off_road(scenes):
    scene = scenes[0]
    env = begun(scenes=scene, traffic="replay", driver="replay")
    states, (_, centre) = env.worlds.native.states(0), env.worlds.native.off_road(0)
    active = states["active"]
    distance = map_queries.road_distance(scene, states["position"][active])
    np.testing.assert_array_equal(distance < 0.0, centre[active])


def test_several_scenes(scenes):
    points = np.stack([places(scene, 12, 3)[0] for scene in scenes])
    world = np.arange(len(scenes)).repeat(12)
    together = map_queries.road_distance(scenes, points.reshape(-1, 2), world=world)
    for scene, own, expected in zip(scenes, points, together.reshape(-1, 12), strict=True):
        np.testing.assert_array_equal(map_queries.road_distance(scene, own), expected)
    assert map_queries.road_distance(scenes[0], np.zeros((0, 2))).shape == (0,)


def check_lane(scene):
    lanes = scene.map_layers()["lanes"]
    position, heading = places(scene, 120, 2)
    found = map_queries.lane_ahead(scene, position, heading, points=30, spacing_m=1.5, reach_m=4.0)
    lines = [shapely.LineString(lane["centreline"]) for lane in lanes]
    cos, sin = np.cos(heading), np.sin(heading)
    hits = 0
    for row, at in enumerate(position):
        point = shapely.Point(at)
        candidates = []
        for index, line in enumerate(lines):
            coords = np.array(line.coords)
            for a, b in itertools.pairwise(coords):
                along = np.dot(b - a, (cos[row], sin[row]))
                if along >= 0:
                    candidates.append((shapely.LineString([a, b]).distance(point), index))
        least = min(candidates, default=(np.inf, -1))[0]
        lane = int(found.lane[row])
        if abs(least - 4.0) < 0.02:
            continue
        assert (lane >= 0) == (least < 4.0)
        if lane < 0:
            assert not found.valid[row].any()
            continue
        hits += 1
        assert min(d for d, index in candidates if index == lane) < least + 0.02
        # the way: along the lane, then its first successors
        way = list(lines[lane].coords)
        start, follower = lines[lane].project(point), lane
        while shapely.LineString(way).length < start + 60.0 and lanes[follower]["successors"]:
            follower = lanes[follower]["successors"][0]
            way += list(lines[follower].coords)
        way = shapely.LineString(way)
        turn = np.array([[cos[row], -sin[row]], [sin[row], cos[row]]])
        scene_m = found.position_m[row] @ turn.T + at
        if abs(found.heading_error_rad[row]) > 1.4 or least > 3.0:
            continue  # the nearest place of the lane may be another one by its direction
        for k in range(30):
            s_m = start + 1.5 * k
            if abs(s_m - way.length) > 0.1:
                assert found.valid[row, k] == (s_m < way.length)
            if found.valid[row, k] and s_m < way.length:
                expected = np.array(way.interpolate(s_m).coords[0])
                assert np.linalg.norm(scene_m[k] - expected) < 0.05
    return hits


def test_the_lane_ahead_is_that_of_brute_force(scenes):
    assert sum(check_lane(scene) for scene in scenes) > 100


def road_scene(*lanes):
    """A scene with a map of lanes alone: points and the lane that follows."""
    made = [
        {"id": f"{i}", "kind": "lane", "centreline": np.float32(points), "successors": [after]}
        for i, (points, after) in enumerate(lanes)
    ]
    return array_scene(agent("ego", np.zeros(20)), name="bare", layers={"lanes": made})


def test_lanes_in_a_circle_come_to_an_end():
    # no length at all, and round and round
    scene = road_scene(([(0, 0), (8, 0)], 1), ([(8, 0), (8, 0)], 1))
    found = map_queries.lane_ahead(scene, [[1.0, 0.5]], [0.0], points=10, spacing_m=1.0)
    assert found.valid[0].sum() == 8
    assert found.lateral_m[0] == pytest.approx(0.5)
    begun(scenes=scene, history_steps=2)
    ring = road_scene(([(0, 0), (9, 0), (9, 9), (0, 9), (0, 0)], 0))
    found = map_queries.lane_ahead(ring, [[1.0, 0.0]], [0.0], points=100, spacing_m=1.0)
    assert found.valid.all()
    np.testing.assert_allclose(found.position_m[0, 36], found.position_m[0, 0], atol=1e-3)


def test_maps_without_lanes_or_road_say_so():
    scene = road_scene()
    assert map_queries.lane_ahead(scene, [[0.0, 0.0]], [0.0]).lane.tolist() == [-1]
    with pytest.raises(SceneError, match=r"bare.*no road"):
        map_queries.road_distance(scene, [[0.0, 0.0]])


HERE = [[0.0, 0.0]]
DISTANCE, LANE = map_queries.road_distance, map_queries.lane_ahead


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda s: DISTANCE(s, [1.0, 2.0, 3.0]), ShapeError, r"\[M, 2\]"),
        (lambda s: DISTANCE(s, [[np.nan, 0.0]]), ConfigError, "finite"),
        (lambda s: DISTANCE(s, [[1e7, 0.0]]), ConfigError, "below 1e6"),
        (lambda s: DISTANCE([s, s], HERE), ConfigError, "world is None"),
        (lambda s: DISTANCE([], HERE), ConfigError, "scenes"),
        (lambda s: DISTANCE(s, "here"), ShapeError, "position_m"),
        (lambda s: DISTANCE(s, HERE, world=[1]), UnknownNameError, "world 1, expected 0 to 0"),
        (lambda s: DISTANCE(s, HERE, world=[0.0]), ShapeError, "1 integers"),
        (lambda s: LANE(s, HERE, [0, 0]), ShapeError, "heading_rad"),
        (lambda s: LANE(s, HERE, [0], reach_m=11), ConfigError, "reach_m"),
        (lambda s: LANE(s, HERE, [0], points=1.5), ConfigError, "points"),
    ],
)
def test_wrong_arguments_are_refused(scenes, call, error, match):
    with pytest.raises(error, match=match):
        call(scenes[0])
