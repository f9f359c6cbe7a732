"""Choice of adversaries: rows against numpy, rewards, vector form, learners, policy files."""

import copy
import json
import pickle

import gymnasium
import numpy as np
import pytest
import torch
from array_scenes import outline
from gymnasium.utils.env_checker import check_env
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import ccdiff_env
from ccdiff_env import AdversarySelectionEnv, AdversarySelectionVectorEnv, errors
from ccdiff_env.bench import selection
from ccdiff_env.bench.selection import rule_actions
from ccdiff_env.envs.sb3 import SelectionSB3VecEnv
from ccdiff_env.envs.selection import FEATURES, SCALES
from ccdiff_env.system.tensors import read_tensors, write_tensors
from ccdiff_env.training.selection_policy import CandidatePolicy, save_policy
from ccdiff_env.view import render

QUICK = {"ccdiff": {"replan_steps": 5}, "horizon_steps": 40}
BLIND = {"ego": "constant_velocity", "on_off_road": "ignore", "terminate_at_goal": False}


@pytest.fixture
def vector(scenes):
    return lambda num=1, **options: AdversarySelectionVectorEnv(
        num, scenes=scenes, **{**QUICK, **options}
    )


def column(obs, name):
    """A feature in its unit."""
    return obs[..., FEATURES.index(name)] * SCALES[FEATURES.index(name)]


def test_gymnasiums_and_sb3s_checkers_pass(scenes):
    made = gymnasium.make("ccdiff_env/AdversarySelection-v0", scenes=scenes, **QUICK)
    check_env(made.unwrapped, skip_render_check=True)
    sb3_check_env(AdversarySelectionEnv(scenes=scenes, **QUICK), warn=False)


def test_rows_are_the_nearest_moving_vehicles_in_the_egos_frame(vector, scenes):
    env = vector(len(scenes), max_candidates=4)
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
        gaps = np.hypot(*(at - at[0]).T)
        there = np.flatnonzero(states["active"] & moves & cars & (np.arange(len(at)) > 0))
        nearest = sorted(there.tolist(), key=gaps.__getitem__)[:4]
        assert env.candidates[e] == nearest
        assert (column(row, "present") == (np.arange(4) < len(nearest))).all()
        assert (row[len(nearest) :, : FEATURES.index("ego_speed")] == 0.0).all()
        route = np.asarray(native.route(e, 0)[0])
        lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])

        def along(places, route=route, lengths=lengths):
            return np.stack([np.interp(places, lengths, route[:, k]) for k in (0, 1)], axis=1)

        fine = np.linspace(0.0, lengths[-1], 4000)
        start = fine[np.hypot(*(along(fine) - at[0]).T).argmin()]
        times, ahead = np.arange(9) * 0.5, start + 4.0 * np.arange(11)
        ego = along(start + max(float(states["speed"][0]), 0.0) * times)
        for seen, i in zip(row, nearest, strict=False):
            closing, heading = turn @ (velocity[i] - velocity[0]), float(states["heading"][i])
            approach = np.hypot(*(at[i] + times[:, None] * velocity[i] - ego).T).min()
            from_route = np.hypot(*(along(ahead) - at[i]).T).min()
            for name, expected, off in (
                ("velocity_x", closing[0], 1e-4),
                ("velocity_y", closing[1], 1e-4),
                ("sin_heading", np.sin(heading - angle), 1e-5),
                ("distance", min(gaps[i], 50.0), 1e-4),
                ("approach", min(approach, 30.0), 0.15),
                ("route_distance", min(from_route, 20.0), 0.15),
            ):
                assert column(seen, name) == pytest.approx(expected, abs=off), name


