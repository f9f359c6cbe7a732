"""The motion behind what is said: what two bring to their contact, and who is in the way.

``assets/contact.js`` computes the same in the playground.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ccdiff_env.record.rollout import Rollout

WAITS_MPS = 0.3  #: Below this an agent waits, and brings nothing to a contact.
AHEAD_M = 5.0  #: Whoever is nearer than this before an agent that waits is in its way.
BLOCKED_S = 2.0  #: An agent that waits so long behind somebody is blocked.

F64 = npt.NDArray[np.float64]


def impact(rollout: Rollout, step: int, one: int, other: int) -> tuple[F64, F64]:
    """Return the normal [2] of the contact that is seen first at a recorded step, from one agent
    (an index) to another, and the speeds [2] that they bring to it, m/s: those of their centres
    towards each other along the normal, negative where one draws back.

    The normal is, of the axes of both boxes, the one along which they were apart last between the
    step before and this one (of boxes that overlapped in all, the one of least overlap).
    """
    pair = [one, other]
    before = step - 1 if step > 0 and rollout.valid[pair, step - 1].all() else step
    a, b = _boxes(rollout, before)[pair]
    apart = gaps_m(a, b)
    moved, velocity = _boxes(rollout, step)[pair, :2], rollout.velocity[pair, step].astype(float)
    gone = ~rollout.valid[pair, step]  # removed by the contact: as before it
    velocity[gone] = rollout.velocity[pair, before][gone]
    moved[gone] = (np.stack([a, b])[:, :2] + velocity * rollout.dt_s)[gone]
    now = gaps_m(np.r_[moved[0], a[2:]], np.r_[moved[1], b[2:]])
    closed = np.where(apart > 0.0, apart / np.maximum(apart - now, 1e-9), apart)
    turn = (a[2], a[2] + np.pi / 2, b[2], b[2] + np.pi / 2)[int(np.argmax(closed))]
    normal = np.array([np.cos(turn), np.sin(turn)])
    normal *= np.copysign(1.0, normal @ (b[:2] - a[:2]))
    return normal, velocity @ normal * (1.0, -1.0)


def blocker(rollout: Rollout, agent: int) -> tuple[int, float] | None:
    """Return who is in the way of an agent at the end (an index), and for how many seconds it has
    waited with somebody there, if these are :data:`BLOCKED_S` at least.

    In the way is whose box reaches into the :data:`AHEAD_M` before the agent, as wide as it.
    """
    found, steps = -1, 0
    for step in reversed(range(rollout.num_steps)):
        boxes, there = _boxes(rollout, step), rollout.valid[:, step].copy()
        x, y, heading, length, width = boxes[agent]
        moves = np.hypot(*rollout.velocity[agent, step]) >= WAITS_MPS
        if moves or not there[agent]:
            break
        there[agent] = False
        middle = length + AHEAD_M / 2
        before = (x + middle * np.cos(heading), y + middle * np.sin(heading), heading)
        gaps = gaps_m(np.array([*before, AHEAD_M / 2, width]), boxes)
        near = np.flatnonzero(there & (gaps.max(axis=-1) <= 0.0))
        if not len(near):
            break
        if found < 0:
            found = int(near[np.argmin(np.hypot(*(boxes[near, :2] - [x, y]).T))])
        steps += 1
    waited_s = (steps - 1) * rollout.dt_s
    return (found, waited_s) if waited_s > BLOCKED_S - 1e-6 else None


def gaps_m(one: F64, others: F64) -> F64:
    """Return how far boxes are apart along forward and left of the one, and of the others
    [..., 4], metres; negative where they overlap.

    Boxes [..., 5] are x, y, heading, half length, half width.
    """
    x, y = np.moveaxis(others[..., :2] - one[:2], -1, 0)
    half, heading = [one[3:], np.moveaxis(others[..., 3:], -1, 0)], [one[2], others[..., 2]]
    turned = heading[1] - heading[0]
    along, across = np.abs(np.cos(turned)), np.abs(np.sin(turned))
    gaps = []
    for (length, width), (far, wide), turn in zip(half, half[::-1], heading, strict=True):
        c, s = np.cos(turn), np.sin(turn)
        gaps += [np.abs(x * c + y * s) - (length + far * along + wide * across)]
        gaps += [np.abs(y * c - x * s) - (width + far * across + wide * along)]
    return np.stack(gaps, axis=-1)


def _boxes(rollout: Rollout, step: int) -> F64:
    """Boxes of all agents at a step [A, 5]."""
    states = [rollout.position[:, step], rollout.heading[:, step, None]]
    return np.concatenate([*states, rollout.scene.sizes[:, :2] / 2], axis=1, dtype=np.float64)
