"""Actions held for several steps, against the user's own loop over single steps, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import EgoEnv, Recorder
from ccdiff_env.errors import ConfigError

#: Together, so that the figures of a decision have something to keep.
GOES_ON = {"on_collision": "stop", "on_off_road": "ignore", "terminate_at_goal": False}
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
        {"traffic": "idm", **GOES_ON},
        {"traffic": "ccdiff", "criticality": 1.0, "horizon_steps": 26},
        {"observation": "bev", "horizon_steps": 20},
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


def test_snapshots_go_between_paces(scenes):
    """The state of a world does not depend on how often its driver is asked."""
    slow = EgoEnv(scenes=scenes, traffic="idm", decision_steps=5)
    fast = EgoEnv(scenes=scenes, traffic="idm")
    slow.reset(seed=3)
    slow.step(np.zeros(2, np.float32))
    obs = fast.restore(slow.snapshot())
    assert np.array_equal(obs, slow.observation())
    assert fast.worlds.native.digest(0) == slow.worlds.native.digest(0)
    assert slow.worlds.native.status(0).elapsed_steps == 5


def test_what_counts_steps_refuses_decisions(scenes):
    with pytest.raises(ConfigError, match="decision_steps is 3, expected 1"):
        Recorder(EgoEnv(scenes=scenes, decision_steps=3))
    with pytest.raises(ConfigError, match="unknown option 'decision_steps'"):
        ccdiff_env.AdversarySelectionEnv(scenes=scenes, decision_steps=3)
    with pytest.raises(ConfigError, match="decision_steps"):
        EgoEnv(scenes=scenes, decision_steps=0)


def test_max_cycles_counts_decisions(scenes):
    game = ccdiff_env.parallel_env(scenes=scenes, agents=2, max_cycles=4, decision_steps=5)
    assert (game.max_cycles, game.worlds.config.horizon_steps) == (4, 20)
