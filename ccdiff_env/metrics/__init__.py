"""Evaluation metrics of recorded rollouts, and the paper's scores.

A recorded scene is a :class:`Motion`: states of A agents over T steps. Rates over scenes are
means of what its methods give per scene. Geometry is that of the running
world's Rust code; docs/evaluation.md defines each number and says where it differs from the paper.
"""

from __future__ import annotations

from ccdiff_env.metrics.motion import VARIANTS, Collisions, Displacement, Motion, OffRoad
from ccdiff_env.metrics.statistics import (
    PAPER_BOUNDS,
    ComfortDistance,
    comfort_distance,
    generational_distance,
    scores,
    speed_limit,
)

__all__ = [
    "PAPER_BOUNDS", "VARIANTS", "Collisions", "ComfortDistance", "Displacement", "Motion",
    "OffRoad", "comfort_distance", "generational_distance", "scores", "speed_limit",
]  # fmt: skip
