"""Logs as they are played: short gaps filled, boxes annotated backwards turned, odd sizes noted."""

import warnings

import numpy as np
import pytest
from array_scenes import GOES_ON, played
from gpudrive_scene import NOT_VALID, save
from gpudrive_scene import scene as waymo_scene
from test_scenes import VERSION, tables, write
from test_scenes_scenarionet import save as save_scenario
from test_scenes_scenarionet import scenario, track

import ccdiff_env
from ccdiff_env.scenes import Scene

T, DT = 120, 0.1
TIME = DT * np.arange(T)


def bend(radius=30.0, speed=10.0, slowing=0.5):
    """Round a bend while slowing down: position, heading, velocity."""
    way, pace = speed * TIME - 0.5 * slowing * TIME**2, speed - slowing * TIME
    turn = way / radius
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    place = radius * np.stack([np.sin(turn), 1 - np.cos(turn)], axis=1)
    return place, turn, pace[:, None] * along


def line(speed, heading=0.0):
    """Straight on at a speed [T] (m/s), negative backwards."""
    pace = np.broadcast_to(speed, T)
    along = np.array([np.cos(heading), np.sin(heading)])
    place = np.concatenate([[0.0], np.cumsum(0.5 * DT * (pace[1:] + pace[:-1]))])
    return place[:, None] * along, np.full(T, heading), pace[:, None] * along


def made(*tracks, valid=None, kinds=None, sizes=None, **options):
    place, heading, velocity = (np.stack(part) for part in zip(*tracks, strict=True))
    place = place + 100.0 * np.arange(len(tracks))[:, None, None]
    shown = np.ones(heading.shape, bool) if valid is None else valid
    return Scene.from_arrays(
        "made",
        agent_ids=["ego", *map(str, range(1, len(tracks)))],
        agent_types=kinds or ["vehicle"] * len(tracks),
        sizes=np.tile(np.float32([4.5, 2.0, 1.6]), (len(tracks), 1)) if sizes is None else sizes,
        position=np.where(shown[..., None], place, 0).astype(np.float32),
        heading=np.where(shown, heading, 0).astype(np.float32),
        velocity=np.where(shown[..., None], velocity, 0).astype(np.float32),
        valid=shown,
        dt=DT,
        **options,
    )


@pytest.mark.parametrize("lost", [1, 3, 10, 20])
@pytest.mark.parametrize("row", [0, 1], ids=["ego", "other"])
def test_gaps_up_to_two_seconds_are_filled_as_it_went_on(lost, row):
    whole = made(bend(), bend(20.0, 8.0, 0.2)).tracks()
    valid = np.ones((2, T), bool)
    gap = slice(40, 40 + lost)
    valid[row, gap] = False
    filled = made(bend(), bend(20.0, 8.0, 0.2), valid=valid).tracks()
    assert filled["valid"].all()
    assert np.abs(filled["position"] - whole["position"]).max() < 0.003 * lost
    assert np.abs(filled["velocity"] - whole["velocity"]).max() < 0.01 * lost
    assert np.abs(filled["heading"] - whole["heading"]).max() < 0.003 * lost
    # position, velocity and acceleration fit each other, and nothing is invented at the ends
    moved = np.diff(filled["position"][row], axis=0) / DT
    mean = 0.5 * (filled["velocity"][row, 1:] + filled["velocity"][row, :-1])
    assert np.abs(moved - mean).max() < 0.02
    speed = np.linalg.norm(filled["velocity"][row], axis=1)
    assert np.abs(np.diff(speed) / DT).max() < 0.75
    assert np.abs(np.diff(speed, 2) / DT**2).max() < 3.0
    for other in ("position", "heading", "velocity"):
        untouched = np.delete(filled[other], range(*gap.indices(T)), axis=1)
        assert (untouched == np.delete(whole[other], range(*gap.indices(T)), axis=1)).all()


def test_longer_gaps_are_absences_and_so_are_jumps():
    valid = np.ones((3, T), bool)
    valid[0, 40:62] = valid[1, 40:70] = valid[2, 40] = False
    jump = line(8.0)
    jump[0][41:] += 50.0
    tracks = made(line(8.0), line(8.0), jump, valid=valid).tracks()
    assert (tracks["valid"] == valid).all()
    assert (tracks["position"][~valid] == 0).all()


def test_a_gap_at_the_seam_of_headings_is_turned_through_the_short_way():
    place, heading, velocity = bend()
    heading = heading + np.pi - heading[45]
    wrapped = np.angle(np.exp(1j * heading))
    valid = np.ones((1, T), bool)
    valid[0, 43:48] = False
    filled = made((place, wrapped, velocity), valid=valid, mend=True).tracks()["heading"][0]
    assert np.abs(np.exp(1j * filled) - np.exp(1j * heading)).max() < 0.01


