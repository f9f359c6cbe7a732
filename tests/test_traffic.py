"""Networks as drivers of the world: plans, guidance, rankings, snapshots, refusals."""

import dataclasses

import numpy as np
import pytest
from array_scenes import TIMES_S, agent, array_scene, begun
from traffic_play import FIELDS, Play

import ccdiff_env
from ccdiff_env.errors import (
    ConfigError,
    ResetNeededError,
    SceneError,
)
from ccdiff_env.metrics import causal
from ccdiff_env.models import shipped_weights
from ccdiff_env.traffic import KINDS, NETWORKS, CcdiffConfig, PythonTraffic


def test_a_plan_is_made_every_n_steps_and_followed_in_between(scenes):
    play = Play(scenes[:1], ccdiff={"replan_steps": 4, "num_samples": 2})
    assert play.native.explain(0) is None
    made = []
    for step in range(10):
        play.step()
        plan = play.native.explain(0)
        made.append(plan["made_at"])
        agents = plan["agents"][plan["follows_plan"]]
        rows = np.flatnonzero(plan["follows_plan"])
        at = plan["samples"][plan["selected_sample"][rows], rows, step - plan["made_at"]]
        states = play.states()
        there = states["active"][agents]
        assert there.any()
        np.testing.assert_allclose(states["position"][agents][there], at[there, :2], atol=1e-4)
        speed = np.linalg.norm(states["velocity"][agents], axis=1)
        assert (speed < 35).all()
    assert made == [0, 0, 0, 0, 4, 4, 4, 4, 8, 8]


def test_beyond_the_radius_of_plans_idm_drives(scenes):
    idm = Play(scenes[:3], traffic="idm")
    none = Play(scenes[:3], ccdiff={"plan_radius_m": 0.0})
    near = Play(scenes[:3], ccdiff={"plan_radius_m": 25.0})
    every, all_near = Play(scenes[:3]), Play(scenes[:3], ccdiff={"plan_radius_m": 1e4})
    fewer = 0
    for step in range(20):
        before = [near.states(world) for world in range(3)]
        for play in (idm, none, near, every, all_near):
            play.step()
        for world, states in enumerate(before):
            plan, ego = near.native.explain(world), scenes[world].agent_ids.index("ego")
            if plan["made_at"] == step:
                gaps = np.linalg.norm(states["position"] - states["position"][ego], axis=1)
                vehicles = np.array(scenes[world].agent_types) == "vehicle"
                near_ego = np.flatnonzero(states["active"] & vehicles & (gaps <= 25.0))
                assert set(plan["agents"]) <= set(near_ego)
                fewer += len(near_ego) < np.sum(states["active"] & vehicles)
    assert fewer > 0
    for one, other in ((idm, none), (every, all_near)):
        for world in range(3):
            for name in FIELDS:
                np.testing.assert_array_equal(one.states(world)[name], other.states(world)[name])


def test_a_plan_tells_what_it_was_made_from(scenes):
    play = Play(scenes[:1], ccdiff={"num_samples": 3, "criticality": 1.0, "explain": True})
    play.step()
    plan = play.native.explain(0)
    m = len(plan["agents"])
    assert plan["samples"].shape == (3, m, 52, 3)
    for name in ("graph", "ttc_s", "attention"):
        assert plan[name].shape == (m, m)
    assert plan["graph"].diagonal().all()
    assert (plan["attention"][~plan["graph"]] == 0).all()
    assert len(plan["objectives"]) == len(plan["losses"]) == len(plan["gradient_cosine"])
    assert plan["realism_cosine"].shape == plan["conflict_share"].shape == (m,)
    assert plan["guided"].sum() <= 5
    assert set(plan["ranking"]) == set(plan["agents"][plan["follows_plan"]])
    assert (plan["moved_m"][~plan["guided"]] == 0).all()
    assert (plan["moved_m"][plan["guided"]] > 0).any()


