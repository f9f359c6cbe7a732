"""Arriving and succeeding, against the geometry of the plane."""

import numpy as np
import pytest
from array_scenes import GOES_ON, TIMES_S, agent, array_scene, begun, driven, line, played

import ccdiff_env
from ccdiff_env import AgentVectorEnv, EgoEnv
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.config import RewardConfig
from ccdiff_env.envs.sb3 import SB3VecEnv
from ccdiff_env.training.outcomes import play_episodes
from ccdiff_env.view.outcome import outcome
from ccdiff_env.view.sources import play_scene

#: Seconds since the start of an episode, at each step of a scene.
SINCE_S = np.maximum(TIMES_S - 3.0, 0.0)
LEFT = np.array([1.0, 0.0], np.float32)
STAYED = np.array([-1.0, 0.0], np.float32)

STANDING = {
    "stands": 0.0 * TIMES_S,
    "creeps on": 0.1 * TIMES_S,
    "creeps back": -0.1 * TIMES_S,
    "drives and backs to its start": np.clip(SINCE_S, 0, 4) - np.clip(SINCE_S - 5, 0, 4),
}
DRIVES = {
    "stays": 0.0 * SINCE_S,
    "leaves": 2.0 * SINCE_S**1.5,
    "leaves by a little": np.minimum(0.97 * SINCE_S, 7.0),
    "leaves backwards": -np.minimum(0.97 * SINCE_S, 7.0),
    "leaves and comes back": np.clip(4 * SINCE_S, 0, 16) - np.clip(4 * (SINCE_S - 5), 0, 16),
    "comes by in the end": np.clip(4 * SINCE_S, 0, 20) - np.clip(4 * (SINCE_S - 5.5), 0, 20),
}


@pytest.mark.parametrize("ends", [True, False], ids=["ends", "goes on"])
@pytest.mark.parametrize("driven_x", DRIVES.values(), ids=DRIVES)
@pytest.mark.parametrize("x", STANDING.values(), ids=STANDING)
def test_a_place_where_the_log_stands_is_reached_by_who_is_there_in_the_end(x, driven_x, ends):
    _, infos = driven(array_scene(agent("ego", x)), line(x[30] + driven_x), terminate_at_goal=ends)
    assert len(infos) == 100
    away = np.array([np.linalg.norm(info["at"] - [x[130], 0.0]) for info in infos])
    stops = abs(np.gradient(x, 0.1)[130]) < 0.5
    slow = np.array([abs(info["speed"]) <= 1.5 for info in infos]) | (not stops)
    there = (away <= 5.0) & slow
    completion = np.array([info["route_completion"] for info in infos])
    np.testing.assert_array_equal(completion == 1.0, there)
    assert (completion[away > 10.1] == 0.0).all()
    last = infos[-1]
    assert [info["goal_reached"] for info in infos] == [0.0] * 99 + [float(there[-1])]
    assert last["is_success"] == last["metrics"]["is_success"] == there[-1]
    assert sum(info["reward_goal"] for info in infos) == there[-1] * RewardConfig().goal
    assert sum(info["reward_progress"] for info in infos) == 0.0


def test_a_goal_behind_the_start_is_reached_by_who_backs_up_to_it():
    # 4 m on, 12 m back, then it stands
    x = 30.0 + np.clip(2.0 * SINCE_S, 0, 4) - np.clip(2.0 * (SINCE_S - 2.5), 0, 12)
    scene = array_scene(agent("ego", x))
    options = {"terminate_at_goal": False, "dynamics": "unicycle"}
    for action in ([0.0, 0.0], [1.0, 0.0], [-1.0, 0.0]):
        env = begun(scenes=[scene], **options)
        for _ in range(100):
            *_, info = env.step(np.array(action, np.float32))
        assert info["is_success"] == info["metrics"]["goal_reached"] == 0.0
        assert info["route_completion"] < 0.3
    _, infos = driven(scene, line(x), terminate_at_goal=False)
    near = np.array(
        [abs(info["at"][0] - 22.0) <= 2.0 and abs(info["speed"]) <= 1.5 for info in infos]
    )
    first = int(near.argmax())
    assert [info["goal_reached"] for info in infos].index(1.0) == first > 80
    completion = np.array([info["route_completion"] for info in infos])
    assert (completion[:first] < 1.0).all()
    assert (completion[first:] == 1.0).all()
    assert infos[-1]["is_success"] == 1.0
    assert sum(info["goal_reached"] for info in infos) == 1.0


def test_a_short_way_has_a_small_goal():
    x = 0.3 * TIMES_S
    # of 3 m from 0.9 m on, reached within 0.75 m
    for stop_m, reaches in ((0.9, False), (3.0, False), (3.3, True)):
        path = line(np.clip(0.9 + SINCE_S, 0.9, stop_m))
        last = driven(array_scene(agent("ego", x)), path)[1][-1]
        assert last["is_success"] == (last["route_completion"] == 1.0) == reaches


