"""Any vehicle as the ego, from any start; scenes of 9.1 s."""

import collections

import numpy as np
import pytest
from array_scenes import agent, array_scene, begun, rebuilt, wide_road
from array_scenes import played as episode
from episode_play import actions, played, same
from test_own_traffic import straight_on, watching
from traffic_play import Play

import ccdiff_env
from ccdiff_env import EgoEnv, EgoVectorEnv, Recorder, Scene, WorldConfig, embedded_scenes
from ccdiff_env.errors import ConfigError, SceneError, UnknownNameError
from ccdiff_env.models import shipped_weights
from ccdiff_env.scenes import with_tracks
from ccdiff_env.traffic import NETWORKS, PythonTraffic

HISTORY, HORIZON, LEAST_M = 30, 100, 10.0


NUM_SCENES = 4


def moving(scene: Scene, horizon: int = HORIZON) -> set[tuple[str, int]]:
    """Vehicles and steps from which the log goes on for 10 m, recomputed from the tracks."""
    tracks, found = scene.tracks(), set()
    position, valid = tracks["position"], tracks["valid"]
    for a, (name, kind) in enumerate(zip(scene.agent_ids, scene.agent_types, strict=True)):
        for t in np.flatnonzero(valid[a, HISTORY:-1]) + HISTORY:
            last = np.flatnonzero(valid[a, : t + horizon + 1])[-1]
            gap = np.linalg.norm(position[a, last] - position[a, t])
            if kind == "vehicle" and gap >= LEAST_M:
                found.add((name, int(t)))
    return found


def edited(scene: Scene, ego: str) -> Scene:
    """The scene with another vehicle called the ego, built anew from arrays."""
    names = {"ego": "the other", ego: "ego"} if ego != "ego" else {}
    return rebuilt(scene, agent_ids=[names.get(one, one) for one in scene.agent_ids])


def test_a_share_of_the_drawn_egos_may_stand_and_all_are_logged_to_the_end(scenes):
    scene = scenes[0]
    known, valid = moving(scene), scene.tracks()["valid"]
    env = EgoEnv(scenes=[scene], ego="any", standing_share=0.25)
    stands = 0
    for seed in range(400):
        info = env.reset(seed=seed)[1]
        if (info["ego"], info["start_step"]) not in known:
            stands += 1
            end = min(info["start_step"] + HORIZON, scene.num_steps - 1)
            assert valid[info["ego_idx"], [info["start_step"], end]].all()
    # most draws of any vehicle drive on, too
    assert 0 < stands <= 130


def test_the_seed_draws_a_vehicle_that_drives_on_and_a_start(scenes):
    scene = scenes[0]
    known, env = moving(scene), EgoEnv(scenes=[scene], ego="any")
    bounded = EgoEnv(scenes=[scene], ego="any", start_spread_steps=20, horizon_steps=50)
    for seed in range(60):
        info = bounded.reset(seed=seed)[1]
        assert (info["ego"], info["start_step"]) in moving(scene, horizon=50)
        assert info["start_step"] <= HISTORY + 20
    drawn = []
    for seed in range(300):
        _, info = env.reset(seed=seed)
        drawn.append((info["ego"], info["start_step"]))
        assert scene.agent_ids[info["ego_idx"]] == info["ego"]
        assert env.reset(seed=seed)[1] == info
    assert set(drawn) <= known
    vehicles = collections.Counter(name for name, _ in drawn)
    assert set(vehicles) == {name for name, _ in known}
    # vehicles are drawn evenly: five standard deviations of a binomial count
    share = 1 / len(vehicles)
    bound = 5 * np.sqrt(300 * share * (1 - share))
    assert all(abs(count - 300 * share) < bound for count in vehicles.values())
    for name in vehicles:
        starts = sorted(t for one, t in known if one == name)
        got = [t for one, t in drawn if one == name]
        middle = np.std(starts) / np.sqrt(len(got))
        assert abs(np.mean(got) - np.mean(starts)) <= 5 * middle + 1e-9


