"""Logs of py123d against what was written: nuScenes by its own parser, and logs with lights."""

from types import SimpleNamespace

import numpy as np
import pytest
import shapely

import ccdiff_env
from ccdiff_env.errors import DatasetError, DatasetNotFoundError
from ccdiff_env.scenes.scene_types import LIGHT_STATES
from ccdiff_env.scenes.sources import in_windows
from ccdiff_env.scenes.windows import Windows

pytest.importorskip("py123d", reason="py123d is not installed: make test-py123d")

from py123d import datatypes as d
from py123d.api.map.arrow.arrow_map_writer import ArrowMapWriter
from py123d.api.scene.arrow.arrow_log_writer import ArrowLogWriter
from py123d.api.scene.arrow.utils.log_writer_config import LogWriterConfig
from py123d.geometry import BoundingBoxSE3, Polyline2D, Polyline3D, PoseSE3, Vector3D
from py123d.parser.base_dataset_parser import ModalitiesSync
from py123d.parser.nuplan.utils.nuplan_constants import NUPLAN_BOX_DETECTIONS_SE3_METADATA as BOXES
from py123d.parser.nuplan.utils.nuplan_constants import NUPLAN_EGO_STATE_SE3_METADATA as EGO
from py123d.parser.registry import NuPlanBoxDetectionLabel as Label


def write(root, metadata, frames, map_metadata=None, things=()):
    """Write a log of frames, (microseconds, modalities) each, and its map."""
    writer = ArrowLogWriter(LogWriterConfig(), root / "logs", root / "sensors")
    writer.reset(metadata)
    for time_us, modalities in frames:
        writer.write_sync(ModalitiesSync(d.Timestamp.from_us(time_us), modalities))
    writer.close()
    if map_metadata is not None:
        maps = ArrowMapWriter(True, root / "maps", root / "logs")
        maps.reset(map_metadata)
        for thing in things:
            maps.write_map_object(thing)
        maps.close()


def near(folder, scene):
    """The map round a scene, by the devkit and the parser's functions for surfaces.

    Its own one for lanes refuses some of the polygons of these maps.
    """
    from py123d.parser.nuscenes import nuscenes_map_parser as parser
    from py123d.parser.nuscenes.utils.nuscenes_map_utils import extract_nuscenes_centerline

    devkit = parser.NuScenesMap(str(folder), scene.location)
    x, y = scene.tracks()["position"][0].mean(axis=0) + scene.origin
    layers = ["lane", "lane_connector"]
    for layer, tokens in devkit.get_records_in_radius(x, y, 200, layers).items():
        for token in tokens:
            record = devkit.get(layer, token)
            line, surface = extract_nuscenes_centerline(devkit, record), record["polygon_token"]
            yield d.Lane(
                token, d.LaneType.SURFACE_STREET, line, line, line,
                successor_ids=devkit.get_outgoing_lane_ids(token),
                predecessor_ids=devkit.get_incoming_lane_ids(token),
                shapely_polygon=devkit.extract_polygon(surface),
            )  # fmt: skip
    for name in ("crosswalks", "walkways", "carparks", "generic_drivables", "stop_zones"):
        yield from getattr(parser, f"_extract_nuscenes_{name}")(devkit)


