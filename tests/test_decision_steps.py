"""Actions held for several steps, against loops over single steps; assisted ones."""

import itertools

import numpy as np
import pytest
from array_scenes import GOES_ON, begun, played

import ccdiff_env
from ccdiff_env import EgoEnv, Recorder
from ccdiff_env.errors import ConfigError
from ccdiff_env.planners.planning import Steering
from ccdiff_env.record.counterfactual import avoidability

#: What stays in the figures of a decision once it has happened.
CONTACT = ("collision", "collision_kind", "collision_partner", "at_fault")


def held(env, action, steps):
    """A decision by hand: reward, ends and figures of single steps, put together."""
    total, figures = np.float32(0.0), {}
    for _ in range(steps):
        obs, reward, terminated, truncated, info = env.step(action)
        total = np.float32(total + np.float32(reward))
        for name, value in info.items():
            if name.startswith("reward_") and name in figures:
                info[name] = float(np.float32(figures[name]) + np.float32(value))
        if figures.get("collision") and not info["collision"]:
            info.update({name: figures[name] for name in CONTACT})
        info["goal_reached"] = max(info["goal_reached"], figures.get("goal_reached", 0.0))
        figures = info
        if terminated or truncated:
            break
    return obs, float(total), terminated, truncated, figures


def actions(env, seed):
    """Random actions, weak in steering so that episodes last."""
    env.action_space.seed(seed)
    while True:
        sample = env.action_space.sample()
        yield sample if env.worlds.native.num_actions else sample * np.float32([0.8, 0.08])


@pytest.mark.parametrize("steps", [2, 3, 7])
@pytest.mark.parametrize(
    "options",
    [
        {"traffic": "idm"},
        {"traffic": "idm", "discrete": True, "dynamics": "bicycle"},
        {"traffic": "idm", "horizon_steps": 25, "start_spread_steps": 20},
        # figures of a decision have something to keep
        {"traffic": "idm", **GOES_ON, "on_collision": "stop"},
        {"traffic": "ccdiff", "criticality": 1.0, "horizon_steps": 26},
        {"observation": "bev", "horizon_steps": 20},
        {"dynamics": {"assisted": {"base": "pdm"}}, "horizon_steps": 30},
    ],
    ids=str,
)
def test_a_decision_is_the_loop_over_its_steps(options, steps, scenes):
    one = EgoEnv(scenes=scenes, decision_steps=steps, **options)
    other = EgoEnv(scenes=scenes, **options)
    for seed in range(3):
        assert np.array_equal(one.reset(seed=seed)[0], other.reset(seed=seed)[0])
        for action in actions(one, seed):
            got, want = one.step(action), held(other, action, steps)
            assert np.array_equal(got[0], want[0])
            assert got[1:4] == want[1:4]
            assert got[4] == want[4]
            assert one.worlds.native.digest(0) == other.worlds.native.digest(0)
            if got[2] or got[3]:
                break


def test_each_agent_sees_its_own_end(scenes):
    """Vehicles whose episode ends inside a decision, while their world goes on."""
    steps, options = 5, {"agents": "all", "names": "slot", "traffic": "idm", "horizon_steps": 60}
    one = ccdiff_env.parallel_env(scenes=scenes, decision_steps=steps, **options)
    other = ccdiff_env.parallel_env(scenes=scenes, **options)
    early = 0
    for seed in range(6):
        assert one.reset(seed=seed)[0].keys() == other.reset(seed=seed)[0].keys()
        rng = np.random.default_rng(seed)
        while one.agents:
            driven = {name: rng.uniform(-1, 1, 2).astype(np.float32) for name in one.agents}
            obs, rewards, terminated, truncated, _ = one.step(driven)
            seen, total = {}, dict.fromkeys(driven, np.float32(0.0))
            ends = {}
            for k in range(steps):
                if not other.agents:
                    break
                now = other.step({name: driven[name] for name in other.agents})
                seen.update(now[0])
                for name, reward in now[1].items():
                    total[name] = np.float32(total[name] + np.float32(reward))
                    ends[name] = (now[2][name], now[3][name])
                early += k + 1 < steps and bool(other.agents) and any(now[2].values())
            assert one.agents == other.agents
            for name in driven:
                assert np.array_equal(obs[name], seen[name]), name
                assert rewards[name] == total[name], name
                assert (terminated[name], truncated[name]) == ends[name]
    assert early > 0


def test_what_counts_steps_refuses_decisions(scenes):
    with pytest.raises(ConfigError, match="decision_steps is 3, expected 1"):
        Recorder(EgoEnv(scenes=scenes, decision_steps=3))
    with pytest.raises(ConfigError, match="decision_steps is not an option"):
        ccdiff_env.AdversarySelectionEnv(scenes=scenes, decision_steps=3)
    with pytest.raises(ConfigError, match="decision_steps"):
        EgoEnv(scenes=scenes, decision_steps=0)


def driven(env, scene, action=(0, 0), steps=60):
    """Info columns of the first steps of an episode [T], by name."""
    episode = played(env, np.float32(action), seed=scene, options={"scene": scene})
    rows = [info for *_, info in itertools.islice(episode, steps)]
    return {name: np.array([row[name] for row in rows]) for name in env.worlds.column_names}


