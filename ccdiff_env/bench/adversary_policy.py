"""A learned adversary policy in traffic: at every plan it says which vehicle turns on the ego."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.envs.selection.episode import SelectionEpisode
from ccdiff_env.envs.selection.options import SelectionActions, SelectionReward
from ccdiff_env.worlds import Worlds

__all__ = ["MAX_AGENTS", "REPLAN_STEPS", "AdversaryPolicy"]

#: Vehicles that an adversary policy sees, the nearest ones.
MAX_AGENTS = 8
#: Steps from one decision to the next: 2 s, in which who was chosen can come near the ego.
REPLAN_STEPS = 20


class AdversaryPolicy:
    """Chooses in worlds that have begun: one vehicle each, nobody else is guided.

    Parameters
    ----------
    worlds
        The worlds; in CCDiff traffic that plans every ``REPLAN_STEPS``.
    path
        Policy of MaskablePPO that ``bench selection`` trained. Such a file is a pickle, which can
        run code: load your own alone.
    """

    def __init__(self, worlds: Worlds, path: str) -> None:
        from sb3_contrib import MaskablePPO

        self._policy: Any = MaskablePPO.load(path, device="cpu")
        self._worlds, self._steps = worlds, 0
        self._actions = SelectionActions("discrete", MAX_AGENTS, 1, None)
        self._episodes = [
            SelectionEpisode(worlds, e, SelectionReward()) for e in range(worlds.num_worlds)
        ]

    def choose(self, running: npt.NDArray[np.bool_]) -> None:
        """Choose before a step of the running worlds [E], where plans are due."""
        if self._steps % REPLAN_STEPS == 0:
            num_rows = self._actions.num_rows
            for e in np.flatnonzero(running).tolist():
                episode = self._episodes[e]
                rows = episode.rows(num_rows)
                mask = np.arange(num_rows) < len(rows)
                action, _ = self._policy.predict(
                    episode.observe(num_rows),
                    action_masks=self._actions.masks(mask),
                    deterministic=True,
                )
                guided = [rows[row] for row in self._actions.rows(action, mask)]
                episode.begin(guided)
                self._worlds.native.override_plan(e, guided=guided, criticality=None)
        self._steps += 1

    def step(self, running: npt.NDArray[np.bool_]) -> None:
        """Look at the running worlds [E] after a step."""
        for e in np.flatnonzero(running).tolist():
            self._episodes[e].step()
