"""Forks that go another way, the search for a way out, banks of critical traffic."""

import numpy as np
import pytest
from array_scenes import agent, array_scene, begun, wide_road

import ccdiff_env
from ccdiff_env import EgoEnv, embedded_scenes, record_bank
from ccdiff_env.bench.planners import Traffic, drive
from ccdiff_env.errors import ConfigError, DatasetNotFoundError, ResetNeededError
from ccdiff_env.record.bank import load_bank
from ccdiff_env.record.counterfactual import (
    STEADY,
    EgoPlan,
    attribute,
    avoidability,
    branch,
    ego_plans,
    rollout_avoidability,
)

STEPS = 131
NUM_SCENES = 3  #: Of a bank.


def road(others, *, width=20.0):
    """A straight road along +x, an ego at 10 m/s and others that stand at (x, y)."""
    cars = [agent("ego", np.arange(STEPS, dtype=float))]
    cars += [agent(f"a{i}", x, y) for i, (x, y) in enumerate(others)]
    return array_scene(*cars, name="road", layers=wide_road(width / 2))


def straight(obs):
    return np.zeros((len(obs), 2), np.float32)


def started(scene, **options):
    env = begun(scenes=[scene], terminate_at_goal=False, **options)
    return env


def wall(distance_m, width=2.0):
    """A row of parked cars across the road, some way ahead of where the ego starts at 3 s."""
    ys = np.arange(-width / 2 + 1.0, width / 2, 2.0) if width > 2 else [0.0]
    return [(30.0 + distance_m + 4.5, float(y)) for y in ys]


def test_a_parked_car_far_ahead_is_avoided_and_a_wall_too_near_is_not():
    # braking from 10 m/s at 8 m/s² takes 6.25 m and one step of delay
    for distance, possible in ((20.0, True), (9.0, True), (4.5, False), (2.0, False)):
        env = started(road(wall(distance, width=20.0)))
        found = avoidability(env, num_samples=200)
        assert found.avoidable == possible, distance
        assert (found.plan is not None) == possible
        assert found.num_tried == 200 or possible


def test_swerving_is_found_where_braking_does_not_do():
    parked = [(30.0 + 5.0 + 4.5, 1.6)]  # overlaps by 0.4 m; braking takes 6.25 m
    env = started(road(parked))
    narrow = started(road(parked, width=2.5))
    found = avoidability(env, num_samples=400)
    assert found.avoidable
    assert found.plan.offset_m < -0.5
    assert ego_plans(7)[4].acceleration_mps2 == (-8.0, -8.0)
    assert not avoidability(env, num_samples=7).avoidable, "braking alone"
    assert not avoidability(narrow, num_samples=200).avoidable, "off the road"


def test_a_found_plan_is_free_of_collisions_when_driven():
    from ccdiff_env.planners.planning import Steering

    env = started(road(wall(12.0, width=20.0)))
    before = env.snapshot()
    found = avoidability(env)
    assert env.snapshot() == before, "the environment is not changed"
    steering, done, t = Steering(env.worlds), False, 0
    while not done:
        states = env.worlds.native.states(0)
        a = found.plan.acceleration_mps2[int(t * 0.1 >= found.plan.switch_s)]
        action = steering.action(0, states, 0, a, found.plan.offset_m)
        *_, terminated, truncated, info = env.step(action)
        assert not info["collision"]
        done, t = terminated or truncated, t + 1
    assert t == 100


def test_steady_plans_end_and_the_ego_drives_on():
    # 6 m/s² over 2.1 s stop 10 m/s after 8 m; 4 m/s² leave 1.6 m/s, which reach the wall later
    for distance, possible in ((20.0, True), (2.0, False)):
        env = started(road(wall(distance, width=20.0)), traffic="idm")
        found = avoidability(env, reactive=True, ego=straight)
        assert (found.avoidable, found.held, found.unchanged) == (possible, float(possible), 0.0)
        assert found.plan == (EgoPlan((-6, -6), 0.0, 0) if possible else None)
        assert found.num_safe == (3 if possible else 0), "at the three distances from the route"
        assert found.num_tried == 15
    careful = avoidability(started(env.scene, traffic="idm"), reactive=True, ego="idm")
    assert careful.unchanged == 0.0
    far = started(road(wall(40.0, width=20.0)), traffic="idm")
    careful = avoidability(far, reactive=True)
    assert (careful.plan, careful.unchanged) == (EgoPlan((0, 0), 0.0, 0), 1.0), "IDM stops itself"


