"""Criticality of each episode: fixed, drawn by its seed, by the progress of training."""

import copy
import pickle

import numpy as np
import pytest

from ccdiff_env import AgentVectorEnv, EgoEnv, embedded_scenes, make_vec, parallel_env
from ccdiff_env.envs.sb3 import SB3VecEnv
from ccdiff_env.errors import ConfigError, ShapeError
from ccdiff_env.worlds.curriculum import Curriculum, SceneWeights

QUICK = {
    "traffic": "ccdiff",
    "ccdiff": {"denoising_steps": 2},
    "horizon_steps": 6,
    "terminate_at_goal": False,
}


NUM_SCENES = 2


def growing(progress):
    return (0.0, progress)


def test_episodes_draw_from_the_range_by_seed_and_number():
    curriculum = Curriculum((0.5, 1.5))
    drawn = [curriculum.draw(seed, episode) for seed in range(20) for episode in range(5)]
    assert drawn == [Curriculum((0.5, 1.5)).draw(s, e) for s in range(20) for e in range(5)]
    assert len(set(drawn)) == 100
    assert 0.5 <= min(drawn) < 0.6
    assert 1.4 < max(drawn) <= 1.5
    assert Curriculum(0.7).draw(1, 2) == 0.7


def test_every_environment_says_and_sets_it(scenes):
    single = EgoEnv(scenes=scenes, criticality=(0.0, 1.0), **QUICK)
    _, info = single.reset(seed=3)
    assert info["criticality"] == Curriculum((0.0, 1.0)).draw(3, 0)
    many = make_vec(2, scenes=scenes, criticality=(0.0, 1.0), autoreset_mode="same_step", **QUICK)
    _, infos = many.reset(seed=3)
    assert infos["criticality"].tolist() == [Curriculum((0.0, 1.0)).draw(3 + i, 0) for i in (0, 1)]
    for _ in range(6):
        *_, infos = many.step(np.zeros((2, 2), np.float32))
    assert infos["criticality"][0] == Curriculum((0.0, 1.0)).draw(3, 1)
    game = parallel_env(scenes=scenes, agents=2, criticality=0.5, **QUICK)
    assert game.reset(seed=0)[1]["ego"]["criticality"] == 0.5
    rows = AgentVectorEnv(2, scenes=scenes, agents=2, criticality=0.5, **QUICK)
    assert (rows.reset(seed=0)[1]["criticality"] == 0.5).all()


def test_learners_and_copies_carry_the_progress(scenes):
    env = SB3VecEnv(
        make_vec(2, scenes=scenes, criticality=growing, autoreset_mode="same_step", **QUICK)
    )
    env.reset()
    assert [info["criticality"] for info in env.reset_infos] == [0.0, 0.0]
    env.env_method("set_progress", 1.0)
    env.reset()
    assert min(info["criticality"] for info in env.reset_infos) > 0.0
    single = EgoEnv(scenes=scenes, criticality=growing, **QUICK)
    single.reset(seed=1)
    single.set_progress(0.5)
    for other in (copy.deepcopy(single), pickle.loads(pickle.dumps(single))):
        assert other.worlds.curriculum.progress == 0.5
        assert other.reset(seed=9)[1]["criticality"] == single.reset(seed=9)[1]["criticality"] > 0


def test_mistakes_are_named(scenes):
    for bad in (
        -1.0,
        (1.0, 0.0),
        [0.0, 1.0, 2.0],
        "high",
        None,
        float("nan"),
        lambda p: (0.0, float("inf")),
        50.0,
        (0.0, 1e30),
    ):
        with pytest.raises(ConfigError):
            Curriculum(bad)
    with pytest.raises(ConfigError, match="criticality"):
        EgoEnv(scenes=scenes).set_progress(0.5)
    with pytest.raises(ConfigError, match="0 to 1"):
        EgoEnv(scenes=scenes, criticality=1.0, **QUICK).set_progress(2.0)
    with pytest.raises(ConfigError, match="expected a function of the progress of training"):
        EgoEnv(scenes=scenes, criticality=lambda: 1.0, **QUICK)