@pytest.mark.parametrize("steps", [1, 5])
def test_guidance_moves_plans_farther_the_stronger_it_is(scenes, steps):
    found = []
    for criticality in (0.0, 0.5, 1.0, 2.0, 4.0):
        ccdiff = {"criticality": criticality, "denoising_steps": steps, "collision_targets": "all"}
        play = Play(scenes[:1], ccdiff=ccdiff)
        play.step()
        plan = play.native.explain(0)
        moved_m = np.zeros(1) if plan["moved_m"] is None else plan["moved_m"]
        found.append(float(moved_m.max()))
    assert sorted(found) == found
    assert found[0] == 0.0
    assert found[-1] > 1.5 * found[-2] > 0.0


@pytest.mark.parametrize(
    "ranking",
    [
        "cliques",
        "greedy",
        "distance_cliques",
        "first",
        "random",
        "gradient",
        "ttc",
        "reach",
        "list",
    ],
)
def test_every_ranking_orders_the_vehicles_that_may_be_guided(scenes, ranking):
    scene = scenes[0]
    wanted = {scene.name: scene.agent_ids[2:3]} if ranking == "list" else ranking
    play = Play(scenes[:1], ccdiff={"ranking": wanted, "num_guided": 1, "criticality": 1.0})
    play.step()
    plan = play.native.explain(0)
    ours = plan["agents"][plan["follows_plan"]]
    assert sorted(plan["ranking"]) == sorted(ours)
    assert plan["guided"].sum() == 1
    if ranking == "list" and 2 in ours:
        assert plan["ranking"][0] == 2


def test_by_time_to_contact_those_who_meet_the_ego_soonest_come_first():
    guided = {"ranking": "ttc", "num_guided": 1, "criticality": 1.0}
    for scene in ccdiff_env.embedded_scenes("val")[:6]:
        play = Play([scene], ccdiff=guided)
        play.step()
        plan = play.native.explain(0)
        order = scene.ranked_vehicles(play.native.status(0).step_idx - 1, "ttc")
        expected = [agent for agent in order if agent in plan["ranking"]]
        assert plan["ranking"].tolist() == expected


def test_vehicles_left_to_the_log_stay_on_it(scenes):
    ccdiff = {"background_driver": "replay", "num_guided": 1, "rerank": False, "criticality": 1.0}
    play = Play(scenes[:1], ccdiff=ccdiff)
    tracks = scenes[0].tracks()
    for step in range(20):
        play.step()
        plan, states = play.native.explain(0), play.states()
        for one in plan["agents"][~plan["follows_plan"]]:
            at = 31 + step
            if states["active"][one] and tracks["valid"][one, at]:
                logged = tracks["position"][one, at]
                np.testing.assert_allclose(states["position"][one], logged, atol=1e-4)
    assert plan["follows_plan"].sum() == 1


def test_unguided_traffic_is_nearer_to_the_log_than_constant_velocity(scenes):
    def error(options):
        alone = {"late_arrivals": False, "vanish_with_log": True, "on_traffic_collision": "ignore"}
        play = Play(scenes, seed=0, **alone, **options)
        play.step(40)
        errors = []
        for i, scene in enumerate(scenes):
            states, tracks = play.states(i), scene.tracks()
            both = states["active"] & tracks["valid"][:, 70]
            gap = states["position"][both] - tracks["position"][both, 70]
            errors.extend(np.linalg.norm(gap, axis=1))
        return np.mean(errors)

    # that knows no route leaves the drawn town where it turns
    ours = error({"traffic": "ccdiff", "ccdiff": {"num_samples": 4, "follow_route": True}})
    assert ours < error({"traffic": "constant_velocity"})


def test_a_scene_without_a_map_is_refused_by_name():
    cars = agent("ego", 6.0 * TIMES_S), agent("other", 6.0 * TIMES_S, 8.0)
    with pytest.raises(SceneError, match="blank"):
        Play([array_scene(*cars, name="blank", layers={})])


