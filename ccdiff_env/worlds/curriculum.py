"""What is played while an ego learns: how critical traffic is, and which scenes come more often."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env.errors import ConfigError, ShapeError
from ccdiff_env.traffic.checked_options import check

__all__ = ["Criticality", "Curriculum", "SceneWeights"]

#: A strength of the guidance, a range to draw it from, or shares of episodes by strength or range.
Strength: TypeAlias = float | tuple[float, float] | Mapping[float | tuple[float, float], float]
#: The same for all episodes, or from the progress of training (0 to 1).
Criticality: TypeAlias = Strength | Callable[[float], Strength]


class Curriculum:
    """Draws the criticality of each episode.

    Args:
        criticality: A number; a range ``(low, high)`` from which every episode draws by its seed;
            shares of the episodes by number or range, ``{0.0: 0.7, (0.5, 2.0): 0.3}``; or a
            function from the progress of training to one of these.

    Raises:
        ConfigError: If a strength is out of the range of ``CcdiffConfig.criticality``, or a share
            is negative.

    Examples:
        Realistic traffic at first, then more and more episodes of critical traffic:

        >>> curriculum = Curriculum(lambda progress: (0.0, min(2.0 * progress, 1.0)))
        >>> curriculum.draw(seed=3, episode=0)
        0.0
    """

    def __init__(self, criticality: Criticality) -> None:
        self.criticality = criticality  #: As given.
        self.progress = 0.0  #: Progress of training, 0 to 1.
        if callable(criticality):
            try:
                inspect.signature(criticality).bind(self.progress)
            except TypeError as error:
                raise ConfigError(
                    f"criticality: {error}, expected a function of the progress of training, 0 to 1"
                ) from None
        # what is no function is read once, not at every draw
        self._constant = self._read(criticality(0.0) if callable(criticality) else criticality)

    def _ranges(self) -> list[tuple[float, float, float]]:
        """Shares of the episodes, and from where to where their strengths are drawn, by now."""
        given = self.criticality
        return self._read(given(self.progress)) if callable(given) else self._constant

    @staticmethod
    def _read(strength: Strength) -> list[tuple[float, float, float]]:
        """Shares and ranges that a strength stands for, checked."""
        parts = strength.items() if isinstance(strength, Mapping) else [(strength, 1.0)]
        wrong = ConfigError(
            f"criticality is {strength!r}, expected a number of at least 0, a pair (low, high) "
            "or the share of each: {0: 0.5, (1, 2): 0.5}"
        )
        try:
            pairs = [(p if isinstance(p, Sequence) else (p, p), float(s)) for p, s in parts]
            ranges = [(share, float(low), float(high)) for (low, high), share in pairs]
        except (TypeError, ValueError):
            raise wrong from None
        for end in (end for _, *ends in ranges for end in ends):
            check("CcdiffConfig", "", {"criticality": end})
        shares = [share for share, _, _ in ranges]
        fine = all(low <= high for _, low, high in ranges)
        if not (fine and min(shares, default=-1.0) >= 0.0 and 0.0 < sum(shares) < np.inf):
            raise wrong
        return ranges

    def draw(self, seed: int, episode: int) -> float:
        """Return the criticality of an episode; the same seed and number give the same one."""
        ranges = self._ranges()
        rng = np.random.default_rng([seed, episode])
        chosen = 0
        if len(ranges) > 1:
            sums = np.cumsum([share for share, _, _ in ranges])
            chosen = int(np.searchsorted(sums, rng.uniform(0.0, sums[-1]), side="right"))
        _, low, high = ranges[chosen]
        return low if low == high else float(rng.uniform(low, high))


class SceneWeights:
    """Weights of scenes by how their last episodes went: failures come more often.

    A scene's weight is its share of failures, lately: every episode moves it by ``rate`` towards 1
    or 0, but never below ``least``. Scenes not played yet count as failed, in the manner of
    prioritised level replay (Jiang, Grefenstette, Rocktaeschel, ICML 2021), with failures in place
    of errors of the value.

    Args:
        num_scenes: Scenes S.
        rate: Part of the newest episode in a scene's share of failures, above 0, at most 1.
        least: Least weight, above 0: no scene is forgotten.

    Raises:
        ConfigError: If one of them is out of its range.

    Examples:
        >>> failures = SceneWeights(3, rate=0.5, least=0.1)
        >>> failures.update([0, 1, 1], [False, False, False])
        >>> failures.weights.tolist()
        [0.5, 0.25, 1.0]

        ``env.set_scene_weights(failures.weights)`` then draws the third scene four times as often
        as the second. Which scene a world plays is ``infos["scene_idx"]`` where it was reset.
    """

    def __init__(self, num_scenes: int, *, rate: float = 0.2, least: float = 0.1) -> None:
        if not (num_scenes >= 1 and 0.0 < rate <= 1.0 and 0.0 < least <= 1.0):
            raise ConfigError(
                f"num_scenes, rate and least are {num_scenes!r}, {rate!r} and {least!r}, expected "
                "at least 1, above 0 to 1, above 0 to 1"
            )
        self._failed = np.ones(num_scenes)
        self._rate, self._least = rate, least

    @property
    def weights(self) -> npt.NDArray[np.float64]:
        """Weights [S] as a new array, ``least`` to 1."""
        return np.maximum(self._failed, self._least)

    def update(self, scenes: npt.ArrayLike, failed: npt.ArrayLike) -> None:
        """Take in episodes that ended, in their order.

        Args:
            scenes: Indices [N] of their scenes.
            failed: Whether [N] they failed.

        Raises:
            ShapeError: If the two differ in length, or a scene is none of them.
        """
        indices, bad = np.asarray(scenes, np.int64), np.asarray(failed, np.bool_)
        inside = (indices >= 0) & (indices < len(self._failed))
        if indices.ndim != 1 or indices.shape != bad.shape or not inside.all():
            raise ShapeError(
                f"scenes {indices.shape} and failed {bad.shape}: expected one of each for every "
                f"episode, scenes 0 to {len(self._failed) - 1}"
            )
        for scene, fails in zip(indices, bad, strict=True):
            self._failed[scene] += self._rate * (fails - self._failed[scene])
