"""Hidden differences of egos, and styles of their rewards."""

import json

import numpy as np
import pytest
from array_scenes import GOES_ON, rebuilt
from episode_play import actions, played

from ccdiff_env import EgoEnv, EgoVectorEnv, Recorder, replay
from ccdiff_env.errors import ConfigError

ALL = {"acceleration_gain": 0.3, "yaw_gain": 0.2, "delay_steps": 3, "size": 0.2, "noise": 0.02}
STYLE = {"progress": (0.5, 2.0), "comfort": (0.0, 4.0)}


NUM_SCENES = 4


def drawn(env: EgoEnv, seed: int) -> dict:
    env.reset(seed=seed)
    return env.worlds.native.drawn(0)[0]


def test_draws_are_even_and_each_on_its_own(scenes):
    env = EgoEnv(scenes=scenes, randomization=ALL)
    found = [drawn(env, seed) for seed in range(600)]
    assert found[:20] == [drawn(env, seed) for seed in range(20)]
    for name, spread in (("acceleration_gain", 0.3), ("yaw_gain", 0.2), ("size", 0.2)):
        values = np.array([one[name] for one in found])
        assert abs(values - 1).max() <= spread * (1 + 1e-6)
        assert abs(values.mean() - 1) < 5 * spread / np.sqrt(3 * 600)
        assert abs(values.std() - spread / np.sqrt(3)) < 0.1 * spread
        alone = EgoEnv(scenes=scenes, randomization={name: spread})
        assert [drawn(alone, seed)[name] for seed in range(9)] == [one[name] for one in found[:9]]
    counts = np.bincount([one["delay_steps"] for one in found])
    assert len(counts) == 4
    assert abs(counts - 150).max() < 5 * np.sqrt(600 * 0.25 * 0.75)
    # episodes of one seed differ, too
    env.reset(seed=3)
    first = env.worlds.native.drawn(0)
    env.reset()
    assert env.worlds.native.drawn(0) != first


@pytest.mark.parametrize("decision_steps", [1, 3])
def test_the_unicycle_drives_with_its_gains_and_delay(decision_steps, scenes):
    env = EgoEnv(
        scenes=scenes,
        randomization={"acceleration_gain": 0.3, "yaw_gain": 0.2, "delay_steps": 4},
        decision_steps=decision_steps,
        **GOES_ON,
    )
    plain = EgoEnv(scenes=scenes, **GOES_ON)
    for seed in range(12):
        given, chosen = drawn(env, seed), actions(20)
        plain.reset(seed=seed)
        held = np.repeat(chosen, decision_steps, axis=0)
        late = np.concatenate([np.zeros((given["delay_steps"], 2)), held])[: len(held)]
        for action in chosen:
            env.step(action)
        for action in late * [given["acceleration_gain"], given["yaw_gain"]]:
            plain.step(action)
        ours, theirs = (one.worlds.native.states(0) for one in (env, plain))
        for name in ("position", "heading", "speed"):
            assert np.allclose(ours[name], theirs[name], atol=1e-3)


def test_the_drawn_size_is_that_of_the_box(scenes):
    env = EgoEnv(scenes=scenes, randomization={"size": 0.9}, traffic="idm", **GOES_ON)
    for seed in range(12):
        factor, scene = drawn(env, seed)["size"], env.scene
        recorder, sizes = Recorder(env), scene.sizes
        sizes[0, :2] *= factor
        other = EgoEnv(scenes=[rebuilt(scene, sizes=sizes)], traffic="idm", **GOES_ON)
        other.reset(seed=seed)
        env.step(actions(1)[0])
        other.step(actions(1)[0])
        recorder.step()
        assert np.allclose(recorder.rollout().scene.sizes[0], sizes[0], rtol=1e-6)
        for one, two in zip(played(env, actions(60)), played(other, actions(60)), strict=True):
            assert np.allclose(one, two, atol=1e-4)


def test_noise_is_normal_on_numbers_with_a_unit_alone(scenes):
    noisy = EgoEnv(scenes=scenes, randomization={"noise": 0.02}, traffic="idm")
    plain = EgoEnv(scenes=scenes, traffic="idm")
    schema = json.loads(plain.worlds.native.layout_json)["entries"]
    units = {e["name"]: [bool(c["unit"]) for c in e["columns"]] for e in schema}
    assert plain.worlds.layout == noisy.worlds.layout
    added = []
    for seed in range(10):
        rows = []
        for env in (noisy, noisy, plain):
            env.reset(seed=seed)
            rows.append(np.stack(played(env, actions(30))[::4]))
        assert np.array_equal(rows[0], rows[1])
        for entry in plain.worlds.layout.entries:
            here = slice(entry.offset, entry.offset + entry.size)
            got, true = (r[:, here].reshape(-1, *entry.shape) for r in rows[1:])
            present = (true != 0).any(-1, keepdims=True)
            moves = np.broadcast_to(present & np.array(units[entry.name] or False), true.shape)
            assert np.array_equal(got[~moves], true[~moves])
            low, high = entry.bounds()
            assert ((got >= low) & (got <= high)).all()
            inside = moves & (true > low + 0.1) & (true < high - 0.1)
            added.append((got - true)[inside])
    noise = np.concatenate(added)
    assert len(noise) > 15_000
    assert abs(noise.mean()) < 5 * 0.02 / np.sqrt(len(noise))
    assert abs(noise.std() / 0.02 - 1) < 0.01
    assert abs((abs(noise) < 0.02).mean() - 0.6827) < 0.01


