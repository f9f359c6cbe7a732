"""The space of what an adversary policy sees; the rows themselves are made in Rust."""

from __future__ import annotations

import json

import numpy as np
from gymnasium import spaces

from ccdiff_env import _native

__all__ = ["FEATURES", "observation_space"]

_TABLE = json.loads(_native.candidate_features_json())
#: Columns of the agents' features; row 0 is the ego, in whose frame positions and velocities are.
#: Units, scales and meanings stand in the table of ``rust/sim/src/world/candidates.rs``.
FEATURES: tuple[str, ...] = tuple(feature["name"] for feature in _TABLE["features"])
_BOUND: float = _TABLE["bound"]


def observation_space(num_rows: int) -> spaces.Dict:
    """Return the space of observations of M candidates; matrices have M + 1 rows, the ego first."""
    n = num_rows + 1

    def unit() -> spaces.Box:
        return spaces.Box(0.0, 1.0, (n, n), np.float32)

    return spaces.Dict(
        {
            "agents": spaces.Box(-_BOUND, _BOUND, (n, len(FEATURES)), np.float32),
            "ttc": unit(),
            "distance": unit(),
            "graph": unit(),
            "attention": unit(),
            "mask": spaces.MultiBinary(num_rows),
            "time_left": spaces.Box(0.0, 1.0, (1,), np.float32),
        }
    )
