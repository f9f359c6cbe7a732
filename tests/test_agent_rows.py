"""Multi-agent environments in many worlds: rows agree with the PettingZoo form, and learn."""

from __future__ import annotations

import numpy as np
import pytest
from stable_baselines3 import PPO

from ccdiff_env import parallel_env
from ccdiff_env.envs.agent_vector import AgentVectorEnv
from ccdiff_env.envs.sb3 import AgentSB3VecEnv
from ccdiff_env.errors import ConfigError, ShapeError

RULES = {"agents": 4, "traffic": "idm", "horizon_steps": 40}


@pytest.mark.parametrize("more", [{}, {"adversaries": 2}, {"decision_steps": 3}], ids=str)
def test_rows_show_what_the_parallel_form_shows(scenes, more):
    options = {**RULES, "scenes": scenes, "info": "full", **more}
    rows = AgentVectorEnv(3, **options)
    games = [parallel_env(**options, names="slot") for _ in range(3)]
    names = games[0].possible_agents
    obs, infos = rows.reset(seed=5)
    for i, game in enumerate(games):
        seen, said = game.reset(seed=5 + i)
        for name, row in seen.items():
            c = names.index(name)
            assert (obs[4 * i + c] == row).all()
            assert infos["agent_id"][4 * i + c] == said[name]["agent_id"]
            assert infos["role"][4 * i + c] == said[name]["role"]
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(90):
        actions = rng.uniform(-1, 1, (12, 2)).astype(np.float32)
        active = rows.active_masks()
        obs, rewards, terminated, truncated, infos = rows.step(actions)
        for i, game in enumerate(games):
            assert [names.index(n) for n in game.agents] == np.flatnonzero(
                active[4 * i : 4 * i + 4]
            ).tolist()
            chosen = {n: actions[4 * i + names.index(n)] for n in game.agents}
            seen, reward, dead, cut, said = game.step(chosen)
            for name in seen:
                r = 4 * i + names.index(name)
                assert rewards[r] == pytest.approx(reward[name], abs=1e-5)
                assert (terminated[r], truncated[r]) == (dead[name], cut[name])
                assert infos["speed"][r] == np.float32(said[name]["speed"])
                if dead[name] or cut[name]:
                    ends += 1
                    assert (infos["final_obs"][r] == seen[name]).all()
                    assert infos["final_info"]["played"][r]
                    final = infos["final_info"]["metrics"]
                    assert final["return"][r] == said[name]["metrics"]["return"]
                else:
                    assert (obs[r] == seen[name]).all()
            if not game.agents:
                seen, _ = game.reset()
                for name, row in seen.items():
                    assert (obs[4 * i + names.index(name)] == row).all()
        waiting = ~infos["active"]
        assert (obs[waiting] == 0).all()
        assert (rewards[~active] == 0).all()
    assert ends > 10


@pytest.mark.parametrize(
    "form", [{"observation": "dict"}, {"observation": "bev"}, {"observation": "dict", "bev": {}}]
)
def test_dictionaries_rasters_and_indices_work_too(scenes, form):
    rows = AgentVectorEnv(2, scenes=scenes, discrete=True, **form, **RULES)
    game = parallel_env(scenes=scenes, discrete=True, names="slot", **form, **RULES)
    obs, _ = rows.reset(seed=0)
    seen, _ = game.reset(seed=0)
    for name in seen:
        assert game.observation_space(name).contains(seen[name])
    if form["observation"] == "bev":
        assert (obs[0] == seen["ego_0"]).all()
    assert rows.observation_space.contains(obs)
    rows.action_space.seed(0)
    for _ in range(60):
        obs, *_, infos = rows.step(rows.action_space.sample())
        for i in np.flatnonzero(infos.get("_final_obs", [])):
            assert rows.single_observation_space.contains(infos["final_obs"][i])
    assert rows.observation_space.contains(obs)


def test_mistakes_are_named(scenes):
    with pytest.raises(ConfigError):
        AgentVectorEnv(1, scenes=scenes, num_slots=3)
    rows = AgentVectorEnv(2, scenes=scenes, **RULES)
    with pytest.raises(ConfigError):
        rows.reset(seed=[1, 2, 3])
    rows.reset(seed=[1, 2])
    with pytest.raises(ShapeError):
        rows.step(np.zeros((2, 2)))


def test_sb3_counts_driven_episodes_only_and_learns(scenes):
    env = AgentSB3VecEnv(AgentVectorEnv(4, scenes=scenes, info="end", **RULES))
    assert env.num_envs == 16
    env.seed(0)
    env.reset()
    driven = waits = 0
    for _ in range(120):
        _, rewards, dones, infos = env.step(np.full((16, 2), 0.3, np.float32))
        assert rewards.dtype == np.float32
        for done, info in zip(dones, infos, strict=True):
            assert isinstance(info["active"], bool)
            if not done:
                continue
            driven += info["played"]
            waits += not info["played"]
            assert ("episode" in info) == info["played"]
            assert "terminal_observation" in info
            if info["played"]:
                assert info["episode"]["r"] == pytest.approx(info["metrics"]["return"], abs=1e-3)
                assert info["episode"]["l"] == info["metrics"]["length"]
    assert driven > 16
    assert waits > 0
    PPO("MlpPolicy", env, n_steps=16, batch_size=64, n_epochs=1, seed=0).learn(512)