def test_rewards_are_those_of_the_weights_times_the_factors(scenes):
    styled, plain = (
        EgoEnv(scenes=scenes, traffic="idm", style=style, **GOES_ON) for style in (STYLE, {})
    )
    entry = styled.worlds.layout.entries[-1]
    assert (entry.name, entry.shape) == ("style", (2,))
    assert (entry.columns, entry.low, entry.high) == (tuple(STYLE), (0.5, 0.0), (2.0, 4.0))
    seen = []
    for seed in range(30):
        (obs, _), (known, _) = styled.reset(seed=seed), plain.reset(seed=seed)
        factors = styled.worlds.native.drawn(0)[0]["style"]
        seen.append([factors["progress"], factors["comfort"]])
        for action in actions(20):
            assert np.array_equal(obs, [*known, *np.float32(seen[-1])])
            assert styled.observation_space.contains(obs)
            (obs, reward, *_, info), (known, _, *_, true) = styled.step(action), plain.step(action)
            terms = {n: v for n, v in true.items() if n.startswith("reward_")}
            for name, term in terms.items():
                terms[name] = term * factors.get(name.removeprefix("reward_"), 1.0)
                assert np.isclose(info[name], terms[name], rtol=1e-5)
            assert np.isclose(reward, sum(terms.values()), rtol=1e-5, atol=1e-6)
    seen = np.array(seen)
    assert (seen.min(0) < [0.8, 0.8]).all()
    assert (seen.max(0) > [1.7, 3.2]).all()


def test_a_reset_sets_the_style_for_its_episode(scenes, tmp_path):
    env = EgoEnv(scenes=scenes, style=STYLE)
    usual = drawn(env, 4)["style"]
    obs, _ = env.reset(seed=4, options={"style": {"comfort": 3.5}})
    factors = env.worlds.native.drawn(0)[0]["style"]
    assert factors == {"progress": usual["progress"], "comfort": 3.5}
    assert obs[-1] == 3.5
    played(env, actions(40))
    certificate = env.certificate()
    assert certificate.style == factors
    certificate.save(tmp_path / "styled.json")
    assert replay(tmp_path / "styled.json", scenes).env.certificate() is not None

    batch = EgoVectorEnv(2, scenes=scenes, style=STYLE)
    obs, _ = batch.reset(seed=4, options={"style": {"progress": 1.25}})
    assert obs[:, -2].tolist() == [1.25, 1.25]
    obs, _ = batch.reset(seed=4, options={"style": [{"progress": 0.75}, None]})
    assert obs[0, -2] == 0.75
    before = [batch.worlds.native.digest(i) for i in range(2)]
    for style, words in (
        ({"progress": 2.5}, "progress: 2.5, expected 0.5 to 2"),
        ({"progress": float("nan")}, "expected a number"),
        ({"progress": "fast"}, "expected a number"),
        ({"goal": 1.0}, "goal, expected some of the configuration's style: comfort, progress"),
        (2.0, "values by name"),
    ):
        with pytest.raises(ConfigError, match=words):
            batch.reset(options={"style": style})
    assert [batch.worlds.native.digest(i) for i in range(2)] == before


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"randomization": {"size": 1.0}}, "randomization.size"),
        ({"randomization": {"noise": -0.1}}, "randomization.noise"),
        ({"randomization": {"nois": 0.1}}, "did you mean"),
        ({"randomization": {"delay_steps": 1}, "dynamics": "delta_pose"}, "actions that are poses"),
        ({"style": {"speed": (0.0, 1.0)}}, "style is speed, expected weights that are not 0"),
        ({"style": {"jerk": (0.0, 1.0)}}, "style is jerk"),
        ({"style": {"comfort": (0.0, 1.0)}, "reward": "product"}, "style is comfort"),
        ({"style": {"goal": (2.0, 1.0)}}, "style.goal"),
        ({"style": {"goal": (-1.0, 1.0)}}, r"style.goal is \[-1.0,1.0\]"),
        ({"style": {"goal": 1.0}}, "lowest and highest"),
    ],
    ids=str,
)
def test_what_does_not_fit_is_refused(options, words, scenes):
    with pytest.raises(ConfigError, match=words):
        EgoEnv(scenes=scenes, **options)
