"""Planning networks, CCDiff and its rivals: loading, planning."""

from __future__ import annotations

from ccdiff_env.models.trajectory_model import ScenePlan, TrajectoryModel, guidance_preset
from ccdiff_env.models.weights import (
    TORCH,
    needs_torch,
    require_networks,
    shipped_weights,
    weight_files,
    weights_path,
)

__all__ = [
    "TORCH", "ScenePlan", "TrajectoryModel", "guidance_preset", "needs_torch", "require_networks",
    "shipped_weights", "weight_files", "weights_path",
]  # fmt: skip
