"""Planners of the package: PDM-Closed and IDM on lanes by rules, and one that does nothing.

They know what a vehicle can know and drive through the action. Their rules are in
``rust/sim/src/pdm`` and ``planner``; docs/planners.md says what differs from the published ones.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ccdiff_env._native import Planner
from ccdiff_env.errors import ConfigError
from ccdiff_env.worlds import Worlds


class RulePlanner:
    """Drives the one slot of every world, by any dynamics but the assisted ones."""

    kind: ClassVar[str]

    def __init__(self, worlds: Worlds) -> None:
        self._native = worlds.native
        self._planner = Planner(self.kind)

    def __call__(self, obs: object) -> npt.NDArray[np.float32]:
        """Return the actions [E, W], or indices [E], of all worlds; zeros where nobody drives."""
        native = self._native
        alive = [bool(native.slot_alive(i)[0]) for i in range(native.num_worlds)]
        actions: npt.NDArray[np.float32] = native.planner_actions(self._planner, alive)
        return actions if native.num_actions is None else actions[:, 0]


class PdmClosed(RulePlanner):
    """PDM-Closed (Dauner et al. 2023)."""

    kind = "pdm"


class LaneIdm(RulePlanner):
    """The worlds' intelligent driver model on the centre lines, at the road's limit."""

    kind = "idm"


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
