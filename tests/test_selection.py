"""Choice of adversaries: rows against numpy, rewards, vector form, learners, policy files."""

from __future__ import annotations

import json

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import ccdiff_env
from ccdiff_env import AdversarySelectionEnv, AdversarySelectionVectorEnv
from ccdiff_env.bench import selection
from ccdiff_env.envs.sb3 import SelectionSB3VecEnv
from ccdiff_env.envs.selection import FEATURES, fork_actions, rule_actions
from ccdiff_env.envs.selection.sb3_policy import CandidatePolicy, save_policy
from ccdiff_env.errors import (
    ActionError,
    CheckpointError,
    ConfigError,
    DatasetNotFoundError,
    ResetNeededError,
    ShapeError,
)
from ccdiff_env.policies.planners import ego_driver
from ccdiff_env.system.tensors import read_tensors, write_tensors
from ccdiff_env.view import render

ID = "ccdiff_env/AdversarySelection-v0"
QUICK = {"ccdiff": {"replan_steps": 5}, "horizon_steps": 40}


def column(obs, name):
    return obs[..., FEATURES.index(name)]


def test_gymnasiums_and_sb3s_checkers_pass(scenes):
    env = gymnasium.make(ID, scenes=scenes, **QUICK)
    check_env(env.unwrapped, skip_render_check=True)
    sb3_check_env(AdversarySelectionEnv(scenes=scenes, **QUICK), warn=False)


def test_rows_are_the_nearest_moving_vehicles_in_the_egos_frame(scenes):
    env = AdversarySelectionVectorEnv(len(scenes), scenes=scenes, max_candidates=4, **QUICK)
    obs, _ = env.reset(seed=3)
    seen = 0
    for decision in range(3):
        for e in range(len(scenes)):
            states, scene = env.worlds.native.states(e), env.worlds.scenes[e]
            scene = env.worlds.scenes[env.worlds.native.status(e).scene_idx]
            at, heading = states["position"], float(states["heading"][0])
            turn = np.array(
                [[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]]
            )
            reach = np.array(
                [
                    np.ptp(p[v], axis=0).max() if v.any() else 0.0
                    for p, v in zip(
                        scene.tracks()["position"], scene.tracks()["valid"], strict=True
                    )
                ]
            )
            there = [
                i
                for i, kind in enumerate(scene.agent_types)
                if kind == "vehicle" and states["active"][i] and i != 0 and reach[i] > 1.5
            ]
            gaps = {i: float(np.hypot(*(at[i] - at[0]))) for i in there}
            nearest = sorted(gaps, key=gaps.__getitem__)[:4]
            assert env.candidates[e] == nearest
            assert (column(obs[e], "present") == (np.arange(4) < len(nearest))).all()
            assert (obs[e, len(nearest) :, : FEATURES.index("ego_speed")] == 0.0).all()
            route = np.asarray(env.worlds.native.route(e, 0)[0])
            lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])
            fine = np.linspace(0.0, lengths[-1], 4000)
            line = np.stack([np.interp(fine, lengths, route[:, k]) for k in (0, 1)], axis=1)
            start = fine[np.hypot(*(line - at[0]).T).argmin()]
            times = np.arange(9) * 0.5
            places = start + max(float(states["speed"][0]), 0.0) * times
            ego = np.stack([np.interp(places, lengths, route[:, k]) for k in (0, 1)], axis=1)
            for row, i in enumerate(nearest):
                seen += 1
                local = turn @ (at[i] - at[0])
                assert column(obs[e, row], "x") == pytest.approx(
                    np.clip(local[0] / 50, -3, 3), abs=1e-5
                )
                assert column(obs[e, row], "y") == pytest.approx(
                    np.clip(local[1] / 50, -3, 3), abs=1e-5
                )
                closing = turn @ (states["velocity"][i] - states["velocity"][0])
                assert column(obs[e, row], "velocity_x") == pytest.approx(closing[0] / 15, abs=1e-5)
                assert column(obs[e, row], "distance") == pytest.approx(
                    min(gaps[i], 50) / 50, abs=1e-5
                )
                own = at[i] + times[:, None] * states["velocity"][i]
                approach = np.hypot(*(own - ego).T).min()
                assert 30 * column(obs[e, row], "approach") == pytest.approx(
                    min(approach, 30), abs=0.15
                )
        obs, *_ = env.step(rule_actions(env, "nearest"))
        plan = env.worlds.explain(0)
        if env.candidates[0] and plan is not None and decision < 2:
            row = {int(agent): k for k, agent in enumerate(plan.agents)}
            was = [bool(plan.guided[row[i]]) if i in row else False for i in env.candidates[0]]
            shown = column(obs[0], "was_guided")[: len(was)] > 0.5
            assert env.worlds.native.status(0).elapsed_steps == 0 or shown.tolist() == was
    assert seen > 20
    assert env.observation_space.contains(obs)


