"""ScenarioNet import: made-up descriptions, hostile pickles, and the real files."""

import pickle

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import errors

T = 11


def track(kind, x, *, valid=None, **changes):
    state = {
        "position": np.stack([x + np.arange(T), np.full(T, 4000.0), np.zeros(T)], axis=1),
        "heading": np.linspace(3.0, 3.5, T) % (2 * np.pi)
        - 2 * np.pi * (np.linspace(3, 3.5, T) > np.pi),
        "velocity": np.tile([10.0, 0.0], (T, 1)),
        "valid": np.ones(T) if valid is None else np.asarray(valid, float),
        "length": np.full((T, 1), 4.5),
        "width": np.full((T, 1), 1.9),
        "height": np.full((T, 1), 1.6),
    }
    return {"type": kind, "state": state | changes, "metadata": {"type": kind}}


def scenario():
    features = {
        "1": {
            "type": "LANE_SURFACE_STREET",
            "polyline": [(3000.0, 4000.0, 0.0), (3010.0, 4000.0, 0.0)],
            "polygon": np.array([[3000, 3998], [3010, 3998], [3010, 4002], [3000, 4002.0]]),
            "exit_lanes": ["2", "gone"],
            "speed_limit_kmh": 36.0,
        },
        "2": {
            "type": "LANE_SURFACE_STREET",
            "polyline": np.array([[3010.0, 4000.0], [3010.0, 4000.0], [3013.5, 4000.0]]),
            "polygon": [[3010, 3998], [3014, 3998], [3014, 4002], [3010, 4002], [3010, 3998]],
            "entry_lanes": ["1"],
        },
        "y": {"type": "ROAD_LINE_SOLID_SINGLE_YELLOW", "polyline": np.ones((4, 3))},
        "w": {"type": "ROAD_LINE_BROKEN_SINGLE_WHITE", "polyline": np.ones((3, 2))},
        "c": {"type": "CROSSWALK", "polygon": np.eye(3)},
        "s": {"type": "STOP_SIGN", "position": np.zeros(3)},
    }
    return {
        "id": "sd_1",
        "version": "1",
        "length": T,
        "metadata": {
            "dataset": "waymo",
            "scenario_id": "abc",
            "sdc_id": 7,
            "ts": np.arange(T) * 0.1,
            "map": "waymo",
        },
        "tracks": {
            "3": track("VEHICLE", 3010.0, valid=[0, 0, 1, 1, 1, 1, 1, 1, 1, 0, 0]),
            "7": track("VEHICLE", 3000.4),
            "8": track("TRAFFIC_LIGHT", 3000.0),
            "9": track("PEDESTRIAN", 3000.0, valid=[1] + [0] * 10),
        },
        "dynamic_map_states": {},
        "map_features": features,
    }


def save(folder, data, name="sd_1.pkl", protocol=4):
    path = folder / name
    path.write_bytes(pickle.dumps(data, protocol=protocol))
    return path


@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_description_becomes_a_scene(tmp_path, protocol):
    loaded = ccdiff_env.load_scenarionet(save(tmp_path, scenario(), protocol=protocol))
    scene = loaded["abc"]
    assert scene.agent_ids == ["ego", "3"]
    assert (scene.dt, scene.num_steps, scene.origin) == (0.1, T, (3000.0, 4000.0))
    assert scene.source == "scenarionet waymo"
    tracks = scene.tracks()
    assert np.allclose(tracks["position"][0, :, 0], 0.4 + np.arange(T), atol=1e-4)
    assert tracks["valid"].sum(axis=1).tolist() == [T, 7]
    assert (tracks["position"][~tracks["valid"]] == 0).all()
    assert np.abs(np.diff(tracks["heading"][0])).max() < 0.06, "unwrapped"
    layers = scene.map_layers()
    first, second = layers["lanes"]
    assert (first["id"], first["successors"], second["predecessors"]) == ("1", [1], [0])
    assert first["centreline"].shape == (11, 2)
    assert np.allclose(second["centreline"][[0, -1]], [[10, 0], [13.5, 0]])
    assert len(second["polygon"]["exterior"]) == 4
    assert first["speed_limit_mps"] == pytest.approx(10.0)
    shapely = pytest.importorskip("shapely")
    (area,) = layers["drivable_area"]
    surface, road = shapely.box(0, -2, 14, 2), shapely.Polygon(area["exterior"])
    assert road.buffer(0.1).covers(surface), "the lanes' polygons are one"
    # vehicles were within 1.75 m of y = 0 from 0.4 to 18 m
    driven = shapely.LineString([(0.4, 0), (18.0, 0)]).buffer(1.75)
    assert surface.union(driven).buffer(0.3).covers(road)
    assert [len(layers[k]) for k in ("road_dividers", "lane_dividers", "ped_crossings")] == [
        1,
        1,
        1,
    ]
    report = loaded.report
    dropped = {"TRAFFIC_LIGHT: unknown type": 1, "PEDESTRIAN: fewer than 2 steps": 1}
    assert report.scenes[0].dropped == dropped
    assert any("STOP_SIGN" in note for note in report.scenes[0].notes)


