"""What one entry of a table makes: columns, rewards, options, sources and planners."""

from __future__ import annotations

import numpy as np
import pytest

from ccdiff_env import EgoEnv, embedded_scenes
from ccdiff_env.bench.planners import TRAFFIC, play
from ccdiff_env.config import ObservationConfig, RewardConfig, WorldConfig
from ccdiff_env.errors import ConfigError
from ccdiff_env.planners.built_in import BUILT_IN


@pytest.fixture(scope="module")
def scenes():
    return embedded_scenes("val")[:3]


def steps(env, seed=0, most=40):
    """Yield (observation, reward, info) of an episode with a hasty driver."""
    env.reset(seed=seed)
    for t in range(most):
        action = np.array([1.0 if t % 7 < 4 else -1.0, 0.0], np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        yield observation, reward, info
        if terminated or truncated:
            return


def test_an_observation_column_is_there_for_who_asks_for_it(scenes):
    columns = ("x", "y", "speed", "acceleration")
    row = ObservationConfig(num_neighbors=60, radius_m=500.0, agent_columns=columns)
    config = WorldConfig(traffic="idm", observation=row)
    env = EgoEnv(scenes=scenes, config=config, observation="dict")
    before, was_there, braked = np.zeros(0), np.zeros(0, bool), 0
    for observation, _, _ in steps(env):
        states = env.worlds.native.states(0)
        speed_mps, there = states["speed"].copy(), states["active"][1:]
        if len(before):
            change_mps = (speed_mps - before)[1:][there & was_there]
            # divided by the step of 0.1 s and by the scale of 10 m/s²
            expected = np.clip(change_mps, -1.0, 1.0)
            shown = observation["agents"][observation["agents_mask"] > 0][:, 3]
            if len(shown) == len(expected):
                np.testing.assert_allclose(np.sort(shown), np.sort(expected), atol=1e-3)
                braked += int(np.abs(expected).max() > 0.05)
        before, was_there = speed_mps, there.copy()
    assert braked > 5


def test_columns_on_request_are_not_in_the_default_row(scenes):
    env = EgoEnv(scenes=scenes)
    agents = next(e for e in env.unwrapped.worlds.layout.entries if e.name == "agents")
    assert "acceleration" not in agents.columns
    asked = EgoEnv(
        scenes=scenes,
        config=WorldConfig(
            observation=ObservationConfig(agent_columns=(*agents.columns, "acceleration"))
        ),
    )
    more = asked.observation_space.shape[0] - env.observation_space.shape[0]
    assert more == ObservationConfig().num_neighbors


def test_a_reward_component_has_a_weight_a_column_and_a_metric(scenes):
    plain = [(r, i) for _, r, i in steps(EgoEnv(scenes=scenes))]
    env = EgoEnv(scenes=scenes, reward=RewardConfig(jerk=-0.01))
    weighted = [(r, i) for _, r, i in steps(env)]
    assert len(plain) == len(weighted)
    for (reward, info), (other, same) in zip(plain, weighted, strict=True):
        expected = -0.01 * min(abs(float(info["jerk"])), 10.0)
        assert info["reward_jerk"] == 0.0
        np.testing.assert_allclose(same["reward_jerk"], expected, rtol=1e-5)
        np.testing.assert_allclose(other - reward, expected, atol=1e-5)


def test_an_info_column_says_by_how_much_the_limit_is_exceeded(scenes):
    env = EgoEnv(scenes=scenes, on_off_road="ignore", on_collision="ignore")
    env.reset(seed=0)
    found = []
    for _ in range(90):
        *_, terminated, truncated, info = env.step(np.array([1.0, 0.0], np.float32))
        per_mps = RewardConfig().speed_limit
        np.testing.assert_allclose(
            info["speeding"], info["reward_speed_limit"] / per_mps, rtol=1e-5
        )
        found.append(float(info["speeding"]))
        if terminated or truncated:
            break
    assert min(found) == 0.0
    assert max(found) > 0.0


def test_an_option_decides_how_much_of_the_route_is_a_success(scenes):
    def success(share):
        env = EgoEnv(
            scenes=scenes, success_completion=share, horizon_steps=20, on_off_road="ignore"
        )
        env.reset(seed=0)
        for _ in range(20):
            braking = np.array([-0.8, 0.0], np.float32)
            *_, terminated, truncated, info = env.step(braking)
            if terminated or truncated:
                break
        return float(info["is_success"]), float(info["route_completion"])

    _, reached = success(0.5)
    assert 0.0 < reached < 1.0
    assert success(reached * 0.9)[0] == 1.0
    assert success(min(1.0, reached * 1.1))[0] == 0.0
    with pytest.raises(ConfigError, match="success_completion"):
        EgoEnv(scenes=scenes, success_completion=1.5)


def test_a_planner_is_one_entry(scenes, monkeypatch):
    class Coast:
        def __init__(self, worlds):
            self.shape = (worlds.native.num_worlds, 2)

        def __call__(self, obs):
            return np.zeros(self.shape, np.float32)

    with pytest.raises(ConfigError, match="'coast'"):
        play(scenes[:1], "coast", TRAFFIC["replay"])
    monkeypatch.setitem(BUILT_IN, "coast", Coast)
    [named] = play(scenes[:1], "coast", TRAFFIC["replay"])
    [given] = play(scenes[:1], Coast, TRAFFIC["replay"])
    assert named["score"] == given["score"]
