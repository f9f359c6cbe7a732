"""Rollouts as the compressed text that the replay page reads.

It is JSON, compressed by zlib, in base64. Of an array it holds the differences along the last axis,
as whole numbers of a step; ``row`` is the length of that axis.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.metrics import causal
from ccdiff_env.record.rollout import Intention, Rollout
from ccdiff_env.scenes.scene_types import LIGHT_STATES
from ccdiff_env.traffic import TrafficPlan
from ccdiff_env.view.captions import (
    agent_titles,
    driver_of,
    driver_title,
    ego_title,
    still,
    subtitle,
)
from ccdiff_env.view.outcome import Happening, happenings, outcome

LENGTH_STEP_M = 0.01
ANGLE_STEP_RAD = 1e-4
SPEED_STEP_MPS = 0.01
PLAN_SPACING_S = 0.4  #: Time between the points of planned samples, at least.
PLAN_SAMPLES = 12  #: Samples kept of a plan, at most; the selected one is always kept.
TTC_CAP_S = 10.0  #: Pairs that meet later than this are left out.

Array = dict[str, Any]  #: As the page reads it.

_AREAS = {
    "drivable": "drivable_area",
    "walkways": "walkways",
    "carparks": "carpark_areas",
    "stops": "stop_lines",
    "crossings": "ped_crossings",
}
_LINES = ("road_dividers", "lane_dividers")


def pack(rollout: Rollout, title: str) -> str:
    """Return the text of a rollout's data element, base64 of the compressed bytes; ``title`` is the
    short name of the run on the page.
    """
    header = {
        "run": _run(rollout, title) | {"pairs": [*contacts(rollout)]},
        "layers": _map(rollout),
        "plans": [_plan(rollout, plan) for plan in rollout.plans],
        "intentions": [_intention(rollout, meant) for meant in rollout.intentions],
        "arrays": _tracks(rollout),
    }
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    return base64.b64encode(zlib.compress(text, 9)).decode()


def _packed(values: npt.ArrayLike, step: float = 1) -> Array:
    """An array in steps."""
    numbers = np.rint(np.asarray(values, np.float64) / step).astype(np.int64)
    deltas = np.diff(numbers, axis=-1, prepend=0)
    return {"step": step, "row": max(numbers.shape[-1], 1), "deltas": deltas.ravel().tolist()}


def _run(rollout: Rollout, title: str) -> dict[str, Any]:
    """What the header says of a run."""
    scene = rollout.scene
    kinds, ids = scene.agent_types, rollout.agent_ids
    sizes = scene.sizes.astype(float).round(2).tolist()
    standing = still(rollout).tolist()
    agents = [
        {
            "id": ids[i],
            "label": label,
            "title": long,
            "kind": kinds[i],
            "length": sizes[i][0],
            "width": sizes[i][1],
            "driver": driver_of(rollout, i),
            "drivenBy": ego_title(rollout) if ids[i] == "ego" else driver_title(rollout, i),
            "still": stays,
        }
        for i, ((label, long), stays) in enumerate(zip(agent_titles(scene), standing, strict=True))
    ]
    fate, rescue = outcome(rollout), rollout.meta.get("rescue", {})
    return {
        "title": title,
        "subtitle": subtitle(rollout).partition(" · ")[2],
        "dt": rollout.dt_s,
        "startStep": rollout.start_step,
        "numSteps": rollout.num_steps,
        "graphTtc": causal.GRAPH_TTC_S,
        "graphDistance": causal.GRAPH_DISTANCE_M,
        "agents": agents,
        "events": [_event(happening) for happening in happenings(rollout)],
        "outcome": {name: getattr(fate, name) for name in ("tone", "text", "fault", "others")}
        | {"rescue": rescue.get("text", "")},
        "rescue": {"step": rescue.get("step", 0), "path": rescue.get("path", [])},
        "opening": round(fate.opening_s, 3),
        "lights": [*_lights(rollout)],
    }


def _lights(rollout: Rollout) -> Iterator[dict[str, Any]]:
    """Yield the stop line of each traffic light, and from which steps on it shows what."""
    for light in rollout.scene.map_layers().get("lights", []):
        first, states = rollout.start_step, light["states"]
        steps = np.minimum(np.arange(first, first + rollout.num_steps), len(states) - 1)
        shown = states[steps]
        changes = np.flatnonzero(np.diff(shown, prepend=255))
        line = light["stop_line"].astype(float).round(2).tolist()
        yield {"line": line, "shows": [[int(k), LIGHT_STATES[shown[k]]] for k in changes]}


def _event(happening: Happening) -> dict[str, Any]:
    named = ("step", "agent", "partner", "lane", "kind", "fault")
    return {name: getattr(happening, name) for name in named} | {"text": happening.told()}


def _tracks(rollout: Rollout) -> dict[str, Array]:
    valid = rollout.valid
    held = _held(valid)
    rows = np.arange(len(valid))[:, None]
    heading = np.unwrap(rollout.heading[rows, held].astype(np.float64))
    position, velocity = rollout.position[rows, held], rollout.velocity[rows, held]
    return {
        "x": _packed(position[..., 0], LENGTH_STEP_M),
        "y": _packed(position[..., 1], LENGTH_STEP_M),
        "heading": _packed(heading, ANGLE_STEP_RAD),
        "vx": _packed(velocity[..., 0], SPEED_STEP_MPS),
        "vy": _packed(velocity[..., 1], SPEED_STEP_MPS),
        "valid": _packed(valid),
    }


def _held(valid: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Steps [A, T] whose state stands for each step: its own, else the last, else the first."""
    steps = np.arange(valid.shape[1])
    last = np.maximum.accumulate(np.where(valid, steps, -1), axis=1)
    first = np.where(valid.any(axis=1), valid.argmax(axis=1), 0)
    return np.where(last < 0, first[:, None], last)


