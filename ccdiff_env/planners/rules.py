"""Planners of the package: PDM-Closed and IDM on lanes by rules, and CCDiff as a planner.

They know what a vehicle can know and drive through the action. Their rules are in
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
