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

    obs: F32  #: Observations [E, C, D] float32.
    reward: F32  #: Rewards [E, C] float32.
    terminated: Bool  #: Whether an agent's episode ended by what happened [E, C].
    truncated: Bool  #: Whether it was cut off [E, C].
    alive: Bool  #: Whether the agent goes on [E, C].
    columns: F32  #: Info columns of the step [E, C, M] float32.
    done: Bool  #: Whether the world's episode ended [E].
    was_reset: Bool  #: Whether the observation is the first of an episode [E].
    #: SAME_STEP: last observations of ended episodes [E, C, D]; else ``None``.
    final_obs: F32 | None
    bev: U8 | None  #: Rasters [E, C, P, S, S] uint8; ``None`` without them.
    final_bev: U8 | None  #: Rasters beside ``final_obs``.