def test_arrays_can_be_taken_as_they_are():
    valid = np.ones((2, T), bool)
    valid[1, 50] = False
    backwards = line(-8.0)
    scene = made(line(8.0), backwards, valid=valid, mend=False)
    assert (scene.tracks()["valid"] == valid).all()
    assert (scene.tracks()["heading"] == 0).all()


def turned(*driven, **options):
    """Whether each of the tracks is turned; the warnings say so."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = made(line(8.0), *driven, **options)
    heading, before = scene.tracks()["heading"][1:], np.stack([part[1] for part in driven])
    off = np.abs(np.abs(heading - before) - np.pi).max(axis=1) < 1e-5
    assert (off | (heading == before.astype(np.float32)).all(axis=1)).all()
    said = [str(w.message) for w in caught if "against its heading" in str(w.message)]
    assert len(said) == off.sum()
    for number, yes in enumerate(off, 1):
        assert any(f": {number} runs against its heading" in text for text in said) == yes
    return off.tolist()


def test_boxes_annotated_backwards_are_turned():
    back = line(-8.0)
    stops = line(np.where(TIME < 4, -6.0, 0.0), heading=2.0)
    assert turned(back, stops) == [True, True]
    place, heading, velocity = bend()
    assert turned((place, heading - np.pi, velocity)) == [True]
    assert turned(back, back, kinds=["vehicle", "motorcycle", "pedestrian"]) == [True, False]


def test_reversing_cars_and_unreliable_motion_are_not():
    out_of_a_drive = line(np.where(TIME < 5, -2.5, 6.0))
    and_a_little_on = line(np.where(TIME < 5, -2.9, 1.5))
    all_of_it = line(np.where(TIME < 6, -1.8, 0.0))
    jitter = line(np.where((TIME > 3) & (TIME < 3.6), -9.0, 0.0))
    there_and_back = line(np.where(TIME < 6, -9.0, 9.0))
    sideways = line(8.0, heading=np.pi / 2)
    sideways = (sideways[0], np.zeros(T), sideways[2])
    far = line(-2.9)  # 35 m
    driven = [far, out_of_a_drive, and_a_little_on, all_of_it, jitter, there_and_back, sideways]
    assert turned(*driven) == [False] * 7


@pytest.mark.parametrize("back", [range(50), range(60, 80), range(60, 61), range(30, 120)])
def test_parts_of_a_track_that_are_the_other_way_round_are_turned(back):
    place, heading, velocity = bend()
    other_way = np.where(np.isin(np.arange(T), back), np.pi, 0.0)
    with pytest.warns(UserWarning, match=r"other way round for \d+ steps"):
        scene = made(line(8.0), (place, heading + other_way, velocity))
    found = scene.tracks()["heading"][1]
    np.testing.assert_allclose(np.cos(found - heading), 1.0, atol=1e-5)
    # pedestrians turn round
    kinds = ["vehicle", "pedestrian"]
    walks = made(line(8.0), (place, heading + other_way, velocity), kinds=kinds)
    assert (walks.tracks()["heading"][1] == (heading + other_way).astype(np.float32)).all()


def wrong_velocities():
    """Of a car that drives to the north-east and speeds up, and the right ones [T, 2]."""
    place, heading, right = line(4.0 + 0.5 * TIME, heading=0.7)
    pace = np.linalg.norm(right, axis=1)
    wrong = {
        "turned": right[:, ::-1] * [-1.0, 1.0],
        "none": 0.0 * right,
        "of the body": np.stack([pace, 0.0 * pace], axis=1),
        "other half": np.where(TIME[:, None] < 6.0, right, -right),
    }
    return (place, heading), right, wrong


@pytest.mark.parametrize("name", wrong_velocities()[2])
def test_velocities_that_contradict_the_positions_are_their_change(name):
    path, right, wrong = wrong_velocities()
    with pytest.warns(UserWarning, match="the velocities of 1 contradict its positions") as caught:
        scene = made(line(8.0), (*path, wrong[name]))
    assert len(caught) == 1
    found = scene.tracks()["velocity"]
    np.testing.assert_allclose(found[1], right, atol=0.05)
    np.testing.assert_array_equal(found[0], np.float32(line(8.0)[2]))
    kept = made(line(8.0), (*path, wrong[name]), mend=False).tracks()["velocity"][1]
    np.testing.assert_array_equal(kept, np.float32(wrong[name]))


def test_velocities_that_are_inexact_stay():
    place, heading, right = line(8.0)
    noise = np.random.default_rng(0).normal(0.0, 0.05, place.shape)
    late = np.roll(line(4.0 + 0.5 * TIME)[2], 5, axis=0)
    late[:5] = late[5]
    short = np.where((TIME[:, None] > 3) & (TIME[:, None] < 3.85), 0.0, right)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tracks = (place + noise, heading, right), (*line(4.0 + 0.5 * TIME)[:2], late)
        found = made(*tracks, (place, heading, short)).tracks()["velocity"]
    np.testing.assert_array_equal(found, np.float32([right, late, short]))


def test_files_with_velocities_that_contradict_the_positions_say_so(tmp_path):
    data = waymo_scene()
    for velocity in data["objects"][1]["velocity"]:
        velocity["x"], velocity["y"] = -velocity["y"], velocity["x"]
    whole = ccdiff_env.load_gpudrive(save(tmp_path / "whole.json"))[0]
    loaded = ccdiff_env.load_gpudrive(save(tmp_path / "turned.json", data), cache=False)
    (note,) = [n for n in loaded.report.scenes[0].notes if "velocities" in n]
    assert "contradict its positions" in note
    found, right = (scene.tracks()["velocity"] for scene in (loaded[0], whole))
    assert np.abs(found - right).max() < 0.5
    data = scenario()
    data["tracks"]["7"] = track("VEHICLE", 3000.4, velocity=np.zeros((11, 2)))
    loaded = ccdiff_env.load_scenarionet(save_scenario(tmp_path, data))
    assert any("velocities of ego contradict" in note for note in loaded.report.scenes[0].notes)
    np.testing.assert_allclose(loaded[0].tracks()["velocity"][0], [[10.0, 0.0]] * 11, atol=0.01)


@pytest.mark.nuscenes
def test_no_velocity_of_nuscenes_contradicts_its_positions(data_root):
    scenes = ccdiff_env.load(f"nuscenes:{data_root}/nuscenes@v1.0-trainval/val")
    assert len(scenes) > 90
    notes = [note for report in scenes.report.scenes for note in report.notes]
    assert not [note for note in notes if "contradict" in note or "across" in note]


@pytest.mark.parametrize(
    ("heading_rad", "wrong"),
    [(3.0, np.rad2deg), (0.1, lambda rad: np.pi / 2 - rad), (1.0, np.negative)],
)
def test_headings_of_another_kind_are_noted(heading_rad, wrong):
    place, heading, velocity = line(8.0, heading=heading_rad)
    said = r": 1 runs across its heading: degrees, or axes turned\?$"
    with pytest.warns(UserWarning, match=said) as caught:
        scene = made(line(8.0), (place, wrong(heading), velocity))
    assert len(caught) == 1
    assert np.cos(scene.tracks()["heading"][1] - wrong(heading)).min() > 1.0 - 1e-4
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made(line(8.0), (place, heading, velocity), bend())


def test_sizes_that_are_odd_are_noted():
    sizes = np.float32([[4.1, 1.7, 1.5], [1.7, 4.1, 1.5], [2.0, 2.5, 1.5], [12.0, 3.0, 3.0]])
    with pytest.warns(UserWarning, match=r"1 is 4.10 m wide and 1.70 m long") as caught:
        made(*[line(8.0)] * 4, sizes=sizes)
    assert len(caught) == 1


def test_flickering_waymo_tracks_are_filled_and_counted(tmp_path):
    data, whole = waymo_scene(), ccdiff_env.load_gpudrive(save(tmp_path / "whole.json"))[0]
    for number, steps in ((1, [30, 50, 51]), (0, range(20, 26)), (2, range(20, 60))):
        states = data["objects"][number]
        for step in steps:
            states["valid"][step] = False
            for name in ("position", "velocity"):
                states[name][step] = {"x": NOT_VALID, "y": NOT_VALID, "z": NOT_VALID}
            states["heading"][step] = NOT_VALID
    loaded = ccdiff_env.load_gpudrive(save(tmp_path / "gaps.json", data), cache=False)
    (report,) = loaded.report.scenes
    assert (report.filled_gaps, report.absences) == (3, 1)
    assert "gaps above 2 s" in str(loaded.report)
    filled, tracks = loaded[0].tracks(), whole.tracks()
    rows = [0, 1]  # the ego, and who comes the other way
    assert (filled["valid"][rows] == tracks["valid"][rows]).all()
    assert np.abs(filled["position"][rows] - tracks["position"][rows]).max() < 0.02
    assert np.abs(filled["velocity"][rows] - tracks["velocity"][rows]).max() < 0.05
    assert filled["valid"][2].sum() == tracks["valid"][2].sum() - 40


def test_scenarionet_sizes_are_medians_and_gaps_are_counted(tmp_path):
    data = scenario()
    length = np.full((11, 1), 4.5)
    length[:3, 0] = 4.0, 9.0, 9.0
    valid = np.ones(11)
    valid[4:6] = 0
    data["tracks"]["3"] = track("VEHICLE", 3010.0, valid=valid, length=length)
    data["tracks"]["4"] = track("VEHICLE", 3050.0, width=np.full(11, 6.0))
    loaded = ccdiff_env.load_scenarionet(save_scenario(tmp_path, data))
    scene, report = loaded[0], loaded.report.scenes[0]
    assert scene.sizes[scene.agent_ids.index("3"), 0] == 4.5
    assert scene.tracks()["valid"][scene.agent_ids.index("3")].all()
    assert (report.filled_gaps, report.absences) == (1, 0)
    assert any("4 is 6.00 m wide and 4.50 m long" in note for note in report.notes)


def test_egos_of_nuscenes_in_scenarionet_are_centred_and_their_sides_swapped_back(tmp_path):
    data = scenario()
    data["metadata"]["dataset"] = "nuscenes"
    heading = 0.3 * 0.1 * np.arange(11)
    along = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    state = {
        "heading": heading,
        "velocity": 10.0 * along,
        "length": np.full(11, 1.73),
        "width": np.full(11, 4.08),
    }
    data["tracks"]["7"] = track("VEHICLE", 3000.4, **state)
    path = save_scenario(tmp_path, data)
    loaded = ccdiff_env.load_scenarionet(path)
    (scene,), (report,) = loaded, loaded.report.scenes
    as_paper = ccdiff_env.load_scenarionet(path, ego_reference="centre")[0]
    assert np.allclose(scene.sizes[0, :2], [4.08, 1.73])
    assert any("sides swapped" in note for note in report.notes)
    place = [s.tracks()["position"][0] + np.array(s.origin) for s in (as_paper, scene)]
    assert np.allclose(place[1] - place[0], 1.385 * along, atol=2e-3)
    velocity = [s.tracks()["velocity"][0] for s in (as_paper, scene)]
    assert np.allclose((velocity[1] - velocity[0])[1:-1], 1.385 * 0.3 * left[1:-1], atol=2e-3)
    data["metadata"]["dataset"] = "waymo"
    other = ccdiff_env.load_scenarionet(save_scenario(tmp_path, data))[0]
    assert np.allclose(other.tracks()["position"][0] + np.array(other.origin), place[0], atol=2e-3)
    with pytest.raises(ccdiff_env.errors.ConfigError, match="rear_axle"):
        ccdiff_env.load_scenarionet(path, ego_reference="bumper")


def test_nuscenes_boxes_have_their_median_size_and_long_gaps_are_absences(tmp_path):
    rows = tables(1, 16)
    boxes = rows["sample_annotation"]
    for box, width in zip(boxes[:6], [3.0, 1.9, 3.0, 1.9, 3.0, 1.9], strict=True):
        box["size"] = [width, 4.5, 1.6]
    # 1 s, 1.5 s and 2 s are missing
    rows["sample_annotation"] = [boxes[k] for k in (0, 2, 3, 6, 7, 12, 13, 14)]
    loaded = ccdiff_env.load_nuscenes(write(tmp_path, rows), VERSION, cache=False)
    (scene,), (report,) = loaded, loaded.report.scenes
    assert np.allclose(scene.sizes[1], [4.5, 1.9, 1.6])
    expected = np.ones(76, bool)
    expected[36:60] = expected[71:] = False
    assert (scene.tracks()["valid"][1] == expected).all()
    assert (report.filled_gaps, report.absences) == (2, 1)


@pytest.mark.nuscenes
def test_the_log_of_a_nuscenes_ego_touches_nobody(data_root):
    """Of 93 scenes of val; with poses as centres one is hit from behind."""
    scenes = ccdiff_env.load(f"nuscenes:{data_root}/nuscenes@v1.0-trainval/val")
    env = ccdiff_env.EgoEnv(scenes=scenes, driver="replay", horizon_steps=400, **GOES_ON)
    touched = []
    for name in scenes.names:
        infos = [info for *_, info in played(env, options={"scene": name})]
        touched += [name] * any(info["collision"] for info in infos)
    assert touched == []
