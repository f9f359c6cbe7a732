"""Roads that pass over each other: who meets whom, whose road is whose, what loaders keep."""

import json
import pickle
from typing import Any

import numpy as np
import pytest
from array_scenes import begun, rebuilt
from shapely import Point, Polygon
from shapely.ops import unary_union

import ccdiff_env
from ccdiff_env import EgoEnv, Recorder, Rollout, Scene, SceneSet, WorldConfig
from ccdiff_env.bench.traffic import relations
from ccdiff_env.errors import CcdiffError, DatasetError, SceneError, ShapeError
from ccdiff_env.metrics import Motion
from ccdiff_env.planners import planning
from ccdiff_env.scenes import map_queries
from ccdiff_env.scenes.scenarionet_export import scenario_dict, write_scenario
from ccdiff_env.view.pack import contacts
from tests import overpass

#: An ego on the bridge, and one that passes below it when the ego is there.
CROSSING = [
    overpass.vehicle(1, overpass.on_bridge(0.0)),
    overpass.vehicle(2, overpass.below(-40.0)),
]
OPTIONS: dict[str, Any] = {"history_steps": 10, "horizon_steps": 80, "terminate_at_goal": False}


def load(tmp_path, objects, lift=0.0):
    """Scenes of objects; those on the ground are lifted with their road, then without edges."""
    objects, roads = json.loads(json.dumps([objects, overpass.roads()]))
    roads = [road for road in roads if not lift or road["type"] == "lane"]
    for points in [o["position"] for o in objects] + [r["geometry"] for r in roads]:
        if max(point["z"] for point in points) < 4:
            for point in points:
                point["z"] += lift
    path = overpass.write(tmp_path / f"bridge-{lift:g}.json", objects, roads=roads)
    return ccdiff_env.load_gpudrive(path, cache=False)


def play(scenes, driver="replay", **options):
    """Metrics of an episode, the least time to contact, and the observations and infos."""
    settings = {"traffic": "replay", "observation": "dict", **OPTIONS, **options}
    env = EgoEnv(scenes=scenes, driver=driver, **settings)
    recorder = Recorder(env)
    seen, infos = [env.reset(seed=0)[0]], [{}]
    recorder.start()
    while "metrics" not in infos[-1]:
        observation, *_, info = env.step(env.action_space.sample() * 0)
        recorder.step()
        infos.append(info)
        seen.append(observation)
    rollout = recorder.rollout()
    return {"metrics": infos[-1]["metrics"], "infos": infos, "seen": seen, "rollout": rollout}


@pytest.mark.parametrize(
    ("traffic", "driver"),
    [("replay", "replay"), ("idm", "replay"), ("replay", "idm"), ("replay", "pdm")],
)
def test_nobody_meets_who_is_below(tmp_path, traffic, driver):
    found = play(load(tmp_path, CROSSING), driver, traffic=traffic)
    metrics = found["metrics"]
    assert metrics["collision"] == 0
    assert metrics["min_ttc"] >= 10
    assert metrics["route_completion"] > 0.95
    # both go on at their 10 m/s all the time: neither is the other's leader
    rollout = found["rollout"]
    speed = np.linalg.norm(rollout.velocity, axis=-1)
    assert min(speed[agent][rollout.valid[agent]].min() for agent in (0, 1)) > 8.5


@pytest.mark.parametrize(("gap_m", "meets"), [(1.5, True), (2.4, True), (3.0, False)])
def test_levels_begin_at_two_and_a_half_metres(tmp_path, gap_m, meets):
    found = play(load(tmp_path, CROSSING, lift=overpass.BRIDGE_M - gap_m))
    assert found["metrics"]["collision"] == meets
    assert (found["metrics"]["min_ttc"] < 1) == meets


def test_observations_show_those_of_ones_own_level(tmp_path):
    ahead = overpass.vehicle(3, overpass.on_bridge(25.0))
    scenes = load(tmp_path, [*CROSSING, ahead])
    for traffic in ("replay", "idm"):
        for row in play(scenes, traffic=traffic)["seen"]:
            assert row["agents_mask"].sum() == 1
            x, y = row["agents"][0][:2]
            assert abs(y) < 0.1 < x
    # on one level all are seen
    assert play(load(tmp_path, [*CROSSING, ahead], lift=7.0))["seen"][0]["agents_mask"].sum() == 2


def on_ramp(x, speed):
    """Over the bridge and down the ramp."""
    return lambda t: (x + speed * t, 0.0, overpass.ramp_height(x + speed * t))


def test_who_drives_up_a_ramp_far_ahead_is_ones_leader(tmp_path):
    # 60 m ahead and 3.6 m lower, standing where the bridge has come down by half
    objects = [
        overpass.vehicle(1, on_ramp(105.0, 8.0)),
        overpass.vehicle(2, on_ramp(165.0, 0.0)),
        overpass.vehicle(3, overpass.below(-40.0)),
    ]
    found = play(load(tmp_path, objects), "idm")
    assert found["seen"][0]["agents_mask"].sum() == 1
    assert found["metrics"]["collision"] == 0
    assert found["infos"][-1]["speed"] < 2
    assert found["metrics"]["min_ttc"] < 9


