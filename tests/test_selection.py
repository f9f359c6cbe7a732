"""Choice of adversaries: rows against numpy, rewards, vector form, learners, policy files."""

from __future__ import annotations

import copy
import json
import pickle

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
from ccdiff_env.envs.sb3 import SB3VecEnv, SelectionSB3VecEnv
from ccdiff_env.envs.selection import FEATURES, fork_actions, rule_actions
from ccdiff_env.envs.selection.sb3_policy import CandidatePolicy, save_policy
from ccdiff_env.envs.selection.vector import SCALES
from ccdiff_env.errors import (
    ActionError,
    CheckpointError,
    ConfigError,
    DatasetNotFoundError,
    ResetNeededError,
    ShapeError,
)
from ccdiff_env.system.tensors import read_tensors, write_tensors
from ccdiff_env.view import render

ID = "ccdiff_env/AdversarySelection-v0"
QUICK = {"ccdiff": {"replan_steps": 5}, "horizon_steps": 40}


def column(obs, name):
    """A feature in its unit."""
    return obs[..., FEATURES.index(name)] * SCALES[FEATURES.index(name)]


def test_gymnasiums_and_sb3s_checkers_pass(scenes):
    check_env(gymnasium.make(ID, scenes=scenes, **QUICK).unwrapped, skip_render_check=True)
    sb3_check_env(AdversarySelectionEnv(scenes=scenes, **QUICK), warn=False)


def test_rows_are_the_nearest_moving_vehicles_in_the_egos_frame(scenes):
    env = AdversarySelectionVectorEnv(len(scenes), scenes=scenes, max_candidates=4, **QUICK)
    obs, _ = env.reset(seed=3)
    assert env.observation_space.contains(obs)
    for e, row in enumerate(obs):
        native = env.worlds.native
        states, scene = native.states(e), env.worlds.scenes[native.status(e).scene_idx]
        at, velocity, angle = states["position"], states["velocity"], float(states["heading"][0])
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        logs = zip(scene.tracks()["position"], scene.tracks()["valid"], strict=True)
        moves = [bool(v.any()) and np.ptp(p[v], axis=0).max() > 1.5 for p, v in logs]
        cars = [kind == "vehicle" for kind in scene.agent_types]
        there = np.flatnonzero(states["active"] & moves & cars)
        gaps = {int(i): float(np.hypot(*(at[i] - at[0]))) for i in there if i}
        nearest = sorted(gaps, key=gaps.__getitem__)[:4]
        assert env.candidates[e] == nearest
        assert (column(row, "present") == (np.arange(4) < len(nearest))).all()
        assert (row[len(nearest) :, : FEATURES.index("ego_speed")] == 0.0).all()
        route = np.asarray(native.route(e, 0)[0])
        lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])
        fine = np.linspace(0.0, lengths[-1], 4000)

        def along(places, route=route, lengths=lengths):
            return np.stack([np.interp(places, lengths, route[:, k]) for k in (0, 1)], axis=1)

        start = fine[np.hypot(*(along(fine) - at[0]).T).argmin()]
        times, ahead = np.arange(9) * 0.5, start + 4.0 * np.arange(11)
        ego = along(start + max(float(states["speed"][0]), 0.0) * times)
        for seen, i in zip(row, nearest, strict=False):
            closing = turn @ (velocity[i] - velocity[0])
            assert column(seen, "velocity_x") == pytest.approx(closing[0], abs=1e-4)
            assert column(seen, "velocity_y") == pytest.approx(closing[1], abs=1e-4)
            assert column(seen, "distance") == pytest.approx(min(gaps[i], 50.0), abs=1e-4)
            heading = float(states["heading"][i]) - angle
            assert column(seen, "sin_heading") == pytest.approx(np.sin(heading), abs=1e-5)
            approach = np.hypot(*(at[i] + times[:, None] * velocity[i] - ego).T).min()
            assert column(seen, "approach") == pytest.approx(min(approach, 30.0), abs=0.15)
            from_route = np.hypot(*(along(ahead) - at[i]).T).min()
            assert column(seen, "route_distance") == pytest.approx(min(from_route, 20.0), abs=0.15)


