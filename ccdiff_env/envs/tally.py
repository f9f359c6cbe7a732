"""What is summed up over an episode, from the figures of its steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Figures that are 1 if they were 1 at any step.
EVER = ("collision", "at_fault", "off_road", "wrong_way", "goal_reached")
#: Figures whose last value counts.
LAST = ("progress", "route_completion", "is_success")
#: Figures that are averaged over the steps: (figure, name).
MEAN = (("speed", "mean_speed"), ("log_distance", "mean_log_distance"))


class Tally:
    """Running sums of N agents, one row each.

    Parameters
    ----------
    names
        Names of the M figures of a step.
    num_rows
        N.
    """

    def __init__(self, names: Sequence[str], num_rows: int) -> None:
        at = {name: i for i, name in enumerate(names)}
        self._sums = np.zeros((num_rows, len(names) + 2))
        self._most = np.zeros((num_rows, len(names)), np.float32)
        self._least_ttc = np.full(num_rows, np.inf, np.float32)
        self._ttc = at["ttc"]
        self._ever = [(name, at[name]) for name in EVER]
        self._last = [(name, at[name]) for name in LAST]
        self._mean = [(name, at[figure]) for figure, name in MEAN]
        self._rewards = [(name, i) for name, i in at.items() if name.startswith("reward_")]

    def add(self, columns: F32, reward: F32, counted: Bool | None = None) -> None:
        """Add a step: figures [N, M] and rewards [N], of the counted rows [N] (all without)."""
        if counted is not None:
            columns = np.where(counted[:, None], columns, np.float32(0.0))
        self._sums[:, :-2] += columns
        self._sums[:, -2] += reward
        self._sums[:, -1] += 1.0 if counted is None else counted
        np.maximum(self._most, columns, out=self._most)
        ttc = columns[:, self._ttc]
        ttc = ttc if counted is None else np.where(counted, ttc, np.inf)
        np.minimum(self._least_ttc, ttc, out=self._least_ttc)

    def clear(self, rows: Bool | slice) -> None:
        """Begin again in some rows."""
        self._sums[rows] = 0.0
        self._most[rows] = 0.0
        self._least_ttc[rows] = np.inf

    def metrics(self, columns: F32) -> dict[str, F64]:
        """Return the metrics [N] of episodes that end now; figures [N, M] of their last step.

        ``return`` and ``length``; flags of what ever happened; ``progress`` (m) and
        ``route_completion`` at the end; ``is_success``; ``min_ttc`` (s), ``mean_speed`` (m/s),
        ``mean_log_distance`` (m); and the sum of every reward component.
        """
        steps = np.maximum(self._sums[:, -1], 1.0)
        metrics: dict[str, Any] = {
            "return": self._sums[:, -2].copy(),
            "length": self._sums[:, -1].copy(),
        }
        metrics.update((name, (self._most[:, i] > 0).astype(float)) for name, i in self._ever)
        metrics.update((name, columns[:, i].astype(float)) for name, i in self._last)
        metrics["min_ttc"] = self._least_ttc.astype(float)
        metrics.update((name, self._sums[:, i] / steps) for name, i in self._mean)
        metrics.update((name, self._sums[:, i].copy()) for name, i in self._rewards)
        return metrics

    def save(self, row: int) -> bytes:
        """Return one row as bytes."""
        parts = (self._sums[row], self._most[row], self._least_ttc[row : row + 1])
        return b"".join(part.tobytes() for part in parts)

    def load(self, row: int, data: bytes) -> bool:
        """Take one row back; returns whether the bytes fit."""
        wide, narrow = self._sums[row].nbytes, self._most[row].nbytes
        if len(data) != wide + narrow + 4:
            return False
        self._sums[row] = np.frombuffer(data[:wide], np.float64)
        self._most[row] = np.frombuffer(data[wide : wide + narrow], np.float32)
        self._least_ttc[row] = np.frombuffer(data[wide + narrow :], np.float32)[0]
        return True
