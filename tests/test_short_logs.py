"""Scenes of 9.1 s: a second of history, eight to drive, and what each driver needs at least."""

from __future__ import annotations

import numpy as np
import pytest
from array_scenes import agent, array_scene

import ccdiff_env
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, SceneError
from ccdiff_env.models import shipped_weights
from ccdiff_env.scenes import SceneSet, with_tracks
from ccdiff_env.traffic import NETWORKS, PythonTraffic
from ccdiff_env.worlds import Worlds

PROTOCOL = {"history_steps": 10, "horizon_steps": 80}
NO_CONSEQUENCE = {
    "on_collision": "ignore",
    "on_off_road": "ignore",
    "terminate_at_goal": False,
    "autoreset": "disabled",
}


def road(num_steps: int = 91) -> ccdiff_env.Scene:
    """Six cars on a road of two lanes, each at a speed of its own."""
    across, t = np.array([-1.75, 1.75]), np.arange(num_steps) * 0.1
    cars = [
        agent(f"car-{i}" if i else "ego", 20.0 + 18.0 * i + (5.0 + 0.8 * i) * t, across[i % 2])
        for i in range(6)
    ]
    line = np.linspace(0.0, 400.0, 401)

    def strip(low, high):
        corners = [(0.0, low), (400.0, low), (400.0, high), (0.0, high)]
        return {"exterior": np.array(corners, np.float32), "holes": []}

    lanes = [
        {
            "id": f"lane-{i}", "kind": "lane", "successors": [], "predecessors": [],
            "centreline": np.stack([line, np.full(401, at)], axis=-1).astype(np.float32),
            "polygon": strip(at - 1.75, at + 1.75), "speed_limit_mps": None,
        }
        for i, at in enumerate(across)
    ]  # fmt: skip
    layers = {"drivable_area": [strip(-3.5, 3.5)], "lanes": lanes}
    return array_scene(*cars, name=f"road-{num_steps}", layers=layers)


def keep_on(batch):
    """Poses at the speed of the last state, straight on."""
    ahead = batch.speed_mps[:, -1:] * batch.dt_s * np.arange(1, 6)
    heading = batch.heading_rad[:, -1:]
    way = np.stack([np.cos(heading) * ahead, np.sin(heading) * ahead], axis=-1)
    at = batch.position_m[:, -1:] + way
    return np.concatenate([at, np.repeat(heading, 5, axis=1)[..., None]], axis=-1)


def play(scenes, traffic, *, steps=None, driver=None, **options):
    """Worlds in which the traffic and the ego are driven alike, and how many steps they took."""
    driver = driver or ("python" if isinstance(traffic, PythonTraffic) else traffic)
    options = {**NO_CONSEQUENCE, **options}
    config = WorldConfig().with_options(traffic=traffic, driver=driver, **options)
    worlds = Worlds(SceneSet(scenes), config, num_worlds=len(scenes), num_threads=1)
    native, out = worlds.native, worlds.arrays()
    native.reset([3] * len(scenes), list(range(len(scenes))), None, out)
    nothing = np.zeros((len(scenes), 1, native.action_width), np.float32)
    taken = 0
    while not out.done.all() and (steps is None or taken < steps):
        native.step(nothing, out)
        taken += 1
    return worlds, taken


def network(name):
    assert shipped_weights(name).is_file()
    pytest.importorskip("torch")
    return name


@pytest.mark.parametrize(
    "traffic",
    ["replay", "idm", "ccdiff", PythonTraffic(keep_on, history_states=11)],
    ids=["replay", "idm", "ccdiff", "python"],
)
def test_a_second_of_history_and_eight_seconds_are_played(traffic):
    if traffic == "ccdiff":
        network(traffic)
    scene = road()
    worlds, taken = play([scene], traffic, **PROTOCOL)
    native = worlds.native
    status, states = native.status(0), native.states(0)
    assert taken == 80
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


def plan_of(scene, name, *, history_steps, **options):
    worlds, _ = play([scene], name, steps=1, history_steps=history_steps, **options)
    plan = worlds.native.explain(0)
    assert plan is not None
    return plan


def cut_and_blanked(start, history):
    """A scene without the states before a step, and one in which they are marked as not there."""
    scene = ccdiff_env.embedded_scenes("val")["cut-in-03"]
    tracks = dict(scene.tracks())
    cut = {n: np.ascontiguousarray(v[:, start - history :]) for n, v in tracks.items()}
    valid = tracks["valid"].copy()
    valid[:, : start - history] = False
    return with_tracks(scene, cut), with_tracks(scene, {**tracks, "valid": valid})


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("history", [10, 5])
def test_states_before_a_log_count_as_states_of_nobody(name, history):
    cut, blanked = cut_and_blanked(40, history)
    short = plan_of(cut, network(name), history_steps=history)
    whole = plan_of(blanked, name, history_steps=40)
    assert len(short["agents"]) > 3
    assert np.isfinite(short["samples"]).all()
    for key in ("agents", "samples", "ranking", "graph"):
        np.testing.assert_array_equal(short[key], whole[key])


def test_a_python_model_is_told_which_states_there_were():
    seen = []

    def look(batch):
        seen.append(batch)
        return keep_on(batch)

    play([road()], PythonTraffic(look, history_states=31), steps=1, **PROTOCOL)
    (batch,) = seen
    assert not batch.valid[:, :20].any()
    assert batch.valid[:, 20:].all()
    for array in (batch.position_m, batch.heading_rad, batch.speed_mps):
        assert not array[:, :20].any()


def test_the_least_history_is_said_and_checked():
    network("ccdiff")
    for traffic, least in (
        ("replay", 0),
        ("idm", 0),
        ("ccdiff", 5),
        (PythonTraffic(keep_on), 0),
        (PythonTraffic(keep_on, least_history_states=8), 7),
    ):
        play([road()], traffic, steps=1, history_steps=least)
        if least:
            match = f"history_steps is {least - 1}.*at least {least}"
            with pytest.raises(ConfigError, match=match):
                play([road()], traffic, history_steps=least - 1)


def test_a_scene_that_is_too_short_says_what_fits():
    with pytest.raises(SceneError, match=r"road-25.*num_steps is 25.*= 32.*at most 23 fits"):
        play([road(25)], "replay")
    _, taken = play([road(25)], "replay", history_steps=23)
    assert taken == 1
    with pytest.raises(SceneError, match="at least 2"):
        play([road(1)], "replay", history_steps=0)
