"""Traffic lights: in scenes and files, passed in red by geometry, and waited for by drivers."""

import base64
import json
import zlib

import numpy as np
import pytest
import shapely
from array_scenes import GOES_ON, STEPS, TIMES_S, agent, array_scene, played, rebuilt, wide_road
from test_scenes_scenarionet import save, scenario

import ccdiff_env
from ccdiff_env import EgoEnv, Scene
from ccdiff_env.envs.sb3 import SB3VecEnv
from ccdiff_env.errors import ConfigError, DatasetError, SceneError, ShapeError
from ccdiff_env.scenes.scenarionet_export import scenario_dict
from ccdiff_env.scenes.scene_types import LIGHT_STATES
from ccdiff_env.scenes.signals import recorded_passes
from ccdiff_env.training.outcomes import red_of_arrivals
from ccdiff_env.training.recipe import LIGHTS
from ccdiff_env.view.pack import pack
from ccdiff_env.view.render import legend
from ccdiff_env.view.sources import play_scene
from ccdiff_env.view.video import Video
from ccdiff_env_cli import main

UNKNOWN, GREEN, YELLOW, RED = range(4)
STOP_X = 40.0  # where the controlled lanes begin


def layers(*lights, y=(0.0,)):
    """A wide road with a lane before STOP_X and one behind it at every y, and lights over these."""
    made = wide_road()
    for i, at in enumerate(y):
        for name, (x0, x1) in {"before": (-300, STOP_X), "behind": (STOP_X, 600)}.items():
            x = np.arange(x0, x1 + 1, dtype=np.float32)
            line = np.stack([x, np.full_like(x, at)], 1)
            made["lanes"].append({"id": f"{name} {i}", "kind": "lane", "centreline": line})
    made["lights"] = [
        {"lane": 2 * i + 1, "states": np.asarray(states, np.uint8)} for i, states in lights
    ]
    return made


def always(state):
    return np.full(STEPS, state)


def test_lights_are_part_of_a_scene(tmp_path):
    ego = agent("ego", 8.0 * TIMES_S)
    bare, states = array_scene(ego, layers=layers()), np.arange(STEPS) // 50
    lit = array_scene(ego, layers=layers((0, states)))
    assert "lights" not in bare.map_layers()
    assert lit != bare
    assert lit.hash != bare.hash
    (light,) = lit.map_layers()["lights"]
    assert (light["lane"], light["states"].tolist()) == (1, states.tolist())
    assert np.allclose(light["stop_line"], [[STOP_X, 1.75], [STOP_X, -1.75]])
    assert Scene.from_bytes(lit.to_bytes()) == lit
    assert lit.to_bytes().startswith(bare.to_bytes()[:-1])
    given = lit.map_layers()
    given["lights"][0]["stop_line"] = np.array([[38.0, 0.5]], np.float32)  # a point
    moved = rebuilt(lit, map_layers=given)
    assert np.allclose(moved.map_layers()["lights"][0]["stop_line"], [[38, 2.25], [38, -1.25]])
    (back,) = ccdiff_env.load_scenarionet(save(tmp_path, scenario_dict(moved)))
    (light,) = back.map_layers()["lights"]
    assert np.allclose(light["stop_line"], [[38, 2.25], [38, -1.25]])
    assert np.array_equal(light["states"], states)


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"lane": 9}, DatasetError, "lane is 9, expected the index"),
        ({"states": np.full(STEPS, 7, np.uint8)}, DatasetError, "a state is 7, expected 0 to 3"),
        ({"states": always(1)}, ShapeError, "uint8 array"),
        ({"states": np.zeros(3, np.uint8)}, SceneError, r"lights\[0\].states is 3 states"),
        ({"stop_line": np.zeros((3, 2), np.float32)}, ShapeError, "stop_line"),
        ({"stop_line": np.full((2, 2), np.nan, np.float32)}, SceneError, "lights"),
    ],
)
def test_wrong_lights_are_refused(changed, error, message):
    given = layers((0, always(RED)))
    given["lights"][0] |= changed
    with pytest.raises(error, match=message):
        array_scene(agent("ego", 8.0 * TIMES_S), layers=given)