def test_plans_that_react_are_chosen_in_some_futures_and_tested_in_others():
    from ccdiff_env.planners.planning import Steering

    env = EgoEnv(
        scenes=embedded_scenes("val"),
        traffic="ccdiff",
        ccdiff={"denoising_steps": 1},
        horizon_steps=60,
    )
    drawn = np.random.SeedSequence(5).generate_state(3, np.uint64).tolist()
    verdicts = set()
    for seed in range(6):
        env.reset(seed=seed)
        before = env.snapshot()
        found = avoidability(env, reactive=True, ego=straight, seed=5, num_samples=4)
        assert env.snapshot() == before
        assert found == avoidability(env, reactive=True, ego=straight, seed=5, num_samples=4)

        def safe(plan, future):
            fork = env.fork(seed=future)
            steering, t, done = Steering(fork.worlds), 0, False
            while not done:
                action, states = np.zeros(2, np.float32), fork.worlds.native.states(0)
                if plan is not None and t < 21:
                    action = steering.action(0, states, 0, plan.acceleration_mps2[0], plan.offset_m)
                *_, terminated, truncated, info = fork.step(action)
                if info["collision"] or info["off_road"]:
                    return False
                done, t = terminated or truncated, t + 1
            return True

        good = [all(safe(plan, future) for future in (None, drawn[0])) for plan in STEADY[:4]]
        assert found.num_safe == sum(good)
        assert found.unchanged == np.mean([safe(None, future) for future in drawn[1:]])
        if found.avoidable:
            assert found.plan == STEADY[good.index(True)]
            assert found.held == np.mean([safe(found.plan, future) for future in drawn[1:]])
        verdicts.add((found.avoidable, found.unchanged))
    assert len(verdicts) > 1


def test_a_recorded_collision_is_judged_with_the_others_as_recorded():
    env = started(road(wall(30.0, width=20.0)))
    crash = branch(env, ego=straight)
    assert crash.collisions("ego")
    assert rollout_avoidability(crash).avoidable
    assert not rollout_avoidability(crash, before_s=0.3).avoidable
    careful = branch(env, ego="idm")
    assert rollout_avoidability(careful) is None


def test_branches_leave_the_environment_alone_and_differ_by_the_ego_only():
    env = started(road([(30.0, 6.0)]))
    for _ in range(5):
        env.step(np.array([0.5, 0.0], np.float32))
    before = env.snapshot()
    one, other = branch(env, ego=straight, steps=20), branch(env, ego="idm", steps=20)
    log = branch(env, ego="replay", steps=20)
    assert env.snapshot() == before
    assert one.num_steps == other.num_steps == log.num_steps == 21
    assert (one.position[:, 0] == other.position[:, 0]).all()
    assert not (one.position[0] == other.position[0]).all()
    assert (one.position[1:] == other.position[1:]).all()
    want = env.scene.tracks()["position"][0, 35:56]
    assert np.abs(log.position[0, -1] - want[-1]).max() < 0.5, "back on the log"


def test_causes_of_a_collision_are_told_apart():
    scenes = embedded_scenes("val")
    env = begun(scenes=scenes, traffic="ccdiff", ccdiff={"denoising_steps": 2})
    found = attribute(env, ego=straight, steps=30)
    hits = [bool(rollout.collisions("ego")) for rollout in found.rollouts]
    assert hits == [found.collided, found.without_adversaries, found.with_reference]
    assert (found.cause == "none") == (not found.collided)
    assert all(rollout.num_steps <= 31 for rollout in found.rollouts)


def test_mistakes_are_named():
    scene = road(wall(20.0))
    fresh = EgoEnv(scenes=[scene])
    with pytest.raises(ResetNeededError):
        avoidability(fresh)
    with pytest.raises(ResetNeededError):
        branch(fresh, ego="idm")
    with pytest.raises(ConfigError, match="continuous"):
        avoidability(started(scene, discrete=True))
    with pytest.raises(ConfigError, match="external"):
        avoidability(started(scene, driver="idm"))
    with pytest.raises(ConfigError, match="ccdiff"):
        attribute(started(scene), ego="idm")
    with pytest.raises(ConfigError, match="reacts"):
        avoidability(started(scene), reactive=True)
    for wrong in ({"num_samples": -1}, {"seed": 1.5}):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            avoidability(started(scene), **wrong)
    for wrong in ({"draws": 0}, {"ego": "replay"}, {"ego": "nobody"}):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            avoidability(started(scene, traffic="idm"), reactive=True, **wrong)


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
        for row, name in enumerate(rollout.agent_ids):
            there = rollout.valid[row]
            if name == "ego" or not there.any():
                continue
            found = tracks["position"][recorded.agent_ids.index(name), window]
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
    for name, wrong in (
        ("draws", 0), ("draws", 1.5), ("workers", 0), ("seed", 7.5), ("seed", "7"),
        ("criticality", -1.0), ("criticality", float("nan")), ("ego", "nobody"),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=name):
            record_bank(scenes, tmp_path / "new", **{name: wrong})
    assert not (tmp_path / "new").exists()
    given = {"seed": np.int64(5), "criticality": np.float32(1.0)}
    assert len(record_bank(scenes, folder, draws=2, **given)) == 6
