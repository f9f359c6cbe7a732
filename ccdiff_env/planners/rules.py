"""Planners of the package: PDM-Closed and IDM on lanes by rules, and the better of both.

The first two know what a vehicle can know and drive through the action. Their rules stand in
``rust/sim/src/pdm`` and ``planner``; docs/planners.md says what differs from the published ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env._native import Planner
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError
from ccdiff_env.traffic import CcdiffConfig, NamedDriver
from ccdiff_env.worlds import Worlds, network_policies
from ccdiff_env.worlds.worlds_view import behind

F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]


class RulePlanner:
    """Drives the one slot of every world, by any dynamics but the assisted ones."""

    kind: str
    #: Network that it asks, and its options; ``None``: none.
    network: tuple[str, Mapping[str, Any]] | None = None

    def __init__(self, worlds: Worlds) -> None:
        self._native = worlds.native
        found = None
        if self.network is not None:
            options = CcdiffConfig(**self.network[1])
            own = {"planner": NamedDriver(self.network[0], options)}
            config = WorldConfig(dt_s=worlds.config.dt_s, driver="planner", named_drivers=own)
            found = network_policies(config, list(behind(worlds.scenes)), 1)["planner"]
        self._planner = Planner(self.kind, found)

    def __call__(self, obs: object) -> npt.NDArray[np.float32]:
        """Return the actions [E, W], or indices [E], of all worlds; zeros where nobody drives."""
        native = self._native
        alive = [bool(native.slot_alive(i)[0]) for i in range(native.num_worlds)]
        actions: npt.NDArray[np.float32] = native.planner_actions(self._planner, alive)
        return actions if native.num_actions is None else actions[:, 0]


class NoOp:
    """Takes the zero action at every step: the unicycle keeps its speed and heading.

    Indices of a grid, which need not hold zero, are a :class:`ConfigError`.
    """

    def __init__(self, worlds: Worlds) -> None:
        native = worlds.native
        if native.num_actions is not None:
            raise ConfigError("planner 'noop' needs continuous actions, these are discrete")
        self._nothing = np.zeros((native.num_worlds, native.action_width), np.float32)

    def __call__(self, obs: object) -> npt.NDArray[np.float32]:
        """Return zeros [E, W]."""
        return self._nothing


def _rule(kind: str, network: str | None = None, **options: Any) -> type[RulePlanner]:
    found = None if network is None else (network, options)
    return type("Rule", (RulePlanner,), {"kind": kind, "network": found})


#: Planners by name: PDM-Closed (Dauner et al. 2023); the same, whose proposals meet four samples of
#: CCDiff in place of constant velocity; the worlds' intelligent driver model on the centre lines,
#: at the road's limit; CCDiff with the ego's route, one careful plan every half second.
RULES: dict[str, type[RulePlanner]] = {
    "pdm": _rule("pdm"),
    "pdm_ccdiff": _rule("pdm", "ccdiff", num_samples=4, replan_steps=10, parked_rule="nobody"),
    "lane_idm": _rule("idm"),
    "diffusion": _rule("plan", "ccdiff", follow_route=True, careful=True, parked_rule="nobody"),
}

EVERY_S, AHEAD_S = 1.0, 2.0  #: Seconds between choices, and how far the forks are driven.
#: Least time to contact that counts as safe, as in the score of ``bench planners``.
LEAST_TTC_S = 0.95
FAULTS = ("at_fault", "off_road", "wrong_way")  #: Metrics of an episode that must stay 0.


class Arbiter:
    """Chooses every second between PDM-Closed and IDM on lanes.

    The forks hold the traffic as it is, so that their futures are those that will come: no vehicle
    can know them. Worlds have one slot.
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