@pytest.mark.parametrize(
    ("crash_m", "success"), [(None, 1.0), (150.0, 1.0), (135.0, 1.0), (80.0, 0.0)]
)
def test_success_does_not_depend_on_what_comes_after_the_goal(crash_m, success):
    others = [] if crash_m is None else [agent("b", crash_m + 0.0 * TIMES_S)]
    scene = array_scene(agent("ego", 10.0 * TIMES_S), *others)
    ends, on = (
        driven(scene, line(12.0 * SINCE_S + 30.0), terminate_at_goal=ends)[1][-1]
        for ends in (True, False)
    )
    assert ends["is_success"] == on["is_success"] == success
    assert on["metrics"]["collision"] == (crash_m is not None)
    assert ends["metrics"]["collision"] == (crash_m == 80.0)


@pytest.mark.parametrize("driver", ["idm", "constant_velocity"])
def test_success_is_one_thing_everywhere(driver):
    """In environments, whether or not episodes end at the goal, rows, learners, curves, benchmarks
    and pages.
    """
    made = [array_scene(agent("ego", x), name=name) for name, x in STANDING.items()]
    scenes = ccdiff_env.SceneSet([*ccdiff_env.embedded_scenes("val"), *made])
    options = {"driver": driver, "traffic": "idm", "terminate_at_goal": False}
    found = {"bench": [row["success"] for row in drive(scenes, driver, TRAFFIC["idm"])[0]]}
    found |= {n: [] for n in ("ego", "ends", "agents", "rows", "sb3", "curve", "page")}
    for scene in scenes:
        alone = {**options, "scenes": [scene]}
        for name, ends in (("ego", False), ("ends", True)):
            *_, (_, _, info) = played(EgoEnv(**{**alone, "terminate_at_goal": ends}))
            found[name].append(info["is_success"])
        env = ccdiff_env.parallel_env(agents=["ego"], **alone)
        env.reset(seed=0)
        while env.agents:
            *_, infos = env.step({"ego": LEFT})
        found["agents"].append(infos["ego"]["is_success"])
        rows = AgentVectorEnv(1, agents=["ego"], **alone)
        learner = SB3VecEnv(ccdiff_env.make_vec(1, **alone))
        rows.reset(seed=0), learner.reset()
        while not (ended := rows.step(LEFT[None]))[2] | ended[3]:
            _, _, done, infos = learner.step(LEFT[None])
        _, _, done, infos = learner.step(LEFT[None])
        assert done
        found["rows"].append(ended[-1]["final_info"]["is_success"][0])
        found["sb3"].append(infos[0]["is_success"])
        worlds = ccdiff_env.make_vec(1, autoreset_mode="same_step", **alone)
        found["curve"].append(play_episodes(worlds)[0])
        run = play_scene(scene, traffic="idm", driver=driver)
        found["page"].append(outcome(run).text.startswith("ego reached its goal"))
    for name, of in found.items():
        np.testing.assert_array_equal(of, found["ego"], name)
    assert 0.0 < np.mean(found["ego"]) < 1.0


def test_agents_that_wait_arrive_by_waiting():
    others = [agent(f"v{i}", 0.0 * TIMES_S, 12.0 * i) for i in (1, 2)]
    scene = array_scene(agent("ego", 10.0 * TIMES_S, -12.0), *others)
    options = {"agents": ["v1", "v2"], "traffic": "replay"}
    env = ccdiff_env.parallel_env(scenes=[scene], **options)
    env.reset(seed=0)
    while env.agents:
        *_, infos = env.step({"v1": STAYED, "v2": LEFT})
    assert {name: infos[name]["is_success"] for name in infos} == {"v1": 1.0, "v2": 0.0}
    rows = AgentVectorEnv(1, scenes=[scene], **options)
    rows.reset(seed=0)
    for _ in range(100):
        *_, infos = rows.step(np.stack([STAYED, LEFT]))
    assert infos["final_info"]["is_success"].tolist() == [1.0, 0.0]


@pytest.mark.nuscenes
def test_rules_succeed_where_real_logs_stand_only_if_they_stay(data_root):
    scenes = ccdiff_env.load_nuscenes(data_root / "nuscenes", "v1.0-trainval", "val")
    logged = {}
    for scene in scenes:
        position = scene.tracks()["position"][scene.agent_ids.index("ego")]
        if np.linalg.norm(position[30:131] - position[30], axis=1).max() < 1.0:
            logged[scene.name] = position[130]
    standing = [scene for scene in scenes if scene.name in logged]
    assert len(standing) >= 10
    options = {
        "scene_order": "sequential",
        "autoreset_mode": "disabled",
        "traffic": "idm",
        **GOES_ON,
    }
    worlds = ccdiff_env.make_vec(len(standing), scenes=standing, driver="lane_idm", **options)
    worlds.reset(seed=0)
    for _ in range(100):
        *_, infos = worlds.step(np.zeros(worlds.action_space.shape, np.float32))
    for i, scene in enumerate(standing):
        states = worlds.worlds.native.states(i)
        ego = scene.agent_ids.index("ego")
        away_m = np.linalg.norm(states["position"][ego] - logged[scene.name])
        assert infos["is_success"][i] <= (away_m <= 5.0 and states["speed"][ego] <= 1.5)
    assert infos["is_success"].sum() < len(standing)