def test_an_action_guides_its_vehicle_at_its_strength_and_the_last_one_nobody(scenes):
    env = AdversarySelectionEnv(scenes=scenes, **QUICK)
    shifts = {}
    for strength in range(3):
        found = []
        for seed in range(4):
            _, info = env.reset(seed=seed)
            *_, after = env.step(strength)
            assert after["adversary"] == info["agent_ids"][0]
            assert (after["guided"], after["steps"]) == (1.0, 5.0)
            plan = env.worlds.explain(0)
            guided = [env.scene.agent_ids[i] for i in plan.agents[plan.guided]]
            assert guided == [after["adversary"]]
            assert after["reward_shift"] == pytest.approx(-0.03 * after["shift_sigmas"])
            found.append(after["shift_sigmas"])
        shifts[strength] = np.mean(found)
    assert 0.0 < shifts[0] < shifts[1] < shifts[2]
    masks = env.action_masks()
    for action in (int(env.action_space.n) - 1, *np.flatnonzero(~masks)[:1]):
        env.reset(seed=0)
        _, reward, *_, after = env.step(action)
        assert (reward, after["adversary"], after["guided"]) == (0.0, None, 0.0)


def test_images_show_the_adversary_in_its_colour(scenes):
    drawing = {"size": (200, 200), "trails": False, "labels": False, "span_m": 200.0}
    env = AdversarySelectionEnv(
        scenes=scenes, render_mode="rgb_array", render_options=drawing, **QUICK
    )
    colour = render.legend()["adversary"]
    for action, shown in ((int(env.action_space.n) - 1, False), (0, True)):
        env.reset(seed=1)
        env.step(action)
        assert (env.render() == colour).all(axis=-1).any() == shown


def attacked(scenes, **options):
    """Last infos of episodes in which an ego that does not look meets the strongest guidance."""
    env = AdversarySelectionVectorEnv(
        len(scenes), scenes=scenes, ego="constant_velocity", on_off_road="ignore",
        terminate_at_goal=False, strengths=(8.0,), **options, **QUICK,
    )  # fmt: skip
    env.reset(seed=0, options={"scene": list(range(len(scenes)))})
    found: list = [None] * len(scenes)
    rewards = np.zeros(len(scenes))
    while not all(found):
        _, reward, terminated, truncated, infos = env.step(rule_actions(env, "approach"))
        rewards += np.where([row is None for row in found], reward, 0.0)
        for e in np.flatnonzero(terminated | truncated):
            if found[e] is None:
                metrics = infos["final_info"]["metrics"]
                found[e] = {name: metrics[name][e] for name in metrics if name[0] != "_"}
    return found, rewards


def test_rewards_are_collisions_less_the_cost_of_shift_and_count_as_asked(scenes):
    every, rewards = attacked(scenes, reward={"collision": 2.0, "shift_cost": 0.1})
    for row, reward in zip(every, rewards, strict=True):
        total = 2.0 * row["collisions"] - 0.1 * row["mean_shift_sigmas"] * row["decisions"]
        assert reward == pytest.approx(total, abs=1e-5)
        assert row["is_success"] == (row["collisions"] > 0)
    hits = [row["collisions"] for row in every]
    assert sum(hits) > 0
    for counts in ("ego_at_fault", "avoidable"):
        some, _ = attacked(scenes, reward={"counts": counts})
        assert all(row["collisions"] <= hit for row, hit in zip(some, hits, strict=True))
        if counts == "ego_at_fault":
            expected = [h * row["ego_at_fault"] for h, row in zip(hits, every, strict=True)]
            assert [row["collisions"] for row in some] == expected


