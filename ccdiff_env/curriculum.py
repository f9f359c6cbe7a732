"""How critical CCDiff traffic is in each episode: fixed, drawn, or by the progress of training."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from ccdiff_env.errors import ConfigError

__all__ = ["Criticality", "Curriculum"]

#: A strength of the guidance, or a range to draw it from.
Strength: TypeAlias = float | tuple[float, float]
#: The same for all episodes, or from the progress of training (0 to 1).
Criticality: TypeAlias = Strength | Callable[[float], Strength]


class Curriculum:
    """Draws the criticality of each episode.

    Parameters
    ----------
    criticality
        A number; a range ``(low, high)`` from which every episode draws by its seed; or a function
        from the progress of training to one of these.

    Raises
    ------
    ConfigError
        If a strength is negative or not finite.

    Examples
    --------
    Realistic traffic at first, then more and more episodes of critical traffic:

    >>> curriculum = Curriculum(lambda progress: (0.0, min(2.0 * progress, 1.0)))
    >>> curriculum.draw(seed=3, episode=0)
    0.0
    """

    def __init__(self, criticality: Criticality) -> None:
        self._criticality = criticality
        self._progress = 0.0
        self._range()

    @property
    def progress(self) -> float:
        """Progress of training, 0 to 1."""
        return self._progress

    @progress.setter
    def progress(self, progress: float) -> None:
        if not 0.0 <= progress <= 1.0:
            raise ConfigError(f"progress is {progress!r}, expected 0 to 1")
        self._progress = float(progress)

    def _range(self) -> tuple[float, float]:
        found = self._criticality
        strength = found(self._progress) if callable(found) else found
        try:
            low, high = map(float, strength if isinstance(strength, Sequence) else (strength,) * 2)
        except (TypeError, ValueError):
            low = high = np.nan
        if not (0.0 <= low <= high and np.isfinite(high)):
            raise ConfigError(f"criticality is {strength!r}, expected 0 <= low <= high, finite")
        return low, high

    def draw(self, seed: int, episode: int) -> float:
        """Return the criticality of an episode; the same seed and number give the same one."""
        low, high = self._range()
        if low == high:
            return low
        return float(np.random.default_rng([seed, episode]).uniform(low, high))