def test_an_action_guides_its_vehicle_at_its_strength_and_the_last_one_nobody(scenes):
    drawing = {"size": (200, 200), "trails": False, "labels": False, "span_m": 200.0}
    env = AdversarySelectionEnv(
        scenes=scenes, render_mode="rgb_array", render_options=drawing, **QUICK
    )

    def shows_an_adversary():
        return (env.render() == render.legend()["adversary"]).all(axis=-1).any()

    shifts = []
    for strength in range(3):
        found = []
        for seed in range(4):
            _, info = env.reset(seed=seed)
            _, reward, *_, after = env.step(strength)
            assert after["adversary"] == info["agent_ids"][0]
            assert (after["guided"], after["steps"]) == (1.0, 5.0)
            plan = env.worlds.explain(0)
            guided = [env.scene.agent_ids[i] for i in plan.agents[plan.guided]]
            assert guided == [after["adversary"]]
            expected = after["collisions"] - 0.03 * after["shift_sigmas"]
            assert reward == pytest.approx(expected, abs=1e-6)
            found.append(after["shift_sigmas"])
            assert shows_an_adversary()
        shifts.append(np.mean(found))
    assert 0.0 < shifts[0] < shifts[1] < shifts[2]
    for action in (int(env.action_space.n) - 1, *np.flatnonzero(~env.action_masks())[:1]):
        env.reset(seed=0)
        _, reward, *_, after = env.step(action)
        assert (reward, after["adversary"], after["guided"]) == (0.0, None, 0.0)
        assert not shows_an_adversary()
    two = AdversarySelectionVectorEnv(1, scenes=scenes, num_adversaries=2, **QUICK)
    obs, _ = two.reset(seed=0)
    row = two.candidates[0]
    two.step([3])
    plan = two.worlds.explain(0)
    nearest = np.argsort(column(obs[0], "approach")[: len(row)], kind="stable").tolist()
    nearest.remove(1)
    assert set(plan.agents[plan.guided]) == {row[1], row[nearest[0]]}


def test_collisions_count_as_asked(scenes):
    """An ego that does not look meets the strongest guidance."""
    blind = {"ego": "constant_velocity", "on_off_road": "ignore", "terminate_at_goal": False}
    strong = selection.Choice(
        "", "", lambda env: env.chosen(rule_actions(env, "approach")), {"strengths": (8.0,)}
    )
    found = {
        counts: selection.play(scenes, strong, counts=counts, **blind, **QUICK)
        for counts in ("all", "ego_at_fault", "avoidable")
    }
    hits, at_fault = (np.array(found["all"][name]) for name in ("collisions", "ego_at_fault"))
    assert hits.sum() > 0
    assert found["ego_at_fault"]["collisions"] == (hits * at_fault).tolist()
    assert (np.array(found["avoidable"]["collisions"]) <= hits).all()


def test_worlds_of_the_vector_form_and_copies_run_as_single_ones(scenes):
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
    for decision in range(14):
        if decision == 5:
            many, alone = pickle.loads(pickle.dumps(many)), copy.deepcopy(alone)
        actions, masks = many.action_space.sample(), many.action_masks()
        obs, rewards, terminated, truncated, infos = many.step(actions)
        for i, env in enumerate(alone):
            assert (env.action_masks() == masks[i]).all()
            seen, reward, dead, cut, said = env.step(actions[i])
            assert rewards[i] == reward
            assert (terminated[i], truncated[i]) == (dead, cut)
            if dead or cut:
                ends += 1
                assert (seen == infos["final_obs"][i]).all()
                metrics = infos["final_info"]["metrics"]
                assert said["metrics"] == {name: metrics[name][i] for name in said["metrics"]}
                with pytest.raises(ResetNeededError):
                    env.step(0)
                seen, _ = env.reset()
            else:
                assert infos["shift_sigmas"][i] == said["shift_sigmas"]
            assert (seen == obs[i]).all()
    assert ends > 2