def test_lights_of_descriptions(tmp_path):
    """Names of MetaDrive and of Waymo; stop points of the light or of every step."""
    data = scenario()
    names = ["LANE_STATE_STOP", "LANE_STATE_ARROW_GO", "TRAFFIC_LIGHT_YELLOW", None]
    points = np.zeros((data["length"], 3))
    points[3:] = [3002.0, 4000.5, 9.0]
    shown = [names[i % 4] for i in range(data["length"])]
    light = {"type": "TRAFFIC_LIGHT", "lane": "1", "state": {"object_state": shown}}
    data["dynamic_map_states"] = {"2": {**light, "stop_point": points}, "77": {**light, "lane": 77}}
    scenes = ccdiff_env.load_scenarionet(save(tmp_path, data))
    (light,) = scenes[0].map_layers()["lights"]
    assert light["lane"] == 0
    told = ["red", "green", "yellow", "unknown"]
    assert [LIGHT_STATES[s] for s in light["states"]] == [told[i % 4] for i in range(len(shown))]
    assert np.allclose(light["stop_line"], [[2, 2.25], [2, -1.25]])
    assert "a light of lane 77, which is not there" in scenes.report.scenes[0].notes
    data["dynamic_map_states"]["2"]["state"]["object_state"] = shown[:-1]
    with pytest.raises(DatasetError, match="length of dynamic_map_states"):
        ccdiff_env.load_scenarionet(save(tmp_path, data))


def ran(scene, **options):
    """Steps at which the ego, on its log, passes in red, and rewards for it."""
    env = EgoEnv(scenes=[scene], driver="replay", history_steps=10, horizon_steps=STEPS, **GOES_ON,
                 **options)  # fmt: skip
    told = [(step, info) for step, _, info in played(env)]
    steps = [step for step, info in told if info["ran_red"]]
    return steps, [info["reward_red_light"] for _, info in told]


def test_passing_in_red_is_seen_at_the_front():
    x = 8.0 * TIMES_S
    crossing = int(np.flatnonzero(x + 2.25 >= STOP_X)[0])
    for state in (UNKNOWN, GREEN, YELLOW, RED):
        scene = array_scene(agent("ego", x), layers=layers((0, always(state))))
        steps, rewards = ran(scene, reward={"red_light": -3.0})
        assert steps == [crossing] * (state == RED)
        assert sum(rewards) == -3.0 * (state == RED)
    for turns, seen in ((crossing, []), (crossing + 1, [crossing])):  # red until it turns
        states = np.where(np.arange(STEPS) < turns, RED, GREEN)
        assert ran(array_scene(agent("ego", x), layers=layers((0, states))))[0] == seen
    for y, seen in ((1.7, [crossing]), (1.8, [])):  # beside the stop line
        scene = array_scene(agent("ego", x, y), layers=layers((0, always(RED))))
        assert ran(scene)[0] == seen
    against = agent("ego", 80 - x, heading=np.pi)
    assert ran(array_scene(against, layers=layers((0, always(RED)))))[0] == []
    both = layers((0, always(RED)), (0, always(GREEN)))  # another way from the same line has green
    assert ran(array_scene(agent("ego", x), layers=both))[0] == []


