"""Whose plans guidance moves, when and where to: collisions, care, conflicts, targets, routes."""

import os
import subprocess
import sys
import traceback
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from traffic_play import Play

import ccdiff_env
from ccdiff_env import embedded_scenes
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.errors import ConfigError, PolicyError, ShapeError, UnknownNameError
from ccdiff_env.models import TrajectoryModel, guidance_preset, shipped_weights


def test_careful_plans_leave_the_road_less(scenes):
    off_road = {}
    for careful in (False, True):
        play, corners = Play(scenes, ccdiff={"careful": careful}), 0
        for _ in range(60):
            play.step()
            for w in range(len(scenes)):
                driven = np.array(play.native.drivers(w)) == "ccdiff"
                corners += int(play.native.off_road(w)[0][driven].sum())
        plan = play.native.explain(0)
        assert not plan["guided"].any()
        assert (plan["moved_m"] is not None and plan["moved_m"].max() > 0.0) == careful
        off_road[careful] = corners
    assert off_road[True] < 0.9 * off_road[False]


def test_careful_changes_nothing_in_guided_worlds(scenes):
    digests = set()
    for careful in (False, True):
        play = Play(scenes[:1], ccdiff={"criticality": 1.0, "careful": careful})
        play.step(12)
        assert play.native.explain(0)["guided"].any()
        digests.add(play.native.digest(0))
    assert len(digests) == 1


@pytest.mark.parametrize("kind", ["rear_end", "cut_in", "crossing", "head_on"])
def test_only_vehicles_that_stand_so_to_the_ego_are_guided(scenes, kind):
    guided, free = 0, 0
    for index in range(len(scenes)):
        play = Play(scenes[index : index + 1], ccdiff={"criticality": 1.0, "conflicts": (kind,)})
        before = play.states()
        play.step()
        plan = play.native.explain(0)
        ego = scenes[index].agent_ids.index("ego")
        apart = np.abs(
            np.degrees(np.angle(np.exp(1j * (before["heading"] - before["heading"][ego]))))
        )
        offset = before["position"] - before["position"][ego]
        left = np.array([-np.sin(before["heading"][ego]), np.cos(before["heading"][ego])])
        same_lane = np.abs(offset @ left) <= 2.0
        expected = {
            "rear_end": (apart < 45.0) & same_lane,
            "cut_in": (apart < 45.0) & ~same_lane,
            "crossing": (apart >= 45.0) & (apart <= 135.0),
            "head_on": apart > 135.0,
        }[kind]
        ranked = expected[plan["ranking"]]
        assert set(plan["agents"][plan["guided"]]) == set(plan["ranking"][ranked][:5])
        guided, free = guided + ranked.sum(), free + (~ranked).sum()
    assert guided > 0
    assert free > 0


def test_guided_plans_that_leave_the_ego_no_way_out_are_dropped(scenes):
    """What a way out is, the tests of Rust have by hand."""
    shares = {}
    for only in (False, True):
        ccdiff = {"criticality": 4.0, "denoising_steps": 1, "avoidable_only": only}
        play, guided = Play(scenes, ccdiff=ccdiff), []
        for _ in range(8):
            play.step(5)
            for w in range(len(scenes)):
                plan = play.native.explain(w)
                guided.append(plan["guided"].any())
                assert guided[-1] or not np.any(plan["moved_m"] or 0.0)
        shares[only] = np.mean(guided)
    assert 0.2 < shares[True] < 0.9
    assert shares[False] == 1.0


def test_guidance_keeps_to_its_time(scenes):
    ccdiff = {"criticality": 1.0, "guided_from_s": 1.0, "guided_until_s": 2.0}
    play, guided = Play(scenes[:1], ccdiff=ccdiff), {}
    for _ in range(30):
        play.step()
        plan = play.native.explain(0)
        guided[plan["made_at"]] = bool(plan["guided"].any())
    assert guided == {at: 10 <= at <= 20 for at in range(0, 30, 5)}


