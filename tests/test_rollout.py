"""Recorded episodes: what they hold, and that files and scenes made of them say the same."""

import dataclasses

import numpy as np
import pytest
from array_scenes import begun, rebuilt
from view_rollouts import plan_of

import ccdiff_env
from ccdiff_env import EgoEnv, Recorder, Rollout, errors, metrics
from ccdiff_env.scenes.scenarionet import load_scenario_dict
from ccdiff_env.scenes.scenarionet_export import write_scenario

NAMES = ("position", "heading", "velocity", "valid", "drivers")


def record(scene=None, scenes="val", **options):
    env = EgoEnv(scenes=scenes, **options)
    env.reset(seed=3, options={"scene": scene} if scene else None)
    recorder = Recorder(env, planner=options.get("driver", "straight"))
    recorder.start()
    states, infos, done = [env.worlds.native.states(0)], [], False
    while not done:
        *_, terminated, truncated, info = env.step(np.zeros(2, np.float32))
        assert recorder.step()
        states.append(env.worlds.native.states(0))
        infos.append(info)
        done = terminated or truncated
    return env, recorder.rollout(), states, infos


@pytest.fixture(scope="module")
def driven():
    return record(driver="idm", traffic="idm")


def crash():
    """An ego that goes straight on until it hits something."""
    for scene in ccdiff_env.embedded_scenes("val"):
        options = {"on_off_road": "ignore", "terminate_at_goal": False}
        rollout = record(scenes=[scene], **options)[1]
        if rollout.collisions("ego"):
            return rollout
    raise AssertionError("nobody was hit")


def test_states_and_figures_are_those_that_the_world_showed(driven):
    env, rollout, states, infos = driven
    assert rollout.num_steps == len(states)
    assert rollout.start_step == 30
    for t, state in enumerate(states):
        for name in ("position", "heading", "velocity"):
            assert (getattr(rollout, name)[:, t] == state[name]).all()
        assert (rollout.valid[:, t] == state["active"]).all()
    assert list(rollout.driver_names) == env.worlds.native.drivers(0)
    assert rollout.meta["planner"] == "idm"
    assert rollout.meta["traffic"] == "idm"
    assert rollout.meta["config"]["horizon_steps"] == 100
    for name in ("speed", "ttc", "reward_progress"):
        assert rollout.info[name].tolist() == [info[name] for info in infos]


def test_a_collision_is_listed_from_both_sides_where_the_boxes_begin_to_overlap():
    rollout = crash()
    event = rollout.collisions("ego")[0]
    other = next(e for e in rollout.collisions(event.partner_id) if e.partner_id == "ego")
    assert (other.step, other.partner_id) == (event.step, "ego")
    partner = rollout.agent_ids.index(event.partner_id)
    controlled = np.arange(len(rollout.agent_ids)) == 0
    for until, touch in ((None, True), (event.step, False)):
        tracks = (a[:, :until] for a in (rollout.position, rollout.heading))
        sizes, valid = rollout.scene.sizes[:, :2], rollout.valid[:, :until]
        boxes = metrics.Motion(*tracks, sizes, valid, dt_s=0.1)
        pairs = boxes.collisions(controlled=controlled).contacts[:, 1:].tolist()
        assert ([0, partner] in pairs) == touch


