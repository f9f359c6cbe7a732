"""The kinds of drivers, as Rust declares them, and the options that each of them takes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

from ccdiff_env import _native
from ccdiff_env.errors import ConfigError
from ccdiff_env.system.named_objects import option_values, strip_title
from ccdiff_env.traffic import options as tables
from ccdiff_env.traffic.options import CcdiffConfig, EgosConfig, IdmConfig
from ccdiff_env.traffic.python import PythonTraffic

Options: TypeAlias = IdmConfig | CcdiffConfig | EgosConfig | PythonTraffic  #: Options of a driver.


@dataclass(frozen=True, kw_only=True)
class Kind:
    """What is known of a kind of driver."""

    name: str  #: Name in configurations.
    title: str  #: Name in legends and tables.
    options: type[Options] | None  #: Class of its options; ``None``: it takes none.
    always: bool  #: Whether every environment has one under this name.
    weights: tuple[str, ...] = ()  #: Shipped weights of a network: ``"fast"`` and variants.
    denoises: bool = False  #: Whether a network denoises its plans.
    attends: bool = False  #: Whether plans of a network attend to each other.
    one_plan: bool = False  #: Whether a network has one plan, whatever the noise.
    #: Whether it was taught by the traffic of another network, not by logs.
    distilled: bool = False


def _read(fields: dict[str, Any]) -> Kind:
    name = fields["options"]
    options = PythonTraffic if name == "PythonOptions" else getattr(tables, str(name), None)
    return Kind(**{**fields, "options": options, "weights": tuple(fields.get("weights", ()))})


#: All kinds of drivers by name.
KINDS: dict[str, Kind] = {kind.name: kind for kind in map(_read, _native.driver_kinds())}
#: The kind whose traffic a policy of the ego drives.
EGOS = next(name for name, kind in KINDS.items() if kind.options is EgosConfig)
#: The kind that ``ccdiff-env distil`` makes.
SWIFT = next(name for name, kind in KINDS.items() if kind.distilled)
#: Networks whose plans traffic may follow: names of drivers, and of the kinds of their weights.
NETWORKS: tuple[str, ...] = tuple(name for name, kind in KINDS.items() if kind.weights)


def read_driver(text: str, what: str = "traffic") -> tuple[str, dict[str, Any]]:
    """Return name and options of ``name?option=value&option=value``; a title is left out.

    Options of parts, ``guidance.gradient_steps=0``, are dictionaries. A :class:`ConfigError` says
    what is no option.
    """
    name, _, given = strip_title(text).partition("?")
    options: dict[str, Any] = {}
    for path, value in option_values(given, what, text).items() if given else ():
        *parts, last = path.split(".")
        place = options
        for part in parts:
            place = place.setdefault(part, {})
            if not isinstance(place, dict):
                raise ConfigError(f"{what} {text!r}: {path}, but {part} is {place!r}")
        place[last] = value
    return name, options


@dataclass(frozen=True)
class NamedDriver:
    """A driver under a custom name."""

    kind: str  #: One of :data:`KINDS` that takes options.
    options: Options

    @classmethod
    def of(cls, options: Options) -> NamedDriver:
        """Return the driver that options are of; those of planning networks are CCDiff's."""
        return cls(next(n for n, kind in KINDS.items() if kind.options is type(options)), options)


def driver_names(own: Iterable[str] = ()) -> tuple[str, ...]:
    """Return the names under which traffic can be driven, with ``own`` ones."""
    usual = tuple(name for name, kind in KINDS.items() if kind.options is not PythonTraffic)
    return (*usual, *(name for name in own if name not in usual))


def driver_titles() -> dict[str, str]:
    """Return what everybody who may move an agent is called in words, in the legend's order."""
    return {name: title for name, title, *_ in _native.drivers()}
