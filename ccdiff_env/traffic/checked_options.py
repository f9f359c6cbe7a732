"""What all options are: unknown keywords are refused by name, values by the tables of Rust."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from ccdiff_env import _native
from ccdiff_env.errors import unknown_option
from ccdiff_env.system.fields import documented

_T = TypeVar("_T")


class Options:
    """Keywords that are no field are refused by name; ``help()`` lists what fields mean."""

    def __init_subclass__(cls) -> None:
        documented(cls)

    def __new__(cls: type[_T], *_: Any, **options: Any) -> _T:
        """Refuse unknown keywords with an :class:`~ccdiff_env.errors.UnknownOptionError`."""
        known = [entry.name for entry in fields(cls)]  # type: ignore[arg-type]
        for name in options:
            if name not in known:
                raise unknown_option(name, known)
        return object.__new__(cls)


def _written(value: Any) -> Any:
    """Values as JSON can hold them; what it cannot is quoted, for the message."""
    if isinstance(value, Mapping):
        return {str(name): _written(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_written(entry) for entry in value]
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:  # numpy scalars
        value = value.item()
    plain = value is None or isinstance(value, (bool, int, str, float))
    return value if plain and value not in (math.inf, -math.inf) and value == value else repr(value)


def check(table: str, path: str, options: Mapping[str, Any]) -> None:
    """Check names, types and ranges of options that stand at a path against a table of Rust.

    Raises:
        ConfigError: The first option that is wrong, with its path, its value and what is expected.
    """
    _native.check_options(table, path, json.dumps(_written(options)))
