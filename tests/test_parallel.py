"""Multi-agent environments: PettingZoo's own suites, names, roles, endings; the same as rows."""

import copy
import itertools
import pickle
import warnings

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, render_test, seed_test
from stable_baselines3 import PPO

import ccdiff_env
from ccdiff_env import Scene, aec_env, parallel_env
from ccdiff_env.envs.agent_selection import RANKINGS
from ccdiff_env.envs.agent_vector import AgentVectorEnv
from ccdiff_env.envs.sb3 import AgentSB3VecEnv
from ccdiff_env.errors import (
    ActionError,
    ConfigError,
    ResetNeededError,
    ShapeError,
    UnknownNameError,
)
from ccdiff_env.metrics import causal


@pytest.fixture(autouse=True)
def _no_window(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


FORMS = [
    {},
    {"observation": "dict", "names": "slot"},
    {"agents": 3, "adversaries": 1, "discrete": True},
    {"agents": 4, "ranking": "cliques", "traffic": "idm", "adversaries": "others"},
]


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_pettingzoos_parallel_suite_passes_without_a_warning(scenes, form):
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        parallel_api_test(parallel_env(scenes=scenes[:1], **form), num_cycles=150)


def test_pettingzoos_other_suites_pass(scenes):
    for names in ("token", "slot"):
        parallel_api_test(parallel_env(scenes=scenes, agents=3, names=names), num_cycles=60)
    parallel_seed_test(lambda: parallel_env(scenes=scenes, agents=3), num_cycles=40)
    seed_test(lambda: aec_env(scenes=scenes, agents=3), num_cycles=20)
    render_test(lambda **more: aec_env(scenes=scenes[:1], agents=2, **more))
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        options = {"agents": 4, "names": "slot", "horizon_steps": 30}
        api_test(aec_env(scenes=scenes[:1], **options), num_cycles=100)


def test_a_game_of_the_ego_alone_is_ego_v0(scenes):
    single = ccdiff_env.EgoEnv(scenes=scenes, traffic="idm")
    game = parallel_env(scenes=scenes, agents=["ego"], traffic="idm")
    assert (game.reset(seed=4)[0]["ego"] == single.reset(seed=4)[0]).all()
    zero = np.zeros(2, np.float32)
    while game.agents:
        step, want = game.step({"ego": zero}), single.step(zero)
        assert (step[0]["ego"] == want[0]).all()
        assert [part["ego"] for part in step[1:4]] == list(want[1:4])
    assert step[4]["ego"]["metrics"] == want[4]["metrics"]
    assert game.step({}) == ({}, {}, {}, {}, {})
    with pytest.raises(ResetNeededError):
        game.step({"ego": zero})


def test_names_are_instance_tokens_of_all_scenes_or_ranks(scenes):
    by_token = parallel_env(scenes=scenes, agents=3)
    every = {one for scene in scenes for one in scene.agent_ids}
    assert by_token.possible_agents[0] == "ego"
    assert set(by_token.possible_agents) <= every
    for scene in scenes:
        by_token.reset(options={"scene": scene.name})
        assert set(by_token.agents) <= set(scene.agent_ids)
    by_rank = parallel_env(scenes=scenes, agents=3, names="slot")
    assert by_rank.possible_agents == ["ego_0", "vehicle_1", "vehicle_2"]
    _, infos = by_rank.reset(options={"scene": scenes[0].name})
    by_token.reset(options={"scene": scenes[0].name})
    assert [info["agent_id"] for info in infos.values()] == by_token.agents


def ranked_by_numpy(ranking, states, candidates):
    """The order behind agent 0 in NumPy, from measures of pairs over time [T, M, M]."""
    position, heading, speed, valid, size = states
    position, heading, speed, valid = (a.swapaxes(0, 1) for a in (position, heading, speed, valid))
    there = candidates & valid[-1]
    there[0] = False
    chosen = np.flatnonzero(there)
    metres = np.linalg.norm(position[-1] - position[-1, 0], axis=-1)
    if ranking == "nearest":
        return chosen[np.argsort(metres[chosen], kind="stable")].tolist()
    contact = causal.ttc(position, heading, speed, size, valid, normalised=False)
    if ranking == "ttc":
        return chosen[np.lexsort((metres[chosen], contact[-1, 0, chosen]))].tolist()
    if ranking == "cliques":
        near = causal.distance(position, valid, normalised=True)
        pairs = {"ttc": causal.normalise_ttc(contact), "distance": near}
        every = causal.rank("cliques", top_k=len(there), valid=valid[-1], **pairs).agents
        return [i for i in every if there[i]]
    return causal.rank(ranking, top_k=len(there), valid=there).agents


def test_rankings_of_any_states_are_those_of_numpy():
    rng = np.random.default_rng(4)
    for num_agents, num_steps in itertools.product((1, 2, 9, 24), (1, 7)):
        shape = (num_agents, num_steps)
        grid = rng.integers(-4, 5, (*shape, 2)) * 5.0  # many are equally far
        states = (
            grid.astype(np.float32),
            rng.uniform(-4, 4, shape).astype(np.float32),
            rng.choice([0.0, 8.0], shape).astype(np.float32),
            rng.random(shape) < 0.8,
            np.full((num_agents, 2), (4.5, 2.0), np.float32),
        )
        position, heading, speed, valid, size = states
        valid[0, -1] = True
        candidates = rng.random(num_agents) < 0.8
        scene = Scene.from_arrays(
            "states",
            agent_ids=["ego", *map(str, range(1, num_agents))],
            agent_types=["vehicle", *np.where(candidates, "vehicle", "static")[1:]],
            sizes=np.column_stack([size, size[:, 1]]),
            position=position,
            heading=heading,
            velocity=np.stack([speed, 0.0 * speed], -1),
            valid=valid,
            mend=False,
        )
        for ranking in RANKINGS:
            got = scene.ranked_vehicles(num_steps - 1, ranking)
            assert got == [0, *ranked_by_numpy(ranking, states, candidates)]


def test_supersuit_wraps_it(scenes):
    supersuit = pytest.importorskip("supersuit")
    options = {"scenes": scenes, "agents": 3, "names": "slot", "horizon_steps": 20}
    (width,) = parallel_env(**options).observation_space("ego_0").shape
    stacked = supersuit.frame_stack_v1(parallel_env(**options), 3)
    observations, _ = stacked.reset(seed=0)
    assert observations["ego_0"].shape == (3 * width,)
    rows = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.black_death_v3(parallel_env(**options)))
    rows = supersuit.concat_vec_envs_v1(rows, 2, base_class="stable_baselines3")
    assert rows.reset().shape == (6, width)
    ends = 0
    for _ in range(45):
        obs, rewards, dones, _ = rows.step(np.zeros((6, 2), np.float32))
        assert obs.shape == (6, width)
        assert rewards.shape == (6,)
        ends += dones.sum()
    assert ends >= 12