@pytest.fixture(scope="module")
def both(data_root, tmp_path_factory):
    """A mini scene by our loader and by py123d, whose parser reads what nuscenes-devkit has."""
    parser = pytest.importorskip("py123d.parser.nuscenes.utils.nuscenes_extraction")
    from py123d.parser.nuscenes.nuscenes_map_parser import NuScenesMapParser
    from py123d.parser.nuscenes.utils import nuscenes_constants as constants

    name, folder = "scene-0103", data_root / "nuscenes"
    (own,) = ccdiff_env.load_nuscenes(
        folder, scenes=[name], timing="nominal", interpolation="linear", cache=False
    )
    devkit = parser.NuScenes("v1.0-mini", str(folder), verbose=False)
    (record,) = [scene for scene in devkit.scene if scene["name"] == name]
    without = SimpleNamespace(get_messages=lambda *_: [])  # no CAN bus
    frames = []
    for i, sample in enumerate(parser.collect_keyframe_samples(devkit, record)):
        ego = parser.extract_ego_state_from_sample(
            devkit, sample, without, constants.NUSCENES_EGO_STATE_SE3_METADATA
        )
        boxes = parser.extract_nuscenes_box_detections(
            devkit, sample, constants.NUSCENES_BOX_DETECTIONS_SE3_METADATA
        )
        time_us = 1_500_000_000_000_000 + 500_000 * i  # nominal
        for state in (ego, boxes):
            state._timestamp = d.Timestamp.from_us(time_us)
        frames.append((time_us, [ego, boxes]))
    root = tmp_path_factory.mktemp("py123d")
    city = NuScenesMapParser(folder, own.location)
    metadata = d.LogMetadata("nuscenes", "nuscenes-mini_val", name, own.location)
    write(root, metadata, frames, city.get_map_metadata(), near(folder, own))
    (read,) = ccdiff_env.load(f"py123d:{root}")
    return own, read


@pytest.mark.nuscenes
def test_nuscenes_by_py123d_is_nuscenes(both):
    own, read = both
    assert (read.name, read.location, read.dt) == (own.name, own.location, own.dt)
    assert set(read.agent_ids) == set(own.agent_ids)
    assert read.agent_ids[0] == "ego"
    order = [read.agent_ids.index(ident) for ident in own.agent_ids]
    assert [read.agent_types[i] for i in order] == own.agent_types
    assert np.allclose(read.sizes[order, :2], own.sizes[:, :2], atol=1e-3)
    ours, theirs = own.tracks(), {k: v[order] for k, v in read.tracks().items()}
    shift = np.subtract(read.origin, own.origin)
    keys = np.arange(0, own.num_steps, 5)
    seen = (ours["valid"] & theirs["valid"])[:, keys]
    assert np.array_equal(ours["valid"][:, keys], theirs["valid"][:, keys])
    apart = np.linalg.norm(theirs["position"] + shift - ours["position"], axis=2)[:, keys]
    assert apart[seen].max() < 0.01
    turned = (theirs["heading"] - ours["heading"])[:, keys]
    assert np.abs(np.angle(np.exp(1j * turned)))[seen].max() < 1e-3


@pytest.mark.nuscenes
def test_surfaces_of_nuscenes_by_py123d(both):
    own, read = both
    shift = np.subtract(read.origin, own.origin)
    points = own.tracks()["position"][0]
    near = shapely.LineString(points).buffer(50)

    def union(polygons, by=(0, 0)):
        parts = [
            shapely.make_valid(shapely.Polygon(p["exterior"] + by, [h + by for h in p["holes"]]))
            for p in polygons
        ]
        return shapely.intersection(shapely.union_all(parts), near)

    ours, theirs = own.map_layers(), read.map_layers()
    for layer in ("drivable_area", "ped_crossings", "walkways", "stop_lines", "carpark_areas"):
        mine, other = union(ours[layer]), union(theirs[layer], shift)
        assert mine.symmetric_difference(other).area <= 0.001 * mine.area + 0.1, layer
    for lane in ours["lanes"]:
        line = shapely.LineString(lane["centreline"])
        if line.within(near):
            lines = (shapely.LineString(o["centreline"] + shift) for o in theirs["lanes"])
            assert min(line.hausdorff_distance(other) for other in lines) < 0.3, lane["id"]


def pose(x, y, yaw, z=0.0):
    turned = np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
    return PoseSE3.from_R_t(turned, np.array([x, y, z]))


def line(*points):
    return Polyline2D.from_array(np.array(points, float))


