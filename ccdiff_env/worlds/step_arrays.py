"""Arrays that a reset or step writes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]


class StepArrays(NamedTuple):
    """Arrays that a reset or step writes.

    E worlds, C slots, D floats of a row, M info columns, rasters of P channels.
    """

    #: Observations [E, C, D] float32.
    obs: F32
    #: Rewards [E, C] float32.
    reward: F32
    #: Whether an agent's episode ended by what happened [E, C].
    terminated: Bool
    #: Whether it was cut off [E, C].
    truncated: Bool
    #: Whether the agent goes on [E, C].
    alive: Bool
    #: Info columns of the step [E, C, M] float32.
    columns: F32
    #: Whether the world's episode ended [E].
    done: Bool
    #: Whether the observation is the first of an episode [E].
    was_reset: Bool
    #: SAME_STEP: last observations of ended episodes [E, C, D]; else ``None``.
    final_obs: F32 | None
    #: Rasters [E, C, P, S, S] uint8; ``None`` without them.
    bev: U8 | None
    #: Rasters beside ``final_obs``.
    final_bev: U8 | None