def test_copies_and_pickles_go_on_alike(scenes):
    env = parallel_env(scenes=scenes, agents=3, adversaries=1, traffic="idm")
    env.reset(seed=2)
    for _ in range(10):
        env.step({name: np.array([0.5, 0.1], np.float32) for name in env.agents})
    others = [copy.deepcopy(env), pickle.loads(pickle.dumps(env)), env.fork()]
    while env.agents:
        actions = {name: np.array([0.2, -0.1], np.float32) for name in env.agents}
        want = env.step(actions)
        for other in others:
            assert other.step(actions)[1:4] == want[1:4]
            assert other.agents == env.agents
            assert (other.state() == env.state()).all()


def test_mistakes_are_named(scenes):
    for options in (
        {"agents": "every"},
        {"agents": 0},
        {"ranking": "height"},
        {"names": "colour"},
        {"controlled": "ego"},
        {"adversaries": "egos"},
        {"num_slots": 3},
    ):
        for make in (parallel_env, AgentVectorEnv):
            if make is parallel_env or "names" not in options:
                with pytest.raises(ConfigError):
                    make(scenes=scenes, **options)
    env = parallel_env(scenes=scenes[:1], agents=2)
    with pytest.raises(UnknownNameError):
        env.action_space("nobody")
    with pytest.raises(ResetNeededError):
        env.step({})
    env.reset(seed=0)
    digest = env.worlds.native.digest(0)
    good = {name: np.zeros(2, np.float32) for name in env.agents}
    for bad in (
        None,
        list(good.values()),
        {},
        {"ego": np.zeros(2)},
        {**good, "ego": np.zeros(3)},
        {**good, "ego": np.array([np.nan, 0])},
        {**good, "ego": np.array(["a", "b"])},
    ):
        with pytest.raises(ActionError):
            env.step(bad)
    with pytest.raises(UnknownNameError):
        env.step({**good, "nobody": np.zeros(2)})
    assert env.worlds.native.digest(0) == digest
    rows = AgentVectorEnv(2, scenes=scenes, **RULES)
    with pytest.raises(ConfigError):
        rows.reset(seed=[1, 2, 3])
    rows.reset(seed=[1, 2])
    with pytest.raises(ShapeError):
        rows.step(np.zeros((2, 2)))