@pytest.mark.parametrize("driver", ["replay", "idm", "pdm"])
def test_a_ramp_stays_road_from_one_level_to_the_other(tmp_path, driver):
    scenes = load(tmp_path, [overpass.vehicle(1, on_ramp(60.0, 20.0)), CROSSING[1]])
    found = play(scenes, driver)
    assert found["metrics"]["off_road"] == 0
    rollout = found["rollout"]
    x = rollout.position[0, :, 0] + scenes[0].origin[0]
    assert x[-1] > 200
    expected = [overpass.ramp_height(float(place)) for place in x]
    np.testing.assert_allclose(rollout.elevation_m[0], expected, atol=0.3)


def test_a_road_above_or_below_is_none_of_ones_own(tmp_path):
    # the ego leaves the road below where the bridge is overhead; 8 m up it is road all the way
    for height_m, other in (
        (0.0, overpass.on_bridge(0.0)),
        (overpass.BRIDGE_M, overpass.below(-40)),
    ):
        aside = overpass.vehicle(1, lambda t, z=height_m: (34.0 + 4.0 * t, 0.0, z))
        metrics = play(load(tmp_path, [aside, overpass.vehicle(2, other)]))["metrics"]
        assert metrics["off_road"] == (height_m == 0.0)
        assert metrics["collision"] == 0


def test_lanes_and_lines_are_those_of_ones_own_level(tmp_path):
    # below the bridge, across the lane of the road below, which leads north; that of the bridge
    # leads east and is 1 m away
    turned = overpass.vehicle(1, lambda t: (40.0, 1.0, 0.0), heading=0.0)
    scenes = load(tmp_path, [turned, overpass.vehicle(2, overpass.on_bridge(0.0))])
    config = WorldConfig(observation={"num_map_segments": 64})
    rows = play(scenes, config=config)["seen"][0]
    lines = rows["map"][rows["map_mask"] > 0]
    assert len(lines) > 20
    # all lines run along the road below, across the ego: x, y, then the cosine of the direction
    assert np.abs(lines[:, 2]).max() < 0.1


def test_networks_and_their_graph_leave_out_other_levels(tmp_path):
    ahead = overpass.vehicle(3, overpass.on_bridge(25.0, speed=4.0))
    for lift, joined in ((0.0, False), (7.0, True)):
        scenes = load(tmp_path, [*CROSSING, ahead], lift=lift)
        env = begun(scenes=scenes, traffic="ccdiff", **OPTIONS)
        env.step(env.action_space.sample() * 0)
        plan = env.unwrapped.worlds.explain(0)
        assert plan is not None
        rows = {int(agent): row for row, agent in enumerate(plan.agents)}
        assert bool(plan.graph[rows[0], rows[1]]) == joined
        assert bool(plan.graph[rows[0], rows[2]])


def test_recordings_keep_heights(tmp_path):
    scenes = load(tmp_path, CROSSING)
    rollout = play(scenes, "idm", traffic="idm")["rollout"]
    assert rollout.elevation_m is not None
    np.testing.assert_allclose(rollout.elevation_m[0], overpass.BRIDGE_M, atol=0.01)
    rollout.save(tmp_path / "r.npz")
    again = Rollout.load(tmp_path / "r.npz")
    assert (again.elevation_m == rollout.elevation_m).all()
    played = rollout.to_scene()
    assert play(SceneSet([played]))["metrics"]["collision"] == 0
    assert (played.tracks()["elevation_m"][0] > 7).all()


def test_metrics_of_motions_part_levels(tmp_path):
    scene = load(tmp_path, CROSSING)[0]
    tracks = scene.tracks()
    arrays = (tracks["position"], tracks["heading"], scene.sizes[:, :2])
    flat, real = Motion(*arrays), Motion(*arrays, elevation_m=tracks["elevation_m"])
    assert flat.collisions().any("all")
    assert not real.collisions().any("all")
    assert (flat.min_ttc() == 0).all()
    assert (real.min_ttc() == 20).all()
    layers = scene.map_layers()
    areas = [(area["exterior"], area["holes"]) for area in layers["drivable_area"]]
    heights = layers["elevation_m"]["drivable_area"]
    assert real.off_road(areas, elevation_m=heights).box_rate == 0
    # the same places at the other's height: on the road only where the roads cross, 12 m of 90 m
    swapped = Motion(*arrays, elevation_m=tracks["elevation_m"][::-1].copy())
    assert swapped.off_road(areas, elevation_m=heights).centroid_rate > 0.8


