"""Roles: rewards of adversaries and the end of an episode, against the formula in numpy."""

from __future__ import annotations

import numpy as np
import pytest

from ccdiff_env import AgentVectorEnv, embedded_scenes
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError
from ccdiff_env.worlds import Worlds


def expected(own, columns, played, adversary, names, shaping):
    """Rewards [E, C]: of adversaries minus the mean of the egos', plus their own costs."""
    egos, others = played & ~adversary, played & adversary
    num_egos = np.maximum(egos.sum(axis=-1, keepdims=True), 1)
    against = np.where(egos, own, 0.0).sum(axis=-1, keepdims=True) / num_egos
    cost = [names.index("reward_off_road"), names.index("reward_comfort")]
    shaped = columns[..., cost].sum(axis=-1) * np.float32(shaping)
    return np.where(others, shaped - against, own).astype(np.float32)


def own_rewards(columns, names):
    """Sum of the components of each slot, in their order."""
    parts = [i for i, name in enumerate(names) if name.startswith("reward_")]
    total = np.zeros(columns.shape[:2], np.float32)
    for i in parts:
        total += columns[..., i]
    return total


@pytest.mark.parametrize("shaping", [0.0, 0.7])
@pytest.mark.parametrize("threads", [1, 2])
def test_adversaries_are_paid_what_the_egos_lose(scenes, shaping, threads):
    env = AgentVectorEnv(
        9,
        scenes=scenes,
        agents=6,
        adversaries=2,
        adversary_shaping=shaping,
        traffic="idm",
        num_threads=threads,
        horizon_steps=40,
    )
    _, infos = env.reset(seed=3)
    names = env.worlds.column_names
    shape = (env.num_worlds, env.num_slots)
    role = np.array(infos["role"]).reshape(shape)
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(90):
        played = env.active_masks().reshape(shape)
        adversary = role == "adversary"
        actions = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        actions[adversary.ravel()] *= 0.05  # they outlast the egos
        _, rewards, terminated, truncated, infos = env.step(actions)
        out = env.worlds.last
        own = own_rewards(out.columns, names)
        want = expected(own, out.columns, played, adversary, names, shaping)
        assert np.array_equal(rewards.reshape(shape), want)
        # an episode without an ego is over at once
        over = (terminated | truncated).reshape(shape)
        left = played & ~over
        alone = (left & adversary).any(axis=1) & ~(left & ~adversary).any(axis=1)
        assert not alone.any()
        egos_end = (played & ~adversary).any(axis=1) & ~(left & ~adversary).any(axis=1)
        assert out.done[egos_end].all()
        cut = truncated.reshape(shape) & played & (out.columns[..., names.index("time_limit")] == 0)
        assert not (cut & ~adversary).any()
        ends += cut.sum()
        for e in np.flatnonzero(out.done):
            role[e] = np.array(infos["role"]).reshape(shape)[e]
    assert ends > 0


def test_a_game_that_is_over_stays_over_in_a_copy_of_its_state(scenes):
    ids = list(scenes[0].agent_ids)
    vehicles = [i for i, kind in zip(ids, scenes[0].agent_types, strict=True) if kind == "vehicle"]
    config = WorldConfig(
        controlled=tuple(vehicles[:2]),
        num_slots=2,
        adversaries={scenes[0].name: (vehicles[1],)},
        autoreset="disabled",
        traffic="idm",
    )
    worlds = [Worlds(scenes[:1], config, num_worlds=1) for _ in range(2)]
    outs = [one.arrays() for one in worlds]
    for one, out in zip(worlds, outs, strict=True):
        one.native.reset([1], [0], None, out)
    hard = np.array([[[1.0, 1.0], [0.0, 0.0]]], np.float32)
    for t in range(100):
        worlds[0].native.step(hard, outs[0])
        if t == 2:  # the copy knows who plays which part
            worlds[1].native.restore(0, worlds[0].native.snapshot(0))
        elif t > 2:
            worlds[1].native.step(hard, outs[1])
            for name in ("reward", "truncated", "terminated", "done", "alive"):
                assert np.array_equal(getattr(outs[0], name), getattr(outs[1], name))
        if outs[0].done[0]:
            break
    assert outs[0].terminated[0].tolist() == [True, False]
    assert outs[0].truncated[0].tolist() == [False, True]
    assert not outs[0].alive.any()


def test_wrong_roles_are_named():
    with pytest.raises(ConfigError, match="adversaries"):
        WorldConfig().with_options(adversaries="others")
    with pytest.raises(ConfigError, match="adversary_shaping"):
        Worlds(
            embedded_scenes("val")[:1], WorldConfig(adversary_shaping=float(2**30)), num_worlds=1
        )
