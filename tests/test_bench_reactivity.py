"""Reactivity: plausible ways off the log, and what the others make of it."""

from __future__ import annotations

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env.bench.episode import drivable
from ccdiff_env.bench.planners import TRAFFIC
from ccdiff_env.bench.reactivity import WAYS, altered, reactions
from ccdiff_env.errors import UnknownNameError
from ccdiff_env.metrics import Motion

START = 30


def test_altered_egos_leave_their_log_within_the_rules():
    found = dict.fromkeys(WAYS, 0)
    for scene in ccdiff_env.embedded_scenes("val"):
        log = scene.tracks()
        for way in WAYS:
            new = altered(scene, way)
            if new is None:
                continue
            found[way] += 1
            tracks, ego = new.tracks(), list(scene.agent_ids).index("ego")
            others = np.delete(np.arange(len(scene.agent_ids)), ego)
            np.testing.assert_array_equal(tracks["position"][others], log["position"][others])
            before = slice(0, START + 1)
            np.testing.assert_allclose(
                tracks["position"][ego, before], log["position"][ego, before], atol=1e-4
            )
            path = tracks["position"][ego, START:].astype(np.float64)
            away = np.linalg.norm(path - log["position"][ego, START:], axis=-1).max()
            assert (away > 1.0) == (way != "log")
            if way == "log":
                continue
            motion = Motion(
                path[None].astype(np.float32), tracks["heading"][ego : ego + 1, START:],
                scene.sizes[ego : ego + 1, :2], np.ones((1, len(path)), bool), dt_s=scene.dt,
            )  # fmt: skip
            if way != "speed":
                assert not motion.off_road(drivable(scene)).centroid.any()
            speed = np.linalg.norm(np.diff(path, axis=0), axis=-1) / scene.dt
            if way == "direction":
                # half a second of braking at 3 m/s², in steps
                assert (speed[5:] - speed[:-5] > -2.0).all()
            if way == "speed":
                logged = np.linalg.norm(np.diff(log["position"][ego, START:], axis=0), axis=-1)
                assert (np.cumsum(speed) * scene.dt <= np.cumsum(logged) + 1e-3).all()
    assert all(found.values()), found


def test_unknown_ways_are_refused():
    with pytest.raises(UnknownNameError, match="no way 'up'"):
        altered(ccdiff_env.embedded_scenes("val")[0], "up")


def test_traffic_that_reacts_has_fewer_contacts_with_an_ego_off_its_log():
    scenes = ccdiff_env.embedded_scenes("val")[:12]
    found = {name: reactions(scenes, TRAFFIC[name], seed=0) for name in ("replay", "idm")}
    mean = {n: np.mean([row["contact_off_log"] for row in of.values()]) for n, of in found.items()}
    assert mean["idm"] < mean["replay"]
    # the log replayed meets an ego on its log as it was
    assert not any(row["contact_on_log"] for row in found["replay"].values())
