"""Arbitration: two planners drive forks of a world on, and who fares better there drives it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.planners.rules import RULES
from ccdiff_env.worlds import Worlds

F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

EVERY_S, AHEAD_S = 1.0, 2.0  #: Seconds between choices, and how far the forks are driven.
#: Least time to contact that counts as safe, as in the score of ``bench planners``.
LEAST_TTC_S = 0.95
FAULTS = ("at_fault", "off_road", "wrong_way")  #: Metrics of an episode that must stay 0.


class Arbiter:
    """Chooses every second between PDM-Closed and IDM on lanes.

    The forks hold the traffic as it is, so that their futures are those that will come: no vehicle
    can know them.

    Args:
        worlds: Worlds with one slot, driven from outside.
    """

    privileged = True
    names = ("pdm", "lane_idm")

    def __init__(self, worlds: Worlds) -> None:
        self._worlds = worlds
        self._planners = [RULES[name](worlds) for name in self.names]
        forks = [
            Worlds(worlds.scenes, worlds.config, num_worlds=worlds.num_worlds, num_threads=1)
            for _ in self.names
        ]
        self._forks = [(f, RULES[n](f)) for f, n in zip(forks, self.names, strict=True)]
        self._steps = tuple(round(s / worlds.config.dt_s) for s in (EVERY_S, AHEAD_S))
        self._chosen = np.zeros(worlds.num_worlds, np.int64)

    def reset(self, worlds: Worlds, indices: npt.NDArray[np.int64]) -> None:
        """Begin with the first planner."""
        self._chosen[indices] = 0

    def __call__(self, obs: object) -> npt.NDArray[Any]:
        """Return the actions [E, W], or indices [E], of whom each world is left to."""
        native, every = self._worlds.native, self._steps[0]
        due = np.array(
            [
                native.slot_alive(i)[0] and native.status(i).elapsed_steps % every == 0
                for i in range(native.num_worlds)
            ]
        )
        if due.any():
            values = np.stack([self._value(fork, planner, due) for fork, planner in self._forks])
            self._chosen[due] = values.argmax(axis=0)[due]
        actions = np.stack([planner(obs) for planner in self._planners])
        chosen: npt.NDArray[Any] = actions[self._chosen, np.arange(native.num_worlds)]
        return chosen

    def _value(self, fork: Worlds, planner: Any, due: Bool) -> F64:
        """How a planner fares [E] in forks of the worlds that are due: higher is better."""
        native, origin = fork.native, self._worlds.native
        for i in np.flatnonzero(due).tolist():
            native.restore(i, origin.snapshot(i))
        out = fork.last or fork.arrays()
        shape = (fork.num_worlds, fork.num_slots, native.action_width)
        ttc, running = fork.column_names.index("ttc"), due.copy()
        least_s = np.full(len(due), np.inf)
        for _ in range(self._steps[1]):
            native.step(planner(None).astype(np.float32).reshape(shape), out, running)
            least_s[running] = np.minimum(least_s, out.columns[:, 0, ttc])[running]
            running &= ~out.done
            if not running.any():
                break
        values = np.zeros(len(due))
        for i in np.flatnonzero(due).tolist():
            ended = bool(out.done[i])
            rows = native.ended_metrics([i])[0] if ended else native.metrics(i)
            of = dict(zip(fork.metric_names, rows[0].tolist(), strict=True))
            safe = all(of[name] == 0.0 for name in FAULTS)
            values[i] = safe * (1.0 + of["route_completion"] + (least_s[i] >= LEAST_TTC_S))
        return values
