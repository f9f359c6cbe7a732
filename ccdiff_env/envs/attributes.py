"""Attributes of environments that are called as options: set for later episodes, or refused."""

from __future__ import annotations

from typing import Any, ClassVar

from ccdiff_env.config import OPTION_NAMES, WorldConfig
from ccdiff_env.errors import ConfigError
from ccdiff_env.worlds import Worlds

_OPTIONS = OPTION_NAMES | {"criticality", "scenes"}


class Attributes:
    """What every environment lets be set: not the options that it was made with."""

    metadata: dict[str, Any]
    worlds: Worlds
    #: Attributes of the class that are called as options are.
    _own: ClassVar[tuple[str, ...]] = ()

    @property
    def config(self) -> WorldConfig:
        """Configuration of the worlds."""
        return self.worlds.config

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute; an option is a :class:`ConfigError` that says how to change it."""
        if name in _OPTIONS and name not in self._own:
            raise ConfigError(
                f"{name} is an option, which stays as the environment was made: make another one; "
                "reset(options=...) chooses scenes, egos, starts and drivers, and criticality can "
                "be set (docs/tasks.md)"
            )
        super().__setattr__(name, value)

    def _pace(self, config: WorldConfig, held_steps: int | None = None) -> None:
        """Say how many images a second of the world has: one for every action."""
        seconds = config.dt_s * (held_steps or config.decision_steps)
        self.metadata = {**self.metadata, "render_fps": 1.0 / seconds}
