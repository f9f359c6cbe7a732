"""Planners of nuPlan in the ego's seat, beside nuplan-devkit itself.

Needs a checkout of nuplan-devkit, and for PDM-Closed of tuplan_garage, in CCDIFF_NUPLAN.
"""

import importlib
import os
import sys

import numpy as np
import pytest
from shapely import Point, Polygon
from shapely.ops import unary_union

import ccdiff_env
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.provenance import source_digest
from ccdiff_env.errors import ConfigError, MissingFeatureError, PolicyError
from ccdiff_env.interop.nuplan.devkit import VARIABLE, checkouts, find_devkit
from ccdiff_env.planners.built_in import ego_driver
from ccdiff_env.record.episode import begin
from ccdiff_env.scenes.scene_types import LIGHT_STATES
from ccdiff_env_cli import main

REPLAY = TRAFFIC["replay"]
IDM = "nuplan:nuplan.planning.simulation.planner.idm_planner.IDMPlanner"
PDM = (
    "nuplan:tuplan_garage.planning.simulation.planner.pdm_planner.pdm_closed_planner"
    ".PDMClosedPlanner"
)
#: A planner on nuPlan's interface: straight on at a speed, or an error.
MINE = """
from nuplan.common.actor_state.ego_state import EgoState
from nuplan.common.actor_state.state_representation import StateSE2, StateVector2D, TimePoint
from nuplan.planning.simulation.observation.observation_type import DetectionsTracks, SensorsTracks
from nuplan.planning.simulation.planner.abstract_planner import AbstractPlanner
from nuplan.planning.simulation.trajectory.interpolated_trajectory import InterpolatedTrajectory


class Straight(AbstractPlanner):
    told = []
    given = []

    def __init__(self, speed_mps, fails_at=None):
        self._speed, self._fails_at = speed_mps, fails_at

    def name(self):
        return "straight"

    def observation_type(self):
        return DetectionsTracks

    def initialize(self, initialization):
        Straight.told.append(initialization)

    def compute_planner_trajectory(self, current_input):
        Straight.given.append(current_input)
        if current_input.iteration.index == self._fails_at:
            raise ValueError("no way on")
        ego = current_input.history.current_state[0]
        x, y, heading = ego.rear_axle.serialize()
        states = []
        for k in range(41):
            way = self._speed * 0.1 * k
            states.append(
                EgoState.build_from_rear_axle(
                    moved(x, y, heading, way),
                    StateVector2D(self._speed, 0.0),
                    StateVector2D(0.0, 0.0),
                    0.0,
                    TimePoint(ego.time_us + 100000 * k),
                    ego.car_footprint.vehicle_parameters,
                )
            )
        return InterpolatedTrajectory(states)


def moved(x, y, heading, way):
    from math import cos, sin

    return StateSE2(x + way * cos(heading), y + way * sin(heading), heading)


class Sees(Straight):
    def observation_type(self):
        return SensorsTracks


class Oracle(Straight):
    requires_scenario = True
"""


@pytest.fixture(scope="module", autouse=True)
def devkit():
    """The devkit, importable; skips where it is not."""
    pytest.importorskip("yaml", reason="PyYAML is not installed: pip install 'ccdiff-env[nuplan]'")
    try:
        find_devkit()
    except MissingFeatureError as error:
        pytest.skip(f"{VARIABLE} names no usable nuplan-devkit: {error}")


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A module with custom planners."""
    (tmp_path / "mine_of_nuplan.py").write_text(MINE.replace("SensorsTracks", "Sensors"))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "mine_of_nuplan", raising=False)
    return importlib.import_module("mine_of_nuplan")


@pytest.fixture(scope="module")
def scenes():
    return ccdiff_env.embedded_scenes("val")[:3]


def played(scenes, name, steps):
    """Ego's places [T, 3] in the first world: x, y and heading, and the worlds."""
    _, seat = ego_driver(name)
    config = PROTOCOL.world(seat, name, scenes[0].dt).with_options(
        driver="external", traffic="replay", on_collision="ignore", terminate_at_goal=False
    )
    worlds = begin(scenes, config, 0)
    out = worlds.last
    seat.begin(worlds)
    ego = worlds.native.slot_agents(0)[0]
    places = []
    for _ in range(steps + 1):
        now = worlds.native.states(0)
        places.append([*now["position"][ego], now["heading"][ego]])
        actions = seat(np.zeros((len(scenes), worlds.layout.size), np.float32))
        out = out or worlds.arrays()
        worlds.native.step(actions.reshape(len(scenes), 1, -1), out)
    return np.array(places, np.float64), worlds