def frame(k, hertz, boxes, lights=None, ego_at=None):
    """Frame k of a log: the ego at 10 m/s along x, boxes (token, label, x, y, yaw), and lights."""
    time_us = k * 1_000_000 // hertz
    stamp, x = d.Timestamp.from_us(time_us), 10.0 * time_us / 1e6 - 100.0
    zero = Vector3D(0, 0, 0)
    moves = d.DynamicStateSE3(velocity=Vector3D(10, 0, 0), acceleration=zero, angular_velocity=zero)
    at = pose(x, 0, 0) if ego_at is None else pose(*ego_at(x))
    found = [
        d.BoxDetectionSE3(
            d.BoxDetectionAttributes(label, token),
            BoundingBoxSE3(pose(bx, by, yaw, 1.0), 4.5, 2.0, 1.5),
            Vector3D(5, 0, 0),
        )
        for token, label, bx, by, yaw in boxes
    ]
    states = [
        d.EgoStateSE3.from_center(at, EGO, stamp, moves),
        d.BoxDetectionsSE3(found, stamp, BOXES),
    ]
    if lights is not None:
        seen = [d.TrafficLightDetection(lane, d.TrafficLightStatus[name]) for lane, name in lights]
        states.append(d.TrafficLightDetections(seen, stamp))
    return time_us, states


def test_a_log_as_nuplan_has_them(tmp_path):
    """20 Hz, a light over a connector that turns green at 10 s, a walker who is away for 3 s."""

    def at(k):
        boxes = [("car", Label.VEHICLE, 0.25 * k - 80, 0.0, 0.0)]
        if not 100 < k < 160:
            boxes.append(("walker", Label.PEDESTRIAN, 0.0, 5 + 0.05 * k, 1.5))
        return frame(k, 20, boxes, [(7, "RED" if k < 200 else "GREEN")] if k > 20 else [])

    def lane(ident, x0, x1, group, successors=(), predecessors=()):
        sides = [line((x0, y), (x1, y)) for y in (1.75, -1.75, 0.0)]
        links = {"successor_ids": list(successors), "predecessor_ids": list(predecessors)}
        return d.Lane(
            ident, d.LaneType.SURFACE_STREET, *sides, group, speed_limit_mps=13.0, **links
        )

    def group(ident, lanes, x0, x1, **more):
        return d.LaneGroup(
            ident, lanes, line((x0, 1.75), (x1, 1.75)), line((x0, -1.75), (x1, -1.75)), **more
        )

    things = [
        lane(6, -150, 0, 60, successors=[7]), lane(7, 0, 150, 70, predecessors=[6]),
        group(60, [6], -150, 0), group(70, [7], 0, 150, intersection_id=1),
        d.Intersection(1, d.IntersectionType.DEFAULT, [70], None, shapely.box(0, -9, 150, 9)),
        d.StopZone(3, d.StopZoneType.TRAFFIC_LIGHT, None, shapely.box(-1, -1.75, 0, 1.75)),
        d.Crosswalk(4, shapely_polygon=shapely.box(-5, -9, -2, 9)),
        d.RoadLine(5, d.RoadLineType.SOLID_YELLOW, line((-150, 1.75), (0, 1.75))),
        d.RoadLine(8, d.RoadLineType.DASHED_WHITE, line((-150, -1.75), (0, -1.75))),
    ]  # fmt: skip
    metadata = d.LogMetadata("nuplan", "nuplan-mini_val", "log-1", "us-ma-boston")
    town = d.MapMetadata("nuplan", "us-ma-boston", map_has_z=False, map_is_per_log=False)
    write(tmp_path, metadata, map(at, range(401)), town, things)
    scenes = ccdiff_env.load(f"py123d:{tmp_path}/logs/nuplan-mini_val")
    (scene,) = scenes
    assert (scene.num_steps, scene.dt, scene.location) == (201, 0.1, "us-ma-boston")
    assert scene.agent_ids == ["ego", "car", "walker"]
    assert scene.agent_types == ["vehicle", "vehicle", "pedestrian"]
    assert np.allclose(scene.sizes[:2], [[EGO.length, EGO.width, EGO.height], [4.5, 2, 1.5]])
    tracks, times = scene.tracks(), 0.1 * np.arange(201)
    assert np.allclose(tracks["position"][0], np.stack([10 * times, 0 * times], 1), atol=1e-3)
    assert np.allclose(tracks["velocity"][1], [5, 0], atol=1e-3)
    away = (times > 5) & (times < 8)
    assert np.array_equal(tracks["valid"][2], ~away)
    assert scenes.report.scenes[0].absences == 1
    layers = scene.map_layers()
    assert [(lane["id"], lane["kind"], lane["successors"]) for lane in layers["lanes"]] == [
        ("6", "lane", [1]),
        ("7", "connector", []),
    ]
    assert np.allclose(layers["lanes"][1]["centreline"][[0, -1]], [[100, 0], [250, 0]])
    road = shapely.union_all([shapely.Polygon(p["exterior"]) for p in layers["drivable_area"]])
    drawn = shapely.union(shapely.box(-50, -1.75, 100, 1.75), shapely.box(100, -9, 250, 9))
    border = drawn.boundary.buffer(0.8)  # it is made of pixels
    assert road.symmetric_difference(drawn).difference(border).area < 0.1
    for name in ("stop_lines", "ped_crossings", "road_dividers", "lane_dividers"):
        assert len(layers[name]) == 1, name
    (light,) = layers["lights"]
    assert light["lane"] == 1
    assert np.allclose(np.sort(light["stop_line"], axis=0), [[100, -1.75], [100, 1.75]])
    shown = [LIGHT_STATES[state] for state in light["states"]]
    assert shown == ["unknown"] * 11 + ["red"] * 89 + ["green"] * 101
    cut = ccdiff_env.load_py123d(tmp_path, window_s=8, history_s=1, limit=9)
    assert cut.names == ("log-1@0", "log-1@8")
    (again,) = ccdiff_env.load(f"py123d:{tmp_path}?window_s=8&history_s=1", names=["log-1@8"])
    assert again == cut[1]
    assert np.array_equal(again.map_layers()["lights"][0]["states"], light["states"][80:171])
    assert np.allclose(
        again.tracks()["position"][0] + again.origin, tracks["position"][0, 80:171] + scene.origin
    )


