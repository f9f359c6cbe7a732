"""Actions of decisions, held for as many steps as they were trained to be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.worlds import Worlds


class Held:
    """Holds the actions of a batch for the ``steps`` of a decision, unless the worlds do so
    themselves.
    """

    def __init__(self, worlds: Worlds, steps: int) -> None:
        self._worlds = worlds
        self._steps = steps if worlds.config.decision_steps == 1 else 1
        discrete = worlds.native.num_actions is not None
        #: Shape of actions: [E, W], or [E] of indices.
        self.shape = (worlds.num_worlds, worlds.native.action_width)[: 1 if discrete else 2]
        dtype = np.int64 if discrete else np.float32
        self._present: npt.NDArray[Any] = np.zeros(self.shape, dtype)
        self._new = np.ones(worlds.num_worlds, np.bool_)

    def reset(self, indices: npt.NDArray[np.int64]) -> None:
        """Let a decision be due in worlds, whatever their clocks say."""
        self._new[indices] = True

    def __call__(
        self,
        decide: Callable[[npt.NDArray[np.bool_]], npt.NDArray[Any]],
        active: npt.NDArray[np.bool_] | None = None,
    ) -> npt.NDArray[Any]:
        """Return the present actions; ``decide`` makes them where a decision is due.

        It makes those of all worlds, for products of matrices round with the number of rows, and is
        told which are due [E]. ``active`` are the worlds [E] that go on, all by default.
        """
        num_worlds, native = self._worlds.num_worlds, self._worlds.native
        due = np.ones(num_worlds, np.bool_) if active is None else active
        if self._steps > 1:
            elapsed = np.array([native.status(i).elapsed_steps for i in range(num_worlds)])
            due = due & ((elapsed % self._steps == 0) | self._new)
            if not due.any():
                return self._present
        self._new &= ~due
        found = decide(due)
        self._present = self._present.copy()
        self._present[due] = found[due]
        return self._present