def test_the_ego_goes_where_nuplans_own_controller_takes_it(mine, scenes):
    """Beside the devkit's closed loop: two-stage controller, LQR and bicycle."""
    from nuplan.planning.simulation.controller.motion_model.kinematic_bicycle import (
        KinematicBicycleModel,
    )
    from nuplan.planning.simulation.controller.tracker.lqr import LQRTracker
    from nuplan.planning.simulation.controller.two_stage_controller import TwoStageController

    steps = 30
    places, _ = played(scenes[:1], "nuplan:mine_of_nuplan.Straight?speed_mps=6.0", steps)
    given = mine.Straight.given
    ego = given[0].history.current_state[0]
    vehicle = ego.car_footprint.vehicle_parameters
    values = {
        "q_longitudinal": [10.0],
        "r_longitudinal": [1.0],
        "q_lateral": [1.0, 10.0, 0.0],
        "r_lateral": [1.0],
        "discretization_time": 0.1,
        "tracking_horizon": 10,
        "jerk_penalty": 1e-4,
        "curvature_rate_penalty": 1e-2,
        "stopping_proportional_gain": 0.5,
        "stopping_velocity": 0.2,
    }
    loop = TwoStageController(
        None, LQRTracker(**values, vehicle=vehicle), KinematicBicycleModel(vehicle)
    )
    planner = mine.Straight(6.0)
    expected = [ego.center.serialize()]
    for k in range(steps):
        history = type("History", (), {"current_state": (ego, None)})
        seen = type("Input", (), {"history": history, "iteration": given[k].iteration})
        loop.update_state(
            given[k].iteration,
            given[k + 1].iteration,
            ego,
            planner.compute_planner_trajectory(seen),
        )
        ego = loop.get_state()
        expected.append(ego.center.serialize())
    expected = np.array(expected)
    assert np.ptp(expected[:, :2], axis=0).max() > 5.0
    assert np.abs(places[:, :2] - expected[:, :2]).max() < 2e-3  # float32 of the world, summed
    turn = places[:, 2] - expected[:, 2]
    assert np.abs(np.arctan2(np.sin(turn), np.cos(turn))).max() < 1e-4


def test_a_planner_is_given_the_rear_axle_two_seconds_and_all_others(mine, scenes):
    played(scenes[:1], "nuplan:mine_of_nuplan.Straight?speed_mps=6.0", 5)
    scene, (told,), given = scenes[0], mine.Straight.told, mine.Straight.given[3]
    start = PROTOCOL.fields["world"]["history_steps"]
    now, tracks = start + 3, scene.tracks()
    ego, seen = given.history.current_state
    assert given.iteration.time_us == now * 100_000
    assert given.history.size == 22
    assert [s.time_us for s in given.history.ego_states] == [
        100_000 * k for k in range(now - 21, now + 1)
    ]
    # the log's past: the middle of the rear axle, as nuScenes' car has it
    before = given.history.ego_states[0]
    at, heading = tracks["position"][0, now - 21], tracks["heading"][0, now - 21]
    length = scene.sizes[0, 0]
    behind = at - 1.385 / 4.084 * length * np.array([np.cos(heading), np.sin(heading)])
    assert before.rear_axle.array == pytest.approx(behind, abs=1e-4)
    assert before.center.array == pytest.approx(at, abs=1e-4)
    corners = np.array(before.car_footprint.geometry.exterior.coords)
    assert Polygon(corners).area == pytest.approx(length * scene.sizes[0, 1], rel=1e-4)
    # the others as the world has them, which replays the log
    others = np.flatnonzero(tracks["valid"][:, now])[1:]
    objects = {o.track_token: o for o in seen.tracked_objects.tracked_objects}
    assert set(objects) == {str(i) for i in others}
    for i in others:
        track = objects[str(i)]
        assert track.center.array == pytest.approx(tracks["position"][i, now], abs=0.05)
        assert track.box.length == pytest.approx(scene.sizes[i, 0], rel=1e-5)
    assert told.mission_goal.array.shape == (2,)
    assert len(told.route_roadblock_ids) >= 2
    # nothing of it says which scene it is
    text = repr([told.route_roadblock_ids, told.map_api.map_name, sorted(objects)])
    assert scene.name not in text
    assert not any(name in text for name in scene.agent_ids if len(name) > 4)
    assert ego.scene_object_metadata.token == "ego"


def test_planners_are_told_of_traffic_lights(mine):
    """States of the step by connector; the devkit's IDM waits where they are red."""
    scene = ccdiff_env.load("embedded/city-lights")["tee-crossing-005"]
    lights = scene.map_layers()["lights"]
    _, worlds = played([scene], "nuplan:mine_of_nuplan.Straight?speed_mps=0", 20)
    start = worlds.config.history_steps
    edges = mine.Straight.told[-1].map_api.edges
    assert all(edges[light["lane"]].has_traffic_lights() for light in lights)
    for k, given in enumerate(mine.Straight.given[-21:]):
        told = {d.lane_connector_id: d.status.name.lower() for d in given.traffic_light_data}
        assert told == {
            int(edges[light["lane"]].id): LIGHT_STATES[light["states"][start + k]]
            for light in lights
        }
    ends = {}
    for name, each in (("lit", scene), ("bare", scene.with_lights([]))):
        places, _ = played([each], IDM, 40)
        ends[name] = np.linalg.norm(places[-1, :2] - places[0, :2])
    assert ends["lit"] < 25 < ends["bare"]


