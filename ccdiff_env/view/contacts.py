"""Pairs of agents on course to meet, at every step of a rollout."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ccdiff_env.metrics import causal
from ccdiff_env.record.rollout import Rollout

TTC_CAP_S = 10.0  #: Pairs that meet later than this are left out.


def contacts(
    rollout: Rollout,
) -> Iterator[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.float32]]]:
    """Yield for each step the pairs (a < b) that meet within :data:`TTC_CAP_S`, and when.

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
        yield a, b, seconds[a, b]
