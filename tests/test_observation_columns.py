"""Columns that rows have on request, against shapely and the states."""

import numpy as np
import shapely
from array_scenes import TIMES_S, agent, array_scene, played, wide_road

from ccdiff_env import EgoEnv
from ccdiff_env.config import ObservationConfig, WorldConfig

REACH_M = 20.0
#: Bearings of the columns of the road, degrees to the left of the heading.
BEARINGS = {"left": 90, "front_left": 30, "front": 0, "front_right": -30, "right": -90}


def test_changes_of_speed_and_heading_are_there_for_who_asks_for_them(scenes):
    columns = ("x", "y", "speed", "acceleration", "yaw_rate")
    row = ObservationConfig(num_neighbors=60, radius_m=500.0, agent_columns=columns)
    config = WorldConfig(traffic="idm", observation=row, horizon_steps=40)
    env = EgoEnv(scenes=scenes, config=config, observation="dict")
    before, was_there, braked, turned = {}, np.zeros(0, bool), 0, 0
    for _, states, _ in played(env, np.array([-0.8, 0.0], np.float32)):
        now, there = {n: states[n].copy() for n in ("speed", "heading")}, states["active"][1:]
        if before:
            speed_mps, turn = ((now[n] - before[n])[1:][there & was_there] for n in now)
            # divided by the step of 0.1 s and by the scales of 10 m/s² and 1 rad/s
            turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
            expected = [np.clip(speed_mps, -1.0, 1.0), np.clip(10.0 * turn, -1.0, 1.0)]
            observation = env.observation()
            shown = observation["agents"][observation["agents_mask"] > 0][:, 3:]
            if len(shown) == len(expected[0]):
                np.testing.assert_allclose(np.sort(shown.T), np.sort(expected), atol=2e-3)
                braked += int(np.abs(expected[0]).max() > 0.05)
                turned += int(np.abs(expected[1]).max() > 0.05)
        before, was_there = now, there.copy()
    assert braked > 5
    assert turned > 5


def test_the_way_to_the_end_of_the_road_is_that_of_shapely(scenes):
    columns = tuple(f"road_{name}" for name in BEARINGS)
    row = ObservationConfig(ego_columns=columns)
    env = EgoEnv(scenes=scenes, config=WorldConfig(observation=row), observation="dict")
    found = []
    for scene in scenes:
        env.reset(seed=0, options={"scene": scene.name})
        areas = scene.map_layers()["drivable_area"]
        polygons = [shapely.Polygon(a["exterior"], a["holes"]).buffer(0) for a in areas]
        road = shapely.unary_union(polygons)
        for _ in range(4):
            shown = env.step(np.array([0.3, 0.4], np.float32))[0]["ego"] * REACH_M
            states = env.worlds.native.states(0)
            place, heading = states["position"][0].astype(float), float(states["heading"][0])
            for way_m, bearing in zip(shown, np.deg2rad([*BEARINGS.values()]), strict=True):
                angle = heading + bearing
                ahead = place + REACH_M * np.array([np.cos(angle), np.sin(angle)])
                off = shapely.LineString([place, ahead]).difference(road)
                parts = [*shapely.get_parts(off), shapely.Point(ahead)]
                begins = np.array([shapely.Point(place).distance(part) for part in parts])
                wide = np.array([part.length > 1.0 for part in parts[:-1]] + [True])
                # what is narrower than the steps of a metre may be passed over
                last = begins[wide].min()
                assert (np.abs(begins[begins <= last] - way_m - 0.05) < 0.1).any()
                found.append(way_m)
    assert 0.2 < np.mean(np.array(found) < REACH_M) < 0.9


def test_without_a_road_its_end_is_far():
    row = ObservationConfig(ego_columns=("road_left",))
    scene = array_scene(agent("ego", x=5.0 * TIMES_S), layers=wide_road() | {"drivable_area": []})
    env = EgoEnv(scenes=scene, config=WorldConfig(observation=row), observation="dict")
    assert env.reset(seed=0)[0]["ego"].tolist() == [1.0]
