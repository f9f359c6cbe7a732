"""Banks of recorded critical traffic."""

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import record_bank
from ccdiff_env.bench.planners import Traffic, drive
from ccdiff_env.errors import ConfigError, DatasetNotFoundError
from ccdiff_env.record.bank import load_bank

NUM_SCENES = 3


@pytest.fixture(scope="module")
def folder(scenes, tmp_path_factory):
    target = tmp_path_factory.mktemp("bank")
    record_bank(scenes, target, ego="idm", criticality=1.0, draws=2, seed=5)
    return target


def test_the_others_do_as_they_did(scenes, folder):
    """Agents of the bank are where they were in the episode that was recorded."""
    bank = load_bank(folder)
    assert len(bank) == 6
    settings = {"criticality": 1.0, "num_samples": 1}
    options = {"terminate_at_goal": False}
    _, rollouts = drive(
        scenes, "idm", Traffic("", "ccdiff", settings), seed=6, options=options, record=scenes.names
    )
    for scene in scenes:
        (recorded,) = [s for s in bank if s.name.startswith(scene.name) and s.name.endswith("-1")]
        rollout, tracks = rollouts[scene.name], recorded.tracks()
        window = slice(rollout.start_step, rollout.start_step + rollout.num_steps)
        for row, agent in enumerate(rollout.agent_ids):
            there = rollout.valid[row]
            if agent == "ego" or not there.any():
                continue
            found = tracks["position"][recorded.agent_ids.index(agent), window]
            np.testing.assert_allclose(found[there], rollout.position[row][there], atol=1e-4)


def test_a_bank_plays_beside_its_logs(scenes, folder):
    both = ccdiff_env.SceneSet([*scenes, *load_bank(folder)])
    env = ccdiff_env.make_vec(9, scenes=both, traffic="replay", scene_order="sequential")
    _, infos = env.reset(seed=0)
    assert set(infos["scene"]) == set(both.names)
    for _ in range(5):
        env.step(np.zeros((9, 2), np.float32))


def test_a_call_that_was_stopped_goes_on(scenes, folder):
    """Pieces that are there stay; those that lack come out as they were."""
    pieces = {path: path.read_bytes() for path in folder.glob("*.scenes")}
    lost, kept = sorted(pieces)
    lost.unlink()
    before = kept.stat().st_mtime_ns
    again = record_bank(scenes, folder, ego="idm", criticality=1.0, draws=2, seed=5)
    assert len(again) == 6
    assert lost.read_bytes() == pieces[lost]
    assert kept.stat().st_mtime_ns == before


def test_other_settings_need_another_folder(scenes, folder, tmp_path):
    with pytest.raises(DatasetNotFoundError, match="no bank"):
        load_bank(tmp_path)
    with pytest.raises(ConfigError, match=r"criticality 1\.0, now 2\.0"):
        record_bank(scenes, folder, ego="idm", criticality=2.0, seed=5)
    with pytest.raises(ConfigError, match="draws"):
        record_bank(scenes, folder, draws=0)


def test_unavoidable_episodes_can_be_left_out(scenes, tmp_path):
    options = {"ego": "idm", "criticality": 2.0, "seed": 1}
    some = record_bank(scenes, tmp_path / "some", avoidable_only=True, **options)
    everything = record_bank(scenes, tmp_path / "all", **options)
    assert len(some) <= len(everything) == 3