def contacts(rollout: Rollout) -> Iterator[list[tuple[int, int, float]]]:
    """Yield for each step the pairs (a < b) that meet within :data:`TTC_CAP_S`, and when, seconds.

    Boxes move at constant velocities. Pairs of static obstacles and pairs of walkers are left out.
    """
    valid = rollout.valid.T
    speed = np.linalg.norm(rollout.velocity, axis=-1).T
    forwards = (
        rollout.velocity[..., 0] * np.cos(rollout.heading)
        + rollout.velocity[..., 1] * np.sin(rollout.heading)
    ).T
    kinds = np.array(rollout.scene.agent_types)
    alike = kinds[:, None] == kinds[None, :]
    dull = np.isin(kinds, ("static", "pedestrian"))
    upper = np.triu(~(alike & dull), 1)
    for t in range(rollout.num_steps):
        seconds = causal.ttc(
            rollout.position[:, t],
            rollout.heading[:, t],
            np.copysign(speed[t], forwards[t]),
            rollout.scene.sizes[:, :2],
            valid[t],
            elevation_m=None if rollout.elevation_m is None else rollout.elevation_m[:, t],
            normalised=False,
        )
        a, b = np.nonzero((seconds <= TTC_CAP_S) & upper)
        times = seconds[a, b].astype(float).round(2)
        yield [*zip(a.tolist(), b.tolist(), times.tolist(), strict=True)]


def _plan(rollout: Rollout, plan: TrafficPlan) -> dict[str, Any]:
    samples = plan.samples[..., :2].astype(np.float64)
    steps = _spaced(rollout, samples.shape[2])
    # The selected sample of each agent comes first.
    order = np.argsort(
        np.arange(len(samples))[:, None] != plan.selected_sample[None, :], axis=0, kind="stable"
    )
    kept = np.take_along_axis(samples, order[:PLAN_SAMPLES, :, None, None], axis=0)[:, :, steps]
    agents = plan.agents.tolist()
    here = np.broadcast_to(rollout.position[agents, plan.made_at], kept[:, :, 0].shape)
    kept = np.nan_to_num(np.concatenate([here[:, :, None], kept], axis=2))
    into, origin = np.nonzero(plan.graph & ~np.eye(len(agents), dtype=bool))
    moved_m = np.zeros(len(agents)) if plan.moved_m is None else plan.moved_m
    return {
        "x": _packed(kept[..., 0], 5 * LENGTH_STEP_M),
        "y": _packed(kept[..., 1], 5 * LENGTH_STEP_M),
        "made_at": plan.made_at,
        "agents": agents,
        "num_samples": len(kept),
        "num_points": kept.shape[2],
        "guided": [int(g) for g in plan.guided],
        "follows_plan": [int(e) for e in plan.follows_plan],
        "moved_m": [round(float(m), 2) for m in np.nan_to_num(moved_m)],
        "edges": [[agents[j], agents[i]] for i, j in zip(into, origin, strict=True)],
    }


def _intention(rollout: Rollout, meant: Intention) -> dict[str, Any]:
    """Candidates of the ego's planner, the one that it drives first, then by cost; ``share`` is
    what each costs, 0 of the cheapest to 1 of the dearest of all.
    """
    steps = _spaced(rollout, meant.trajectories.shape[1])
    kept = meant.trajectories[:PLAN_SAMPLES, steps, :2].astype(np.float64)
    here = rollout.position[rollout.agent_ids.index("ego"), meant.made_at]
    kept = np.concatenate([np.broadcast_to(here, (len(kept), 1, 2)), kept], axis=1)
    costs = meant.costs.astype(np.float64) - meant.costs.min()
    return {
        "x": _packed(kept[..., 0], 5 * LENGTH_STEP_M),
        "y": _packed(kept[..., 1], 5 * LENGTH_STEP_M),
        "made_at": meant.made_at,
        "num_points": kept.shape[1],
        "share": (costs / max(costs.max(), 1e-9)).round(3).tolist()[:PLAN_SAMPLES],
    }


def _spaced(rollout: Rollout, num_steps: int) -> npt.NDArray[np.int64]:
    """Steps of a plan that are drawn: :data:`PLAN_SPACING_S` apart, and the last."""
    stride = max(1, round(PLAN_SPACING_S / rollout.dt_s))
    steps = np.append(np.arange(stride - 1, num_steps, stride), num_steps - 1)
    spaced: npt.NDArray[np.int64] = np.unique(steps)
    return spaced


def _map(rollout: Rollout) -> dict[str, list[list[Array]]]:
    """Rings and lines [2, N] of each layer."""
    layers: dict[str, Any] = {**rollout.scene.map_layers()}
    lanes = layers.get("lanes", [])
    areas = {name: layers.get(key, []) for name, key in _AREAS.items()}
    areas["drivable"] = areas["drivable"] or [lane["polygon"] for lane in lanes]
    found = {name: [[a["exterior"], *a["holes"]] for a in of] for name, of in areas.items()}
    found |= {name: [[line] for line in layers.get(name, [])] for name in _LINES}
    found["lanes"] = [[lane["centreline"][::2]] for lane in lanes]
    return {
        name: [[_packed(ring.T, LENGTH_STEP_M) for ring in rings] for rings in entries]
        for name, entries in found.items()
    }
