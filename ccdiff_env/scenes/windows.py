"""Windows of scenes: parts of a log, each as long as an episode and the history before it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from ccdiff_env.errors import ConfigError

HISTORY_S = 3.0  #: History of a window where none is asked for: what environments look back on.


def whole_steps(name: str, seconds: float, dt: float, least: int = 1) -> int:
    """Return seconds in steps; refuse what is no whole number of them."""
    steps = round(seconds / dt) if math.isfinite(seconds) else -1
    if steps < least or abs(steps - seconds / dt) > 0.01:
        raise ConfigError(f"{name} is {seconds:g}, expected a whole number of steps of {dt:g} s")
    return steps


@dataclass(frozen=True)
class Windows:
    """How logs are cut.

    Args:
        window_s: Seconds that an episode may last.
        stride_s: Seconds from one window to the next; those of an episode by default.
        history_s: Seconds of a window before its episode.
    """

    window_s: float
    stride_s: float | None = None
    history_s: float | None = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            low = 0.0 if name == "history_s" else 1e-3
            if value is not None and not low <= value < 1e6:
                raise ConfigError(f"{name} is {value}, expected seconds, at least {low:g}")

    def steps(self, dt: float) -> tuple[int, int]:
        """Return the steps of history and those of an episode, the present one not counted."""
        history = round(HISTORY_S / dt)
        if self.history_s is not None:
            history = whole_steps("history_s", self.history_s, dt, least=0)
        return history, whole_steps("window_s", self.window_s, dt)

    def cut(self, name: str, num_steps: int, dt: float) -> dict[str, tuple[int, int]]:
        """Return first step and end of every whole window, by name: ``scene-0061@8`` begins at 8 s.

        A log that is one window keeps its name.
        """
        whole = sum(self.steps(dt)) + 1
        if whole == num_steps:
            return {name: (0, num_steps)}
        stride = self.window_s if self.stride_s is None else self.stride_s
        starts = range(0, num_steps - whole + 1, whole_steps("stride_s", stride, dt))
        return {f"{name}@{round(first * dt, 3):g}": (first, first + whole) for first in starts}


def logs_of(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the logs that windows are of, each once."""
    return tuple(dict.fromkeys(name.rpartition("@")[0] or name for name in names))
