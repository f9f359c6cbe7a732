"""Rollouts as the compact bytes that the replay page reads.

Layout before compression (zlib): length of the header (u32, little endian), the header (JSON), then
the arrays that the header lists, each at a multiple of four bytes. Arrays hold whole numbers: a
value is ``base + step * number``; those marked ``delta`` hold differences along the last axis,
wrapping round like their type.
"""

from __future__ import annotations

import base64
import json
import struct
import zlib
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.metrics.causal import GRAPH_DISTANCE_M, GRAPH_TTC_S
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.traffic import TrafficPlan
from ccdiff_env.view.captions import (
    about,
    agent_titles,
    driver_of,
    driver_title,
    ego_title,
    still,
    subtitle,
)
from ccdiff_env.view.contacts import contacts
from ccdiff_env.view.outcome import happenings, outcome

LENGTH_STEP_M = 0.01
ANGLE_STEP_RAD = 1e-4
SPEED_STEP_MPS = 0.01
TTC_STEP_S = 0.05
PLAN_SPACING_S = 0.4  #: Time between the points of planned samples, at least.
PLAN_SAMPLES = 12  #: Samples kept of a plan, at most; the selected one is always kept.

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
    arrays = _Arrays()
    layers = _add_map(arrays, rollout)
    _add_tracks(arrays, rollout)
    _add_pairs(arrays, rollout)
    header = {
        "run": _run(rollout, title) | {"layers": layers},
        "plans": [_add_plan(arrays, rollout, i, plan) for i, plan in enumerate(rollout.plans)],
        "arrays": arrays.entries,
    }
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    raw = b"".join([_padded(struct.pack("<I", len(text)) + text), *arrays.parts])
    return base64.b64encode(zlib.compress(raw, 9)).decode()


class _Arrays:
    """Arrays in the order in which they are written, and what the header says of them."""

    def __init__(self) -> None:
        self.entries: list[dict[str, Any]] = []
        self.parts: list[bytes] = []

    def whole(self, name: str, values: npt.ArrayLike, dtype: str) -> None:
        """Add whole numbers as they are."""
        self._add(name, np.asarray(values).astype(f"<{dtype}"), {})

    def real(self, name: str, values: npt.ArrayLike, step: float) -> None:
        """Add real numbers in steps of ``step``, coarser where two bytes would not do."""
        array = np.asarray(values, dtype=np.float64)
        low, high = (array.min(), array.max()) if array.size else (0.0, 0.0)
        base = float(low + high) / 2.0
        step = max(step, float(high - low) / 65_000.0)
        numbers = np.rint((array - base) / step).astype("<i2")
        if numbers.ndim == 0 or numbers.size == 0:
            numbers = numbers.reshape(-1)
        first = numbers[..., :1]
        numbers = np.concatenate([first, np.diff(numbers, axis=-1)], axis=-1)
        self._add(name, numbers, {"step": step, "base": base, "delta": True})

    def _add(self, name: str, array: npt.NDArray[Any], more: dict[str, Any]) -> None:
        kind = f"{array.dtype.kind}{array.dtype.itemsize}"
        self.entries.append({"name": name, "type": kind, "shape": list(array.shape), **more})
        self.parts.append(_padded(np.ascontiguousarray(array).tobytes()))


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


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
    fate = outcome(rollout)
    return {
        "title": title,
        "subtitle": subtitle(rollout).partition(" · ")[2],
        "about": about(rollout),
        "dt": rollout.dt_s,
        "startStep": rollout.start_step,
        "numSteps": rollout.num_steps,
        "graphTtc": GRAPH_TTC_S,
        "graphDistance": GRAPH_DISTANCE_M,
        "agents": agents,
        "events": [asdict(event) for event in happenings(rollout)],
        "outcome": {"tone": fate.tone, "text": fate.text, "others": fate.others},
        "opening": round(fate.opening_s, 3),
    }


def _add_tracks(arrays: _Arrays, rollout: Rollout) -> None:
    valid = rollout.valid
    held = _held(valid)
    rows = np.arange(len(valid))[:, None]
    heading = np.angle(np.exp(1j * rollout.heading[rows, held].astype(np.float64)))
    position, velocity = rollout.position[rows, held], rollout.velocity[rows, held]
    arrays.real("x", position[..., 0], LENGTH_STEP_M)
    arrays.real("y", position[..., 1], LENGTH_STEP_M)
    arrays.real("heading", heading, ANGLE_STEP_RAD)
    arrays.real("vx", velocity[..., 0], SPEED_STEP_MPS)
    arrays.real("vy", velocity[..., 1], SPEED_STEP_MPS)
    arrays.whole("valid", valid, "u1")