def test_a_plans_record_has_the_same_fields_everywhere(scenes):
    env = begun(scenes=scenes, traffic="ccdiff", ccdiff={"explain": True})
    with pytest.raises(ResetNeededError, match="call step"):
        env.explain()
    recorder = ccdiff_env.Recorder(env)
    states, sizes = env.worlds.native.states(0), env.scene.sizes[:, :2]
    env.step(np.zeros(env.action_space.shape, np.float32))
    recorder.step()
    plan, record = env.worlds.native.explain(0), env.explain()
    drawn = {"moment"}  # what a notebook draws the plan with
    assert set(plan) == {field.name for field in dataclasses.fields(record)} - drawn
    recorded = recorder.rollout().plans[0]
    assert type(recorded) is type(record)
    for name, told in plan.items():
        kept = getattr(recorded, name)
        assert type(told) is type(kept)
        assert np.array_equal(told, kept)
    # times to contact of the moment in which it was made
    now = (states[name][plan["agents"]] for name in ("position", "heading", "speed"))
    want = causal.ttc(*now, sizes[plan["agents"]], normalised=False)
    np.testing.assert_allclose(plan["ttc_s"], want, atol=1e-3)


def test_the_papers_protocol_is_a_set_of_options(scenes):
    env = ccdiff_env.make_vec(2, scenes=scenes, **ccdiff_env.traffic.PAPER_PROTOCOL)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(env.action_space.shape, np.float32))
    plan = env.explain(0)
    assert plan.follows_plan.sum() <= 5
    assert (plan.guided <= plan.follows_plan).all()


SHIPPED = [name for name in NETWORKS if shipped_weights(name).is_file()]


@pytest.mark.parametrize("name", [name for name in SHIPPED if not KINDS[name].distilled])
def test_every_shipped_network_drives_live_traffic_and_explains_it(scenes, name):
    options = {"criticality": 1.0, "num_samples": 2, "num_guided": 1, "explain": True}
    env = begun(scenes=scenes[:1], traffic=name, driver="idm", ccdiff=options)
    start = env.worlds.native.states(0)
    for _ in range(8):
        env.step(env.action_space.sample())
    plan, states = env.explain(), env.worlds.native.states(0)
    driven = plan.agents[plan.follows_plan]
    assert name in {env.worlds.native.drivers(0)[agent] for agent in driven}
    moved = np.linalg.norm(states["position"] - start["position"], axis=1)[driven]
    assert np.isfinite(plan.samples).all()
    assert moved.max() > 1.0
    assert plan.objectives == ("agent_collision", "approach", "map_collision")
    denoises, attends = name in ("ccdiff", "ctg", "ctgpp"), name in ("ccdiff", "ctgpp")
    assert np.isfinite(plan.moved_m).all() == (name != "tokens")
    assert (plan.conflict_share is not None) == denoises
    assert (plan.attention is not None) == attends


def test_options_of_networks_are_refused_where_none_drives(scenes):
    def coast(batch):
        return np.zeros((len(batch.kind), 8, 2), np.float32)

    own = {"mine": CcdiffConfig(num_samples=2)}
    options = {"ccdiff": {"num_samples": 3}}
    for traffic in ("idm", "replay", {"idm": 0.5, "replay": 0.5}, PythonTraffic(coast), "mine"):
        for make in (ccdiff_env.EgoEnv, ccdiff_env.make_vec, ccdiff_env.parallel_env):
            with pytest.raises(ConfigError, match=r"ccdiff: traffic is .*, expected one of"):
                make(scenes=scenes, traffic=traffic, named_drivers=own, **options)
    # what says nothing is no mistake; one network among several, the ego or one vehicle is enough
    ccdiff_env.EgoEnv(scenes=scenes, traffic="idm", ccdiff={})
    for fine in (
        {"traffic": {"idm": 0.5, "ccdiff": 0.5}},
        {"traffic": "idm", "driver": "ccdiff"},
        {"traffic": "idm", "drivers": {scenes[0].agent_ids[1]: "ccdiff"}},
    ):
        ccdiff_env.EgoEnv(scenes=scenes[:1], **fine, **options)


def test_what_means_nothing_to_a_network_is_refused_by_name(scenes, tmp_path):
    for options, match in [
        ({"graph": "full"}, "graph"),
        ({"cfg_weight": 1.5}, "guidance_weight"),
        ({"denoising_steps": 10}, "solver"),
        ({"ranking": "greedy"}, "ranking"),
        ({"ranking": "gradient"}, "ranking"),
        ({"weights": str(shipped_weights("ccdiff"))}, "tokens"),
    ]:
        with pytest.raises(ConfigError, match=match):
            Play(scenes[:1], traffic="tokens", ccdiff=options)
