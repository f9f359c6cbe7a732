"""What an adversary policy sees, and step metrics of any agents, against numpy."""

from __future__ import annotations

import numpy as np
import pytest

from ccdiff_env import AdversarySelectionEnv, embedded_scenes
from ccdiff_env.envs.selection.view import FEATURES
from ccdiff_env.errors import ShapeError, UnknownNameError
from ccdiff_env.metrics import causal

QUICK = {"ccdiff": {"denoising_steps": 2, "explain": True}, "horizon_steps": 40}


@pytest.fixture(scope="module")
def scenes():
    return embedded_scenes("val")


def rows_in_numpy(states, size, chosen, before, plan, num_rows):
    """Rows and matrices of the ego, ``chosen[0]``, and the candidates."""
    n, k = num_rows + 1, len(chosen)
    position, heading, speed = (states[f][chosen] for f in ("position", "heading", "speed"))
    seconds = causal.ttc(position, heading, speed, size[chosen], normalised=False)
    metres = causal.distance(position)
    cos, sin = np.cos(heading[0], dtype=float), np.sin(heading[0], dtype=float)
    turn = np.array([[cos, -sin], [sin, cos]])
    at = (position - position[0]) @ turn
    moving = (states["velocity"][chosen] - states["velocity"][chosen[0]]) @ turn
    columns = [
        *(at / 50.0).T,
        np.cos(heading - heading[0]),
        np.sin(heading - heading[0]),
        *(moving / 15.0).T,
        speed / 15.0,
        states["acceleration"][chosen] / 5.0,
        size[chosen, 0] / 10.0,
        size[chosen, 1] / 5.0,
        causal.normalise_ttc(seconds)[0],
        [agent in before for agent in chosen],
        np.ones(k),
    ]
    agents = np.zeros((n, len(columns)))
    agents[:k] = np.clip(np.stack(columns, axis=1), -5.0, 5.0)
    attention = np.zeros((k, k))
    if plan is not None and plan.attention is not None:
        place = {int(agent): i for i, agent in enumerate(plan.agents)}
        for i, one in enumerate(chosen):
            for j, other in enumerate(chosen):
                if one in place and other in place:
                    attention[i, j] = np.clip(plan.attention[place[one], place[other]], 0, 1)
    found = {"agents": agents}
    for name, values in {
        "ttc": causal.normalise_ttc(seconds),
        "distance": 1.0 - np.minimum(metres, 50.0) / 50.0,
        "graph": causal.graph(seconds, metres).adjacency,
        "attention": attention,
    }.items():
        found[name] = np.zeros((n, n))
        found[name][:k, :k] = values
    return found


def test_rows_and_step_metrics_are_those_of_numpy(scenes):
    env = AdversarySelectionEnv(scenes=scenes, ego="idm", max_agents=5, **QUICK)
    native, attended, driven = env.worlds.native, 0, []
    for seed in range(2):
        env.reset(seed=seed)
        episode, steps, before = env._batch.episode(0), [], set()
        last = native.states(0)

        def look(episode=episode, steps=steps):
            nonlocal last
            now, dt_s = native.states(0), env.worlds.config.dt_s
            rows = [i for i in episode.before if now["active"][i] and last["active"][i]]
            if rows:
                acceleration = now["acceleration"][rows].astype(float)
                jerk = (acceleration - last["acceleration"][rows]) / dt_s
                lateral = now["speed"][rows].astype(float) * now["yaw_rate"][rows]
                cost = (acceleration / 4) ** 2 + (jerk / 10) ** 2 + (lateral / 4) ** 2
                off_road = native.off_road(0)[0][rows].mean()
                steps.append((np.minimum(cost, 3.0).mean(), off_road))
            last = now

        env._batch.on_step = look
        size = env.scene.sizes[:, :2]
        done = False
        while not done:
            rows = episode.rows(5)
            obs, plan = env._batch.observe(0), episode.plan()
            want = rows_in_numpy(native.states(0), size, [episode.ego, *rows], before, plan, 5)
            assert obs["agents"].shape == (6, len(FEATURES))
            for name, values in want.items():
                np.testing.assert_allclose(obs[name], values, atol=2e-6, err_msg=name)
            attended += float(obs["attention"].sum()) > 0
            steps.clear()
            _, _, terminated, truncated, info = env.step(np.ones(5, np.int8))
            before, done = set(episode.before), terminated or truncated
            if steps:
                discomfort, off_road = np.mean(steps, axis=0)
                assert info["discomfort"] == pytest.approx(discomfort, rel=1e-4, abs=1e-5)
                assert info["off_road"] == pytest.approx(off_road)
                driven.append(info["discomfort"])
    assert attended > 0
    assert max(driven) > 0.0


def test_agents_that_are_not_there_are_refused(scenes):
    env = AdversarySelectionEnv(scenes=scenes[:1], horizon_steps=20)
    env.reset(seed=0)
    native = env.worlds.native
    # nothing has happened since the reset
    assert native.step_metrics(0, [0, 1]) == {"num_agents": 0, "off_road": 0.0, "discomfort": 0.0}
    num_agents = len(env.scene.agent_ids)
    for call in (
        lambda: native.step_metrics(0, [num_agents]),
        lambda: native.candidates(0, [num_agents], [], 3),
    ):
        with pytest.raises(UnknownNameError, match=f"below {num_agents}"):
            call()
    with pytest.raises(ShapeError, match="rows"):
        native.candidates(0, [1, 2, 3], [], 2)