def test_an_action_guides_its_vehicle_at_its_strength_and_the_last_one_nobody(vector, scenes):
    drawing = {"size": (200, 200), "labels": False, "span_m": 200.0}
    env = AdversarySelectionEnv(
        scenes=scenes, render_mode="rgb_array", render_options=drawing, **QUICK
    )

    def played(action, seed):
        """Reward, info and whether the image shows an adversary."""
        _, info = env.reset(seed=seed)
        _, reward, *_, after = env.step(action)
        shown = (env.render() == render.legend()["adversary"]).all(axis=-1).any()
        return reward, info["agent_ids"], after, shown

    moves_m = np.zeros((3, 4))
    for strength, seed in np.ndindex(3, 4):
        reward, ids, after, shown = played(strength, seed)
        assert (after["adversary"], after["guided"], after["steps"], shown) == (ids[0], 1, 5, True)
        plan = env.worlds.explain(0)
        assert [env.scene.agent_ids[i] for i in plan.agents[plan.guided]] == [ids[0]]
        assert reward == pytest.approx(after["collisions"] - 0.03 * after["moved_m"], abs=1e-6)
        moves_m[strength, seed] = after["moved_m"]
    assert 0.0 < moves_m[0].mean() < moves_m[1].mean() < moves_m[2].mean()
    for action in (int(env.action_space.n) - 1, *np.flatnonzero(~env.action_masks())[:1]):
        reward, _, after, shown = played(action, 0)
        assert (reward, after["adversary"], after["guided"], shown) == (0.0, None, 0.0, False)
    many = vector(num_adversaries=64)
    many.reset(seed=0)
    row = set(many.candidates[0])
    *_, infos = many.step([3])
    plan = many.worlds.explain(0)
    assert set(plan.agents[plan.guided]) == row == many.adversaries[0]
    assert infos["moved_m"][0] == pytest.approx(plan.moved_m[plan.guided].sum())
    two = vector(num_adversaries=2)
    obs, _ = two.reset(seed=0)
    row = two.candidates[0]
    two.step([3])
    plan = two.worlds.explain(0)
    nearest = np.argsort(column(obs[0], "approach")[: len(row)], kind="stable").tolist()
    nearest.remove(1)
    assert set(plan.agents[plan.guided]) == {row[1], row[nearest[0]]}


def test_collisions_count_as_asked(scenes):
    """An ego that does not look meets the strongest guidance."""
    strong = selection.Choice(
        "", "", lambda env: env.chosen(rule_actions(env, "approach")), {"strengths": (8.0,)}
    )
    found = {
        counts: selection.play(scenes, strong, counts=counts, **BLIND, **QUICK)
        for counts in ("all", "ego_at_fault")
    }
    hits, at_fault = (np.array(found["all"][name]) for name in ("collisions", "ego_at_fault"))
    assert hits.sum() > 0
    assert found["ego_at_fault"]["collisions"] == (hits * at_fault).tolist()


def test_whoever_the_traffic_itself_guides_is_an_adversary(scenes):
    """All that its plans have guided; of several, one used to be kept."""
    env = AdversarySelectionVectorEnv(
        len(scenes), scenes=scenes, **BLIND, **selection.traffics("", "", num_guided=None).options
    )
    env.reset(seed=[0] * len(scenes), options={"scene": list(range(len(scenes)))})
    guided = [set() for _ in scenes]
    while not env.ended.all():
        running = np.flatnonzero(~env.ended)
        env.decide([(None, 1.0)] * len(scenes))
        for e in running.tolist():
            plan = env.ego.explain(e)
            guided[e].update(plan.agents[plan.guided].tolist())
    assert env.adversaries == guided
    assert max(map(len, guided)) > 1


def test_a_contact_counts_when_it_begins_whatever_follows_from_it(scenes):
    """Against boxes of shapely, where the ego drives on; and where it ends or is removed."""
    options = {"on_collision": "ignore", "on_traffic_collision": "ignore", **BLIND, **QUICK}
    options |= {"strengths": (8.0,), "num_adversaries": 8, "counts": "ego_at_fault"}
    env = AdversarySelectionEnv(scenes=scenes, **options)
    found, expected = [], []

    def touched():
        states = env.worlds.native.states(0)
        tracks = zip(states["position"], states["heading"], env.scene.sizes, strict=True)
        box = [outline(*at, heading, size) for at, heading, size in tracks]
        return {j for j in np.flatnonzero(states["active"])[1:] if box[j].intersects(box[0])}

    def look():
        at_fault = {j for i, j, *_, fault in env.worlds.native.contacts(0) if i == 0 and fault}
        begun.append((at_fault & touched()) - before[-1])
        before.append(touched())

    env.vector.on_step = look
    for scene in range(len(scenes)):
        env.reset(seed=0, options={"scene": scene})
        before, done = [touched()], False
        while not done:
            begun = []
            _, _, done, _, info = env.step(0)
            found.append((info["collisions"], info["ego_at_fault"]))
            adversaries = env.vector.adversaries[0]
            expected.append((sum(bool(new & adversaries) for new in begun), any(map(bool, begun))))
    assert found == expected
    assert sum(count for count, _ in found) > 0
    ends = {
        how: selection.play(
            scenes,
            selection.Choice("", "", lambda env: env.chosen(rule_actions(env, "approach")), {}),
            **{**options, "on_collision": how, "counts": "all"},
        )["collisions"]
        for how in ("terminate", "remove")
    }
    assert ends["terminate"] == ends["remove"]
    assert sum(ends["remove"]) > 0


