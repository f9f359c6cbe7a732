"""What Gymnasium's own vector environments can be asked, for those whose worlds are one object."""

from __future__ import annotations

from typing import Any

from gymnasium.vector import AutoresetMode

from ccdiff_env.errors import ConfigError

__all__ = ["AsVector"]


class AsVector:
    """``autoreset_mode``, ``call``, ``get_attr``, ``set_attr``, as ``SyncVectorEnv`` has them."""

    num_envs: int
    metadata: dict[str, Any]

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """When an ended world begins anew."""
        mode: AutoresetMode = self.metadata["autoreset_mode"]
        return mode

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of the environment once, or get an attribute; one entry per world."""
        found = getattr(self, name)
        result = found(*args, **kwargs) if callable(found) else found
        if name == "render" and result is not None:
            return tuple(result)
        return (result,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute, once per world: the worlds share it."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute: a value, or one per world, all of which are the same.

        Raises
        ------
        ConfigError
            If the values differ: the worlds share their attributes.
        """
        listed = values if isinstance(values, (list, tuple)) else [values] * self.num_envs
        if len(listed) != self.num_envs or any(value != listed[0] for value in listed[1:]):
            raise ConfigError(
                f"set_attr: {name} is {values!r}, expected one value, or {self.num_envs} that are "
                "the same: the worlds share their attributes"
            )
        setattr(self, name, listed[0])
