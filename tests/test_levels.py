"""Worlds in which roads pass over each other: who has to do with whom, and whose road is whose."""

import json
from typing import Any

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import EgoEnv, Recorder, Rollout, SceneSet, WorldConfig
from ccdiff_env.bench.traffic import relations
from ccdiff_env.errors import ShapeError
from ccdiff_env.metrics import Motion
from ccdiff_env.planners import planning
from ccdiff_env.scenes import map_queries
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
    observation, _ = env.reset(seed=0)
    recorder.start()
    infos, seen, done = [], [observation], False
    while not done:
        observation, _, terminated, truncated, info = env.step(env.action_space.sample() * 0)
        done = terminated or truncated
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
        env = EgoEnv(scenes=scenes, traffic="ccdiff", **OPTIONS)
        env.reset(seed=0)
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
    env = EgoEnv(scenes=load(tmp_path, CROSSING), traffic="idm", driver="idm", **OPTIONS)
    env.reset(seed=0)
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
    env = EgoEnv(scenes=scenes, traffic="replay", driver="replay", **OPTIONS)
    env.reset(seed=0)
    found = planning.road_distance(env.worlds, 0, places)
    np.testing.assert_allclose(found, [-14, 6, 6], atol=0.05)
    assert not planning.lane_ahead(env.worlds, 0, [[40.0, 20.0, np.pi / 2]]).valid.any()
