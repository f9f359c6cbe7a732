"""Seeds of runs."""

from __future__ import annotations

import numpy as np


def spread_seed(seed: int, part: int = 0) -> int:
    """Return the seed of a run's worlds, 32 bits, far from that of any other run and part of it.

    World i of a batch has the seed of the batch plus i, as in Gymnasium. Runs with the seeds n and
    n + 1 would share all worlds but one; what this returns for them lies apart.
    """
    words = [seed % 2**64, part % 2**64]
    return int(np.random.SeedSequence(words).generate_state(1)[0])
