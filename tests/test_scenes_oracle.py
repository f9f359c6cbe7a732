"""Loaded scenes against nuscenes-devkit and shapely: the embedded town, and the real data."""

import numpy as np
import pytest
from nuscenes.eval.common.utils import quaternion_yaw
from nuscenes.map_expansion import arcline_path_utils, map_api
from nuscenes.nuscenes import NuScenes
from nuscenes.utils import splits as official
from pyquaternion import Quaternion
from shapely.affinity import translate
from shapely.geometry import LineString, MultiPolygon, Polygon, box
from shapely.ops import unary_union

import ccdiff_env
from ccdiff_env.scenes import splits
from ccdiff_env.scenes.embedded import VERSION, embedded_splits, unpack

KINDS = {"left-turn", "tee-crossing", "cut-in", "hard-brake", "queue", "double-left", "merge-in",
         "free-curve", "pedestrians"}  # fmt: skip


def test_scenes_load_without_losses_and_only_once():
    scenes = ccdiff_env.embedded_scenes()
    assert len(scenes) >= 32
    assert scenes is ccdiff_env.embedded_scenes()
    assert "tracks dropped                   0" in str(scenes.report)
    by_split = embedded_splits()
    names = {"train", "val", "city"}
    assert set(by_split) == names | {f"{name}-lights" for name in names}
    every = [name for split in names for name in by_split[split]]
    assert len(set(every)) == len(every)
    for split, names in by_split.items():
        assert ccdiff_env.embedded_scenes(split).names == names
        assert {n.rsplit("-", 1)[0] for n in names} == KINDS


@pytest.fixture(scope="module", params=["town", pytest.param("real", marks=pytest.mark.nuscenes)])
def data(request, tmp_path_factory):
    """Folder, version and names of scenes."""
    if request.param == "real":
        return request.getfixturevalue("data_root") / "nuscenes", "v1.0-mini", None
    unpack(folder := tmp_path_factory.mktemp("town"))
    return folder, VERSION, embedded_splits()["val"]


@pytest.fixture(scope="module")
def devkit(data):
    return NuScenes(data[1], str(data[0]), verbose=False)


def loaded(data, **options):
    return ccdiff_env.load_nuscenes(*data[:2], scenes=data[2], **options)


@pytest.fixture(scope="module")
def mini(data):
    return loaded(data)


@pytest.fixture(scope="module")
def nominal(data):
    """As the paper's released code has it."""
    return loaded(data, timing="nominal", interpolation="linear")


def key_frames(devkit, scene):
    record = devkit.get("scene", scene.token)
    token, samples = record["first_sample_token"], []
    while token:
        samples.append(devkit.get("sample", token))
        token = samples[-1]["next"]
    return samples


def yaw_of(rotation):
    return quaternion_yaw(Quaternion(rotation))


def annotated(devkit, scene):
    """Times (s) and poses [K, 3] at key frames, by agent; the ego's first, from its rear axle."""
    samples = key_frames(devkit, scene)
    start_us, keys = samples[0]["timestamp"], {"ego": []}
    for sample in samples:
        data = devkit.get("sample_data", sample["data"]["LIDAR_TOP"])
        pose = devkit.get("ego_pose", data["ego_pose_token"])
        rows = [("ego", pose["timestamp"], pose)]
        boxes = [devkit.get("sample_annotation", token) for token in sample["anns"]]
        rows += [(box["instance_token"], sample["timestamp"], box) for box in boxes]
        for agent, time_us, row in rows:
            ahead = 1.385 if agent == "ego" else 0.0
            place = np.array(row["translation"])
            place += Quaternion(row["rotation"]).rotate([ahead, 0.0, 0.0])
            pose = (*place[:2], yaw_of(row["rotation"]))
            keys.setdefault(agent, []).append(((time_us - start_us) * 1e-6, *pose))
    found = {agent: np.array(rows) for agent, rows in keys.items()}
    for rows in found.values():
        rows[:, 3] = np.unwrap(rows[:, 3])
    return found


def smoothed(times, values, smoothing):
    """Values of the natural cubic smoothing spline at its own times, from the dense equations."""
    inner, h = len(times) - 2, np.diff(times)
    if inner < 1 or smoothing == 0:
        return values
    q, r = np.zeros((len(times), inner)), np.zeros((inner, inner))
    for k in range(inner):
        q[k : k + 3, k] = 1 / h[k], -1 / h[k] - 1 / h[k + 1], 1 / h[k + 1]
        r[k, k] = (h[k] + h[k + 1]) / 3
        if k:
            r[k, k - 1] = r[k - 1, k] = h[k] / 6
    return values - smoothing * q @ np.linalg.solve(r + smoothing * q.T @ q, q.T @ values)