@pytest.mark.parametrize(
    "options",
    [{}, {"traffic": "idm", "dynamics": "assisted"}, {"traffic": "ccdiff", "criticality": 1.0}],
    ids=str,
)
def test_it_is_the_world_of_a_scene_in_which_that_vehicle_is_the_ego(options, scenes):
    scene = scenes[2]
    for ego, start in sorted(moving(scene))[::57][:4]:
        env = EgoEnv(scenes=[scene], ego="any", **options)
        obs, info = env.reset(seed=3, options={"scene": 0, "ego": ego, "start": start})
        assert (info["ego"], info["start_step"]) == (ego, start)
        other = EgoEnv(scenes=[edited(scene, ego)], history_steps=start, **options)
        expected, _ = other.reset(seed=3)
        assert np.array_equal(obs, expected)
        for route, wanted in zip(
            env.worlds.native.route(0, 0), other.worlds.native.route(0, 0), strict=True
        ):
            assert np.array_equal(route, wanted)
        assert same(played(env, actions(40)), played(other, actions(40)))


def test_recordings_call_it_the_ego(scenes):
    env = EgoEnv(scenes=scenes, ego="any", driver="idm", traffic="idm")
    seed = next(s for s in range(50) if env.reset(seed=s)[1]["ego"] != "ego")
    _, info = env.reset(seed=seed)
    recorder = Recorder(env)
    while env.step(np.zeros(2, np.float32))[2:4] == (False, False):
        recorder.step()
    recorder.step()
    rollout = recorder.rollout()
    assert rollout.agent_ids.index("ego") == info["ego_idx"]
    assert rollout.meta["ego"] == info["ego"]
    assert rollout.start_step == info["start_step"]
    other = begun(scenes=[rollout.to_scene()], history_steps=rollout.start_step)
    at = other.scene.agent_ids.index("ego")
    assert np.array_equal(
        other.worlds.native.states(0)["position"][at], rollout.position[info["ego_idx"], 0]
    )


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"ego": "ego"}, ConfigError, "without a scene"),
        ({"start": 40}, ConfigError, "without a scene"),
        ({"scene": 0, "ego": "nobody"}, UnknownNameError, "nobody"),
        ({"scene": 0, "ego": 3}, UnknownNameError, "3"),
        ({"scene": 0, "start": 29}, ConfigError, "start is 29, expected 30 to"),
        ({"scene": 0, "start": 10**6}, ConfigError, "start is 1000000"),
        ({"scene": 0, "start": -1}, ConfigError, "start is -1"),
        ({"scene": 0, "start": 1.5}, ConfigError, "start is 1.5"),
        ({"scene": 0, "start": True}, ConfigError, "start is True"),
    ],
    ids=str,
)
def test_starts_that_do_not_fit_are_refused_and_nothing_moves(options, error, words, scenes):
    env = EgoVectorEnv(2, scenes=scenes, ego="any")
    env.reset(seed=0)
    before = [env.worlds.native.digest(i) for i in range(2)]
    with pytest.raises(error, match=words):
        env.reset(options=options)
    assert [env.worlds.native.digest(i) for i in range(2)] == before


def test_an_ego_must_be_a_vehicle_that_is_there(scenes):
    scene = next(s for s in embedded_scenes("all") if "pedestrian" in s.agent_types)
    env = EgoEnv(scenes=[scene], ego="any")
    walker = scene.agent_ids[scene.agent_types.index("pedestrian")]
    with pytest.raises(ConfigError, match="expected a vehicle of"):
        env.reset(options={"scene": 0, "ego": walker})
    plain = EgoEnv(scenes=[scene])
    with pytest.raises(ConfigError, match="ego is given, expected nothing"):
        plain.reset(options={"scene": 0, "ego": "ego"})
    tracks, at = dict(scene.tracks()), scene.agent_types.index("vehicle", 1)
    tracks["valid"][at, HISTORY:60] = False
    gone = EgoEnv(scenes=[ccdiff_env.scenes.with_tracks(scene, tracks)], ego="any")
    with pytest.raises(ConfigError, match="logged at step 40"):
        gone.reset(options={"scene": 0, "ego": scene.agent_ids[at], "start": 40})


def test_it_is_an_option_of_one_ego_per_world():
    assert WorldConfig().with_options(ego="any").controlled == "any"
    assert WorldConfig.from_json(WorldConfig(controlled="any").to_json()).controlled == "any"
    with pytest.raises(ConfigError, match="ego is 'all', expected one of ego, any"):
        EgoEnv(ego="all")
    with pytest.raises(ConfigError, match="num_slots"):
        ccdiff_env.worlds.Worlds(
            embedded_scenes("val"), WorldConfig(controlled="any", num_slots=2), num_worlds=1
        )
    with pytest.raises(ConfigError, match="ego is not supported"):
        ccdiff_env.parallel_env(agents=2, ego="any")


