"""Reactivity: the ego leaves its log in plausible ways, and the others must avoid it.

In the manner of reactivity tests of nuPlan, not an implementation of any. An ego that moves at
2 m/s or faster at the start of the episode

* ``speed``: brakes on its logged path with 2 m/s², or as the log where that is slower;
* ``lateral``: moves over by 1.5 m within 3 s at its logged pace, to the left, else to the right,
  where its centre stays on the road;
* ``direction``: turns off by 30 degrees with at most 1.5 m/s² across, at the speed it has, and
  brakes with 3 m/s² to a standstill before its centre leaves the road; to the left, else right.

``log`` is the floor: the ego does as logged. A way that a scene has no room for is left out of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.episode import driven, logged, off_road
from ccdiff_env.bench.planner_score import TTC_BOUND_S
from ccdiff_env.bench.planners import HISTORY_STEPS, Traffic, drive
from ccdiff_env.errors import UnknownNameError
from ccdiff_env.metrics import Motion
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene, SceneSet, with_tracks

WAYS = ("log", "speed", "lateral", "direction")
LEAST_SPEED_MPS, LEAST_CHANGE_M = 2.0, 1.0
BRAKING_MPS2, STOPPING_MPS2 = 2.0, 3.0
OFFSET_M, OFFSET_S = 1.5, 3.0
TURN_RAD, ACROSS_MPS2, YAW_RATE_RADPS = np.pi / 6, 1.5, 0.3

F64 = npt.NDArray[np.float64]
Path3 = tuple[F64, F64, F64]  #: x, y and heading after each step.


def altered(scene: Scene, way: str) -> Scene | None:
    """Return a scene in which the log of the ego takes another of :data:`WAYS` from the start on.

    ``None`` where there is no ego that moves, or no room.
    """
    if way not in WAYS:
        raise UnknownNameError(f"no way {way!r}, there are {', '.join(WAYS)}")
    tracks = {name: np.array(values) for name, values in scene.tracks().items()}
    ego = list(scene.agent_ids).index("ego") if "ego" in scene.agent_ids else None
    if ego is None or not tracks["valid"][ego, HISTORY_STEPS:].all():
        return None
    if np.linalg.norm(tracks["velocity"][ego, HISTORY_STEPS]) < LEAST_SPEED_MPS:
        return None
    if way == "log":
        return scene
    path = _path(scene, tracks, ego, way)
    if path is None:
        return None
    x, y, heading = path
    after = slice(HISTORY_STEPS, None)
    position = np.stack([x, y], axis=-1)
    tracks["velocity"][ego, HISTORY_STEPS + 1 :] = np.diff(position, axis=0) / scene.dt
    tracks["position"][ego, after] = position
    tracks["heading"][ego, after] = heading
    return with_tracks(scene, tracks)


def _path(scene: Scene, tracks: Mapping[str, Any], ego: int, way: str) -> Path3 | None:
    x, y = tracks["position"][ego, HISTORY_STEPS:].T.astype(np.float64)
    heading = tracks["heading"][ego, HISTORY_STEPS:].astype(np.float64)
    speed = float(np.linalg.norm(tracks["velocity"][ego, HISTORY_STEPS]))
    time_s = np.arange(len(x)) * scene.dt
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    if way == "speed":
        until = np.minimum(time_s, speed / BRAKING_MPS2)
        driven = speed * until - 0.5 * BRAKING_MPS2 * until**2
        # where the log brakes harder, so does the ego
        driven = np.minimum(driven, way_m)
        far = np.max(way_m - driven) > LEAST_CHANGE_M
        return _at(driven, way_m, (x, y, heading)) if far else None
    for side in (1.0, -1.0):
        if way == "lateral":
            share = np.clip(time_s / OFFSET_S, 0.0, 1.0)
            offset = side * OFFSET_M * share**2 * (3.0 - 2.0 * share)
            x2, y2 = x - offset * np.sin(heading), y + offset * np.cos(heading)
            pace = np.maximum(np.gradient(way_m, scene.dt), 1.0)
            path = (x2, y2, heading + np.arctan2(np.gradient(offset, scene.dt), pace))
            if not _off_road(scene, ego, path).any():
                return path
            continue
        rate = min(YAW_RATE_RADPS, ACROSS_MPS2 / speed)
        turned = heading[0] + side * np.minimum(rate * time_s, TURN_RAD)
        step = speed * scene.dt
        x2 = x[0] + np.concatenate([[0.0], np.cumsum(step * np.cos(turned[:-1]))])
        y2 = y[0] + np.concatenate([[0.0], np.cumsum(step * np.sin(turned[:-1]))])
        off = _off_road(scene, ego, (x2, y2, turned))
        room_m = step * (int(off.argmax()) - 1 if off.any() else len(x))
        if room_m < speed**2 / (2.0 * STOPPING_MPS2) + step:
            continue
        driven, now = np.zeros(len(x)), speed
        for k in range(1, len(x)):
            left_m = max(room_m - driven[k - 1], 0.0)
            now = min(now, np.sqrt(2.0 * STOPPING_MPS2 * left_m))
            driven[k] = driven[k - 1] + min(now * scene.dt, left_m)
        return _at(driven, step * np.arange(len(x)), (x2, y2, turned))
    return None


def _at(driven_m: F64, way_m: F64, path: Path3) -> Path3:
    """Where a path is after so many metres."""
    x, y, heading = (np.interp(driven_m, way_m, values) for values in path)
    return x, y, heading


def _off_road(scene: Scene, ego: int, path: Path3) -> npt.NDArray[np.bool_]:
    x, y, heading = (values[None] for values in path)
    size, there = scene.sizes[ego : ego + 1, :2], np.ones(x.shape, bool)
    heights = scene.tracks().get("elevation_m")
    motion = Motion(
        np.stack([x, y], axis=-1),
        heading,
        size,
        there,
        dt_s=scene.dt,
        elevation_m=None if heights is None else heights[ego : ego + 1, -x.size :],
    )
    road = off_road(scene, motion)
    return np.zeros(x.size, bool) if road is None else road.centroid[0]


def reactions(scenes: SceneSet, traffic: Traffic, *, seed: int) -> dict[str, dict[str, float]]:
    """Play scenes with an ego that goes each of :data:`WAYS`; return figures by scene's name.

    ``contact_on_log``, ``contact_off_log``: whether the ego is in a contact with a vehicle that
    touches it neither at the start nor in the log, on its log and on average over the other ways
    that the scene has room for; ``low_ttc_off_log``: whether its least time to contact is below
    0.95 s. A scene without room has no such figures.
    """
    found: dict[str, dict[str, list[float]]] = {}
    for way in WAYS:
        changed = {scene.name: new for scene in scenes if (new := altered(scene, way)) is not None}
        if not changed:
            continue
        batch, names = SceneSet(list(changed.values())), list(changed)
        _, rollouts = drive(batch, "replay", traffic, seed=seed, record=names)
        for name in names:
            contact, low_ttc = _contact(scenes[name], rollouts[name])
            figures = found.setdefault(name, {})
            place = "on_log" if way == "log" else "off_log"
            figures.setdefault(f"contact_{place}", []).append(contact)
            figures.setdefault(f"low_ttc_{place}", []).append(low_ttc)
    return {
        scene: {name: float(np.mean(values)) for name, values in figures.items()}
        for scene, figures in found.items()
    }


def _contact(scene: Scene, rollout: Rollout) -> tuple[float, float]:
    """Whether the ego has a new contact with a vehicle, and a low time to contact."""
    vehicles = np.flatnonzero(np.array(scene.agent_types) == "vehicle")
    ego = int(np.flatnonzero(np.array(scene.agent_ids)[vehicles] == "ego")[0])
    motion = driven(rollout, vehicles)
    steps = slice(rollout.start_step, rollout.start_step + rollout.num_steps)
    new = motion.collisions(log=logged(scene, vehicles, steps)).matrix("new")
    return float(new[ego].any() or new[:, ego].any()), float(motion.min_ttc()[ego] < TTC_BOUND_S)