def test_a_named_target_takes_the_place_of_the_ego(scenes):
    scene = scenes[0]
    plain = Play(scenes[:1], ccdiff={"criticality": 1.0})
    ego = Play(scenes[:1], ccdiff={"criticality": 1.0, "targets": ("ego",)})
    other = Play(scenes[:1], ccdiff={"criticality": 1.0, "targets": scene.agent_ids[2:3]})
    for play in (plain, ego, other):
        play.step(12)
    assert ego.native.digest(0) == plain.native.digest(0)
    assert other.native.digest(0) != plain.native.digest(0)
    with pytest.raises(UnknownNameError, match=r"ccdiff.targets: no scene has an agent 'nobody'"):
        Play(scenes[:1], ccdiff={"targets": ("ego", "nobody")})


@pytest.mark.parametrize("steps", [1, 5])
def test_who_is_told_the_route_keeps_to_the_path_of_the_log(scenes, steps):
    def aside_m(follow_route):
        ccdiff = {"follow_route": follow_route, "denoising_steps": steps}
        play, found = Play(scenes, ccdiff=ccdiff), []
        play.step(50)
        for index, scene in enumerate(scenes):
            plan, states, tracks = play.native.explain(index), play.states(index), scene.tracks()
            for agent in plan["agents"][plan["follows_plan"]]:
                logged = tracks["position"][agent][tracks["valid"][agent]]
                place = np.linspace(0, len(logged) - 1, 4 * len(logged))
                path = np.stack(
                    [np.interp(place, np.arange(len(logged)), logged[:, k]) for k in (0, 1)], -1
                )
                distance = np.linalg.norm(path - states["position"][agent], axis=1)
                moves = np.linalg.norm(path[-1] - path[0]) > 5.0
                if states["active"][agent] and moves and distance.argmin() < len(path) - 1:
                    found.append(distance.min())
        assert len(found) > 30
        return np.mean(found)

    assert aside_m(True) < 0.6 * aside_m(False)


def test_routes_are_refused_by_weights_that_know_none(scenes):
    weights = str(shipped_weights())
    with pytest.raises(ConfigError, match=r"follow_route.*without routes"):
        Play(scenes[:1], ccdiff={"follow_route": True, "weights": weights})
    with pytest.raises(ConfigError, match=r"follow_route"):
        Play(scenes[:1], traffic="ctg", ccdiff={"follow_route": True})


def test_guidance_raises_collisions_with_the_ego(scenes):
    def collided(criticality, seed):
        play = Play(scenes, seed=seed, ccdiff={"criticality": criticality})
        touched, column = set(), play.worlds.column_names.index("collision")
        for _ in range(80):
            play.step()
            touched |= set(np.flatnonzero(play.out.columns[:, 0, column]))
        return len(touched)

    calm, critical = (sum(collided(c, seed) for seed in (3, 4, 5)) for c in (0.0, 1.0))
    assert critical >= max(2 * calm, 10), (calm, critical)


def test_commands_choose_who_is_guided_and_how_hard(scenes):
    play = Play(scenes[:1], ccdiff={"criticality": 0.0})
    play.step()
    free = play.native.explain(0)
    chosen = int(free["ranking"][-1])
    play = Play(scenes[:1], ccdiff={"criticality": 0.0})
    play.native.override_plan(0, guided=[chosen], criticality=1.0)
    play.step()
    plan = play.native.explain(0)
    assert plan["agents"][plan["guided"]].tolist() == [chosen]
    row = list(plan["agents"]).index(chosen)
    moved = np.abs(plan["samples"] - free["samples"]).max(axis=(0, 2, 3))
    assert moved[row] > 0.01
    with pytest.raises(UnknownNameError, match="agent"):
        play.native.override_plan(0, guided=[10_000], criticality=None)
    with pytest.raises(ConfigError, match="criticality"):
        play.native.override_plan(0, guided=None, criticality=-1.0)


