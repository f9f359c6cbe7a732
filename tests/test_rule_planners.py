"""The package's planners that follow rules, and what planners are given, against other code."""

import numpy as np
import pytest
from array_scenes import outline
from traffic_play import Play

import ccdiff_env
from ccdiff_env.bench.planners import Traffic, drive
from ccdiff_env.config import ActionConfig, AssistedLimits, BicycleLimits
from ccdiff_env.errors import ActionError, ConfigError, PolicyError, ShapeError
from ccdiff_env.planners.built_in import Seat, ego_driver
from ccdiff_env.planners.planning import Tracker, overlap

REPLAY = Traffic("log", "replay")


def begun(scenes, **options):
    """Worlds that stand at their start and go on past goals, and their arrays."""
    ends = dict.fromkeys(("on_collision", "on_off_road"), "terminate")
    options = {"traffic": "replay", "autoreset": "next_step", **ends, **options}
    play = Play(scenes, seed=0, driver="external", **options)
    return play.worlds, play.out


@pytest.fixture(scope="module")
def val():
    return ccdiff_env.embedded_scenes("val")


def driven(scenes, name=None, **options):
    """Speeds [T, E] of planners in worlds of their own, 40 steps; without one, of zero actions."""
    worlds, out = begun(scenes, **options)
    act = ego_driver(name)[1] if name else lambda obs: np.zeros((len(obs), 2))
    if name:
        act.begin(worlds)
    speeds = []
    for _ in range(40):
        actions = act(out.obs[:, 0]).astype(np.float32).reshape(len(scenes), 1, -1)
        worlds.native.step(actions, out)
        egos = [worlds.native.slot_agents(i)[0] for i in range(len(scenes))]
        speeds.append([worlds.native.states(i)["speed"][a] for i, a in enumerate(egos)])
    return np.array(speeds)


@pytest.mark.parametrize("name", ["pdm", "lane_idm"])
def test_a_batch_drives_as_each_world_alone(val, name):
    together = driven(val[:3], name)
    alone = [driven(val[i : i + 1], name)[:, 0] for i in range(3)]
    assert np.array_equal(together, np.stack(alone, axis=1))


def test_pdm_drives_better_than_constant_velocity_and_keeps_to_its_lanes(val):
    rows = {name: drive(val, name, REPLAY)[0] for name in ("pdm", "constant_velocity")}
    mean = {name: np.mean([row["score"] for row in found]) for name, found in rows.items()}
    assert mean["pdm"] > 0.85 > mean["constant_velocity"]
    assert all(row["on_road"] == row["right_way"] == 1.0 for row in rows["pdm"])


def test_planners_take_the_bicycle_and_refuse_assisted_dynamics(val):
    action = ActionConfig(dynamics=BicycleLimits())
    assert np.abs(driven(val[:1], "pdm", action=action) - driven(val[:1], "pdm")).max() < 0.5
    with pytest.raises(ConfigError, match="assisted"):
        driven(val[:1], "pdm", action=ActionConfig(dynamics=AssistedLimits()))


def test_zero_is_pdm_where_it_is_the_base_of_assisted_actions(val):
    assisted = driven(val, action=ActionConfig(dynamics=AssistedLimits(base="pdm")))
    # actions of the planner are rounded once more on their way
    assert np.abs(assisted - driven(val, "pdm")).max() < 1e-3


@pytest.mark.parametrize("where", ["__init__", "reset", "__call__"])
def test_what_a_planner_raises_names_it_its_scene_and_step(val, where):
    def broken(self, *given):
        raise KeyError("speed")

    parts = {"__call__": lambda self, obs: obs, where: broken}
    worlds, out = begun(val[:1])
    seat = Seat(type("Broken", (), parts), "mine:broken")

    def driven():
        seat.begin(worlds)
        seat(out.obs[:, 0])

    with pytest.raises(PolicyError, match=f"mine:broken: KeyError.*{val[0].name} at step 0"):
        driven()


def test_overlap_agrees_with_shapely():
    rng = np.random.default_rng(0)
    low, high = [-4, -4, -4, 1, 1], [4, 4, 4, 5, 5]
    rows = [rng.uniform(low, high, (300, 5)) for _ in range(2)]
    shapes = [[outline(*row[:3], row[3:]) for row in boxes] for boxes in rows]
    expected = [a.intersects(b) for a, b in zip(*shapes, strict=True)]
    assert 50 < sum(expected) < 250
    assert overlap(*rows).tolist() == expected
    with pytest.raises(ShapeError, match="boxes"):
        overlap(np.zeros((3, 4)), np.zeros(5))


def test_a_tracker_follows_the_log(val):
    scenes = val[:2]
    worlds, out = begun(scenes)
    tracker = Tracker(worlds)
    tracks = [scene.tracks() for scene in scenes]
    egos = [worlds.native.slot_agents(i)[0] for i in range(2)]
    for _ in range(40):
        step = worlds.native.status(0).step_idx
        ahead = slice(step + 1, step + 9)
        poses = [
            np.column_stack([t["position"][a, ahead], t["heading"][a, ahead]])
            for t, a in zip(tracks, egos, strict=True)
        ]
        worlds.native.step(tracker(np.stack(poses))[:, None], out)
    step = worlds.native.status(0).step_idx
    for i, (track, ego) in enumerate(zip(tracks, egos, strict=True)):
        away = worlds.native.states(i)["position"][ego] - track["position"][ego, step]
        assert np.hypot(*away) < 0.5
    with pytest.raises(ShapeError, match="trajectories"):
        tracker(np.zeros((2, 0, 3)))


def test_a_trajectory_that_begins_elsewhere_names_its_world_and_the_frames(val):
    scenes = val[:4]
    worlds, out = begun(scenes)
    ids = [worlds.native.slot_agents(i)[0] for i in range(4)]
    places = [worlds.native.states(i)["position"][agent] for i, agent in enumerate(ids)]

    def decided(poses, due=None, **attributes):
        def plan(obs):
            return poses

        vars(plan).update(attributes)
        made = Seat(plan, "mine")
        made.begin(worlds)
        return made(out.obs[:, 0], due)

    here, origin = np.column_stack([places, np.zeros(4)])[:, None], np.zeros((4, 1, 3))
    near = np.array([2.0, 0.0, 0.0])
    for poses, frame in ((here, {}), (here, {"frame": "scene"}), (origin, {"frame": "ego"})):
        assert decided(poses + near, **frame).shape == (4, 2)
        with pytest.raises(ActionError, match=r"mine .*world 0 \(\S+, step 0\): .* 20\.0 m from"):
            decided(poses + 10 * near, **frame)
    # of its own frame, which it does not say
    far = np.hypot(*np.transpose(places)) > 20.0
    assert far.any()
    with pytest.raises(
        ActionError, match=r"'scene'; expected at most .* \(the default\) or \"ego\""
    ):
        decided(origin)
    decided(origin, ~far)  # those that do not go on mean nothing
    with pytest.raises(ConfigError, match="frame is 'world', expected 'scene' or 'ego'"):
        decided(here, frame="world")
