"""What a policy must be given: options, form and meaning of observations, carried by their space.

An observation space of this package has the attribute ``ccdiff_env``, a JSON text.
stable-baselines3 writes it into the file of a policy, so that it says what it was trained in.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import gymnasium

from ccdiff_env.errors import ConfigError
from ccdiff_env.system.files import parse_object

if TYPE_CHECKING:
    from ccdiff_env.config import WorldConfig

ATTRIBUTE = "ccdiff_env"  #: Name of the attribute of a space.
#: Name of the attribute of a policy of stable-baselines3 with the mean, scale and limit by which
#: its observations were normalised.
STATISTICS = "ccdiff_env_statistics"
#: Fields of the configuration that a policy depends on.
FIELDS = ("action", "observation", "decision_steps", "dt_s")


def schema_digest(*tables: str) -> str:
    """Return the digest of what the numbers of rows mean, JSON tables of their columns.

    How a column is described is left out: a better sentence makes no policy useless.
    """

    def without_doc(entry: dict[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in entry.items() if name != "doc"}

    meant = [json.loads(table, object_hook=without_doc) for table in tables]
    return hashlib.blake2b(json.dumps(meant).encode(), digest_size=8).hexdigest()


def fitting_fields(config: WorldConfig) -> dict[str, Any]:
    """Return the fields that a policy depends on, as JSON has them."""
    whole = json.loads(config.to_json())
    return {name: whole[name] for name in FIELDS}


@dataclass(frozen=True)
class Fit:
    """What a policy was trained in: fields of :class:`~ccdiff_env.WorldConfig` (:data:`FIELDS`),
    form of observations, and :func:`schema_digest`.
    """

    options: Mapping[str, Any]
    form: str
    schema: str

    @classmethod
    def of(cls, config: WorldConfig, layout_json: str, form: str) -> Fit:
        """Return what worlds of a configuration give."""
        return cls(fitting_fields(config), form, schema_digest(layout_json))

    def mark(self, space: gymnasium.Space[Any]) -> gymnasium.Space[Any]:
        """Write it on a space; returns the space."""
        setattr(space, ATTRIBUTE, json.dumps(asdict(self)))
        return space

    @classmethod
    def read(cls, text: object, who: str) -> Fit:
        """Read what :meth:`mark` wrote; nothing, or damage, is a :class:`ConfigError`."""
        if text is None:
            raise ConfigError(
                f"{who} does not say what it was trained in: it is older than this version, or was "
                "trained under a wrapper that changes observations; train it on the environment's "
                "own space"
            )
        try:
            found = parse_object(text) if isinstance(text, str) else {}
            made = cls(found["options"], str(found["form"]), str(found["schema"]))
            if not isinstance(made.options, dict) or set(made.options) != set(FIELDS):
                raise ValueError("options")
        except (KeyError, ValueError) as error:
            raise ConfigError(f"{who}: damaged description of its training ({error})") from None
        return made

    def check(self, config: WorldConfig, layout_json: str, who: str) -> None:
        """Refuse worlds that give something else with a :class:`ConfigError` that says what."""
        there = fitting_fields(config)
        for name, wanted in self.options.items():
            given = there[name]
            if name == "decision_steps" and given == 1:
                continue  # the planner itself holds its actions
            if given != wanted:
                part, wanted, given = _first_difference(name, wanted, given)
                raise ConfigError(
                    f"{who} was trained with {part} = {_short(wanted)}, the worlds have "
                    f"{_short(given)}: make them with its env_options"
                )
        if self.schema != schema_digest(layout_json):
            raise ConfigError(f"{who} was trained on observations that this version does not have")


def _first_difference(part: str, wanted: Any, given: Any) -> tuple[str, Any, Any]:
    """Go down to the first field that differs."""
    while isinstance(wanted, dict) and isinstance(given, dict) and [*wanted] == [*given]:
        key = next(k for k in wanted if wanted[k] != given[k])
        part, wanted, given = f"{part}.{key}", wanted[key], given[key]
    return part, wanted, given


def _short(value: object) -> str:
    if isinstance(value, dict) and len(value) == 1:
        value = next(iter(value))  # the choice that has these settings
    text = json.dumps(value)
    return text if len(text) <= 80 else text[:77] + "..."