@pytest.mark.parametrize("steps", [1, 3])
def test_every_environment_tells_of_passing_in_red_and_ends(steps):
    x = 8.0 * TIMES_S
    decisions = -(-(int(np.flatnonzero(x + 2.25 >= STOP_X)[0]) - 10) // steps)
    options = {"scenes": [array_scene(agent("ego", x), layers=layers((0, always(RED))))]}
    options |= {"driver": "replay", "info": "full", "history_steps": 10}
    options |= {**GOES_ON, "on_red_light": "terminate", "decision_steps": steps}
    options |= {"reward": {"red_light": -3.0}}
    env, worlds = EgoEnv(**options), ccdiff_env.make_vec(1, **options)
    rows = ccdiff_env.AgentVectorEnv(1, agents=["ego"], **options)
    game = ccdiff_env.parallel_env(agents=["ego"], **options)
    learner = SB3VecEnv(ccdiff_env.make_vec(1, **options))
    for each in (env, worlds, rows, game, learner):
        each.reset()
    still = np.zeros(2, np.float32)
    for k in range(1, decisions + 1):
        told = [env.step(still), worlds.step(still[None]), rows.step(still[None])]
        alone = [part["ego"] for part in game.step({"ego": still})]
        *_, done, infos = learner.step(still[None])
        ends = [np.any(one[2]) for one in (*told, alone)]
        assert [*ends, done[0]] == [k == decisions] * 5
        for info in (*(one[-1] for one in (*told, alone)), infos[0]):
            if k == decisions or info is not infos[0]:  # which tells at ends alone
                info = info if "ran_red" in info else info["final_info"]
                assert np.squeeze(info["ran_red"]) == (k == decisions)
                assert np.squeeze(info["reward_red_light"]) == -3.0 * (k == decisions)


def test_arrivals_that_ran_red_are_counted_where_one_could_have_stopped():
    """Not counted: past the light, too far from it, too fast for it."""
    x, fast = 8.0 * TIMES_S, 17.0 * TIMES_S
    lit = {name: layers((0, always(state))) for name, state in (("red", RED), ("green", GREEN))}
    drives = [(x, "red"), (x, "green"), (x + STOP_X, "red"), (x - 100, "red"), (fast, "red")]
    made = [
        array_scene(agent("ego", way), layers=lit[state], name=f"own {i}")
        for i, (way, state) in enumerate(drives)
    ]
    for scenes, counted in ((made, (2, 1)), (made[1:], (1, 0)), (made[2:], (0, 0))):
        env = ccdiff_env.make_vec(
            len(scenes), scenes=scenes, scene_order="sequential",
            driver="replay", autoreset_mode="same_step", info="end", history_steps=10,
            reward={"red_light": -1.0}, observation=LIGHTS["observation"],
        )  # fmt: skip
        assert red_of_arrivals(env) == counted
        assert red_of_arrivals(env, draws=3) == (3 * counted[0], 3 * counted[1])
    blind = ccdiff_env.make_vec(1, scenes=made[:1], driver="replay", autoreset_mode="same_step")
    with pytest.raises(ConfigError, match="red_of_arrivals: expected columns"):
        red_of_arrivals(blind)


def test_how_recorded_drivers_obey_lights_is_printed(tmp_path, capsys):
    """Of four vehicles one passes in red, one beside the stop line, one against the lane."""
    x = 8.0 * TIMES_S
    states = np.where(np.arange(STEPS) < 80, GREEN, RED)
    log = [agent("ego", x), agent("late", x - 40), agent("beside", x - 40, 3.0),
           agent("against", 80 - x, heading=np.pi)]  # fmt: skip
    scene = array_scene(*log, layers=layers((0, states)))
    path = save(tmp_path, scenario_dict(scene))
    assert main(["scenes", "--scenes", f"scenarionet:{path}"]) == 0
    assert "pass 2 stop lines of lights, 50.0% in red" in capsys.readouterr().out


def test_passing_in_red_ends_an_episode_where_asked():
    scene = array_scene(agent("ego", 8.0 * TIMES_S), layers=layers((0, always(RED))))
    for ends in ("terminate", "ignore"):
        env = EgoEnv(scenes=[scene], driver="replay", **{**GOES_ON, "on_red_light": ends})
        for *_, info in played(env):
            assert info["terminated"] == (ends == "terminate" and bool(info["ran_red"]))
        assert info["is_success"] == (ends == "ignore")


LIGHT_COLUMNS = ["light_green", "light_yellow", "light_red", "light_distance", "light_since",
                 "light_braking"]  # fmt: skip


def test_who_waits_at_a_light_is_not_late():
    ego = agent("ego", np.minimum(8.0 * TIMES_S, 70.0))
    paid = {}
    for state in (GREEN, RED):
        scene = array_scene(ego, layers=layers((0, always(state))))
        env = EgoEnv(scenes=[scene], reward={"lagging": -0.5})
        env.reset(seed=0)
        paid[state] = [env.step([-1.0, 0.0])[-1]["reward_lagging"] for _ in range(30)]
    assert min(paid[GREEN][20:]) < -0.5
    # at 24 m, as fast as the log, it could be held by the line at 40 m from its first step on
    assert paid[RED] == [0.0] * 30


def test_the_next_light_is_observed_on_request():
    """Its columns against geometry, by the log; none of them is in the default layout."""
    x, states = 8.0 * TIMES_S, np.where(np.arange(STEPS) < 35, GREEN, RED)
    states[45:50] = YELLOW
    given = layers((0, states), (1, always(GREEN)), y=(0.0, 4.0))
    scene = array_scene(agent("ego", x), layers=given)
    options = {"scenes": [scene], "driver": "replay", **GOES_ON, "history_steps": 0}
    options["horizon_steps"] = STEPS
    usual = EgoEnv(**options).worlds.layout
    assert not set(LIGHT_COLUMNS) & {name for entry in usual.entries for name in entry.columns}
    env = EgoEnv(**options, observation={"ego_columns": LIGHT_COLUMNS, "num_neighbors": 0,
                                         "num_route_points": 0})  # fmt: skip
    row, _ = env.reset(seed=0)
    for k in range(STEPS - 1):
        gap = STOP_X - (x[k] + 2.25)
        shown = states[k]
        since = k - max((j for j in range(1, k + 1) if states[j] != states[j - 1]), default=0)
        seen = [shown == s for s in (GREEN, YELLOW, RED)]
        braking = 64 / (2 * max(gap, 0.1)) if shown == RED else 0.0
        expected = [*seen, min(gap / 60, 1), min(0.1 * since / 30, 1), min(braking / 10, 1)]
        if gap <= 0:
            expected = [0, 0, 0, 1, 0, 0]
        if abs(gap) > 0.01:
            assert np.allclose(row, expected, atol=2e-3), (k, row, expected)
        row, *_ = env.step(np.zeros(2, np.float32))


def test_lights_are_a_channel_of_the_raster_on_request():
    x = 8.0 * TIMES_S
    for state, byte in ((UNKNOWN, 0), (GREEN, 85), (YELLOW, 170), (RED, 255)):
        scene = array_scene(agent("ego", x), layers=layers((0, always(state))))
        env = EgoEnv(scenes=[scene], observation="bev", driver="replay", history_steps=20,
                     bev={"lights": True, "metres_per_px": 0.5, "size_px": 100})  # fmt: skip
        seen, _ = env.reset(seed=0)
        assert env.worlds.layout.channels[-1] == "lights"
        assert EgoEnv(scenes=[scene], observation="bev").observation_space.shape[0] == 5
        row, left = 75 - (STOP_X - x[20]) / 0.5, 50 - 1.75 / 0.5
        expected = np.zeros((100, 100), np.uint8)
        expected[int(row), int(left) : int(left) + 7] = byte
        where = np.argwhere(seen[-1] > 0)
        assert set(seen[-1][seen[-1] > 0]) == ({byte} if byte else set())
        if byte:
            assert np.abs(where.mean(axis=0) + 0.5 - [row, 50]).max() < 0.6
            assert np.ptp(where[:, 1]) in (6, 7)


def test_passing_in_red_against_shapely():
    rng = np.random.default_rng(0)
    count = 0
    for _ in range(40):
        y = np.cumsum(rng.normal(0, 0.1, STEPS)) + rng.uniform(-2, 2)
        x = np.maximum.accumulate(9.0 * TIMES_S + rng.normal(0, 0.2, STEPS))
        heading = np.unwrap(rng.normal(0, 0.05, STEPS))
        states = rng.integers(0, 4, STEPS)
        scene = array_scene(agent("ego", x, y, heading=heading), layers=layers((0, states)))
        tracks = scene.tracks()
        (light,) = scene.map_layers()["lights"]
        turned = tracks["heading"][0]
        front = tracks["position"][0] + 2.25 * np.stack([np.cos(turned), np.sin(turned)], 1)
        bar = shapely.LineString(light["stop_line"])
        passed = [
            k
            for k in range(1, STEPS)
            if front[k - 1, 0] < STOP_X <= front[k, 0]
            and shapely.LineString(front[k - 1 : k + 1]).intersects(bar)
        ]
        in_red = [k for k in passed if states[k] == RED]
        assert recorded_passes(scene) == (len(passed), len(in_red))
        expected = [k for k in in_red if k > 10]
        assert ran(scene)[0] == expected
        count += len(expected)
    assert count > 4


def test_crossings_of_the_city_have_two_phases():
    """Ways that cross at an angle are never both free; nothing but lights is new."""
    lit, bare = (ccdiff_env.load(f"embedded/{split}") for split in ("city-lights", "city"))
    assert lit.names == bare.names
    for scene, own in list(zip(lit, bare, strict=True))[::10]:
        assert scene.with_lights([]) == own
        assert scene.with_lights(scene.map_layers()["lights"]) == scene
        layers = scene.map_layers()
        lines = [shapely.LineString(lane["centreline"]) for lane in layers["lanes"]]
        first = [np.subtract(*lane["centreline"][1::-1]) for lane in layers["lanes"]]
        lights = layers["lights"]
        assert {layers["lanes"][light["lane"]]["kind"] for light in lights} == {"connector"}
        for i, a in enumerate(lights):
            assert set(a["states"]) == {GREEN, YELLOW, RED}
            for b in lights[:i]:
                axes = [np.arctan2(*first[light["lane"]][::-1]) for light in (a, b)]
                if (
                    lines[a["lane"]].crosses(lines[b["lane"]])
                    and np.cos(2 * np.subtract(*axes)) < -0.5
                ):
                    assert ((a["states"] == RED) | (b["states"] == RED)).all()


def test_pictures_and_pages_have_the_state_of_their_step():
    scene = ccdiff_env.load("embedded/city-lights")["tee-crossing-005"]
    run = play_scene(scene, traffic="idm", driver="pdm")
    text = zlib.decompress(base64.b64decode(pack(run, "run")))
    lights = scene.map_layers()["lights"]
    for light, told in zip(lights, json.loads(text)["run"]["lights"], strict=True):
        assert np.allclose(told["line"], light["stop_line"], atol=0.01)
        firsts, names = zip(*told["shows"], strict=True)
        assert len(names) > 1
        for k in range(run.num_steps):
            state = LIGHT_STATES[light["states"][run.start_step + k]]
            assert names[np.searchsorted(firsts, k, side="right") - 1] == state
    red = next(light for light in lights if light["states"][run.start_step] == RED)
    centre = tuple(red["stop_line"].mean(axis=0).tolist())
    for step in range(0, run.num_steps, 10):
        drawn = Video(run, size=(60, 60), span_m=6, centre_m=centre, captions=False).frame(step)
        colour = legend()[f"{LIGHT_STATES[red['states'][run.start_step + step]]} light"]
        assert (drawn == np.array(colour, np.uint8)).all(axis=2).sum() > 50


@pytest.mark.parametrize("driver", ["idm", "swift", "ego idm", "ego pdm", "ego lane_idm"])
def test_drivers_wait_in_red_and_go_in_green(driver):
    """Traffic, and drivers of the ego; beside, where the light is green, others go on."""
    turns, in_ego = 110, driver.startswith("ego ")
    states = np.where(np.arange(STEPS) < turns, RED, GREEN)
    given = layers((0, states), (1, always(GREEN)), y=(0.0, 4.0))
    x = 8.0 * TIMES_S
    scene = array_scene(agent("ego", x, 30.0), agent("a", x), agent("b", x, 4.0), layers=given)
    if in_ego:
        scene = scene.with_ego("a")
    env = EgoEnv(
        scenes=[scene], traffic="idm" if in_ego else driver,
        driver=driver.removeprefix("ego ") if in_ego else "replay",
        history_steps=10, horizon_steps=STEPS, **GOES_ON,
    )  # fmt: skip
    places = {}
    for k, now, info in played(env):
        assert not info["ran_red"]
        places[k] = now["position"][[1, 2], 0], now["speed"][[1, 2]]
    (waiting, beside), speeds = places[turns - 1]
    assert 0.5 < STOP_X - (waiting + 2.25) < 4.0
    assert speeds[0] < 0.1
    assert beside > STOP_X + 10
    assert places[max(places)][0][0] + 2.25 > STOP_X
