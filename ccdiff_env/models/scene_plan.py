"""Plans of a network for one scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class ScenePlan:
    """Plans for the M vehicles of one scene at one step: N samples of T steps."""

    agents: npt.NDArray[np.int64]  #: Indices of the vehicles in the scene, ``[M]``.
    actions: npt.NDArray[np.float32]  #: Accelerations (m/s²), yaw rates (rad/s), ``[N, M, T, 2]``.
    #: x, y (m), speed (m/s), yaw (rad) and the actions, ``[N, M, T, 6]``, each vehicle in its own
    #: frame at the step: origin at its centre, +x along its heading.
    states: npt.NDArray[np.float32]
    poses: npt.NDArray[np.float32]  #: x, y (m), heading (rad) of those frames in the scene, [M, 3].
    graph: npt.NDArray[np.bool_]  #: Decision causal graph: (i, j): j may influence i, ``[M, M]``.
    ttc: npt.NDArray[np.float32]  #: Times to contact, seconds, ``[M, M]``.
    #: Attention of vehicle i to vehicle j, zero outside of the graph, ``[M, M]``, if asked for.
    attention: npt.NDArray[np.float32] | None
    #: Sample that guidance selected for each vehicle, ``[M]``; 0 without guidance.
    selected_sample: npt.NDArray[np.int64]
    #: With guidance ``losses [J, N, M]`` of the objectives, ``realism_cost [M]`` (C(τ), total
    #: variation in [0, 1]), ``shift_sigmas [M]`` (the same in standard deviations) and, if asked
    #: for, ``alignment``, ``gradient_cosine``, ``conflict_share`` ``[M]`` and ``objective_cosine
    #: [J, J]``.
    guidance: dict[str, npt.NDArray[np.float32]] | None

    def positions(self) -> npt.NDArray[np.float32]:
        """Return the planned centres in the scene frame, metres, ``[N, M, T, 2]``."""
        x, y, heading = (self.poses[:, k][None, :, None] for k in range(3))
        ahead, left = self.states[..., 0], self.states[..., 1]
        cos, sin = np.cos(heading), np.sin(heading)
        return np.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], axis=-1)
