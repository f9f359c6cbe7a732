"""Actions and budget of the selection of adversaries."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from ccdiff_env.config import unknown
from ccdiff_env.envs.agent_selection import MAX_SLOTS
from ccdiff_env.errors import ActionError, ConfigError
from ccdiff_env.traffic.options import SelectionReward, check

__all__ = ["ActionMode", "SelectionActions", "SelectionReward"]

F32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]
ActionMode: TypeAlias = Literal["multibinary", "scores", "discrete"]
MODES: tuple[ActionMode, ...] = ("multibinary", "scores", "discrete")


class SelectionActions:
    """From actions to rows of chosen agents.

    Parameters
    ----------
    mode
        ``"multibinary"``: a flag per row, the first ``budget`` of those set; ``"scores"``: a number
        per row, the ``budget`` highest; ``"discrete"``: one row, the last index for nobody.
    num_rows
        Rows of candidates M.
    budget
        Adversaries at most.
    criticality
        Range of the strength of the guidance, chosen by one more entry of ``"scores"``.

    Raises
    ------
    ConfigError
        For another mode, or numbers out of range.
    """

    def __init__(
        self,
        mode: ActionMode,
        num_rows: int,
        budget: int,
        criticality: tuple[float, float] | None,
    ) -> None:
        if mode not in MODES:
            raise unknown("action mode", str(mode), MODES)
        bounds = (("max_agents", num_rows, MAX_SLOTS), ("budget", budget, num_rows))
        for name, value, most in bounds:
            if type(value) is not int or not 1 <= value <= most:
                raise ConfigError(f"{name} is {value!r}, expected an integer from 1 to {most}")
        if criticality is not None:
            if mode != "scores":
                raise ConfigError('criticality is an entry of action mode "scores" only')
            low, high = criticality
            for end in criticality:
                check("CcdiffConfig", "", {"criticality": end})
            if not low < high:
                raise ConfigError(f"criticality is {criticality}, expected low < high")
        self.mode, self.num_rows, self.budget = mode, num_rows, budget
        self._criticality = criticality
        self.space: spaces.Space[Any]
        if mode == "multibinary":
            self.space = spaces.MultiBinary(num_rows)
        elif mode == "scores":
            width = num_rows + (criticality is not None)
            self.space = spaces.Box(-1.0, 1.0, (width,), np.float32)
        else:
            self.space = spaces.Discrete(num_rows + 1)

    def rows(self, action: Any, mask: Bool) -> list[int]:
        """Return the chosen rows among those of a mask [M]; absent ones are passed over.

        Raises
        ------
        ActionError
            If the action is not one of the space.
        """
        given = np.asarray(action)
        if self.mode == "discrete":
            if given.shape != () or given.dtype.kind not in "iu":
                raise ActionError(f"action is {action!r}, expected an index")
            if not 0 <= int(given) <= self.num_rows:
                raise ActionError(f"action is {int(given)}, expected 0 to {self.num_rows}")
            chosen = [] if int(given) == self.num_rows else [int(given)]
            return [row for row in chosen if mask[row]]
        if given.shape != self.space.shape or given.dtype.kind not in "iufb":
            raise ActionError(
                f"action has shape {given.shape} and dtype {given.dtype}, "
                f"expected numbers of shape {self.space.shape}"
            )
        if self.mode == "multibinary":
            if not np.isin(given, (0, 1)).all():
                raise ActionError("action: entries are not all 0 or 1")
            return [int(i) for i in np.flatnonzero((given > 0) & mask)[: self.budget]]
        if not np.isfinite(given).all():
            raise ActionError("action: entries are not all finite")
        present = np.flatnonzero(mask)
        order = np.argsort(-given[present].astype(np.float64), kind="stable")
        return [int(i) for i in present[order][: self.budget]]

    def criticality(self, action: Any) -> float | None:
        """Return the strength of the guidance that an action asks for, if it has one."""
        if self._criticality is None:
            return None
        low, high = self._criticality
        share = (float(np.clip(np.asarray(action)[-1], -1.0, 1.0)) + 1.0) / 2.0
        return low + share * (high - low)

    def action(self, rows: list[int]) -> Any:
        """Return the action that chooses rows, most important first."""
        if self.mode == "discrete":
            return np.int64(rows[0] if rows else self.num_rows)
        if self.mode == "multibinary":
            flags = np.zeros(self.num_rows, np.int8)
            flags[rows[: self.budget]] = 1
            return flags
        scores = np.full(self.space.shape or (), -1.0, np.float32)
        for place, row in enumerate(rows[: self.num_rows]):
            scores[row] = 1.0 - place / self.num_rows
        if self._criticality is not None:
            scores[-1] = 1.0
        return scores

    def masks(self, mask: Bool) -> Bool:
        """Return the mask of legal actions, as MaskablePPO of sb3-contrib takes it.

        ``"discrete"``: [M + 1], nobody is always legal. ``"multibinary"``: [2 M], off and on of
        each row. ``"scores"`` has nothing to mask: [M].
        """
        if self.mode == "discrete":
            return np.concatenate([mask, [True]])
        if self.mode == "multibinary":
            pairs: Bool = np.stack([np.ones_like(mask), mask], axis=1)
            return pairs.ravel()
        return mask.copy()
