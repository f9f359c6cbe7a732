"""Plans of a network for one scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class ScenePlan:
    """Plans for the vehicles of one scene at one step.

    Attributes:
        agents: Indices in the scene of the M planned vehicles, ``[M]``.
        actions: Accelerations (m/s²) and yaw rates (rad/s), ``[N, M, T, 2]``.
        states: x, y (m), speed (m/s), yaw (rad) and the actions, ``[N, M, T, 6]``, each vehicle in
            its own frame at the step: origin at its centre, +x along its heading.
        poses: x, y (m) and heading (rad) of those frames in the scene, ``[M, 3]``.
        graph: The decision causal graph G, ``[M, M]``; entry (i, j): j may influence i.
        ttc: Times to contact, seconds, ``[M, M]``.
        attention: Attention of vehicle i to vehicle j, zero outside of G, ``[M, M]``; ``None`` if
            not asked for.
        selected_sample: Sample that guidance selected for each vehicle, ``[M]``; 0 without
            guidance.
        guidance: ``losses [J, N, M]`` of the objectives, ``realism_cost [M]`` (C(τ), total
            variation in [0, 1]), ``shift_sigmas [M]`` (the same in standard deviations) and, if
            asked for, ``alignment``, ``gradient_cosine``, ``conflict_share`` ``[M]`` and
            ``objective_cosine [J, J]``; ``None`` without guidance.
    """

    agents: npt.NDArray[np.int64]
    actions: npt.NDArray[np.float32]
    states: npt.NDArray[np.float32]
    poses: npt.NDArray[np.float32]
    graph: npt.NDArray[np.bool_]
    ttc: npt.NDArray[np.float32]
    attention: npt.NDArray[np.float32] | None
    selected_sample: npt.NDArray[np.int64]
    guidance: dict[str, npt.NDArray[np.float32]] | None

    def positions(self) -> npt.NDArray[np.float32]:
        """Return the planned centres in the scene frame, metres, ``[N, M, T, 2]``."""
        x, y, heading = (self.poses[:, k][None, :, None] for k in range(3))
        ahead, left = self.states[..., 0], self.states[..., 1]
        cos, sin = np.cos(heading), np.sin(heading)
        return np.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], axis=-1)
