"""What resets are told reaches every world, by whatever door, or is refused."""

from __future__ import annotations

import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv

import ccdiff_env
from ccdiff_env import AdversarySelectionVectorEnv, AgentVectorEnv, EgoEnv
from ccdiff_env.envs.sb3 import AgentSB3VecEnv, SB3VecEnv, SelectionSB3VecEnv
from ccdiff_env.errors import ConfigError, UnknownNameError

TOLD = ("scene", "ego", "start_step")


def driver_of(worlds, world_idx, agent):
    ids = worlds.scenes[worlds.native.status(world_idx).scene_idx].agent_ids
    return worlds.native.drivers(world_idx)[list(ids).index(agent)]


def drawn(scenes, scene):
    """An ego that a scene has, besides the logged one."""
    env = EgoEnv(scenes=scenes, ego="any")
    for seed in range(9):
        ego = env.reset(seed=seed, options={"scene": scene})[1]["ego"]
        if ego != "ego":
            return ego
    raise AssertionError(scene)


def cases(scenes):
    one, two = scenes.names[:2]
    other = drawn(scenes, one)
    return [
        ({"scene": one}, {}),
        ([{"scene": one}, {"scene": two}], {}),
        ([{}, {"scene": two}], {}),
        ([{"scene": one, "ego": other, "start": 50}, {"scene": two}], {"ego": "any"}),
        ({"style": {"comfort": 4.0}}, {"style": {"comfort": (0.0, 4.0)}}),
        (
            [{"style": {"comfort": 4.0}}, {"style": {"comfort": 1.0}}],
            {"style": {"comfort": (0.0, 4.0)}},
        ),
        ({"scene": one, "drivers": {other: "replay"}}, {"traffic": "idm"}),
        ([{"scene": one, "drivers": {other: "replay"}}, {"scene": one}], {"traffic": "idm"}),
    ]


def test_stable_baselines3_tells_worlds_what_it_tells_environments(scenes):
    for options, made in cases(scenes):
        native = SB3VecEnv(ccdiff_env.make_vec(2, scenes=scenes, **made))
        envs = [EgoEnv(scenes=scenes, **made) for _ in range(2)]
        single = DummyVecEnv([lambda env=env: env for env in envs])
        found = []
        for vec in (native, single):
            vec.seed(3)
            vec.set_options(options)
            found.append(vec.reset())
        assert np.array_equal(*found), options
        for i, env in enumerate(envs):
            told = [vec.reset_infos[i] for vec in (native, single)]
            assert [one.get(name) for one in told for name in TOLD] == [
                told[0].get(name) for _ in told for name in TOLD
            ]
            drivers = [native.env.worlds.native.drivers(i), env.worlds.native.drivers(0)]
            assert drivers[0] == drivers[1], options
        actions = np.zeros((2, 2), np.float32)
        for _ in range(5):
            rows = [vec.step(actions) for vec in (native, single)]
            assert all(
                np.array_equal(a, b) for a, b in zip(*(row[:3] for row in rows), strict=True)
            )
        # told once
        assert [vec._options for vec in (native, single)] == [[{}, {}]] * 2


def test_what_no_world_takes_is_refused_by_every_door(scenes):
    game = ccdiff_env.parallel_env(scenes=scenes, agents=2)
    rows = AgentVectorEnv(2, scenes=scenes, agents=2)
    selection = AdversarySelectionVectorEnv(2, scenes=scenes)
    doors = [EgoEnv(scenes=scenes), ccdiff_env.make_vec(2, scenes=scenes), game, rows, selection]
    doors += [ccdiff_env.AdversarySelectionEnv(scenes=scenes)]
    for env in doors:
        with pytest.raises(ConfigError, match="did you mean 'scene'"):
            env.reset(seed=0, options={"scen": scenes.names[0]})
        with pytest.raises(ConfigError, match="expected a dictionary"):
            env.reset(seed=0, options=["scene"])
    for vec in (
        SB3VecEnv(ccdiff_env.make_vec(2, scenes=scenes)),
        AgentSB3VecEnv(rows),
        SelectionSB3VecEnv(selection),
    ):
        vec.set_options({"scen": scenes.names[0]})
        with pytest.raises(ConfigError, match="did you mean 'scene'"):
            vec.reset()
        vec.set_options({"reset_mask": np.ones(2, np.bool_)})
        with pytest.raises(ConfigError, match="reset_mask"):
            vec.reset()
        vec.set_options([{"scene": 0}] * (vec.num_envs + 1))
        with pytest.raises(ConfigError, match=f"{vec.num_envs + 1} options"):
            vec.reset()
    game.reset(seed=0, options={"options": 1})  # PettingZoo's own tests


def test_rows_of_a_world_are_told_the_same(scenes):
    one, two = scenes.names[:2]
    env = AgentVectorEnv(2, scenes=scenes, agents=2, traffic="idm")
    vec = AgentSB3VecEnv(env)
    vec.set_options([{"scene": one}, {}, {"scene": two}, {"scene": two}])
    vec.reset()
    assert [info["scene"] for info in vec.reset_infos] == [one, one, two, two]
    vec.set_options([{"scene": one}, {"scene": two}, {}, {}])
    with pytest.raises(ConfigError, match="rows of one world"):
        vec.reset()
    ids = scenes[0].agent_ids
    kept = {env.worlds.native.slot_agents(0)[c] for c in range(2)}
    other = next(i for i in range(len(ids)) if env.worlds.native.drivers(0)[i] == "idm")
    assert other not in kept
    env.reset(seed=0, options={"scene": [one, two], "drivers": {ids[other]: "replay"}})
    assert driver_of(env.worlds, 0, ids[other]) == "replay"
    env.reset(seed=0, options={"scene": one, "drivers": [{}, {ids[other]: "replay"}]})
    assert [driver_of(env.worlds, e, ids[other]) for e in range(2)] == ["idm", "replay"]


def test_drivers_are_told_to_all_worlds_or_to_each(scenes):
    one, two = scenes.names[:2]
    ids = [set(scene.agent_ids) for scene in scenes[:2]]
    only = next(i for i in scenes[0].agent_ids if i in ids[0] - ids[1])
    env = ccdiff_env.make_vec(2, scenes=scenes, traffic="idm")
    env.reset(seed=0, options={"scene": [one, two], "drivers": {only: "replay"}})
    assert driver_of(env.worlds, 0, only) == "replay"
    env.reset(seed=0, options={"scene": [one, two], "drivers": [{only: "replay"}, None]})
    assert driver_of(env.worlds, 0, only) == "replay"
    with pytest.raises(UnknownNameError, match=f"{two}.*world 1.*{only}"):
        env.reset(seed=0, options={"scene": [one, two], "drivers": [{}, {only: "replay"}]})
    with pytest.raises(ConfigError, match="drivers has 3 entries"):
        env.reset(seed=0, options={"drivers": [{}, {}, {}]})
    rows = AgentVectorEnv(2, scenes=scenes, agents=2, traffic="idm")
    for door in (env, rows, AdversarySelectionVectorEnv(2, scenes=scenes)):
        with pytest.raises(UnknownNameError, match="no scene has an agent 'nobody'"):
            door.reset(seed=0, options={"drivers": {"nobody": "idm"}})