def test_worlds_of_the_vector_form_run_as_single_ones(scenes):
    options = {"scenes": scenes, "ego": "constant_velocity", "max_candidates": 6, **QUICK}
    many = AdversarySelectionVectorEnv(3, **options)
    alone = [AdversarySelectionEnv(**options) for _ in range(3)]
    obs, infos = many.reset(seed=7)
    for i, env in enumerate(alone):
        seen, said = env.reset(seed=7 + i)
        assert said["scene"] == infos["scene"][i]
        assert (seen == obs[i]).all()
    many.action_space.seed(0)
    ends = 0
    for _ in range(14):
        actions, masks = many.action_space.sample(), many.action_masks()
        obs, rewards, terminated, truncated, infos = many.step(actions)
        for i, env in enumerate(alone):
            assert (env.action_masks() == masks[i]).all()
            seen, reward, dead, cut, said = env.step(actions[i])
            assert rewards[i] == pytest.approx(reward, abs=1e-6)
            assert (terminated[i], truncated[i]) == (dead, cut)
            if dead or cut:
                ends += 1
                final = infos["final_info"]
                assert (seen == infos["final_obs"][i]).all()
                assert final["metrics"]["decisions"][i] == said["metrics"]["decisions"]
                with pytest.raises(ResetNeededError):
                    env.step(0)
                seen, _ = env.reset()
            assert (seen == obs[i]).all()
    assert ends > 2


def test_rules_choose_what_their_names_say(scenes):
    env = AdversarySelectionVectorEnv(6, scenes=scenes, **QUICK)
    obs, _ = env.reset(seed=2)
    there, nobody = column(obs, "present") > 0.5, env.single_action_space.n - 1
    some = there.any(axis=1)
    rows = {n: rule_actions(env, n, strength=1) for n in ("nearest", "ttc", "approach")}
    for name, found in rows.items():
        assert (found[~some] == nobody).all()
        assert (found[some] % 3 == 1).all(), name
    assert (rows["nearest"][some] // 3 == 0).all()
    gaps = np.where(there, column(obs, "approach"), np.inf)
    assert (rows["approach"][some] // 3 == gaps[some].argmin(axis=1)).all()
    soonest = np.where(there, column(obs, "ttc"), -1.0)
    assert (rows["ttc"][some] // 3 == soonest[some].argmax(axis=1)).all()
    gated = rule_actions(env, "approach", gate_m=6.0)
    assert ((gated != nobody) == (some & (30 * gaps.min(axis=1) <= 6.0))).all()
    assert (rule_actions(env, "none") == nobody).all()
    draws = [rule_actions(env, "random", seed=seed) for seed in (1, 1, 2)]
    assert (draws[0] == draws[1]).all()
    assert (draws[0] != draws[2]).any()
    with pytest.raises(ConfigError, match="nearest"):
        rule_actions(env, "crystal ball")


def test_forks_choose_the_weakest_that_makes_contact_and_change_nothing(scenes):
    options = {"scenes": scenes, "ego": "constant_velocity", "max_candidates": 3}
    env = AdversarySelectionVectorEnv(
        len(scenes), strengths=(0.1, 6.0), **options, ccdiff={"replan_steps": 20}
    )
    env.reset(seed=0, options={"scene": list(range(len(scenes)))})
    hits = 0
    for _ in range(3):
        before = [env.worlds.native.snapshot(e) for e in range(len(scenes))]
        found = fork_actions(env, 20)
        assert [env.worlds.native.snapshot(e) for e in range(len(scenes))] == before
        table, *_ = env.decide(env.chosen(found))
        chose = found != env.single_action_space.n - 1
        # a fork that made contact is what happens where it is chosen
        assert (table["collisions"][chose] == 1.0).all()
        hits += chose.sum()
        if env._ended.all():
            break
    assert hits > 0


def test_a_learned_policy_drives_traffic_as_it_chose_in_torch(scenes, tmp_path):
    torch.manual_seed(0)
    env = SelectionSB3VecEnv(AdversarySelectionVectorEnv(4, scenes=scenes, **QUICK))
    assert is_masking_supported(env)
    PPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0).learn(32)
    model = MaskablePPO(CandidatePolicy, env, n_steps=8, batch_size=16, n_epochs=1, seed=0)
    model.learn(64)
    obs = env.reset()
    action, _ = model.predict(obs, action_masks=get_action_masks(env))
    assert get_action_masks(env)[np.arange(4), action].all()
    path = tmp_path / "policy.safetensors"
    save_policy(model, path, env.env.strengths)

    def in_torch(env):
        masks = env.action_masks()
        actions, _ = model.predict(env.observation(), action_masks=masks, deterministic=True)
        return env.chosen(actions)

    choices = (
        selection.Choice("torch", "", in_torch, strengths=(1.0, 2.0, 4.0)),
        selection.learned("native", path),
    )
    played = [selection.play(scenes, choice) for choice in choices]
    assert played[0] == played[1]
    assert any(row["mean_shift_sigmas"] > 0.0 for row in played[0])


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda t, h: t.pop("row.0.bias"), "row.0.bias"),
        (lambda t, h: t.update({"somebody.weight": t["somebody.weight"][:1]}), "somebody"),
        (lambda t, h: h.update(features=["x"]), "features"),
        (lambda t, h: h.update(strengths=[-1.0]), "strengths"),
        (lambda t, h: h.update(max_candidates=10**9), "strengths"),
        (lambda t, h: h.update(kind="ccdiff"), "kind"),
    ],
)
def test_damaged_policy_files_are_refused(scenes, tmp_path, change, named):
    env = SelectionSB3VecEnv(AdversarySelectionVectorEnv(1, scenes=scenes, **QUICK))
    path = tmp_path / "policy.safetensors"
    save_policy(MaskablePPO(CandidatePolicy, env, seed=0), path, (1.0, 2.0, 4.0))
    tensors, metadata = read_tensors(path)
    header = json.loads(metadata["ccdiff_env"])
    change(tensors, header)
    write_tensors(path, tensors, {"ccdiff_env": json.dumps(header)})
    with pytest.raises(CheckpointError, match=named):
        ccdiff_env.EgoEnv(traffic="ccdiff", ccdiff={"adversary_policy": str(path)})
    with pytest.raises(DatasetNotFoundError, match="none"):
        ccdiff_env.EgoEnv(traffic="ccdiff", ccdiff={"adversary_policy": "none.safetensors"})