@pytest.mark.parametrize(
    ("limit_kmh", "expected_mps"),
    [(0.0, None), (-3.6, None), (np.nan, None), (1000, None), (np.float32(54), 15.0), (54, 15.0)],
)
def test_a_limit_of_no_speed_is_no_limit(tmp_path, limit_kmh, expected_mps):
    data = scenario()
    data["map_features"]["1"]["speed_limit_kmh"] = limit_kmh
    (scene,) = ccdiff_env.load_scenarionet(save(tmp_path, data))
    assert scene.map_layers()["lanes"][0]["speed_limit_mps"] == expected_mps


@pytest.mark.parametrize(("rate_hz", "dt_s"), [(10.0, 0.1), (10.005, 0.1), (30.0, 1 / 30)])
def test_the_time_step_is_that_of_the_time_stamps(tmp_path, rate_hz, dt_s):
    data = scenario()
    data["metadata"]["ts"] = np.arange(T) / rate_hz
    (scene,) = ccdiff_env.load_scenarionet(save(tmp_path, data))
    assert scene.dt == pytest.approx(dt_s, rel=1e-6)


def test_nobody_is_there_where_a_mask_is_not_a_number(tmp_path):
    data = scenario()
    data["tracks"]["7"]["state"]["valid"] = np.where(np.arange(T) < 4, np.nan, 1.0)
    (scene,) = ccdiff_env.load_scenarionet(save(tmp_path, data))
    assert scene.tracks()["valid"][0].tolist() == [False] * 4 + [True] * 7


def nan_at(step):
    position = track("VEHICLE", 0.0)["state"]["position"]
    position[step] = np.nan
    return position


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.pop("tracks"), "tracks is NoneType"),
        (lambda d: d.update(length=0), "length is 0"),
        (lambda d: d["tracks"]["3"]["state"].update(position=nan_at(4)), "position at step 4"),
        (lambda d: d["tracks"]["3"]["state"].update(heading=np.zeros(3)), "length of .*heading"),
        (lambda d: d["tracks"]["3"]["state"].update(width=np.zeros(T)), "size of tracks"),
        (lambda d: d["tracks"]["3"]["state"].pop("velocity"), "an entry 'velocity'"),
        (lambda d: d["tracks"]["3"]["state"].update(valid="yes"), "an array of numbers"),
        (lambda d: d["metadata"].update(sdc_id="nobody"), "sdc_id"),
        (lambda d: d["metadata"].update(ts=np.zeros(T)), "ts"),
        (lambda d: d["metadata"].update(ts=np.arange(3) * 0.1), r"ts is 3, expected 11: .*\.pkl"),
        (lambda d: d["metadata"].update(ts=None, sample_rate=10), "sample_rate is .*seconds"),
        (lambda d: d["map_features"]["1"].update(polyline=np.zeros(4)), "polyline"),
        (lambda d: d["map_features"].update(x=3), "map_features"),
        (lambda d: d.update(tracks={}, metadata={}), "no scenario with agents"),
    ],
)
def test_fields_that_break_a_rule_are_named(tmp_path, change, words):
    data = scenario()
    change(data)
    with pytest.raises(errors.DatasetError, match=words):
        ccdiff_env.load_scenarionet(save(tmp_path, data))


def test_folders_are_searched_and_twins_renamed(tmp_path):
    (tmp_path / "sub").mkdir()
    save(tmp_path, scenario())
    save(tmp_path / "sub", scenario(), "sd_2.pkl")
    save(tmp_path, {"index": 1}, "dataset_summary.pkl")
    loaded = ccdiff_env.load_scenarionet(tmp_path)
    assert loaded.names == ("abc", "abc (sd_2)")


@pytest.mark.nuscenes
def test_real_export_agrees_with_our_own_loader(data_root):
    exports = ccdiff_env.load_scenarionet(data_root / "scenarionet")
    assert len(exports) == 2
    own = ccdiff_env.load_nuscenes(data_root / "nuscenes", "v1.0-mini", scenes=["scene-0757"])[0]
    for export in exports:
        assert (export.dt, export.location) == (0.1, own.location)
        ego, ours = export.tracks(), own.tracks()
        # the same drive, each in its own frame
        steps = min(export.num_steps, own.num_steps)
        a = ego["position"][0, :steps] - ego["position"][0, 0]
        b = ours["position"][0, :steps] - ours["position"][0, 0]
        # ours is linear between key frames, theirs measured at every step
        assert np.abs(a - b).max() < 1.0
        assert np.median(np.abs(a - b)) < 0.05
        assert np.allclose(ego["heading"][0, :steps], ours["heading"][0, :steps], atol=0.05)
        assert sorted(export.agent_types).count("static") == 5
        assert export.has_lanes