def over_speed(states, batch):
    """The formula of rust/nets/src/guidance/objective/over_speed.rs at 4 m/s, in torch."""
    assert states.shape[1:] == (len(batch["pose"]), 52, 4)
    return (states[..., 2].abs() - 4.0).clamp(min=0.0).mean(dim=-1)


def over_speed_by_hand(states, batch):
    """The same with its gradient, in numpy."""
    speed = states[..., 2]
    over = np.maximum(np.abs(speed) - 4.0, 0.0)
    gradient = np.zeros_like(states)
    gradient[..., 2] = np.sign(speed) * (over > 0.0) / speed.shape[-1]
    return over.mean(axis=-1), gradient


def without_a_row(states, batch):
    return states[:, 1:, :, 2].mean(dim=-1)


def of_past_speeds(states, batch):
    return batch["speed_mps"].expand(states.shape[:2])


def elsewhere_differentiable(states, batch):
    return states.detach().requires_grad_().sum(dim=(2, 3))


def looks_for_the_ego(states, batch):
    return batch["ego"]


def _guided(scenes, objective, **guidance):
    """Poses of the first guided plans, two samples each."""
    guidance = {"learning_rate": 0.3, "objectives": [objective], **guidance}
    ccdiff = {"criticality": 4.0, "num_samples": 2, "guidance": guidance}
    play = Play(scenes[:2], ccdiff=ccdiff)
    play.step()
    plans = [play.native.explain(w) for w in range(2)]
    assert all(plan["guided"].any() for plan in plans)
    return plans


def test_a_cost_in_python_moves_plans_as_the_same_formula_in_rust(scenes):
    pytest.importorskip("torch")
    free = _guided(scenes, {"kind": "over_speed", "weight": 0.0})
    want = _guided(scenes, {"kind": "over_speed", "weight": 2.0, "limit_mps": 4.0})
    for cost in ({"call": over_speed}, {"call": over_speed_by_hand, "own_gradient": True}):
        found = _guided(scenes, {"kind": "python", "weight": 2.0, **cost})
        for plan, other, unmoved in zip(found, want, free, strict=True):
            np.testing.assert_allclose(plan["samples"], other["samples"], atol=2e-3)
            np.testing.assert_allclose(plan["losses"], other["losses"], atol=1e-4)
            assert plan["moved_m"][plan["guided"]].max() > 1.0
            assert np.abs(plan["samples"] - unmoved["samples"]).max() > 1.0


COST = """
def slow(states, batch):
    return batch["speed_mps"].expand(states.shape[:2]) + states[..., 2].abs().mean(dim=-1)
"""
DRIVE = """
import sys, ccdiff_env
from mine import slow
assert "torch" not in sys.modules
guidance = {"objectives": [{"kind": "python", "call": slow}]}
env = ccdiff_env.EgoEnv(traffic="ccdiff", criticality=1.0, ccdiff={"guidance": guidance})
env.reset(seed=0)
env.step([0.0, 0.0])
"""


def test_a_cost_may_be_the_first_to_need_torch(tmp_path):
    """Threads that plan imported it: the process hung, or ended."""
    pytest.importorskip("torch")
    (tmp_path / "mine.py").write_text(COST)
    path = os.pathsep.join([str(tmp_path), str(Path(ccdiff_env.__file__).parents[1])])
    run = [sys.executable, "-W", "ignore", "-c", DRIVE]
    subprocess.run(run, env={**os.environ, "PYTHONPATH": path}, check=True, timeout=600)


