"""Options of resets: which there are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ccdiff_env.errors import ConfigError, unknown

__all__ = ["AGENT_OPTIONS", "EGO_OPTIONS", "reset_options"]

#: What resets of one ego per world take, and of several agents.
EGO_OPTIONS = ("scene", "ego", "start", "style", "drivers")
AGENT_OPTIONS = ("scene", "drivers")


def reset_options(given: Any, known: Sequence[str]) -> Mapping[str, Any]:
    """Return the options of a reset, all of which are known.

    Raises:
        ConfigError: For another name, and for what is no dictionary.
    """
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ConfigError(f"options is {given!r}, expected a dictionary")
    for name in given:
        if name not in known:
            raise unknown("reset option", str(name), known)
    return given
