"""Episodes that begin a few seconds before failures: snapshots of live worlds, with new futures."""

from __future__ import annotations

from collections import deque

import numpy as np
import numpy.typing as npt

from ccdiff_env.envs.vector import EgoVectorEnv
from ccdiff_env.errors import ConfigError

__all__ = ["Backtrack"]

Bool = npt.NDArray[np.bool_]
#: Seconds before a failure at which episodes begin, and between snapshots.
BEFORE_S, EVERY_S = (3.0, 6.0), 1.5
KEPT = 512  #: Failures that are kept; new ones push out the oldest.


class Backtrack:
    """Lets a share of the episodes of vector worlds begin before failures of those who drive there.

    The traffic of such an episode is resampled: the failure need not recur. The worlds are in
    ``same_step`` mode; ``seed`` chooses episodes, moments and the seeds of their futures.
    """

    def __init__(self, env: EgoVectorEnv, share: float, seed: int) -> None:
        if not 0.0 <= share <= 1.0:
            raise ConfigError(f"share of episodes before failures is {share}, expected 0 to 1")
        self._env, self._share, self._rng = env, share, np.random.default_rng(seed)
        seconds = env.config.dt_s * env.config.decision_steps
        self._every = max(round(EVERY_S / seconds), 1)
        self._ages = tuple(round(s / seconds) for s in BEFORE_S)
        self._now = 0
        self._past: list[deque[tuple[int, bytes]]] = [
            deque(maxlen=self._ages[1] // self._every + 1) for _ in range(env.num_envs)
        ]
        #: Snapshots from before failures, newest last.
        self.bank: deque[bytes] = deque(maxlen=KEPT)

    def step(self, ended: Bool, failed: Bool) -> npt.NDArray[np.int64]:
        """Follow a step of the worlds; returns those that were put before a failure.

        ``ended`` and ``failed`` are worlds [E] whose episodes ended in the step, and those of them
        that failed.
        """
        self._now += 1
        again = []
        for i in np.flatnonzero(ended).tolist():
            low, high = self._ages
            found = [state for at, state in self._past[i] if low <= self._now - at <= high]
            if failed[i] and found:
                self.bank.append(found[int(self._rng.integers(len(found)))])
            self._past[i].clear()
            if self.bank and self._rng.random() < self._share:
                state = self.bank[int(self._rng.integers(len(self.bank)))]
                self._env.restore(i, state, seed=int(self._rng.integers(2**63)))
                again.append(i)
        if self._now % self._every == 0:
            for i, past in enumerate(self._past):
                past.append((self._now, self._env.snapshot(i)))
        return np.array(again, np.int64)