def test_a_cost_that_cannot_be_had_is_refused(scenes):
    pytest.importorskip("torch")
    with pytest.raises(ConfigError, match="expected what can be imported, as module:name"):
        _guided(scenes, {"kind": "python", "call": lambda states, batch: 0})
    for call, error, message in (
        ("test_traffic_guidance:nothing", ConfigError, "no 'nothing' in module"),
        (without_a_row, ShapeError, "losses has shape"),
        (of_past_speeds, PolicyError, "'.*:of_past_speeds' returns .* cannot differentiate"),
        (elsewhere_differentiable, PolicyError, "cannot differentiate by the states"),
    ):
        with pytest.raises(error, match=message):
            _guided(scenes, {"kind": "python", "call": call})
    # a choice among samples needs no gradient
    for plan in _guided(scenes, {"kind": "python", "call": of_past_speeds}, gradient_steps=0):
        assert np.isfinite(plan["losses"]).all()


def test_a_cost_in_python_chooses_among_samples(scenes):
    """Without gradient steps, all vehicles take the sample that loses least in sum."""
    pytest.importorskip("torch")
    cost = {"kind": "python", "call": over_speed}
    for weight in (1.0, -1.0):
        for plan in _guided(scenes, {**cost, "weight": weight}, gradient_steps=0):
            lost = weight * plan["losses"][0].sum(axis=1)
            assert np.ptp(lost) > 0.0
            assert (plan["selected_sample"] == lost.argmin()).all()


def test_what_a_cost_raises_is_the_cause_with_its_traceback(scenes):
    pytest.importorskip("torch")
    objective = {"kind": "python", "call": looks_for_the_ego}
    model = TrajectoryModel(shipped_weights("ccdiff"))
    for ask in (
        lambda: _guided(scenes, objective),
        lambda: model.plan(scenes[:1], [30], guidance={"objectives": [objective]}, guided=[[1]]),
    ):
        with pytest.raises(PolicyError, match=r"'.*:looks_for_the_ego': KeyError: 'ego'") as failed:
            ask()
        assert isinstance(failed.value.__cause__, KeyError)
        frames = traceback.extract_tb(failed.value.__cause__.__traceback__)
        assert (frames[-1].name, frames[-1].line) == ("looks_for_the_ego", 'return batch["ego"]')


def test_finished_plans_are_moved_by_metres_at_most(scenes):
    objective = {"kind": "approach", "weight": -10.0}
    free, bound = _guided(scenes, objective), _guided(scenes, objective, bound_m=0.5)
    for plan, held in zip(free, bound, strict=True):
        guided = plan["guided"]
        assert plan["moved_m"][guided].max() > 1.0
        assert 0.0 < held["moved_m"][guided].max() <= 0.5
        assert (held["moved_m"][~guided] == 0.0).all()


class Stops:
    """Brakes until it stands."""

    def __call__(self, obs):
        return np.tile(np.array([-1.0, 0.0]), (len(obs), 1))


@pytest.mark.parametrize(
    ("traffic", "least_target_mps", "fewest", "most"),
    [("ccdiff-2", None, 0, 3), ("swift-2", None, 0, 6), ("ccdiff-2", 0.0, 10, 60)],
)
def test_an_ego_that_stands_is_run_into_if_asked_for_alone(traffic, least_target_mps, fewest, most):
    """Contacts after half a second below 1 m/s, in 60 scenes; of unguided CCDiff there are 3."""
    drivers = TRAFFIC[traffic]
    if least_target_mps is not None:
        guidance = {**guidance_preset("rl"), "least_target_mps": least_target_mps}
        drivers = replace(drivers, ccdiff={**drivers.ccdiff, "guidance": guidance})
    scenes = embedded_scenes("city")[:60]
    found = 0
    for rollout in drive(scenes, Stops(), drivers, record=[s.name for s in scenes])[1].values():
        speed_mps = np.hypot(*rollout.velocity[rollout.agent_ids.index("ego")].T)
        for event in rollout.collisions("ego")[:1]:
            found += bool((speed_mps[max(event.step - 5, 0) : event.step] < 1.0).all())
    assert fewest <= found <= most