def test_a_file_gives_the_same_episode(driven, tmp_path):
    rollout = driven[1]
    plan = plan_of(
        5,
        [0, 1],
        np.arange(72, dtype=np.float32).reshape(3, 2, 4, 3),
        selected_sample=np.array([2, 0]),
        follows_plan=np.array([False, True]),
        guided=np.array([False, True]),
        objectives=("approach",),
        losses=np.ones((1, 3, 2), np.float32),
        conflict_share=np.array([0.5, 0.0], np.float32),
    )
    fields = {name: getattr(rollout, name) for name in rollout.__dataclass_fields__}
    saved = Rollout(**{**fields, "plans": (plan,)})
    saved.save(tmp_path / "a.npz")
    loaded = Rollout.load(tmp_path / "a.npz")
    assert loaded.scene == rollout.scene
    for name in NAMES:
        assert (getattr(loaded, name) == getattr(rollout, name)).all()
    assert loaded.events == rollout.events
    assert dict(loaded.meta) == dict(rollout.meta)
    assert loaded.info.keys() == rollout.info.keys()
    assert all((loaded.info[k] == rollout.info[k]).all() for k in loaded.info)
    (again,) = loaded.plans
    for field in dataclasses.fields(plan):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(plan, field.name))
    whole = (tmp_path / "a.npz").read_bytes()
    for wrong in (whole[:-1], whole + b"\0", whole[:100]):
        (tmp_path / "a.npz").write_bytes(wrong)
        with pytest.raises(errors.DatasetError, match="cut off, or with bytes after the end"):
            Rollout.load(tmp_path / "a.npz")


@pytest.mark.parametrize("name", ["graph", "losses", "samples", "ranking", "selected_sample"])
def test_plans_of_wrong_shapes_are_refused(name):
    plan = plan_of(3, [0], np.ones((2, 1, 4, 2), np.float32))
    wrong = {"selected_sample": np.array([2]), "ranking": np.zeros((1, 1), np.int64)}
    with pytest.raises(errors.ShapeError, match=rf"plan\.{name}"):
        dataclasses.replace(plan, **{name: wrong.get(name, getattr(plan, name)[..., None])})


def test_as_a_scene_it_replays_itself(driven):
    rollout = driven[1]
    scene = rollout.to_scene("again")
    assert (scene.name, scene.num_steps) == ("again", 30 + rollout.num_steps)
    again = begun(scenes=[scene], driver="replay", traffic="replay", terminate_at_goal=False)
    rows = [rollout.agent_ids.index(i) for i in scene.agent_ids]
    for t in range(rollout.num_steps - 1):  # an ego that arrives leaves the world
        states = again.worlds.native.states(0)
        there = states["active"] & rollout.valid[rows, t]
        assert there[0]
        assert there.sum() >= rollout.valid[rows, t].sum() - 2
        assert (states["position"][there] == rollout.position[rows, t][there]).all()
        _, _, terminated, truncated, _ = again.step(np.zeros(2, np.float32))
        assert not (terminated or truncated) or t + 2 == rollout.num_steps


def close(a, b):
    return a.shape == b.shape and np.allclose(a, b, atol=2e-3)


def test_scenarionet_gives_the_same_scene(driven, tmp_path):
    rollout = driven[1]
    rollout.to_scenarionet(tmp_path / "sd.pkl", "exported")
    scene, loaded = rollout.to_scene("exported"), ccdiff_env.load_scenarionet(tmp_path)["exported"]
    want, got = scene.tracks(), loaded.tracks()
    kept = np.flatnonzero(want["valid"].sum(axis=1) >= 2)
    assert loaded.agent_ids == [scene.agent_ids[i] for i in kept]
    assert loaded.agent_types == [scene.agent_types[i] for i in kept]
    assert loaded.agent_categories == [scene.agent_categories[i] for i in kept]
    assert (loaded.dt, loaded.origin, loaded.token) == (scene.dt, scene.origin, scene.token)
    assert (got["valid"] == want["valid"][kept]).all()
    for name in ("position", "velocity"):
        assert close(got[name], want[name][kept])
    turn = got["heading"] - want["heading"][kept]
    assert np.abs(np.angle(np.exp(1j * turn)))[got["valid"]].max() < 1e-5
    ours, theirs = scene.map_layers(), loaded.map_layers()
    for name in ("drivable_area", "walkways", "ped_crossings", "stop_lines", "carpark_areas"):
        assert len(ours[name]) == len(theirs[name])
        for a, b in zip(ours[name], theirs[name], strict=True):
            assert close(a["exterior"], b["exterior"])
    for a, b in zip(ours["lanes"], theirs["lanes"], strict=True):
        assert (a["id"], a["kind"], a["successors"]) == (b["id"], b["kind"], b["successors"])
    env = EgoEnv(scenes=[loaded], traffic="idm")
    obs, _ = env.reset(seed=0)
    assert np.isfinite(obs).all()
    twins = rebuilt(scene, map_layers={**ours, "lanes": [*ours["lanes"], ours["lanes"][0]]})
    with pytest.raises(errors.DatasetError, match="'exported': lanes share an id"):
        write_scenario(twins, tmp_path / "twins.pkl")