def straight_beyond(curve, times, at):
    """Value and slope of a curve that goes straight on beyond its ends."""
    inside = np.clip(at, times[0], times[-1])
    slope = curve(inside, 1)
    return curve(inside) + slope * (at - inside)[:, None], slope


def test_tracks_are_splines_through_the_devkits_boxes_at_their_times(devkit, mini):
    from scipy.interpolate import CubicSpline

    for scene in mini:
        tracks, origin = scene.tracks(), np.array(scene.origin)
        first, *_, last = (sample["timestamp"] for sample in key_frames(devkit, scene))
        assert scene.num_steps == round((last - first) / 100_000) + 1
        for agent, rows in annotated(devkit, scene).items():
            if len(rows) == 1:
                assert agent not in scene.agent_ids
                continue
            i = scene.agent_ids.index(agent)
            times, poses = rows[:, 0], rows[:, 1:]
            steps = np.arange(round(times[0] / 0.1), round(times[-1] / 0.1) + 1)
            assert (np.flatnonzero(tracks["valid"][i]) == steps).all()
            poses = smoothed(times, poses, 0.0 if agent == "ego" else 0.003)
            if len(rows) == 2:  # a straight line
                slope = np.diff(poses, axis=0) / np.diff(times) + np.zeros((len(steps), 1))
                value = poses[0] + slope * (steps * 0.1 - times[0])[:, None]
            else:
                curve = CubicSpline(times, poses, bc_type="natural")
                value, slope = straight_beyond(curve, times, steps * 0.1)
            assert np.allclose(tracks["position"][i, steps] + origin, value[:, :2], atol=5e-4)
            assert np.allclose(tracks["heading"][i, steps], value[:, 2], atol=1e-4)
            assert np.allclose(tracks["velocity"][i, steps], slope[:, :2], atol=1e-3)


def test_nominal_steps_have_every_box_of_the_devkit_with_its_pose_and_size(devkit, nominal):
    known = [s["name"] for s in devkit.scene]
    assert list(nominal.names) == [name for name in known if name in nominal]
    for scene in nominal:
        tracks, origin = scene.tracks(), np.array(scene.origin)
        index = {agent: i for i, agent in enumerate(scene.agent_ids)}
        sizes, first_seen = scene.sizes, {}
        expected_valid = np.zeros(tracks["valid"].shape, bool)
        samples = key_frames(devkit, scene)
        assert scene.num_steps == (len(samples) - 1) * 5 + 1
        for k, sample in enumerate(samples):
            for token in sample["anns"]:
                box = devkit.get("sample_annotation", token)
                if box["instance_token"] not in index:
                    assert devkit.get("instance", box["instance_token"])["nbr_annotations"] == 1
                    continue
                i = index[box["instance_token"]]
                position = tracks["position"][i, 5 * k] + origin
                assert np.allclose(position, box["translation"][:2], atol=2e-4)
                yaw = yaw_of(box["rotation"])
                assert abs(np.angle(np.exp(1j * (tracks["heading"][i, 5 * k] - yaw)))) < 1e-5
                if box["instance_token"] not in first_seen:
                    first_seen[box["instance_token"]] = 5 * k
                    width, length, height = box["size"]
                    assert np.allclose(sizes[i], [length, width, height], rtol=1e-6)
                    assert scene.agent_categories[i] == box["category_name"]
                expected_valid[i, first_seen[box["instance_token"]] : 5 * k + 1] = True
        assert set(first_seen) | {"ego"} == set(index)
        # order of first appearance
        assert scene.agent_ids == ["ego", *first_seen]
        expected_valid[0] = True
        assert (tracks["valid"] == expected_valid).all()


def test_steps_between_nominal_key_frames_are_linear(nominal):
    tracks = nominal[0].tracks()
    both = tracks["valid"][:, 0:-1:5] & tracks["valid"][:, 5::5]
    for name in ("position", "heading", "velocity"):
        left, right = tracks[name][:, 0:-1:5], tracks[name][:, 5::5]
        for step in range(1, 5):
            expected = left + (right - left) * (step / 5)
            assert np.allclose(tracks[name][:, step::5][both], expected[both], atol=1e-4)


def test_the_ego_begins_at_the_origin_of_its_city(devkit, mini):
    for scene in mini:
        assert scene.agent_ids[0] == "ego"
        assert np.allclose(scene.sizes[0], [4.084, 1.730, 1.562])
        assert np.abs(scene.tracks()["position"][0, 0]).max() <= 0.5 + 1e-6
        log = devkit.get("log", devkit.get("scene", scene.token)["log_token"])
        assert scene.location == log["location"]