def test_snapshots_go_on_at_their_heights(tmp_path):
    env = begun(scenes=load(tmp_path, CROSSING), traffic="idm", driver="idm", **OPTIONS)
    native = env.worlds.native
    for _ in range(20):
        env.step(env.action_space.sample() * 0)
    kept, heights = native.snapshot(0), native.states(0)["elevation_m"]
    assert heights == pytest.approx([overpass.BRIDGE_M, 0], abs=0.01)
    env.reset(seed=0)
    native.restore(0, kept)
    assert (native.states(0)["elevation_m"] == heights).all()


@pytest.mark.parametrize("lift", [0.0, 7.0])
def test_measures_from_arrays_part_levels(tmp_path, lift):
    ahead = overpass.vehicle(3, overpass.on_bridge(25.0, speed=8.0))
    scene = load(tmp_path, [*CROSSING, ahead], lift=lift)[0]
    step, ids, apart = 35, scene.agent_ids, lift == 0.0
    # the one that crosses is reached first, unless it is below
    nearest = [ids[agent] for agent in scene.ranked_vehicles(step, "ttc")]
    assert nearest == (["ego", "3", "2"] if apart else ["ego", "2", "3"])
    agents = np.array([ids.index(name) for name in ("ego", "2", "3")])
    for near in relations(scene, agents, step):
        assert near[-1, 0, 2] > 0
        assert near[:, 1, ::2].any() != apart
    rollout = play(SceneSet([scene]))["rollout"]
    crosses = rollout.agent_ids.index("2")
    assert any(crosses in pair[:2] for pairs in contacts(rollout) for pair in pairs) != apart


def test_map_queries_answer_for_a_level(tmp_path):
    scenes = load(tmp_path, CROSSING)
    scene, places = scenes[0], np.array([[40.0, 20.0], [0.0, 0.0], [40.0, 0.0]])
    low, high = np.zeros(3), np.full(3, overpass.BRIDGE_M)
    # both roads are 12 m wide: one runs north at x = 40 m on the ground, one east at y = 0 above it
    for elevation_m, expected in ((low, [6, -34, 6]), (high, [-14, 6, 6]), (None, [6, 6, np.nan])):
        found = map_queries.road_distance(scene, places, elevation_m=elevation_m)
        known = np.isfinite(expected)
        np.testing.assert_allclose(found[known], np.array(expected)[known], atol=0.05)
    for elevation_m, along in ((low, 0.0), (high, 1.0)):
        heads = np.array([np.pi / 2 + 0.2, -0.2])
        lanes = map_queries.lane_ahead(scene, places[[2, 2]], heads, elevation_m=elevation_m[:2])
        np.testing.assert_array_equal(lanes.valid[:, 0], [along == 0.0, along == 1.0])
    with pytest.raises(ShapeError, match="elevation_m"):
        map_queries.road_distance(scene, places, elevation_m=np.zeros(2))
    # what planners ask is asked of the level of who is driven
    env = begun(scenes=scenes, traffic="replay", driver="replay", **OPTIONS)
    found = planning.road_distance(env.worlds, 0, places)
    np.testing.assert_allclose(found, [-14, 6, 6], atol=0.05)
    assert not planning.lane_ahead(env.worlds, 0, [[40.0, 20.0, np.pi / 2]]).valid.any()


# what loaders keep


def first(path):
    return ccdiff_env.load_gpudrive(path, cache=False)[0]


@pytest.fixture
def scene(tmp_path):
    return first(overpass.write(tmp_path / "bridge.json", CROSSING))


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
    path = overpass.write(tmp_path / "bridge.json", CROSSING)
    first, second = (ccdiff_env.load_gpudrive(path, cache=tmp_path / "cache") for _ in range(2))
    assert (first.report.cache.hits, second.report.cache.hits) == (0, 1)
    assert first[0] == second[0] == Scene.from_bytes(first[0].to_bytes())
    assert any("levels of roads" in note for note in second.report.scenes[0].notes)
    again = pickle.loads(pickle.dumps(first[0]))
    assert (again.tracks()["elevation_m"] == first[0].tracks()["elevation_m"]).all()


@pytest.mark.parametrize("height", [1e9, -10_000.0, 1e300])
def test_heights_that_are_none_on_earth_are_refused(tmp_path, height):
    objects = json.loads(json.dumps(CROSSING))
    objects[1]["position"][7]["z"] = height
    with pytest.raises(DatasetError, match=r"objects\[1\].position\[7\].*z.*9 km"):
        first(overpass.write(tmp_path / "far.json", objects))
    roads = overpass.roads()
    roads[0]["geometry"][3]["z"] = height
    with pytest.raises(DatasetError, match="9 km in height"):
        first(overpass.write(tmp_path / "far.json", CROSSING, roads=roads))


@pytest.mark.parametrize("of", ["object", "road"])
def test_without_all_heights_a_scene_is_flat_and_says_so(tmp_path, of):
    objects, roads = json.loads(json.dumps(CROSSING)), overpass.roads()
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
