"""The kinds of drivers, and the options that each of them takes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

from ccdiff_env import _native
from ccdiff_env.traffic.ccdiff import NETWORKS
from ccdiff_env.traffic.options import CcdiffConfig, IdmConfig
from ccdiff_env.traffic.python import PythonTraffic

__all__ = ["KINDS", "Options", "Policy", "driver_names", "driver_titles"]

#: Options of a driver.
Options: TypeAlias = IdmConfig | CcdiffConfig | PythonTraffic

#: Kinds of drivers that take options, and the class of their options: all networks take the same.
KINDS: dict[str, type[Options]] = {
    "idm": IdmConfig,
    "python": PythonTraffic,
    **dict.fromkeys(NETWORKS, CcdiffConfig),
}
#: Drivers without options.
PLAIN = ("replay", "constant_velocity")


@dataclass(frozen=True)
class Policy:
    """A driver under a name of one's own.

    Parameters
    ----------
    kind
        One of :data:`KINDS`.
    options
        Its options.
    """

    kind: str
    options: Options

    @classmethod
    def of(cls, options: Options) -> Policy:
        """Return the driver that options are of; those of planning networks are CCDiff's."""
        kind = next(name for name, known in KINDS.items() if isinstance(options, known))
        return cls(kind, options)


def driver_names(own: Iterable[str] = ()) -> tuple[str, ...]:
    """Return the names under which traffic can be driven, with ``own`` ones."""
    usual = (*PLAIN, "idm", *NETWORKS)
    return (*usual, *(name for name in own if name not in usual))


def driver_titles() -> dict[str, str]:
    """Return what everybody who may move an agent is called in words, in the legend's order."""
    return {name: title for name, title, *_ in _native.drivers()}