def test_shares_of_the_episodes_have_their_strengths():
    curriculum = Curriculum({0.0: 3.0, (0.5, 1.0): 1.0})
    drawn = np.array([curriculum.draw(seed, 0) for seed in range(4000)])
    assert np.mean(drawn == 0.0) == pytest.approx(0.75, abs=0.03)
    rest = drawn[drawn > 0.0]
    assert 0.5 <= rest.min() < 0.51
    assert 0.99 < rest.max() <= 1.0
    for bad in ({}, {0.0: -1.0, 1.0: 2.0}, {0.0: 0.0}, {-1.0: 1.0}, {"a": 1.0}, {1.0: "x"}):
        with pytest.raises(ConfigError, match="criticality"):
            Curriculum(bad)


@pytest.mark.parametrize("num_threads", [1, 2])
def test_scenes_are_drawn_by_their_weights_in_the_same_order_for_any_threads(num_threads):
    scenes = embedded_scenes("val")[:4]
    many = make_vec(
        8, scenes=scenes, horizon_steps=2, autoreset_mode="same_step", num_threads=num_threads
    )
    many.set_scene_weights([0.0, 1.0, 0.0, 3.0])
    _, infos = many.reset(seed=5)
    counts = np.bincount(infos["scene_idx"], minlength=4)
    drawn = [infos["scene_idx"].tolist()]
    for _ in range(200):
        *_, infos = many.step(np.zeros((8, 2), np.float32))
        if "scene_idx" in infos:
            begun = infos["scene_idx"][infos["_scene_idx"]]
            counts += np.bincount(begun, minlength=4)
            drawn.append(begun.tolist())
    assert counts[0] == counts[2] == 0
    assert counts[3] / counts.sum() == pytest.approx(0.75, abs=0.06)
    again = make_vec(8, scenes=scenes, horizon_steps=2)
    again.set_scene_weights(np.array([0.0, 1.0, 0.0, 3.0]))
    assert again.reset(seed=5)[1]["scene_idx"].tolist() == drawn[0]
    again.set_scene_weights(None)
    never = make_vec(8, scenes=scenes, horizon_steps=2)
    assert (again.reset(seed=5)[1]["scene_idx"] == never.reset(seed=5)[1]["scene_idx"]).all()


def test_weights_that_mean_nothing_are_refused():
    scenes = embedded_scenes("val")[:2]
    many = make_vec(1, scenes=scenes)
    for bad in ([1.0, -1.0], [0.0, 0.0], [np.nan, 1.0], [np.inf, 1.0], ["a", 1.0]):
        with pytest.raises(ConfigError, match="scene weights"):
            many.set_scene_weights(bad)
    for bad in ([1.0], np.ones((2, 1)), 1.0):
        with pytest.raises(ShapeError, match="scene weights"):
            many.set_scene_weights(bad)
    in_order = EgoEnv(scenes=scenes, scene_order="sequential")
    with pytest.raises(ConfigError, match="scene_order"):
        in_order.unwrapped.set_scene_weights([1.0, 1.0])


def test_failures_weigh_more_and_no_scene_is_forgotten():
    failures = SceneWeights(3, rate=0.5, least=0.1)
    failures.update([0, 0, 0, 0, 1], [False] * 4 + [True])
    assert failures.weights.tolist() == [0.1, 1.0, 1.0]
    failures.update(np.array([0]), np.array([True]))
    assert failures.weights[0] == 0.5 + 0.5 * 0.0625
    for scenes, failed in (([3], [True]), ([-1], [True]), ([0, 1], [True]), ([[0]], [[True]])):
        with pytest.raises(ShapeError, match="episode"):
            failures.update(scenes, failed)
    for bad in ({"num_scenes": 0}, {"rate": 0.0}, {"least": 1.5}):
        with pytest.raises(ConfigError, match="num_scenes, rate and least"):
            SceneWeights(**{"num_scenes": 2, **bad})
