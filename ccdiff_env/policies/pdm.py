"""A planner in the manner of PDM (Dauner et al. 2023): proposals, rolled out and scored.

Differs from PDM-Closed: the route of the environment stands for the centreline search, bodies are
discs in the collision check, and the score is that of this file.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import IdmConfig
from ccdiff_env.policies.steering import Steering
from ccdiff_env.worlds import Worlds

__all__ = ["PdmPlanner"]

F64 = npt.NDArray[np.float64]

#: Proposals: share of the desired speed, and distance from the route, m.
SPEED_SHARES = (0.2, 0.4, 0.6, 0.8, 1.0)
OFFSETS_M = (0.0, 1.0, -1.0)
#: Rollout: step and length, s.
STEP_S, HORIZON_S = 0.2, 4.0
#: IDM of the proposals.
IDM = IdmConfig(deceleration_mps2=3.0)


class PdmPlanner:
    """Drives the first slot of every world.

    Others are forecast at constant velocity. Each proposal follows the route at an offset with the
    intelligent driver model behind whoever is in its way; of the proposals without a contact the
    one with the best mix of progress, time to contact and comfort is taken, else the one whose
    contact comes last.

    Parameters
    ----------
    worlds
        Worlds with one slot, driven from outside, with continuous actions.
    """

    def __init__(self, worlds: Worlds) -> None:
        self._worlds = worlds
        self._steering = Steering(worlds)
        self._proposals = np.array([(s, d) for d in OFFSETS_M for s in SPEED_SHARES])

    def __call__(self, obs: object) -> npt.NDArray[np.float32]:
        """Return the actions [E, W] of all worlds."""
        return np.stack([self.act(i) for i in range(self._worlds.num_worlds)])

    def act(self, world_idx: int) -> npt.NDArray[np.float32]:
        """Return the action [W] of a world's first slot; zeros where it is empty."""
        native = self._worlds.native
        agents = native.slot_agents(world_idx)
        route = native.route(world_idx, 0)
        if agents[0] is None or route is None:
            return np.zeros(native.action_width, np.float32)
        states = native.states(world_idx)
        ego = agents[0]
        scene = self._worlds.scenes[native.status(world_idx).scene_idx]
        plans = self._roll(states, ego, route[0].astype(np.float64), scene.sizes)
        best = int(np.argmax(plans["score"]))
        return self._steering.action(
            world_idx,
            states,
            ego,
            float(plans["acceleration"][best]),
            float(self._proposals[best, 1]),
        )

    def _roll(self, states: Any, ego: int, route: F64, sizes: Any) -> dict[str, F64]:
        """Roll out all proposals: first acceleration [P] and score [P]."""
        others = np.flatnonzero(states["active"])
        others = others[others != ego]
        steps = int(HORIZON_S / STEP_S)
        times = STEP_S * np.arange(1, steps + 1)
        forecast = (
            states["position"][others][:, None]
            + times[:, None] * states["velocity"][others][:, None]
        )
        path = _Path(route)
        speed = float(states["speed"][ego])
        desired = self._worlds.config.speed_limit_mps * self._proposals[:, 0]
        offset = self._proposals[:, 1]
        length, width = float(sizes[ego, 0]), float(sizes[ego, 1])
        half = 0.5 * (sizes[others, 0] + length)
        side = 0.5 * (sizes[others, 1] + width) + 0.3
        s = np.full(len(offset), path.project(states["position"][ego][None])[0, 0])
        v = np.full(len(offset), max(speed, 0.0))
        first: F64 | None = None
        contact = np.full(len(offset), np.inf)
        least_ttc = np.full(len(offset), np.inf)
        start, effort = s.copy(), np.zeros(len(offset))
        for t in range(steps):
            frenet = path.project(forecast[:, t]) if len(others) else np.zeros((0, 2))
            gap = frenet[None, :, 0] - s[:, None] - half[None]
            beside = np.abs(frenet[None, :, 1] - offset[:, None])
            ahead = (beside < side[None]) & (gap > -half[None])
            gap = np.where(ahead, gap, np.inf).min(axis=1, initial=np.inf)
            a = _idm(v, desired, gap)
            first = a if first is None else first
            effort += np.abs(a)
            s, v = s + np.maximum(v + 0.5 * a * STEP_S, 0.0) * STEP_S, np.maximum(v + a * STEP_S, 0)
            touching = gap <= 0.0
            contact = np.where(touching, np.minimum(contact, times[t]), contact)
            least_ttc = np.minimum(
                least_ttc, np.where(gap < np.inf, gap / np.maximum(v, 0.1), np.inf)
            )
        progress = (s - start) / max(float((s - start).max()), 1.0)
        calm = 1.0 - np.minimum(effort / steps / 4.0, 1.0)
        score = 5 * progress + 5 * (least_ttc > 1.0) + 2 * calm - 1.0 * np.abs(offset)
        score = np.where(np.isfinite(contact), -100.0 + contact, score)
        assert first is not None
        return {"acceleration": first, "score": score}


def _idm(speed: F64, desired: F64, gap: F64) -> F64:
    """Return the accelerations of the proposals, m/s².

    A second IDM beside that of the traffic (``rust/sim/src/policy/idm.rs``), on purpose: it takes
    many proposals at once, in float64, and whoever is ahead as standing, so that a proposal that
    brakes in time is safe whatever the other does. Both take their parameters from one class.
    """
    rise, fall = IDM.acceleration_mps2, IDM.deceleration_mps2
    free = 1.0 - (speed / np.maximum(desired, 0.1)) ** IDM.exponent
    wanted = IDM.min_gap_m + speed * IDM.headway_s + speed**2 / (2 * np.sqrt(rise * fall))
    pressure = np.where(np.isfinite(gap), wanted / np.maximum(gap, 0.1), 0.0)
    a: F64 = rise * (free - pressure**2)
    return np.clip(a, -IDM.max_braking_mps2, rise)


class _Path:
    """Positions along a polyline [P, 2], and distances from it."""

    def __init__(self, points: F64) -> None:
        moves = np.linalg.norm(np.diff(points, axis=0), axis=1)
        kept = np.concatenate([[True], moves > 1e-3])
        self.points = points[kept]
        steps = np.diff(self.points, axis=0)
        self.lengths = np.linalg.norm(steps, axis=1)
        self.tangents = steps / self.lengths[:, None] if len(steps) else np.zeros((0, 2))
        self.starts = np.concatenate([[0.0], np.cumsum(self.lengths)])

    def project(self, positions: Any) -> F64:
        """Return position along the path and signed distance, left positive, [N, 2]."""
        if not len(self.tangents):
            return np.zeros((len(positions), 2))
        offset = np.asarray(positions, np.float64)[:, None] - self.points[None, :-1]
        along = np.clip((offset * self.tangents).sum(-1), 0.0, self.lengths)
        away = offset - along[..., None] * self.tangents
        nearest = (away**2).sum(-1).argmin(axis=1)
        rows = np.arange(len(offset))
        tangent = self.tangents[nearest]
        d = offset[rows, nearest]
        side = tangent[:, 0] * d[:, 1] - tangent[:, 1] * d[:, 0]
        return np.stack([self.starts[nearest] + along[rows, nearest], side], axis=1)
