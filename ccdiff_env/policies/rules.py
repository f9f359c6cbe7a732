"""Planners that come with the package and follow rules: PDM-Closed, and IDM on lanes.

Both know what a vehicle can know and drive through the action. Their rules stand in
``rust/sim/src/planner``; docs/planners.md says what differs from the published ones.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ccdiff_env._native import Planner
from ccdiff_env.worlds import Worlds

__all__ = ["RULES", "RulePlanner"]


class RulePlanner:
    """Drives the first slot of every world.

    Parameters
    ----------
    worlds
        Worlds with one slot, driven from outside; any dynamics but the assisted ones.
    """

    kind: str

    def __init__(self, worlds: Worlds) -> None:
        self._native, self._planner = worlds.native, Planner(self.kind)

    def __call__(self, obs: object) -> npt.NDArray[np.float32]:
        """Return the actions [E, W], or indices [E], of all worlds; zeros where nobody drives.

        Raises
        ------
        ConfigError
            For assisted dynamics.
        """
        native = self._native
        alive = [bool(native.slot_alive(i)[0]) for i in range(native.num_worlds)]
        actions: npt.NDArray[np.float32] = native.planner_actions(self._planner, alive)
        return actions if native.num_actions is None else actions[:, 0]


class _Pdm(RulePlanner):
    """PDM-Closed (Dauner et al. 2023)."""

    kind = "pdm"


class _LaneIdm(RulePlanner):
    """The worlds' intelligent driver model on the centre lines, at the road's limit."""

    kind = "idm"


#: Planners by name.
RULES: dict[str, type[RulePlanner]] = {"pdm": _Pdm, "lane_idm": _LaneIdm}
