"""The embedded data set, against the devkit."""

import math

import numpy as np
import pytest
from nuscenes.nuscenes import NuScenes
from pyquaternion import Quaternion

import ccdiff_env
from ccdiff_env.scenes.embedded import VERSION, embedded_splits, unpack

LOCATION = "ccdiff-town"
KINDS = {"left-turn", "tee-crossing", "cut-in", "hard-brake", "queue", "double-left", "merge-in",
         "free-curve", "pedestrians"}  # fmt: skip


@pytest.fixture(scope="module")
def dataroot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("embedded")
    unpack(folder)
    return folder


@pytest.fixture(scope="module")
def devkit(dataroot):
    return NuScenes(VERSION, str(dataroot), verbose=False)


@pytest.fixture(scope="module")
def frames(devkit):
    """Boxes of each key frame: scene, time (s), and of each instance its yaw and centre."""
    out = []
    for scene in devkit.scene:
        token, number = scene["first_sample_token"], 0
        while token:
            sample = devkit.get("sample", token)
            data = devkit.get("sample_data", sample["data"]["LIDAR_TOP"])
            rows = [("ego", devkit.get("ego_pose", data["ego_pose_token"]))]
            for name in sample["anns"]:
                record = devkit.get("sample_annotation", name)
                rows.append((record["instance_token"], record))
            boxes = []
            for instance, record in rows:
                pose = Quaternion(record["rotation"])
                # a pose of the ego is the middle of its rear axle
                ahead = pose.rotate([1.385 if instance == "ego" else 0.0, 0.0, 0.0])
                centre = (np.array(record["translation"]) + ahead)[:2]
                boxes.append((instance, pose.yaw_pitch_roll[0], centre))
            out.append((scene["name"], number * 0.5, boxes))
            token, number = sample["next"], number + 1
    return out


def test_scenes_load_without_losses_and_only_once():
    scenes = ccdiff_env.embedded_scenes()
    assert len(scenes) >= 32
    assert scenes is ccdiff_env.embedded_scenes()
    assert "tracks dropped                   0" in str(scenes.report)
    splits = embedded_splits()
    assert set(splits) == {"train", "val", "city"}
    assert len({name for names in splits.values() for name in names}) == sum(
        map(len, splits.values())
    )
    for split, names in splits.items():
        assert ccdiff_env.embedded_scenes(split).names == names
        assert {n.rsplit("-", 1)[0] for n in names} == KINDS


def test_loaded_tracks_are_those_of_the_devkit(frames):
    scenes = ccdiff_env.embedded_scenes()
    for scene, time, boxes in frames[::7]:
        loaded = scenes[scene]
        tracks, index = loaded.tracks(), {name: i for i, name in enumerate(loaded.agent_ids)}
        for instance, yaw, centre in boxes:
            row, step = index[instance], round(time * 10)
            assert tracks["valid"][row, step]
            at = tracks["position"][row, step] + np.asarray(loaded.origin)
            assert np.allclose(at, centre, atol=2e-3)
            turn = (tracks["heading"][row, step] - yaw + math.pi) % (2 * math.pi) - math.pi
            assert abs(turn) < 1e-3


def test_the_devkits_map_class_opens_the_map_once_it_knows_the_name(dataroot, monkeypatch):
    from nuscenes.map_expansion import map_api

    # the example of docs/data.md adds the name for the whole process
    known = [name for name in map_api.locations if name != LOCATION]
    monkeypatch.setattr(map_api, "locations", known)
    with pytest.raises(AssertionError, match="Unknown map name"):
        map_api.NuScenesMap(str(dataroot), LOCATION)
    monkeypatch.setattr(map_api, "locations", [*known, LOCATION])
    opened = map_api.NuScenesMap(str(dataroot), LOCATION)
    for lane in [*opened.lane, *opened.lane_connector][::5]:
        line = opened.discretize_lanes([lane["token"]], 0.5)[lane["token"]]
        x, y, _ = line[len(line) // 2]
        layers = opened.layers_on_point(x, y)
        assert layers["drivable_area"]
        assert layers["lane"] or lane in opened.lane_connector
        assert opened.get_closest_lane(x, y, radius=3.0)
    for layer in ("ped_crossing", "walkway", "stop_line", "road_block", "carpark_area"):
        record = getattr(opened, layer)[0]
        assert opened.extract_polygon(record["polygon_token"]).is_valid