def test_more_agents_than_there_are_are_refused_with_the_range(scenes):
    """By the vehicles that a scene has at a time, counted here by hand."""
    most = 0
    for scene in scenes:
        vehicles = [i for i, kind in enumerate(scene.agent_types) if kind == "vehicle"]
        most = max(most, *scene.tracks()["valid"][vehicles].sum(0))
    for options, named in (
        ({"agents": 99}, f"agents is 99, expected 1 to {most}"),
        ({"agents": 600}, f"agents is 600, expected 1 to {most}"),
        ({"agents": int(most) + 1}, f"agents is {most + 1}, expected 1 to {most}"),
        ({"agents": 4, "adversaries": 9}, "adversaries is 9, expected 1 to 3"),
        ({"agents": 4, "adversaries": 4}, "adversaries is 4, expected 1 to 3"),
        ({"agents": ["ego", "nobody"]}, "no scene has an agent 'nobody'"),
        ({"agents": 4, "adversaries": ["nobody"]}, "no scene has an agent 'nobody'"),
    ):
        for make in (parallel_env, aec_env, ccdiff_env.AgentVectorEnv):
            with pytest.raises(ConfigError, match=named):
                make(scenes=scenes, **options)
    game = parallel_env(scenes=scenes, agents=4, adversaries=3)
    game.reset(seed=0)
    assert sum(game.role(name) == "adversary" for name in game.agents) == 3
    assert parallel_env(scenes=scenes, agents=int(most)).worlds.num_slots <= most


@pytest.mark.parametrize("ranking", ["nearest", "ttc", "cliques", "first", "random"])
def test_vehicles_are_ranked_at_the_start_that_was_drawn(ranking):
    options = {"agents": 4, "ranking": ranking, "traffic": "idm", "start_spread_steps": 60}
    env = parallel_env(adversaries=1, names="slot", **options)
    rows = AgentVectorEnv(3, **options)

    def expect_ranked(worlds, e):
        status = worlds.native.status(e)
        scene = worlds.scenes[status.scene_idx]
        expected = scene.ranked_vehicles(status.step_idx, ranking)[:4]
        assert worlds.native.slot_agents(e)[: len(expected)] == expected
        return [scene.agent_ids[a] for a in expected]

    for seed in range(12):
        _, infos = env.reset(seed=seed)
        expected = expect_ranked(env.unwrapped.worlds, 0)
        assert [infos[name]["agent_id"] for name in env.agents] == expected
        roles = [env.unwrapped.role(name) for name in env.agents]
        assert roles == ["ego", "adversary", "ego", "ego"][: len(expected)]
        rows.reset(seed=seed)
        counts = [len(expect_ranked(rows.worlds, e)) for e in range(3)]
        assert rows.active_masks().reshape(3, -1).sum(axis=1).tolist() == counts


def test_all_vehicles_are_those_of_the_start_that_was_drawn():
    env = parallel_env(agents="all", traffic="idm", start_spread_steps=60)
    for seed in range(12):
        env.reset(seed=seed)
        worlds = env.unwrapped.worlds
        scene = worlds.scenes[worlds.native.status(0).scene_idx]
        there = worlds.native.states(0)["active"]
        kinds = zip(scene.agent_ids, scene.agent_types, there, strict=True)
        vehicles = {one for one, kind, active in kinds if kind == "vehicle" and active}
        assert set(env.agents) == vehicles
        assert vehicles <= set(env.possible_agents)


RULES = {"agents": 4, "traffic": "idm", "horizon_steps": 40}


@pytest.mark.parametrize("more", [{}, {"decision_steps": 3}, {"adversary_shaping": 0.5}], ids=str)
def test_returns_of_adversaries_too_are_sums_of_rewards(scenes, more):
    env = parallel_env(scenes=scenes, adversaries=2, **RULES, **more)
    rng, ends = np.random.default_rng(0), 0
    for seed in range(6):
        env.reset(seed=seed)
        total = dict.fromkeys(env.agents, 0.0)
        while env.agents:
            actions = {name: rng.uniform(-1, 1, 2).astype(np.float32) for name in env.agents}
            _, rewards, dead, cut, infos = env.step(actions)
            for name, reward in rewards.items():
                total[name] += reward
                if dead[name] or cut[name]:
                    ends += env.role(name) == "adversary"
                    found = infos[name]["metrics"]["return"]
                    assert found == pytest.approx(total[name], abs=1e-4)
    assert ends > 6


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


@pytest.mark.parametrize("form", [{"observation": "bev"}, {"observation": "dict", "bev": {}}])
def test_dictionaries_rasters_and_indices_work_too(scenes, form):
    rows = AgentVectorEnv(2, scenes=scenes, discrete=True, **form, **RULES)
    assert rows.observation_space.contains(rows.reset(seed=0)[0])
    rows.action_space.seed(0)
    for _ in range(60):
        obs, *_, infos = rows.step(rows.action_space.sample())
        for i in np.flatnonzero(infos.get("_final_obs", [])):
            assert rows.single_observation_space.contains(infos["final_obs"][i])
    assert rows.observation_space.contains(obs)


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