def test_scenarionets_own_rules_hold(driven, tmp_path):
    """First-level keys, state lengths and metadata as its sanity check asks for them."""
    driven[1].to_scenarionet(tmp_path / "sd.pkl")
    data = load_scenario_dict(tmp_path / "sd.pkl")
    keys = {"tracks", "version", "id", "dynamic_map_states", "map_features", "length", "metadata"}
    assert keys == set(data)
    for key, track in data["tracks"].items():
        assert {"type", "state", "metadata"} <= set(track)
        assert {"type", "object_id", "track_length"} <= set(track["metadata"])
        assert track["metadata"]["object_id"] == key
        for values in track["state"].values():
            assert isinstance(values, np.ndarray)
            assert len(values) == data["length"]
        assert track["state"]["position"].shape == (data["length"], 3)
        assert (track["state"]["position"][~track["state"]["valid"]] == 0).all()
    assert {"metadrive_processed", "coordinate", "ts"} <= set(data["metadata"])
    assert len(data["metadata"]["ts"]) == data["length"]
    assert data["metadata"]["sdc_id"] in data["tracks"]
    lanes = [f for f in data["map_features"].values() if f["type"].startswith("LANE_")]
    known = set(data["map_features"])
    assert lanes
    assert all(set(f["exit_lanes"]) <= known for f in lanes)


def test_recording_stops_at_the_end_of_the_episode():
    env = ccdiff_env.make_vec(
        2, scenes="val", autoreset_mode="next_step", horizon_steps=3, terminate_at_goal=False
    )
    with pytest.raises(errors.ResetNeededError):
        Recorder(env, world_idx=1).step()
    env.reset(seed=0)
    recorder = Recorder(env, world_idx=1)
    on = [(env.step(np.zeros((2, 2), np.float32)), recorder.step())[1] for _ in range(5)]
    assert on == [True, True, True, False, False]
    rollout = recorder.rollout()
    assert rollout.num_steps == 4
    assert "time_limit" in [event.kind for event in rollout.events if event.step == 3]


def test_a_step_that_is_left_out_is_no_recording():
    env = begun(scenes="val", terminate_at_goal=False)
    recorder = Recorder(env)
    for _ in range(2):
        env.step(np.zeros(2, np.float32))
    with pytest.raises(errors.ResetNeededError, match="step 2 comes after 0"):
        recorder.step()
    recorder.start()
    env.step(np.zeros(2, np.float32))
    assert recorder.step()
    assert recorder.rollout().start_step == 32


def test_plans_of_ccdiff_are_recorded_where_they_were_made():
    options = {"horizon_steps": 12, "terminate_at_goal": False, "on_collision": "ignore"}
    rollout = record(traffic="ccdiff", ccdiff={"denoising_steps": 2}, **options)[1]
    assert [plan.made_at for plan in rollout.plans] == [0, 5, 10]
    assert rollout.driver_names.count("ccdiff") >= 1
    for plan in rollout.plans:
        for m in np.flatnonzero(plan.follows_plan):
            a = plan.agents[m]
            steps = range(min(5, rollout.num_steps - 1 - plan.made_at))
            for h in steps:
                planned = plan.samples[plan.selected_sample[m], m, h, :2]
                assert np.abs(rollout.position[a, plan.made_at + h + 1] - planned).max() < 0.05