@pytest.mark.parametrize("map_has_z", [True, False])
def test_a_log_on_a_ramp_has_heights_where_its_map_has(tmp_path, map_has_z):
    def side(y):
        return Polyline3D.from_array(np.array([(-150, y, -15.0), (150, y, 15.0)]))

    sides = [side(y) for y in (1.75, -1.75, 0.0)]
    things = [
        d.Lane(6, d.LaneType.SURFACE_STREET, *sides, 60),
        d.LaneGroup(60, [6], *sides[:2], outline=None),
    ]
    car = [("car", Label.VEHICLE, 0.0, 0.0, 0.0)]
    frames = (frame(k, 10, car, ego_at=lambda x: (x, 0, 0, 0.1 * x)) for k in range(151))
    metadata = d.LogMetadata("nuplan", "nuplan-mini_val", "log-1", "us-ma-boston")
    town = d.MapMetadata("nuplan", "us-ma-boston", map_has_z=map_has_z, map_is_per_log=False)
    write(tmp_path, metadata, frames, town, things)
    (scene,) = ccdiff_env.load(f"py123d:{tmp_path}")
    tracks = scene.tracks()
    assert ("elevation_m" in tracks) == map_has_z
    if map_has_z:  # that of the ground below the centre of the box
        centre = 0.1 * (0.1 * 10.0 * np.arange(151) - 100.0)
        assert np.allclose(tracks["elevation_m"][0], centre - EGO.height / 2, atol=1e-3)


def test_windows_are_parts_of_the_whole_log(tmp_path):
    """Frames of 2 Hz, most windows begin and end between two of them."""

    def at(k):
        boxes = [("walker", Label.PEDESTRIAN, 2.5 * k - 100, 5.0, 0.0)] if 20 < k < 31 else []
        return frame(k, 2, boxes, ego_at=lambda x: (x, 6 * np.sin(x / 30), 0.0))

    metadata = d.LogMetadata("nuplan", "nuplan-mini_val", "log-1", None)
    write(tmp_path, metadata, map(at, range(60)))
    with pytest.warns(UserWarning, match="no road"):
        whole = ccdiff_env.load_py123d(tmp_path)
    with pytest.warns(UserWarning, match="no road"):
        read = ccdiff_env.load_py123d(tmp_path, window_s=4, stride_s=1.3, history_s=1)
    parts = in_windows(whole, Windows(4.0, 1.3, 1.0))
    assert read.names == parts.names
    assert len(read) > 15
    for window, part in zip(read, parts, strict=True):
        assert window.agent_ids == part.agent_ids
        mine, theirs = window.tracks(), part.tracks()
        assert np.array_equal(mine["valid"], theirs["valid"])
        apart = mine["position"] + window.origin - theirs["position"] - part.origin
        assert np.linalg.norm(apart, axis=-1)[mine["valid"]].max() < 0.01


