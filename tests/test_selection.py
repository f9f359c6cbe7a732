"""Adversary selection: spaces, masks, rewards against recorded rollouts, vector form, learners."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import ccdiff_env
from ccdiff_env import (
    AdversarySelectionEnv,
    AdversarySelectionVectorEnv,
    WorldConfig,
    embedded_scenes,
)
from ccdiff_env.envs.sb3 import SelectionSB3VecEnv
from ccdiff_env.envs.selection import BASELINES, SelectionReward
from ccdiff_env.envs.selection.options import SelectionActions
from ccdiff_env.envs.selection.view import FEATURES
from ccdiff_env.errors import ActionError, ConfigError, ResetNeededError
from ccdiff_env.policies.planners import ego_driver
from ccdiff_env.traffic import CcdiffConfig, PythonTraffic
from ccdiff_env.view import render

ID = "ccdiff_env/AdversarySelection-v0"
QUICK = {"ccdiff": {"denoising_steps": 2}, "horizon_steps": 40}
#: The same with the fastest network, for what does not depend on it.
PLAIN = {"ccdiff": {"denoising_steps": 1}, "horizon_steps": 40}


@pytest.fixture(scope="module")
def scenes():
    return embedded_scenes("val")


@pytest.mark.parametrize("mode", ["multibinary", "scores", "discrete"])
def test_gymnasiums_and_sb3s_checkers_pass(scenes, mode):
    env = gymnasium.make(ID, scenes=scenes, action_mode=mode, **QUICK)
    check_env(env.unwrapped, skip_render_check=True)
    sb3_check_env(AdversarySelectionEnv(scenes=scenes, action_mode=mode, **PLAIN), warn=False)


def test_rows_are_the_nearest_driven_vehicles_in_the_egos_frame(scenes):
    env = AdversarySelectionEnv(scenes=scenes, max_agents=4, **PLAIN)
    for seed in range(3):
        obs, info = env.reset(seed=seed)
        states, scene = env.worlds.native.states(0), env.scene
        drivers = env.worlds.native.drivers(0)
        ids = scene.agent_ids
        metres = {
            one: np.hypot(*(states["position"][i] - states["position"][0]))
            for i, one in enumerate(ids)
            if drivers[i] == "ccdiff" and states["active"][i] and one != "ego"
        }
        assert list(info["agent_ids"]) == sorted(metres, key=metres.__getitem__)[:4]
        assert obs["mask"].tolist() == [1] * len(info["agent_ids"]) + [0] * (
            4 - len(info["agent_ids"])
        )
        angle = states["heading"][0]
        for row, one in enumerate(info["agent_ids"], start=1):
            i = ids.index(one)
            way = states["position"][i] - states["position"][0]
            forward = (way[0] * np.cos(angle) + way[1] * np.sin(angle)) / 50.0
            assert obs["agents"][row, FEATURES.index("x")] == pytest.approx(forward, abs=1e-5)
            assert obs["distance"][0, row] == pytest.approx(1 - min(metres[one], 50) / 50, abs=1e-5)
        assert env.observation_space.contains(obs)


def test_actions_choose_rows_within_mask_and_budget():
    mask = np.array([True, True, False, True, False])
    flags = SelectionActions("multibinary", 5, 2, None)
    assert flags.rows(np.array([0, 1, 1, 1, 1]), mask) == [1, 3]
    assert flags.rows(np.ones(5, np.int8), mask) == [0, 1]
    assert flags.masks(mask).tolist() == [1, 1, 1, 1, 1, 0, 1, 1, 1, 0]
    scores = SelectionActions("scores", 5, 2, (0.0, 4.0))
    action = np.array([0.1, 0.3, 0.9, 0.2, 1.0, 0.5], np.float32)
    assert scores.rows(action, mask) == [1, 3]
    assert scores.criticality(action) == pytest.approx(3.0)
    one = SelectionActions("discrete", 5, 2, None)
    assert one.rows(3, mask) == [3]
    assert one.rows(2, mask) == one.rows(5, mask) == []
    assert one.masks(mask).tolist() == [1, 1, 0, 1, 0, 1]
    for actions in (flags, scores, one):
        want = [3] if actions is one else [1, 3] if actions is flags else [3, 1]
        assert actions.rows(actions.action([3, 1]), mask) == want
    for actions, bad in (
        (flags, np.full(5, 2)),
        (flags, np.zeros(4)),
        (scores, np.full(6, np.nan)),
        (one, 6),
        (one, 1.5),
    ):
        with pytest.raises(ActionError):
            actions.rows(bad, mask)


def test_chosen_agents_are_the_ones_that_the_policy_is_told_to_guide(scenes):
    env = AdversarySelectionEnv(scenes=scenes, budget=2, **QUICK)
    _, info = env.reset(seed=1)
    ids = env.scene.agent_ids
    action = np.zeros(16, np.int8)
    action[:2] = 1
    *_, after = env.step(action)
    assert after["adversaries"] == list(info["agent_ids"][:2])
    plan = env.worlds.native.explain(0)
    assert plan["made_at"] == 0
    guided = {ids[i] for i, on in zip(plan["agents"], plan["guided"], strict=True) if on}
    assert guided <= set(after["adversaries"])
    assert env.worlds.native.status(0).elapsed_steps == 5
    assert after["steps"] == 5.0


def test_images_show_adversaries_in_their_colour(scenes):
    drawing = {"size": (200, 200), "trails": False, "labels": False, "span_m": 200.0}
    env = AdversarySelectionEnv(
        scenes=scenes, render_mode="rgb_array", render_options=drawing, **QUICK
    )
    colour = render.legend()["adversary"]
    for name, shown in (("none", False), ("nearest", True)):
        env.reset(seed=1)
        env.step(env.baseline(name))
        assert (env.render() == colour).all(axis=-1).any() == shown


#: Rewards of collisions alone.
NO_COSTS = {"realism": 0.0, "off_road": 0.0, "comfort": 0.0}


def drive_into_everything(scenes, **options):
    """Episodes of an ego that goes straight on, all agents near being adversaries."""
    env = AdversarySelectionEnv(
        scenes=scenes,
        ego=lambda obs: np.tile(np.array([0.5, 0.0], np.float32), (len(obs), 1)),
        max_agents=16,
        budget=16,
        on_off_road="ignore",
        terminate_at_goal=False,
        ccdiff={"denoising_steps": 1},
        **options,
    )
    for scene in scenes:
        env.reset(seed=0, options={"scene": scene.name})
        recorder = ccdiff_env.Recorder(env)
        recorder.start()
        done, trace = False, []
        while not done:
            _, reward, terminated, truncated, info = env.step(np.ones(16, np.int8))
            trace.append((reward, info))
            done = terminated or truncated
        yield env, trace


def test_collisions_count_once_and_the_egos_fault_can_be_left_out(scenes):
    both = {}
    for ego_fault in (True, False):
        reward = {"collision": 2.0, "ego_fault": ego_fault, **NO_COSTS}
        counts = []
        for env, trace in drive_into_everything(scenes, reward=reward):
            total = sum(info["collisions"] for _, info in trace)
            hits = sum(info["ego_collision"] for _, info in trace)
            counts.append((total, sum(info["ego_at_fault"] for _, info in trace)))
            assert sum(r for r, _ in trace) == pytest.approx(2.0 * total)
            last = trace[-1][1]
            assert last["metrics"]["collisions"] == total
            assert last["is_success"] == float(total > 0)
            assert total <= hits
            pairs = [pair for _, info in trace for pair in info["collision_pairs"]]
            assert len(pairs) == total
            assert all("ego" in pair for pair in pairs)
            assert env.worlds.native.slot_agents(0) == [0]
        both[ego_fault] = counts
    assert sum(total for total, _ in both[True]) > 0
    for (all_of_them, at_fault), (some, _) in zip(both[True], both[False], strict=True):
        assert some == (0 if at_fault else all_of_them)


def test_collisions_that_no_plan_avoids_can_be_left_out(scenes):
    reward = {"collision": 1.0, "avoidable_only": True, **NO_COSTS}
    kept = left = 0.0
    for _, trace in drive_into_everything(scenes, reward=reward):
        for value, info in trace:
            assert value == pytest.approx(info["collisions"])
            assert info["collisions"] == len(info["collision_pairs"])
            kept, left = kept + info["collisions"], left + info["unavoidable"]
    every = [t for _, t in drive_into_everything(scenes, reward={"off_road": 0.0})]
    assert kept + left == sum(info["collisions"] for trace in every for _, info in trace)
    assert kept > 0


def test_reward_components_add_up(scenes):
    env = AdversarySelectionEnv(scenes=scenes, budget=4, **PLAIN)
    env.reset(seed=0)
    done = False
    while not done:
        _, reward, terminated, truncated, info = env.step(env.baseline("ttc"))
        names = ("collision", "realism", "off_road", "comfort")
        assert reward == pytest.approx(sum(info[f"reward_{name}"] for name in names))
        assert info["num_adversaries"] == len(info["adversaries"]) <= 4
        assert 0 <= info["off_road"] <= 1
        assert 0 <= info["discomfort"] <= 3
        done = terminated or truncated
    with pytest.raises(ResetNeededError):
        env.step(env.baseline("none"))


def test_baselines_choose_what_their_names_say(scenes):
    env = AdversarySelectionEnv(scenes=scenes, budget=2, action_mode="scores", **PLAIN)
    obs, _ = env.reset(seed=2)
    mask = obs["mask"] > 0
    rows = {name: env._batch.actions.rows(env.baseline(name), mask) for name in BASELINES}
    assert rows["nearest"] == [0, 1][: mask.sum()]
    soonest = np.lexsort((np.arange(mask.sum()), -obs["ttc"][0, 1:][mask]))
    if obs["ttc"][0, 1:][mask][soonest[0]] > obs["ttc"][0, 1:][mask][soonest[1]]:
        assert rows["ttc"][0] == soonest[0]
    assert (env.baseline("random", 1) != env.baseline("random", 2)).any()
    with pytest.raises(ConfigError, match="causal"):
        env.baseline("crystal ball")


def test_forks_foresee_what_each_choice_leads_to_and_change_nothing(scenes):
    options = {"scenes": scenes[:2], "ego": "replay", "action_mode": "discrete", "max_agents": 3}
    env = AdversarySelectionVectorEnv(2, **options, **QUICK)
    env.reset(seed=0, options={"scene": [0, 1]})
    native = env.worlds.native
    before = [native.snapshot(e) for e in range(2)]
    steps = env.worlds.config.ccdiff.replan_steps
    gaps = env.fork_gaps(steps)
    assert [native.snapshot(e) for e in range(2)] == before
    assert (np.isfinite(gaps) == env.action_masks()[:, :-1]).all()
    # what a choice leads to when it is made: the least distance over the steps of the decision
    chosen = gaps.argmin(axis=1)
    agents = [env._batch.episode(e).rows(3)[row] for e, row in enumerate(chosen)]
    egos = [env._batch.episode(e).ego for e in range(2)]
    seen = []

    def look():
        states = [native.states(e)["position"] for e in range(2)]
        seen.append([np.linalg.norm(states[e][egos[e]] - states[e][agents[e]]) for e in range(2)])

    env._batch.on_step = look
    env.step(chosen)
    assert len(seen) == steps
    assert np.allclose(np.min(seen, axis=0), gaps.min(axis=1))


@pytest.mark.parametrize("rules", [PLAIN, QUICK], ids=["one step", "two steps"])
def test_worlds_of_the_vector_form_run_as_single_ones(scenes, rules):
    def same(seen, rows):
        return all((seen[key] == row).all() for key, row in rows.items())

    options = {"scenes": scenes, "ego": "constant_velocity", "max_agents": 6, **rules}
    many = AdversarySelectionVectorEnv(3, **options)
    alone = [AdversarySelectionEnv(**options) for _ in range(3)]
    obs, infos = many.reset(seed=7)
    for i, env in enumerate(alone):
        seen, said = env.reset(seed=7 + i)
        assert said["scene"] == infos["scene"][i]
        assert same(seen, {key: obs[key][i] for key in obs})
    many.action_space.seed(0)
    ends = 0
    for _ in range(14):
        actions = many.action_space.sample()
        masks = many.action_masks()
        obs, rewards, terminated, truncated, infos = many.step(actions)
        for i, env in enumerate(alone):
            assert (env.action_masks() == masks[i]).all()
            seen, reward, dead, cut, said = env.step(actions[i])
            assert rewards[i] == pytest.approx(reward, abs=1e-4)
            assert (terminated[i], truncated[i]) == (dead, cut)
            if dead or cut:
                ends += 1
                final = infos["final_info"]
                assert same(seen, infos["final_obs"][i])
                assert final["metrics"]["decisions"][i] == said["metrics"]["decisions"]
                assert final["collisions"][i] == said["collisions"]
                seen, _ = env.reset()
            assert same(seen, {key: obs[key][i] for key in obs})
    assert ends > 2


def test_learners_of_sb3_and_sb3_contrib_train(scenes):
    options = {"scenes": scenes, "max_agents": 6, **PLAIN}
    env = SelectionSB3VecEnv(AdversarySelectionVectorEnv(4, **options))
    PPO("MultiInputPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0).learn(32)
    for mode in ("multibinary", "discrete"):
        env = SelectionSB3VecEnv(AdversarySelectionVectorEnv(4, action_mode=mode, **options))
        assert is_masking_supported(env)
        env.reset()
        assert get_action_masks(env).shape == (4, 12 if mode == "multibinary" else 7)
        model = MaskablePPO("MultiInputPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0)
        model.learn(32)
        obs = env.reset()
        masks = get_action_masks(env)
        action, _ = model.predict(obs, action_masks=masks)
        if mode == "discrete":
            assert masks[np.arange(4), action].all()
        else:
            assert not (action.astype(bool) & ~masks.reshape(4, 6, 2)[..., 1]).any()


def test_any_planner_drives_the_ego(scenes, tmp_path):
    train = ccdiff_env.make_vec(2, scenes=scenes, autoreset_mode="same_step")
    from ccdiff_env.envs.sb3 import SB3VecEnv

    model = PPO("MlpPolicy", SB3VecEnv(train), n_steps=8, batch_size=8, seed=0)
    model.save(tmp_path / "ego.zip")
    for ego in ("replay", "idm", "ego", model, tmp_path / "ego.zip", str(tmp_path / "ego.zip")):
        env = AdversarySelectionEnv(scenes=scenes, ego=ego, **PLAIN)
        env.reset(seed=0)
        assert np.isfinite(env.step(env.baseline("nearest"))[1])
    driver, act = ego_driver(tmp_path / "ego.zip")
    obs = np.zeros((2, train.worlds.layout.size), np.float32)
    assert driver == "external"
    assert (act(obs) == model.predict(obs, deterministic=True)[0]).all()
    for bad in ("robot", tmp_path / "none.zip"):
        with pytest.raises((ConfigError, FileNotFoundError)):
            ego_driver(bad)
    (tmp_path / "bad.zip").write_bytes(b"no")
    with pytest.raises(ccdiff_env.errors.DatasetError):
        ego_driver(tmp_path / "bad.zip")


def test_a_policy_of_the_package_drives_as_in_worlds_made_for_it(scenes):
    policy = ccdiff_env.policies.load("ego")
    selection = AdversarySelectionEnv(scenes=scenes, ego="ego", **QUICK)
    alone = ccdiff_env.make_vec(1, scenes=scenes, traffic="ccdiff", **QUICK, **policy.env_options)
    selection.reset(seed=3, options={"scene": scenes[0].name})
    obs, _ = alone.reset(seed=3, options={"scene": scenes[0].name})
    for _ in range(5):  # 3 steps each
        obs, *_ = alone.step(policy.act(obs))
    for _ in range(3):  # 5 steps each
        selection.step(selection.baseline("none"))
    found = [env.worlds.native.states(0)["position"] for env in (selection, alone)]
    assert np.array_equal(*found)


def test_mistakes_are_named(scenes):
    for options in (
        {"action_mode": "levers"},
        {"budget": 0},
        {"max_agents": 2.0},
        {"max_agents": 10**9},
        {"max_agents": 4, "budget": 9},
        {"action_mode": "scores", "criticality": (0.0, 1e30)},
        {"criticality": (0.0, 1.0)},
        {"action_mode": "scores", "criticality": (1.0, 0.0)},
        {"reward": {"colision": 1.0}},
        {"reward": {"count": "everything"}},
        {"reward": {"collision": float("nan")}},
        {"reward": {"avoidable_only": 1}},
        {"driver": "idm"},
        {"ego": "robot"},
    ):
        with pytest.raises(ConfigError):
            AdversarySelectionEnv(scenes=scenes, **{**PLAIN, **options})
    assert SelectionReward(collision=1.0).count == "ego"


def test_traffic_that_nothing_guides_is_refused(scenes):
    mine = PythonTraffic(lambda batch: np.zeros((len(batch.speed_mps), 10, 2), np.float32))
    for traffic in (
        "replay",
        "idm",
        "constant_velocity",
        "egos",
        {"idm": 0.5, "replay": 0.5},
        mine,
    ):
        for make in (AdversarySelectionEnv, AdversarySelectionVectorEnv):
            with pytest.raises(
                ConfigError, match=r"adversary selection: traffic is .* guided: ccdiff"
            ):
                make(scenes=scenes, traffic=traffic)
    # of the ego alone
    with pytest.raises(ConfigError, match="adversary selection"):
        AdversarySelectionEnv(scenes=scenes, ego="ccdiff", traffic="idm")
    shared = AdversarySelectionEnv(scenes=scenes, traffic={"idm": 0.5, "ccdiff": 0.5})
    assert shared.worlds.config.ccdiff.criticality == 1.0


def test_who_is_chosen_is_guided_or_refused(scenes):
    unguided = AdversarySelectionEnv(scenes=scenes, config=WorldConfig(traffic="ccdiff"))
    unguided.reset(seed=0)
    with pytest.raises(ConfigError, match=r"ccdiff\.criticality is 0"):
        unguided.step(unguided.baseline("nearest"))
    assert unguided.worlds.native.status(0).elapsed_steps == 0
    assert unguided.step(unguided.baseline("none"))[4]["num_adversaries"] == 0
    slow = {"traffic": {"a": 1.0}, "policies": {"a": CcdiffConfig(replan_steps=9, criticality=1.0)}}
    env = AdversarySelectionEnv(scenes=scenes, **slow)
    env.reset(seed=0)
    assert env.step(env.baseline("nearest"))[4]["steps"] == 9