def test_agents_of_another_level_are_not_seen(scenes):
    from ccdiff_env.interop.nuplan.states import SceneStates

    states = SceneStates(scenes[0], 0)
    now = {k: v[:, 30] for k, v in scenes[0].tracks().items()}
    there = np.flatnonzero(now["valid"])
    above = np.zeros(len(now["valid"]), np.float32)
    above[there[1]] = 5.0
    seen = states.tracks({**now, "elevation_m": above}, now["valid"], 0).tracked_objects
    assert {o.track_token for o in seen.tracked_objects} == {str(i) for i in there[2:]}


def test_a_map_answers_as_shapely_does(scenes):
    from nuplan.common.actor_state.state_representation import Point2D
    from nuplan.common.maps.maps_datatypes import SemanticMapLayer as Layer

    from ccdiff_env.interop.nuplan.roads import surface
    from ccdiff_env.interop.nuplan.scene_map import SceneMap

    layers = scenes[0].map_layers()
    found = SceneMap(layers, "town")
    assert found.map_name == "town"
    names = [o.id for layer in found.get_available_map_objects() for o in found._layers[layer]]
    assert all(name.isdigit() for name in names)
    lanes = [surface(lane["polygon"]) for lane in layers["lanes"]]
    road = unary_union([surface(p) for p in layers["drivable_area"]])
    rng = np.random.default_rng(0)
    ego = scenes[0].tracks()["position"][0, 30]
    for x, y in ego + rng.uniform(-40, 40, (60, 2)):
        at, point = Point(x, y), Point2D(x, y)
        both = [Layer.LANE, Layer.LANE_CONNECTOR]
        inside = sum(len(found.get_all_map_objects(point, layer)) for layer in both)
        assert inside == sum(lane.intersects(at) for lane in lanes)
        near = found.get_proximal_map_objects(point, 15.0, both)
        assert sum(map(len, near.values())) == sum(lane.distance(at) <= 15.0 for lane in lanes)
        assert found.is_in_layer(point, Layer.DRIVABLE_AREA) == road.intersects(at)
        _, away = found.get_distance_to_nearest_map_object(point, Layer.DRIVABLE_AREA)
        assert away == pytest.approx(road.distance(at), abs=1e-6)
        lane = found.get_one_map_object(point, Layer.LANE)
        if lane is not None:
            left, right = lane.get_width_left_right(point)
            assert 0 <= min(left, right) < 4
            assert found.get_map_object(lane.id, Layer.LANE) is lane
            assert lane in lane.parent.interior_edges
            assert all(lane in after.incoming_edges for after in lane.outgoing_edges)
    with pytest.raises(MissingFeatureError, match="no raster map"):
        found.get_raster_map_layer(Layer.DRIVABLE_AREA)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("mine_of_nuplan.Straight", "missing a required argument: 'speed_mps'; it takes speed_mps"),
        ("mine_of_nuplan.Sees?speed_mps=1", "observes Sensors, expected DetectionsTracks"),
        ("mine_of_nuplan.Oracle?speed_mps=1", "asks for nuPlan's scenario"),
        ("mine_of_nuplan.moved", "not a subclass of nuPlan's AbstractPlanner"),
    ],
)
def test_planners_that_scenes_cannot_feed_are_refused(mine, name, says):
    with pytest.raises(ConfigError, match=says):
        ego_driver(f"nuplan:{name}")


def test_what_a_planner_raises_names_its_scene_alone(mine, scenes):
    name = "nuplan:mine_of_nuplan.Straight?speed_mps=1&fails_at=2"
    with pytest.raises(PolicyError, match=f"no way on .in {scenes[0].name} at step 2.$"):
        drive(scenes, name, REPLAY)


@pytest.mark.parametrize("name", [IDM, "nuplan:simple_planner", PDM])
def test_planners_of_nuplan_drive(name, scenes):
    if name == PDM and not any((f / "tuplan_garage").is_dir() for f in checkouts()):
        pytest.skip(f"{VARIABLE} names no checkout of tuplan_garage")
    rows, _ = drive(scenes, name, REPLAY)
    assert [row["scene"] for row in rows] == list(scenes.names)
    assert all(row["progress"] > 0.05 for row in rows)
    if "simple" not in name:
        assert np.mean([row["score"] for row in rows]) > 0.6
    again, _ = drive(scenes[1:2], name, REPLAY)
    assert again[0]["digest"] == rows[1]["digest"]  # alone as in a batch