def test_worlds_of_the_vector_form_and_copies_run_as_single_ones(scenes):
    options = {"scenes": scenes, "ego": "constant_velocity", "max_candidates": 6, **QUICK}
    many = AdversarySelectionVectorEnv(3, **options)
    alone = [AdversarySelectionEnv(**options) for _ in range(3)]
    obs, infos = many.reset(seed=7)
    begun = [env.reset(seed=7 + i) for i, env in enumerate(alone)]
    assert [info["scene"] for _, info in begun] == infos["scene"].tolist()
    assert (np.stack([seen for seen, _ in begun]) == obs).all()
    many.action_space.seed(0)
    ends = 0
    for decision in range(14):
        if decision == 5:
            many, alone = pickle.loads(pickle.dumps(many)), copy.deepcopy(alone)
        actions, masks = many.action_space.sample(), many.action_masks()
        obs, *results, infos = many.step(actions)
        for i, env in enumerate(alone):
            assert (env.action_masks() == masks[i]).all()
            seen, *result, said = env.step(actions[i])
            assert result == [of[i] for of in results]
            if result[1]:
                ends += 1
                assert (seen == infos["final_obs"][i]).all()
                metrics = infos["final_info"]["metrics"]
                assert said["metrics"] == {name: metrics[name][i] for name in said["metrics"]}
                with pytest.raises(errors.ResetNeededError):
                    env.step(0)
                seen, _ = env.reset()
            else:
                assert infos["moved_m"][i] == said["moved_m"]
            assert (seen == obs[i]).all()
    assert ends > 2


def test_rules_choose_what_their_names_say(vector):
    env = vector(6)
    obs, _ = env.reset(seed=2)
    there = column(obs, "present") > 0.5
    some = there.any(axis=1)
    gaps = np.where(there, column(obs, "approach"), np.inf)
    soonest = np.where(there, column(obs, "ttc"), -1.0)
    rows = {"nearest": np.zeros(6), "ttc": soonest.argmax(1), "approach": gaps.argmin(1)}
    for name, row in rows.items():
        assert (rule_actions(env, name) == np.where(some, 3 * row + 2, env.nobody)).all(), name
    gate = rule_actions(env, "approach", gate_m=6.0)
    assert ((gate != env.nobody) == (some & (gaps.min(axis=1) <= 6.0))).all()
    assert (rule_actions(env, "none") == env.nobody).all()
    draws = [rule_actions(env, "random", seed=seed).tolist() for seed in (1, 1, 2)]
    assert draws[0] == draws[1] != draws[2]
    with pytest.raises(errors.ConfigError, match="nearest"):
        rule_actions(env, "crystal ball")


@pytest.fixture
def policy(vector, tmp_path):
    """A policy after two updates, and its file."""
    torch.manual_seed(0)
    env = SelectionSB3VecEnv(vector(4))
    model = MaskablePPO(CandidatePolicy, env, n_steps=8, batch_size=16, n_epochs=1, seed=0)
    model.learn(64)
    save_policy(model, tmp_path / "policy.safetensors", env.env.strengths)
    return model, tmp_path / "policy.safetensors"


def test_a_learned_policy_drives_traffic_as_it_chose_in_torch(scenes, tmp_path, policy):
    model, path = policy
    env = model.get_env()
    assert is_masking_supported(env)
    masks = get_action_masks(env)
    action, _ = model.predict(env.reset(), action_masks=masks)
    assert masks[np.arange(4), action].all()
    PPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0).learn(32)
    model.save(tmp_path / "policy.zip")
    loaded = selection.learned(MaskablePPO.load(tmp_path / "policy.zip"), "")
    native = selection.traffics("", "", adversary_policy=str(path))
    played = [selection.play(scenes, one) for one in (loaded, native)]
    assert played[0] == played[1]
    assert sum(played[0]["mean_moved_m"]) > 0.0