def test_shares_at_an_equal_shift_lie_on_the_line_between_points():
    def rows(shift, hits):
        return [
            {"scene": f"s{i}", "seed": 0, "mean_shift_sigmas": shift, "is_success": hit}
            for i, hit in enumerate(hits)
        ]

    line = [rows(0.0, [0, 0]), rows(2.0, [1, 0]), rows(1.0, [0, 1])]
    assert selection.at_shift(line, 1.25).tolist() == [0.25, 0.75]
    assert selection.at_shift(line, 2.5) is None


def test_any_planner_drives_the_ego(scenes, tmp_path):
    train = ccdiff_env.make_vec(2, scenes=scenes, autoreset_mode="same_step")
    from ccdiff_env.envs.sb3 import SB3VecEnv

    model = PPO("MlpPolicy", SB3VecEnv(train), n_steps=8, batch_size=8, seed=0)
    model.save(tmp_path / "ego.zip")
    for ego in ("replay", "idm", "ego", model, tmp_path / "ego.zip", str(tmp_path / "ego.zip")):
        env = AdversarySelectionEnv(scenes=scenes, ego=ego, **QUICK)
        env.reset(seed=0)
        assert np.isfinite(env.step(0)[1])
    driver, act = ego_driver(tmp_path / "ego.zip")
    obs = np.zeros((2, train.worlds.layout.size), np.float32)
    assert driver == "external"
    assert (act(obs) == model.predict(obs, deterministic=True)[0]).all()
    with pytest.raises(ConfigError, match="forks"):
        fork_actions(AdversarySelectionVectorEnv(1, scenes=scenes, ego="ego", **QUICK), 5)


def test_mistakes_are_named(scenes):
    for options in (
        {"max_candidates": 0},
        {"max_candidates": 2.0},
        {"strengths": ()},
        {"strengths": (0.0,)},
        {"strengths": (1e9,)},
        {"reward": {"colision": 1.0}},
        {"reward": {"counts": "everything"}},
        {"reward": {"collision": float("nan")}},
        {"reward": {"shift_cost": -1.0}},
        {"driver": "idm"},
        {"ego": "robot"},
        {"traffic": "replay"},
        {"traffic": "idm"},
    ):
        with pytest.raises(ConfigError):
            AdversarySelectionEnv(scenes=scenes, **options)
    env = AdversarySelectionVectorEnv(2, scenes=scenes, **QUICK)
    with pytest.raises(ResetNeededError):
        env.step(np.zeros(2, np.int64))
    env.reset(seed=0)
    for actions in ([0], [[0, 0]]):
        with pytest.raises(ShapeError):
            env.step(actions)
    for actions in ([0, env.single_action_space.n], [-1, 0], [0.0, 1.0]):
        with pytest.raises(ActionError):
            env.step(actions)
    tokens = AdversarySelectionVectorEnv(1, scenes=scenes, traffic="tokens")
    tokens.reset(seed=0)
    with pytest.raises(ConfigError, match="denoises"):
        tokens.step([0])