def test_splits_are_the_devkits():
    ours = splits()
    assert set(ours["train"]) | set(ours["train_val"]) == set(official.train)
    assert list(ours["train_val"]) == official.train[:200]
    assert {k: len(v) for k, v in ours.items()} == {
        "train": 500,
        "train_val": 200,
        "val": 150,
        "mini_train": 8,
        "mini_val": 2,
        "ccdiff100": 100,
    }
    for name in ("val", "mini_train", "mini_val"):
        assert list(ours[name]) == getattr(official, name)
    assert set(ours["ccdiff100"]) < set(ours["val"])


@pytest.mark.nuscenes
def test_split_of_the_paper_lists_the_scenes_that_are_missing(data_root):
    loaded = ccdiff_env.load_nuscenes(data_root / "nuscenes", "v1.0-trainval", "ccdiff100")
    assert len(loaded) + len(loaded.report.missing) == 100
    assert set(loaded.names) | set(loaded.report.missing) == set(splits()["ccdiff100"])
    assert len(loaded) == 93


@pytest.fixture(scope="module")
def map_scenes(data, mini):
    """One scene per location, with the devkit's map, which is told the town's name."""
    by_location = {scene.location: scene for scene in mini}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(map_api, "locations", [*map_api.locations, *by_location])
        maps = [map_api.NuScenesMap(str(data[0]), location) for location in by_location]
    return list(zip(by_location.values(), maps, strict=True))


def test_centre_lines_and_links_are_the_devkits(map_scenes):
    compared = 0
    for scene, nusc_map in map_scenes:
        lanes = scene.map_layers()["lanes"]
        here = {lane["id"] for lane in lanes}
        for lane in lanes:
            path = nusc_map.get_arcline_path(lane["id"])
            poses = np.array(arcline_path_utils.discretize_lane(path, 1.0))[:, :2]
            ours = lane["centreline"].astype(float) + np.array(scene.origin)
            # same points, joints once
            far = np.linalg.norm(poses[:, None] - ours[None], axis=2)
            assert far.min(axis=1).max() < 1.1e-2
            assert far.min(axis=0).max() < 1e-3
            line = LineString(poses)
            assert line.hausdorff_distance(LineString(ours)) < 1.1e-2
            length = arcline_path_utils.length_of_lane(path)
            assert LineString(ours).length == pytest.approx(length, rel=5e-3, abs=0.05)
            outgoing = {lanes[i]["id"] for i in lane["successors"]}
            incoming = {lanes[i]["id"] for i in lane["predecessors"]}
            assert outgoing == set(nusc_map.get_outgoing_lane_ids(lane["id"])) & here
            assert incoming == set(nusc_map.get_incoming_lane_ids(lane["id"])) & here
            kind = "lane" if lane["id"] in {x["token"] for x in nusc_map.lane} else "connector"
            assert lane["kind"] == kind
            compared += 1
    assert compared > 25 * len(map_scenes)


def shape(polygon):
    return Polygon(polygon["exterior"], polygon["holes"]).buffer(0)


def test_cropped_areas_and_dividers_are_what_shapely_finds(map_scenes):
    layers = {
        "drivable_area": "drivable_area",
        "ped_crossings": "ped_crossing",
        "walkways": "walkway",
    }
    for scene, nusc_map in map_scenes:
        tracks = scene.tracks()
        points = tracks["position"][tracks["valid"]]
        crop = box(*(points.min(axis=0) - 60), *(points.max(axis=0) + 60))
        shift = (-scene.origin[0], -scene.origin[1])
        ours = scene.map_layers()
        for name, table in layers.items():
            tokens = []
            for record in getattr(nusc_map, table):
                tokens += record.get("polygon_tokens") or [record["polygon_token"]]
            whole = [translate(nusc_map.extract_polygon(t), *shift).buffer(0) for t in tokens]
            expected = unary_union([p.intersection(crop) for p in whole if p.intersects(crop)])
            got = unary_union([shape(p) for p in ours[name]] or [MultiPolygon()])
            assert got.symmetric_difference(expected).area < 1e-4 * expected.area + 0.5, name
        for name, table in (("road_dividers", "road_divider"), ("lane_dividers", "lane_divider")):
            lines = [nusc_map.extract_line(r["line_token"]) for r in getattr(nusc_map, table)]
            expected = sum(translate(li, *shift).intersection(crop).length for li in lines)
            got = sum(LineString(line).length for line in ours[name])
            assert got == pytest.approx(expected, rel=1e-4, abs=0.1)