def test_a_map_of_opendrive_with_a_car(tmp_path):
    """A straight road of two lanes of 3.5 m, by its own parser; a car follows one of them.

    The parser leaves out roads that nothing precedes or follows: those at both ends.
    """
    lane = """<lane id="{}" type="driving" level="false">
<width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>"""
    roads = """<road name="r{0}" length="200" id="{0}" junction="-1"><link>
<predecessor elementType="road" elementId="{1}" contactPoint="end"/>
<successor elementType="road" elementId="{2}" contactPoint="start"/></link><planView>
<geometry s="0" x="{3}" y="0" hdg="0" length="200"><line/></geometry></planView>
<elevationProfile><elevation s="0" a="0" b="0" c="0" d="0"/></elevationProfile>
<lateralProfile/><lanes><laneOffset s="0" a="0" b="0" c="0" d="0"/>
<laneSection s="0"><left>{4}</left>
<center><lane id="0" type="none" level="false"/></center><right>{5}</right>
</laneSection></lanes></road>"""
    chain = [
        roads.format(k, k - 1, k + 1, 200 * k - 500, lane.format(1), lane.format(-1))
        for k in (1, 2, 3)
    ]
    ends = ('<predecessor elementType="road" elementId="0" contactPoint="end"/>',
            '<successor elementType="road" elementId="4" contactPoint="start"/>')  # fmt: skip
    text = "".join(chain).replace(ends[0], "").replace(ends[1], "")
    (tmp_path / "road.xodr").write_text(
        '<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="4" name="road" '
        f'north="0" south="0" east="0" west="0"/>{text}</OpenDRIVE>'
    )
    from py123d.parser.opendrive.opendrive_parser import OpenDriveParser

    (parser,) = OpenDriveParser([tmp_path / "road.xodr"]).get_map_parsers()
    metadata = d.LogMetadata("opendrive", "opendrive_val", "drive", "road")
    frames = (frame(k, 10, [], ego_at=lambda x: (x, -1.75, 0.0)) for k in range(150))
    write(tmp_path, metadata, frames, parser.get_map_metadata(), parser.iter_map_objects())
    (scene,) = ccdiff_env.load_py123d(tmp_path)
    assert (scene.num_steps, scene.agent_ids) == (150, ["ego"])
    layers = scene.map_layers()
    lines = [lane["centreline"] + scene.origin for lane in layers["lanes"]]
    assert sorted(round(float(points[:, 1].mean()), 2) for points in lines) == [-1.75, 1.75]
    ends = {tuple(np.sign(points[-1] - points[0]).astype(int)) for points in lines}
    assert {x for x, _ in ends} == {-1, 1}  # both directions
    road = shapely.union_all([shapely.Polygon(p["exterior"]) for p in layers["drivable_area"]])
    middle = shapely.box(*(np.array([-90, -3]) - scene.origin), *(np.array([90, 3]) - scene.origin))
    assert road.buffer(0.05).covers(middle)
    assert road.area == pytest.approx(200 * 7, rel=0.1)


def test_bad_logs_are_refused(tmp_path):
    with pytest.raises(DatasetNotFoundError, match="no log of py123d"):
        ccdiff_env.load_py123d(tmp_path)
    metadata = d.LogMetadata("nuplan", "nuplan-mini_val", "log-1", None)
    write(tmp_path, metadata, (frame(k, 20, []) for k in range(40)))
    with pytest.warns(UserWarning, match="no road"):
        scenes = ccdiff_env.load_py123d(tmp_path)
    assert any(note.startswith("no map") for note in scenes.report.scenes[0].notes)
    (tmp_path / "logs/nuplan-mini_val/log-1/sync.arrow").write_bytes(b"damaged")
    with pytest.raises(DatasetError, match="log-1"):
        ccdiff_env.load_py123d(tmp_path)
