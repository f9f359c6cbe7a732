"""Networks for learners of stable-baselines3 that treat agents as a set."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from sb3_contrib import MaskablePPO

from ccdiff_env import AdversarySelectionVectorEnv, EgoVectorEnv
from ccdiff_env.envs.sb3 import SB3VecEnv, SelectionSB3VecEnv
from ccdiff_env.envs.selection_policy import CandidatePolicy

QUICK = {"ccdiff": {"denoising_steps": 2}, "horizon_steps": 40}


@pytest.fixture
def worlds(scenes):
    env = EgoVectorEnv(2, scenes=scenes)
    yield env
    env.close()


def test_torch_has_one_thread_unless_told_otherwise(worlds):
    before = torch.get_num_threads()
    try:
        for threads, found in ((3, 3), (None, 3), (1, 1)):
            SB3VecEnv(worlds, torch_threads=threads)
            assert torch.get_num_threads() == found
        torch.set_num_threads(3)
        SB3VecEnv(worlds)
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(before)


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