def test_rules_choose_what_their_names_say(scenes):
    env = AdversarySelectionVectorEnv(6, scenes=scenes, **QUICK)
    obs, _ = env.reset(seed=2)
    there = column(obs, "present") > 0.5
    some = there.any(axis=1)
    rows = {n: rule_actions(env, n, strength=1) for n in ("nearest", "ttc", "approach")}
    for name, found in rows.items():
        assert (found[~some] == env.nobody).all()
        assert (found[some] % 3 == 1).all(), name
    assert (rows["nearest"][some] // 3 == 0).all()
    gaps = np.where(there, column(obs, "approach"), np.inf)
    assert (rows["approach"][some] // 3 == gaps[some].argmin(axis=1)).all()
    soonest = np.where(there, column(obs, "ttc"), -1.0)
    assert (rows["ttc"][some] // 3 == soonest[some].argmax(axis=1)).all()
    gate = rule_actions(env, "approach", gate_m=6.0)
    assert ((gate != env.nobody) == (some & (gaps.min(axis=1) <= 6.0))).all()
    assert (rule_actions(env, "none") == env.nobody).all()
    draws = [rule_actions(env, "random", seed=seed).tolist() for seed in (1, 1, 2)]
    assert draws[0] == draws[1] != draws[2]
    with pytest.raises(ConfigError, match="nearest"):
        rule_actions(env, "crystal ball")


def test_forks_choose_the_weakest_that_makes_contact_and_change_nothing(scenes):
    env = AdversarySelectionVectorEnv(
        len(scenes), scenes=scenes, ego="constant_velocity", max_candidates=3, strengths=(0.1, 6.0)
    )
    env.reset(seed=0, options={"scene": list(range(len(scenes)))})
    hits = 0
    while not env.ended.all():
        before = [env.ego.snapshot(e) for e in range(len(scenes))]
        found = fork_actions(env, 1)
        assert [env.ego.snapshot(e) for e in range(len(scenes))] == before
        chose = (found != env.nobody) & ~env.ended
        _, table = env.decide(env.chosen(found))
        # a fork that made contact is what happens where it is chosen
        assert (table["collisions"][chose] == 1.0).all()
        hits += chose.sum()
    assert hits > 0


def test_a_learned_policy_drives_traffic_as_it_chose_in_torch(scenes, tmp_path):
    torch.manual_seed(0)
    env = SelectionSB3VecEnv(AdversarySelectionVectorEnv(4, scenes=scenes, **QUICK))
    assert is_masking_supported(env)
    PPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0).learn(32)
    model = MaskablePPO(CandidatePolicy, env, n_steps=8, batch_size=16, n_epochs=1, seed=0)
    model.learn(64)
    action, _ = model.predict(env.reset(), action_masks=get_action_masks(env))
    assert get_action_masks(env)[np.arange(4), action].all()
    model.save(tmp_path / "policy.zip")
    model = MaskablePPO.load(tmp_path / "policy.zip")
    save_policy(model, tmp_path / "policy.safetensors", env.env.strengths)

    def in_torch(env):
        masks = env.action_masks()
        return env.chosen(
            model.predict(env.observation(), action_masks=masks, deterministic=True)[0]
        )

    native = selection.traffics("", "", adversary_policy=str(tmp_path / "policy.safetensors"))
    played = [selection.play(scenes, one) for one in (selection.Choice("", "", in_torch), native)]
    assert played[0] == played[1]
    assert sum(played[0]["mean_shift_sigmas"]) > 0.0


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda t, h: t.pop("row.0.bias"), "row.0.bias"),
        (lambda t, h: t.update({"head.2.weight": t["head.2.weight"][:1]}), "head.2.weight"),
        (lambda t, h: t.update({"more": t["row.0.bias"]}), "more"),
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


def test_shares_at_an_equal_shift_lie_on_the_line_between_points(monkeypatch, scenes):
    def figures(shift, *hits):
        return {"mean_shift_sigmas": [shift] * len(hits), "is_success": list(hits)}

    line = [figures(0.0, 0, 0), figures(2.0, 1, 0), figures(1.0, 0, 1)]
    assert selection.at_shift(line, 1.25).tolist() == [0.25, 0.75]
    assert selection.at_shift(line, 2.5) is None
    # 7 m at 2 lies below the line from 5 m at 4 to 30 m at 4; the others follow no order
    found = {"4 within 5 m": (1.0, 0.3), "2 within 7 m": (1.5, 0.3), "4 within 30 m": (3.0, 0.4)}
    monkeypatch.setattr(
        selection, "play", lambda _, choice, **__: figures(*found.get(choice.point, (9.0, 0.0)))
    )
    assert [choice.point for choice in selection.gated(scenes)] == [
        "4 within 5 m", "4 within 30 m"
    ]  # fmt: skip


def test_models_and_paths_drive_the_ego_too(scenes, tmp_path):
    train = ccdiff_env.make_vec(2, scenes=scenes, autoreset_mode="same_step")
    model = PPO("MlpPolicy", SB3VecEnv(train), n_steps=8, batch_size=8, seed=0)
    model.save(tmp_path / "ego.zip")
    found = []
    for ego in (model, tmp_path / "ego.zip", str(tmp_path / "ego.zip")):
        env = AdversarySelectionEnv(scenes=scenes, ego=ego, **QUICK)
        env.reset(seed=0)
        found.append(env.step(0)[0].tolist())
    assert found[0] == found[1] == found[2]


def test_mistakes_are_named(scenes):
    for options in (
        {"max_candidates": 0},
        {"max_candidates": 2.0},
        {"num_adversaries": 0},
        {"strengths": ()},
        {"strengths": (1e9,)},
        {"counts": "everything"},
        {"shift_cost": float("nan")},
        {"driver": "idm"},
        {"controlled": "any"},
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