def test_options_reach_the_planner(scenes):
    rows = [drive(scenes[:1], f"{IDM}?target_velocity={v}", REPLAY)[0][0] for v in (2, 12)]
    assert rows[0]["digest"] != rows[1]["digest"]


def test_inputs_of_learned_planners_are_built(mine, scenes):
    pytest.importorskip("torch")
    from nuplan.planning.simulation.trajectory.trajectory_sampling import TrajectorySampling
    from nuplan.planning.training.preprocessing.feature_builders.generic_agents_feature_builder import (  # noqa: E501
        GenericAgentsFeatureBuilder,
    )
    from nuplan.planning.training.preprocessing.feature_builders.vector_set_map_feature_builder import (  # noqa: E501
        VectorSetMapFeatureBuilder,
    )

    played(scenes[:1], "nuplan:mine_of_nuplan.Straight?speed_mps=6.0", 2)
    given, (told,) = mine.Straight.given[-1], mine.Straight.told
    kinds = ["LANE", "ROUTE_LANES", "CROSSWALK"]
    lanes = VectorSetMapFeatureBuilder(
        map_features=kinds,
        max_elements=dict.fromkeys(kinds, 20),
        max_points=dict.fromkeys(kinds, 20),
        radius=50,
        interpolation_method="linear",
    ).get_features_from_simulation(given, told)
    assert lanes.coords["LANE"][0].shape == (20, 20, 2)
    assert lanes.availabilities["LANE"][0].any()
    route = lanes.coords["ROUTE_LANES"][0][lanes.availabilities["ROUTE_LANES"][0]]
    assert np.hypot(*route.T).min() < 10  # in the ego's frame
    sampling = TrajectorySampling(num_poses=4, time_horizon=2.0)
    agents = GenericAgentsFeatureBuilder(["VEHICLE", "PEDESTRIAN"], sampling)
    found = agents.get_features_from_simulation(given, told)
    assert found.ego[0].shape == (5, 7)
    assert found.ego[0][-1, :3] == pytest.approx([0, 0, 0], abs=1e-5)
    assert found.agents["VEHICLE"][0].shape[::2] == (5, 8)


def test_nuplans_score_of_the_logged_driver_and_of_one_who_waits(scenes):
    from ccdiff_env.bench.nuplan_score import PARTS, nuplan_score

    _, logged = drive(scenes, "replay", REPLAY, record=scenes.names)
    found = [nuplan_score(rollout, 100) for rollout in logged.values()]
    assert all(set(parts) == {*PARTS, "score"} for parts in found)
    assert min(parts["score"] for parts in found) > 0.9
    (row,), waits = drive(
        scenes[:1], lambda obs: np.full((len(obs), 2), -1.0), REPLAY, record=scenes.names[:1]
    )
    parts = nuplan_score(waits[scenes[0].name], 100)
    assert parts["makes_progress"] == row["makes_progress"] == 0.0
    assert parts["score"] == 0.0


def test_the_bench_plays_them_with_a_column_of_nuplans_score(tmp_path, monkeypatch, capsys):
    checkout = os.environ.get(VARIABLE)
    words = [
        "bench", "planners", "--planners", "nuplan:idm_planner,lane_idm", "--traffic", "replay",
        "--seeds", "0", "--limit", "3", "--out", str(tmp_path / "run"), "--quiet",
        "--nuplan-score", "--replays", "1", *(["--nuplan", checkout] if checkout else []),
    ]  # fmt: skip
    assert main(words) == 0
    header = (tmp_path / "run" / "episodes.csv").read_text().splitlines()[0].split(",")
    assert {"planner", "traffic", "seed", "scene", "score", "nuplan_score"} <= set(header)
    assert "nuplan score" in (tmp_path / "run" / "table.md").read_text()
    # a check plays recorded actions, never the planner
    monkeypatch.setattr("ccdiff_env.planners.built_in.nuplan_planner", None)
    monkeypatch.setattr("ccdiff_env.bench.provenance.nuplan_planner", None)
    capsys.readouterr()
    assert main(["bench", "verify", str(tmp_path / "run")]) == 0
    assert "6 of 6 episodes come out the same" in capsys.readouterr().out


def test_a_digest_follows_the_settings_and_the_source(mine, tmp_path):
    name = "nuplan:mine_of_nuplan.Straight?speed_mps=1"
    found = source_digest(name)
    assert found is not None
    source = tmp_path / "mine_of_nuplan.py"
    source.write_text(source.read_text() + "# more\n")
    with pytest.raises(ConfigError, match="has changed"):
        source_digest(name)
    assert source_digest(IDM) == source_digest(IDM) != found