def _held(valid: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Steps [A, T] whose state stands for each step: its own, else the last, else the first."""
    steps = np.arange(valid.shape[1])
    last = np.maximum.accumulate(np.where(valid, steps, -1), axis=1)
    first = np.where(valid.any(axis=1), valid.argmax(axis=1), 0)
    return np.where(last < 0, first[:, None], last)


def _add_pairs(arrays: _Arrays, rollout: Rollout) -> None:
    """Pairs of agents on course to meet, at every step."""
    starts, first, second, seconds = [0], [], [], []
    for a, b, ttc in contacts(rollout):
        first.append(a)
        second.append(b)
        seconds.append(np.rint(ttc / TTC_STEP_S))
        starts.append(starts[-1] + len(a))
    arrays.whole("pairStart", starts, "u4")
    arrays.whole("pairA", np.concatenate(first), "u2")
    arrays.whole("pairB", np.concatenate(second), "u2")
    arrays.whole("pairTtc", np.concatenate(seconds), "u1")
    arrays.entries[-1] |= {"step": TTC_STEP_S, "base": 0.0}


def _add_plan(arrays: _Arrays, rollout: Rollout, index: int, plan: TrafficPlan) -> dict[str, Any]:
    samples = plan.samples[..., :2].astype(np.float64)
    stride = max(1, round(PLAN_SPACING_S / rollout.dt_s))
    steps = np.unique(
        np.append(np.arange(stride - 1, samples.shape[2], stride), samples.shape[2] - 1)
    )
    # The selected sample of each agent comes first.
    order = np.argsort(
        np.arange(len(samples))[:, None] != plan.selected_sample[None, :], axis=0, kind="stable"
    )
    kept = np.take_along_axis(samples, order[:PLAN_SAMPLES, :, None, None], axis=0)[:, :, steps]
    agents = plan.agents.tolist()
    here = np.broadcast_to(rollout.position[agents, plan.made_at], kept[:, :, 0].shape)
    kept = np.nan_to_num(np.concatenate([here[:, :, None], kept], axis=2))
    arrays.real(f"plan{index}x", kept[..., 0], 5 * LENGTH_STEP_M)
    arrays.real(f"plan{index}y", kept[..., 1], 5 * LENGTH_STEP_M)
    into, origin = np.nonzero(plan.graph & ~np.eye(len(agents), dtype=bool))
    return {
        "made_at": plan.made_at,
        "agents": agents,
        "num_samples": len(kept),
        "num_points": kept.shape[2],
        "guided": [int(g) for g in plan.guided],
        "follows_plan": [int(e) for e in plan.follows_plan],
        "realism_cost": [round(float(c), 4) for c in np.nan_to_num(plan.realism_cost)],
        "edges": [[agents[j], agents[i]] for i, j in zip(into, origin, strict=True)],
    }


def _add_map(arrays: _Arrays, rollout: Rollout) -> dict[str, list[list[int]]]:
    """Add the points of all layers; return the lengths of the rings and lines of each."""
    layers = rollout.scene.map_layers()
    points: list[npt.NDArray[np.float32]] = []
    lengths: dict[str, list[list[int]]] = {}

    def add(name: str, entries: Iterable[list[npt.NDArray[np.float32]]]) -> None:
        lengths[name] = []
        for rings in entries:
            lengths[name].append([len(ring) for ring in rings])
            points.extend(rings)

    surfaces = layers.get("drivable_area") or [lane["polygon"] for lane in layers.get("lanes", [])]
    for name, key in _AREAS.items():
        polygons = surfaces if name == "drivable" else layers.get(key, [])
        add(name, ([p["exterior"], *p["holes"]] for p in polygons))  # type: ignore[attr-defined]
    for name in _LINES:
        add(name, ([line] for line in layers.get(name, [])))  # type: ignore[attr-defined]
    add("lanes", ([lane["centreline"][::2]] for lane in layers.get("lanes", [])))
    joined = np.concatenate(points) if points else np.zeros((0, 2), np.float32)
    arrays.real("mapX", joined[:, 0], LENGTH_STEP_M)
    arrays.real("mapY", joined[:, 1], LENGTH_STEP_M)
    return lengths