def test_candidates_are_scored_alike_wherever_they_stand(policy):
    model, _ = policy
    env = model.get_env()
    obs, masks = env.reset(), get_action_masks(env)

    def shares(obs, masks):
        tensors, _ = model.policy.obs_to_tensor(obs)
        found = model.policy.get_distribution(tensors, action_masks=masks)
        return found.distribution.probs.detach().numpy()

    before = shares(obs, masks)
    assert (before[masks == 0] == 0.0).all()
    order = np.random.default_rng(0).permutation(8)
    moves = np.append((3 * order[:, None] + np.arange(3)).ravel(), 24)
    after = shares(obs[:, order], masks[:, moves])
    np.testing.assert_allclose(after, before[:, moves], atol=1e-6)


def test_damaged_policy_files_are_refused(tmp_path, policy):
    for change, named in (
        (lambda t, h: t.pop("row.0.bias"), "row.0.bias"),
        (lambda t, h: t.update({"head.2.weight": t["head.2.weight"][:1]}), "head.2.weight"),
        (lambda t, h: t.update({"more": t["row.0.bias"]}), "more"),
        (lambda t, h: h.update(features=["x"]), "features"),
        (lambda t, h: h.update(strengths=[-1.0]), "strengths"),
        (lambda t, h: h.update(kind="ccdiff"), "kind"),
    ):
        tensors, metadata = read_tensors(policy[1])
        header = json.loads(metadata["ccdiff_env"])
        change(tensors, header)
        path = tmp_path / "damaged.safetensors"
        write_tensors(path, tensors, {"ccdiff_env": json.dumps(header)})
        with pytest.raises(errors.CheckpointError, match=named):
            ccdiff_env.EgoEnv(traffic="ccdiff", ccdiff={"adversary_policy": str(path)})
    with pytest.raises(errors.DatasetNotFoundError, match="none"):
        ccdiff_env.EgoEnv(traffic="ccdiff", ccdiff={"adversary_policy": "none.safetensors"})


def test_shares_at_an_equal_move_lie_on_the_line_between_points(monkeypatch, scenes):
    def figures(moved_m, *hits):
        return {"mean_moved_m": [moved_m] * len(hits), "is_success": list(hits)}

    line = [figures(0.0, 0, 0), figures(2.0, 1, 0), figures(1.0, 0, 1)]
    assert selection.at_move(line, 1.25).tolist() == [0.25, 0.75]
    assert selection.at_move(line, 2.5) is None
    # 7 m at 2 lies below the line from 5 m at 4 to 30 m at 4; the others follow no order
    found = {"4 within 5 m": (1.0, 0.3), "2 within 7 m": (1.5, 0.3), "4 within 30 m": (3.0, 0.4)}
    monkeypatch.setattr(
        selection, "play", lambda _, choice, **__: figures(*found.get(choice.point, (9.0, 0.0)))
    )
    kept = [choice.point for choice in selection.gated(scenes)]
    assert kept == ["4 within 5 m", "4 within 30 m"]


@pytest.mark.parametrize(
    "options",
    [
        {"max_candidates": 0}, {"max_candidates": 2.0}, {"num_adversaries": 0}, {"strengths": ()},
        {"strengths": (1e9,)}, {"counts": "everything"}, {"move_cost": float("nan")},
        {"driver": "idm"}, {"controlled": "any"}, {"ego": "robot"}, {"traffic": "replay"},
        {"traffic": "idm"},
    ],
    ids=str,
)  # fmt: skip
def test_options_that_cannot_be_had_are_refused(scenes, options):
    with pytest.raises(errors.ConfigError):
        AdversarySelectionEnv(scenes=scenes, **options)


def test_actions_that_do_not_fit_are_refused(vector):
    env = vector(2)
    with pytest.raises(errors.ResetNeededError):
        env.step(np.zeros(2, np.int64))
    env.reset(seed=0)
    for actions in ([0], [[0, 0]]):
        with pytest.raises(errors.ShapeError):
            env.step(actions)
    for actions in ([0, env.single_action_space.n], [-1, 0], [0.0, 1.0]):
        with pytest.raises(errors.ActionError):
            env.step(actions)
    tokens = vector(traffic="tokens")
    tokens.reset(seed=0)
    with pytest.raises(errors.ConfigError, match="finished"):
        tokens.step([0])
