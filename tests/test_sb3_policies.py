"""Networks for learners of stable-baselines3 that treat agents as a set."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO

from ccdiff_env import AdversarySelectionVectorEnv, EgoVectorEnv
from ccdiff_env.envs.sb3 import SB3VecEnv, SelectionSB3VecEnv
from ccdiff_env.envs.sb3_rows import RowsExtractor, rows_policy
from ccdiff_env.envs.selection.sb3_policy import CandidatePolicy
from ccdiff_env.policies.planners import load_sb3

QUICK = {"ccdiff": {"denoising_steps": 2}, "horizon_steps": 40}


@pytest.fixture
def worlds(scenes):
    env = EgoVectorEnv(8, scenes=scenes, autoreset_mode="same_step")
    yield env
    env.close()


def test_features_do_not_depend_on_the_order_of_rows_or_on_absent_ones(worlds):
    obs, _ = worlds.reset(seed=0)
    layout = worlds.worlds.layout
    extractor = RowsExtractor(
        worlds.single_observation_space, **rows_policy(layout)["features_extractor_kwargs"]
    )
    before = extractor(torch.as_tensor(obs))
    assert before.shape == (8, extractor.features_dim)

    rng = np.random.default_rng(0)
    changed = obs.copy()
    places = {entry.name: entry for entry in layout.entries}
    for name in ("agents", "map"):
        rows, mask = places[name], places[f"{name}_mask"]
        table = changed[:, rows.offset : rows.offset + rows.size].reshape(8, *rows.shape)
        there = changed[:, mask.offset : mask.offset + mask.size]
        assert (there == 0).any() or name == "map"
        table[there == 0] = 0.7
        order = rng.permutation(rows.shape[0])
        changed[:, rows.offset : rows.offset + rows.size] = table[:, order].reshape(8, -1)
        changed[:, mask.offset : mask.offset + mask.size] = there[:, order]
    assert not np.array_equal(changed, obs)
    torch.testing.assert_close(extractor(torch.as_tensor(changed)), before)
    # and what is there is seen
    agents = places["agents"]
    changed[:, agents.offset : agents.offset + agents.size] *= 0.5
    assert (extractor(torch.as_tensor(changed)) - before).abs().max() > 1e-3


def test_a_policy_with_these_features_trains_and_drives_from_its_file(worlds, tmp_path):
    env = SB3VecEnv(worlds)
    policy = rows_policy(worlds.worlds.layout)
    model = PPO(
        "MlpPolicy", env, n_steps=16, batch_size=64, n_epochs=1, policy_kwargs=policy, seed=0
    )
    model.learn(128)
    model.save(tmp_path / "ego.zip")
    obs, _ = worlds.reset(seed=1)
    expected, _ = model.predict(obs, deterministic=True)
    np.testing.assert_array_equal(load_sb3(tmp_path / "ego.zip")(obs), expected)


def test_candidates_are_scored_alike_wherever_they_stand(scenes):
    native = AdversarySelectionVectorEnv(4, scenes=scenes, max_candidates=6, **QUICK)
    env = SelectionSB3VecEnv(native)
    model = MaskablePPO(CandidatePolicy, env, n_steps=8, batch_size=16, n_epochs=1, seed=0)
    model.learn(32)
    obs = env.reset()
    masks = np.stack(env.env_method("action_masks"))

    def shares(obs, masks):
        tensors, _ = model.policy.obs_to_tensor(obs)
        found = model.policy.get_distribution(tensors, action_masks=masks)
        return found.distribution.probs.detach().numpy()

    before = shares(obs, masks)
    assert (before[masks == 0] == 0.0).all()
    np.testing.assert_allclose(before.sum(1), 1.0, rtol=1e-5)
    order = np.random.default_rng(0).permutation(6)
    moves = np.append((3 * order[:, None] + np.arange(3)).ravel(), 18)
    after = shares(obs[:, order], masks[:, moves])
    np.testing.assert_allclose(after, before[:, moves], atol=1e-6)
    env.close()
