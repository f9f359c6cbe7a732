"""Settings of a run, kept in its folder: a folder belongs to one choice of what decides results."""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, TypeVar

from ccdiff_env.errors import ConfigError
from ccdiff_env.system.files import parse_object, read_text, reading, write_aside, writing

_LOCKS: dict[Path, IO[bytes]] = {}  #: Of folders that this process writes into.

_Value = TypeVar("_Value")


def check_least(args: argparse.Namespace, **least: float) -> None:
    """Refuse arguments that are less than given here, or not finite."""
    for name, bound in least.items():
        given = getattr(args, name)
        values = given if isinstance(given, Sequence) else [given]
        if not all(bound <= value < math.inf for value in values):
            option = f"--{name.replace('_', '-')}"
            raise ConfigError(f"{option} is {given}, expected at least {bound:g}")


def listed(option: str, text: str, one: Callable[[str], _Value], what: str) -> list[_Value]:
    """Return the values of an option whose text lists them, once each."""
    try:
        return list(dict.fromkeys(map(one, text.split(","))))
    except (ValueError, OverflowError):
        raise ConfigError(f"{option} is {text!r}, expected {what}, comma-separated") from None


def keep_settings(path: Path, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Write settings into the file of a run, which keeps what else it holds; return all of it.

    Raises:
        ConfigError: If the file holds others, see :func:`refuse_others`.
        DatasetError: If the file is damaged.
    """
    known = {**kept_settings(path, settings), **settings}
    write_settings(path, known)
    return known


def write_settings(path: Path, known: Mapping[str, Any]) -> None:
    """Write the file of a run, whose folder is this process's alone until it ends.

    A folder of another process is a :class:`ConfigError`.
    """
    with writing(lock := path.parent.resolve() / ".lock"):
        if lock not in _LOCKS:
            file = lock.open("ab")
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ConfigError(
                    f"another process writes into {path.parent}; choose another folder"
                ) from None
            except OSError:
                pass  # of a file system without locks
            _LOCKS[lock] = file
    write_aside(path, json.dumps(known, indent=1, default=dict))


def kept_settings(path: Path, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the file of a run holds, nothing without one; raises as :func:`keep_settings`."""
    with reading("settings of a run", path):
        known = parse_object(read_text(path)) if path.exists() else {}
    if known:
        refuse_others(path.parent, known, settings)
    return known


def refuse_others(folder: Path, known: Mapping[str, Any], settings: Mapping[str, Any]) -> None:
    """Refuse settings that a run in a folder was not begun with: a :class:`ConfigError` names the
    first, and both its values. What else the run is known by is not compared.
    """
    changed = first_change({name: known.get(name) for name in settings}, settings)
    if changed is not None:
        name, old, new = changed
        raise ConfigError(
            f"{folder} holds a run with other settings: {name} {old!r:.80}, now {new!r:.80}; "
            "choose another folder"
        )


def first_change(then: Mapping[str, Any], now: Mapping[str, Any]) -> tuple[str, Any, Any] | None:
    """Return in what two mappings differ first, as JSON has them: name, old and new value.

    Names of mappings within follow those of their mapping: ``"scenes town"``.
    """
    old, new = (_flat(json.loads(json.dumps(both, default=dict))) for both in (then, now))
    for name in (*new, *old):
        if old.get(name) != new.get(name):
            return name, old.get(name), new.get(name)
    return None


def _flat(settings: Mapping[str, Any], head: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in settings.items():
        found |= _flat(value, f"{head}{name} ") if isinstance(value, dict) else {head + name: value}
    return found


def sha256(*parts: bytes | str) -> str:
    """Return the SHA-256 of bytes and texts, one after another."""
    found = hashlib.sha256()
    for part in parts:
        found.update(part.encode() if isinstance(part, str) else part)
    return found.hexdigest()