@pytest.mark.parametrize("traffic", ["replay", "idm"])
def test_zero_is_idm_on_the_route(traffic, scenes):
    options = {"scenes": scenes, "traffic": traffic, "on_collision": "ignore"}
    assisted = EgoEnv(dynamics="assisted", **options)
    idm = EgoEnv(driver="idm", **options)
    apart = []
    for i in range(len(scenes)):
        ours, theirs = driven(assisted, i), driven(idm, i)
        steps = min(len(ours["speed"]), len(theirs["speed"]))
        # the release of the brake is softer than IDM's
        apart += np.abs(ours["speed"][:steps] - theirs["speed"][:steps]).tolist()
        assert np.abs(ours["route_distance"]).max() < 1.0
    assert np.median(apart) < 0.1
    assert np.quantile(apart, 0.9) < 1.5


def test_the_second_column_is_a_distance_from_the_route(scenes):
    env = EgoEnv(scenes=scenes, dynamics="assisted", on_collision="ignore", on_off_road="ignore")
    reached = 0
    for i in range(len(scenes)):
        for side in (-1.0, 1.0):
            figures = driven(env, i, [0, side])
            if len(figures["speed"]) < 50 or figures["speed"].min() < 3.0:
                continue
            reached += 1
            assert abs(figures["route_distance"][-1] - 1.5 * side) < 0.3
            assert np.abs(figures["route_distance"]).max() < 1.9
    assert reached > 2


def test_the_first_column_changes_idms_acceleration_within_the_jerk(scenes):
    env = EgoEnv(scenes=scenes, dynamics="assisted", on_collision="ignore")
    braked = 0
    for i in range(len(scenes)):
        figures = driven(env, i, [-0.5, 0], 12)
        moving = figures["speed"] > 0.0
        braked += figures["acceleration"][moving].min(initial=0.0) < -1.4
        faster = driven(env, i, [1, 0], 40)
        assert faster["acceleration"].max() <= 2.4 + 1e-3
        rolling = faster["speed"] > 0.1  # a stop ends the braking at once
        assert faster["jerk"][rolling].max(initial=0.0) <= 8.0 + 0.1
    assert braked > len(scenes) // 2


@pytest.mark.parametrize("base", ["idm", "pdm"])
def test_the_bases_jerk_is_held_outside_emergencies(base, scenes):
    asked = {"scenes": scenes, "traffic": "idm", "on_collision": "ignore"}

    def accelerations(action=0.0, **limits):
        env = EgoEnv(dynamics={"assisted": {"base": base} | limits}, **asked)
        return [driven(env, i, [action, 0]) for i in range(len(scenes))]

    def changes(episode, added_mps2=0.0):
        """Per step of 0.1 s, while rolling, but for emergencies: the base brakes by 4.05 m/s²."""
        a, rolling = episode["acceleration"], episode["speed"] > 0
        return np.diff(a)[rolling[1:] & (np.minimum(a[1:], a[:-1]) > added_mps2 - 4.0)]

    free = accelerations()
    for episode, beyond in zip(free, accelerations(base_jerk_mps3=105.0), strict=True):
        # from 2.4 to -8 m/s² in a step is 104 m/s³: the default of 1000 holds nothing
        assert np.array_equal(episode["acceleration"], beyond["acceleration"])
    assert max(np.abs(changes(episode)).max() for episode in free) > 0.3
    for action, added_mps2 in ((0.0, 0.0), (0.1, 0.2)):
        for episode in accelerations(action, base_jerk_mps3=2.0):
            assert np.abs(changes(episode, added_mps2) - added_mps2).max() <= 2.0 * 0.1 + 1e-4


@pytest.mark.parametrize("dynamics", ["unicycle", "bicycle", "delta_pose"])
def test_actions_that_follow_the_log_follow_it_when_they_are_held(scenes, dynamics):
    strayed_m = {}
    for steps in (1, 3):
        env = EgoEnv(scenes=scenes, decision_steps=steps, dynamics=dynamics, **GOES_ON)
        strayed_m[steps] = [
            max(info["log_distance"] for *_, info in followed(env, scene))
            for scene in range(len(scenes))
        ]
    assert np.median(strayed_m[3]) < np.median(strayed_m[1]) + 0.2


def followed(env, scene):
    env.reset(seed=0, options={"scene": scene})
    ended = False
    while not ended:
        told = env.step(env.expert_action())
        ended = told[2] or told[3]
        yield told


def test_plans_that_need_a_model_of_motion_refuse_it(scenes):
    env = begun(scenes=scenes, dynamics="assisted")
    with pytest.raises(ConfigError, match=r"action\.dynamics"):
        env.expert_action()


def test_plans_are_changes_of_idm_and_distances_from_the_route(scenes):
    env = begun(scenes=scenes, dynamics={"assisted": {"delta_mps2": (-6.0, 2.0)}})
    steering = Steering(env.worlds)
    for plan, action in (((0.0, 0.0), (0.0, 0.0)), ((-3.0, 0.75), (-0.5, 0.5)), ((9, -9), (1, -1))):
        assert steering.action(0, None, 0, *plan).tolist() == list(action)
    assert avoidability(env, num_samples=1).avoidable, "IDM"
