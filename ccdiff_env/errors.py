"""Exceptions of the package, raised from Python and from Rust.

Every exception is a :class:`CcdiffError`, so one ``except`` clause catches what the package
refuses; each is also the built-in kind that fits, so that generic handlers work.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any


class CcdiffError(Exception):
    """Anything that the package refuses."""


class ConfigError(CcdiffError, ValueError):
    """An option is out of its range, unknown, or contradicts another one."""


class UnknownOptionError(ConfigError, TypeError):
    """A keyword is no option; also a :class:`TypeError`, as for any unexpected keyword."""


class ShapeError(CcdiffError, ValueError):
    """An array has the wrong shape, dtype or layout."""


class ActionError(CcdiffError, ValueError):
    """An action is not finite or not one of the action space."""


class DatasetError(CcdiffError, ValueError):
    """A data set or scene file is missing a part, is damaged or contradicts itself."""


class DatasetNotFoundError(DatasetError, FileNotFoundError):
    """A data set, table, map or scene file is not where it should be."""


class SceneError(CcdiffError, ValueError):
    """A scene's arrays break a rule (length, finiteness, duplicate ids, sizes)."""


class UnknownNameError(CcdiffError, KeyError):
    """A scene, agent, split or layer of that name does not exist."""

    def __str__(self) -> str:
        """Return the message itself; ``KeyError`` would quote it."""
        return str(self.args[0]) if self.args else ""


class ResetNeededError(CcdiffError, RuntimeError):
    """An environment was stepped before ``reset``, or after its end."""


class SnapshotError(CcdiffError, ValueError):
    """A snapshot or replay certificate is damaged or belongs to something else."""


class CheckpointError(CcdiffError, ValueError):
    """A weight file is damaged, or its shapes or header do not fit."""


class PolicyError(CcdiffError, RuntimeError):
    """A planner, or a driver of traffic, failed."""


class ForkError(CcdiffError, RuntimeError):
    """A native object was used in a forked child process; use the spawn start method."""


class ThreadError(CcdiffError, RuntimeError):
    """Two threads use an environment at once; each needs one of its own."""


class MissingFeatureError(CcdiffError, ImportError):
    """An optional dependency is not installed; the message names the install command."""


@contextmanager
def raised_by(what: str, where: str) -> Iterator[None]:
    """Raise what code of others raises as a :class:`PolicyError` that says whose, and where."""
    try:
        yield
    except CcdiffError:
        raise
    except Exception as error:
        raise PolicyError(f"{what}: {type(error).__name__}: {error} (in {where})") from error


def unknown(what: str, name: str, known: Iterable[str]) -> ConfigError:
    """Return the error for a name that does not exist, with the names that come near it."""
    known = sorted(known)
    return ConfigError(f"unknown {what} {name!r}; {hint_of(name, known, len(known))}")


def hint_of(name: str, known: Iterable[str], shown: int = 5) -> str:
    """Return the names that come near one that does not exist; else the first of all that do."""
    known = list(known)
    names = ", ".join(known[:shown]) + (", ..." if len(known) > shown else "")
    return meant(name, known) or f"there are {names}"


def meant(name: str, known: Iterable[str]) -> str:
    """Return the question whether one of the names that come near was meant; nothing for none."""
    near = difflib.get_close_matches(name.lower(), list(known), n=3, cutoff=0.6)
    return f"did you mean {' or '.join(map(repr, near))}?" if near else ""


def unknown_option(name: str, known: Iterable[str]) -> UnknownOptionError:
    """Return the error for a keyword that is no option."""
    # wrappers of other libraries look for these words
    return UnknownOptionError(
        f"{unknown('option', name, known)} (unexpected keyword argument {name!r})"
    )


def expect_shape(name: str, array: Any, shape: tuple[int, ...]) -> None:
    """Refuse what is no array of this shape with a :class:`ShapeError`."""
    got = getattr(array, "shape", type(array).__name__)
    if got != shape:
        raise ShapeError(f"{name} has shape {got}, expected {shape}")