@pytest.mark.nuscenes
def test_drawn_logs_stay_on_the_road(data_root):
    scenes = ccdiff_env.load_nuscenes(data_root / "nuscenes", "v1.0-mini", cache=False)
    env = EgoEnv(scenes=scenes, ego="any", driver="replay")
    for seed in range(60):
        *_, (_, _, info) = episode(env, seed=seed)
        assert not info["off_road"]


PROTOCOL = {"history_steps": 10, "horizon_steps": 80}


def road(num_steps: int = 91) -> Scene:
    """Six cars in two lanes, each at a speed of its own."""
    t = np.arange(num_steps) * 0.1
    cars = [
        agent(f"car-{i}" if i else "ego", 18.0 * i + (5.0 + 0.8 * i) * t, 3.5 * (i % 2) - 1.75)
        for i in range(6)
    ]
    return array_scene(*cars, name=f"road-{num_steps}", layers=wide_road(3.5, (-1.75, 1.75)))


def play(scene, traffic, *, steps=1000, **options):
    """A world in which the traffic and the ego are driven alike."""
    driver = "python" if isinstance(traffic, PythonTraffic) else traffic
    made = Play([scene], traffic, driver=driver, **options)
    while not made.out.done.all() and made.native.status(0).elapsed_steps < steps:
        made.step()
    return made.worlds


@pytest.mark.parametrize(
    "traffic",
    ["replay", "idm", "ccdiff", PythonTraffic(straight_on, history_states=11)],
    ids=["replay", "idm", "ccdiff", "python"],
)
def test_a_second_of_history_and_eight_seconds_are_played(traffic):
    scene = road()
    native = play(scene, traffic, **PROTOCOL).native
    status, states = native.status(0), native.states(0)
    assert (status.step_idx, status.elapsed_steps) == (90, 80)
    # the ego is gone where its episode ends
    assert states["active"][1:].all()
    position = scene.tracks()["position"]
    way = states["position"][1:] - position[1:, 10]
    logged = position[1:, 90] - position[1:, 10]
    if traffic == "replay" or isinstance(traffic, PythonTraffic):
        np.testing.assert_allclose(way, logged, atol=0.02)
    else:
        assert (way[:, 0] > 0.5 * logged[:, 0]).all()
        assert (np.abs(way[:, 1]) < 3.5).all()


@pytest.mark.parametrize("name", [name for name in NETWORKS if shipped_weights(name).is_file()])
@pytest.mark.parametrize("history", [10, 5])
def test_states_before_a_log_count_as_states_of_nobody(name, history):
    scene, start = embedded_scenes("val")["cut-in-03"], 40 - history
    tracks = dict(scene.tracks())
    cut = {n: np.ascontiguousarray(v[:, start:]) for n, v in tracks.items()}
    tracks["valid"] = tracks["valid"].copy()
    tracks["valid"][:, :start] = False
    short, whole = (
        play(with_tracks(scene, made), name, steps=1, history_steps=steps).native.explain(0)
        for made, steps in ((cut, history), (tracks, 40))
    )
    assert len(short["agents"]) > 3
    assert np.isfinite(short["samples"]).all()
    for key in ("agents", "samples", "ranking", "graph"):
        np.testing.assert_array_equal(short[key], whole[key])


def test_a_python_model_is_told_which_states_there_were():
    traffic, seen = watching(history_states=31)
    play(road(), traffic, steps=1, **PROTOCOL)
    (batch,) = seen
    assert not batch.valid[:, :20].any()
    assert batch.valid[:, 20:].all()
    for array in (batch.position_m, batch.heading_rad, batch.speed_mps):
        assert not array[:, :20].any()


def test_the_least_history_is_said_and_checked():
    for traffic, least in (
        ("replay", 0),
        ("idm", 0),
        ("ccdiff", 5),
        (PythonTraffic(straight_on), 0),
        (PythonTraffic(straight_on, least_history_states=8), 7),
    ):
        play(road(), traffic, steps=1, history_steps=least)
        if least:
            match = f"history_steps is {least - 1}.*at least {least}"
            with pytest.raises(ConfigError, match=match):
                play(road(), traffic, history_steps=least - 1)


def test_a_scene_that_is_too_short_says_what_fits():
    with pytest.raises(SceneError, match=r"road-25.*num_steps is 25.*= 32.*at most 23 fits"):
        play(road(25), "replay")
    assert play(road(25), "replay", history_steps=23).native.status(0).elapsed_steps == 1
    with pytest.raises(SceneError, match="at least 2"):
        play(road(1), "replay", history_steps=0)
