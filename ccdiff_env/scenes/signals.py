"""Signal plans for maps without recorded traffic lights, and how recorded drivers obey lights."""

from __future__ import annotations

import hashlib

import numpy as np
import numpy.typing as npt

from ccdiff_env._native import Scene
from ccdiff_env.scenes.scene_types import LIGHT_STATES, Light

__all__ = ["CYCLE_S", "recorded_passes", "with_signals"]

F64 = npt.NDArray[np.float64]

#: States of a phase one after the other, seconds; the other phase is half a cycle later.
PHASE_S = {"green": 4.0, "yellow": 3.0, "red": 9.0}
CYCLE_S = sum(PHASE_S.values())
#: Connectors cross where they come this near at such an angle, unless they begin side by side.
NEAR_M, ANGLE_RAD, BESIDE_M = 2.0, 0.5, 4.5


def with_signals(scene: Scene) -> Scene:
    """Return a scene in which connectors that cross have lights where they begin.

    Connectors of a crossing that begin along one axis share a phase, oncoming ones too. Its cycle
    starts at a time drawn by the scene's name: the recording knows nothing of the plan.
    """
    lanes = scene.map_layers()["lanes"]
    indices = [i for i, lane in enumerate(lanes) if lane["kind"] == "connector"]
    lines = [lanes[i]["centreline"].astype(np.float64) for i in indices]
    group = _groups(lines) if lines else np.zeros(0, np.int64)
    times_s = np.arange(scene.num_steps) * scene.dt
    ends_s = np.cumsum([*PHASE_S.values()])
    codes = np.array([LIGHT_STATES.index(state) for state in PHASE_S], np.uint8)
    lights: list[Light] = []
    for k, index in enumerate(indices):
        if (first := group[k]) >= 0:
            turn_rad = _directions(lines[k])[0] - _directions(lines[first])[0]
            crossing = f"{scene.name} {lanes[indices[first]]['id']}".encode()
            drawn = int.from_bytes(hashlib.sha256(crossing).digest()[:4], "big") / 2**32
            offset_s = CYCLE_S * (drawn + 0.5 * (np.cos(2.0 * turn_rad) < 0.0))
            phase = np.searchsorted(ends_s, (times_s + offset_s) % CYCLE_S, side="right")
            lights.append({"lane": index, "states": codes[phase]})
    return scene.with_lights(lights)


def recorded_passes(scene: Scene) -> tuple[int, int]:
    """Return how often recorded vehicles pass stop lines of lights, and how often in red.

    Both are counted as ``ran_red`` is: by their fronts, and red where every light of the line is.
    """
    layers, log = scene.map_layers(), scene.tracks()
    vehicles = np.array(scene.agent_types) == "vehicle"
    angle, half_m = log["heading"][vehicles], 0.5 * scene.sizes[vehicles, None, :1]
    front = log["position"][vehicles] + half_m * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    valid = log["valid"][vehicles]
    passed = np.zeros(valid[:, 1:].shape, np.bool_)
    free = passed.copy()
    for light in layers.get("lights", []):
        start, bar = light["stop_line"][0], np.diff(light["stop_line"], axis=0)[0]
        way = np.diff(layers["lanes"][light["lane"]]["centreline"][:2], axis=0)[0]
        side = ((front - start) @ [-bar[1], bar[0]]) * np.sign(way @ [-bar[1], bar[0]])
        before, after = side[:, :-1], side[:, 1:]
        crosses = valid[:, 1:] & valid[:, :-1] & (before < 0.0) & (after >= 0.0)
        share = np.divide(before, before - after, out=np.zeros_like(before), where=crosses)
        at = front[:, :-1] + share[..., None] * np.diff(front, axis=1)
        along = (at - start) @ bar
        crosses &= (along >= 0.0) & (along <= bar @ bar)
        passed |= crosses
        free |= crosses & (light["states"][1:] != LIGHT_STATES.index("red"))
    return int(passed.sum()), int((passed & ~free).sum())


def _directions(line: F64) -> F64:
    """Direction of each piece of a line, radians."""
    way = np.diff(line, axis=0)
    angles: F64 = np.arctan2(way[:, 1], way[:, 0])
    return angles


def _groups(lines: list[F64]) -> npt.NDArray[np.int64]:
    """The first line of the crossing of each; -1 for those of none.

    Lines of a crossing cross each other, or begin beside one that crosses another.
    """
    points = np.concatenate([line[:-1:2] for line in lines])
    angles = np.concatenate([_directions(line)[::2] for line in lines])
    owner = np.repeat(np.arange(len(lines)), [len(line[:-1:2]) for line in lines])
    starts = np.array([line[0] for line in lines])
    heading = np.array([_directions(line)[0] for line in lines])
    beside = np.linalg.norm(starts[:, None] - starts, axis=2) < BESIDE_M
    beside &= np.cos(heading[:, None] - heading) > np.cos(ANGLE_RAD)
    a, b = np.nonzero(np.linalg.norm(points[:, None] - points, axis=2) < NEAR_M)
    turned = np.cos(angles[a] - angles[b]) < np.cos(ANGLE_RAD)
    crosses = np.zeros_like(beside)
    crosses[owner[a[turned]], owner[b[turned]]] = True
    crosses &= ~beside
    joined = crosses | beside
    while (more := joined @ joined).sum() > joined.sum():
        joined = more
    is_crossing = (joined & crosses.any(axis=1)).any(axis=1)
    return np.where(is_crossing, joined.argmax(axis=1), -1)
