"""Files that come from others or go to them: names, safe reading, writing never half done."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ccdiff_env.errors import (
    CcdiffError,
    DatasetError,
    DatasetNotFoundError,
    SceneError,
    ShapeError,
)

MOST_BYTES = 1 << 30  #: Bytes that a file may have, and what is unpacked of files.
MOST_TEXT_BYTES = 64 << 20  #: Bytes of a text: settings, tables, manifests.

#: Values of a text of JSON, each of which takes some hundred bytes of memory at most.
MOST_VALUES = 1 << 22

#: The half of a pair of UTF-16 in JSON: such text cannot be written again.
_HALF_LETTER = re.compile(r"\\u[dD][89a-fA-F]")


@contextmanager
def reading(
    what: str, path: str | os.PathLike[str], error: type[CcdiffError] = DatasetError
) -> Iterator[None]:
    """Let a loader raise exceptions of the package only, which name the file.

    ``what`` is what the file holds; ``error`` is raised for whatever else goes wrong in the block.
    A missing file, or a path longer than the system's may be, is a :class:`DatasetNotFoundError`.
    """
    place = os.fspath(path)
    try:
        yield
    except CcdiffError as found:
        if isinstance(found, DatasetNotFoundError):
            raise
        kind = error if isinstance(found, (ShapeError, SceneError)) else type(found)
        if kind is type(found) and place in str(found):
            raise
        raise kind(f"{what}: {found}: {place}") from None
    except Exception as found:
        missing = isinstance(found, (FileNotFoundError, NotADirectoryError))
        if missing or getattr(found, "errno", None) == errno.ENAMETOOLONG:
            raise DatasetNotFoundError(f"no {what} at {place}") from None
        raise error(f"{_fault(what, found)}: {place}") from found


def _fault(what: str, found: Exception) -> str:
    if isinstance(found, OSError):
        return f"unreadable {what} ({found.strerror or found})"
    said = str(found) if type(found) is ValueError else f"{type(found).__name__}: {found}"
    return f"damaged {what} ({said[:300]})"


def read_bytes(path: str | os.PathLike[str], most: int = MOST_BYTES) -> bytes:
    """Return the bytes of a regular file; a link may lead to one.

    A pipe, device or folder, and more than ``most`` bytes, are an ``OSError``.
    """
    # not blocking: to open a pipe waits for its writer
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(handle, "rb") as file:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise OSError("it is not a regular file")
        data = file.read(most + 1) if status.st_size <= most else None
    if data is None or len(data) > most:
        raise OSError(f"it has more than {most} bytes")
    return data


def read_text(path: str | os.PathLike[str], most: int = MOST_TEXT_BYTES) -> str:
    """Return the text of a file in UTF-8; raises as :func:`read_bytes`, and ``ValueError``."""
    return read_bytes(path, most).decode().replace("\r\n", "\n")


def num_values(text: str) -> int:
    """Return how many values a JSON text has at most, before it is parsed."""
    return 1 + sum(map(text.count, ",[{"))


def parse_object(text: str | bytes) -> dict[str, Any]:
    """Return the object that a JSON text from a file holds.

    A ``ValueError`` refuses what is no object, nested too deep, has more than :data:`MOST_VALUES`
    values, or holds what cannot be computed with or written again: numbers that are not finite,
    integers beyond 64 bits, half letters other than those of :func:`os.fsdecode`.
    """
    plain = text if isinstance(text, str) else text.decode("utf-8-sig")
    if num_values(plain) > MOST_VALUES:
        raise ValueError(f"more than {MOST_VALUES} values")
    kinds: dict[str, Any] = {
        "parse_constant": _finite,
        "parse_float": _finite,
        "parse_int": _integer,
    }
    try:
        value = json.loads(plain, **kinds)
    except RecursionError:
        raise ValueError("nested too deep") from None
    if not isinstance(value, dict):
        raise ValueError(f"a JSON {type(value).__name__}, expected an object")
    if _HALF_LETTER.search(plain):
        os.fsencode(json.dumps(value, ensure_ascii=False))
    return value


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text[:40]}, expected finite ones")
    return value


def _integer(text: str) -> int:
    if len(text) > 20 or not -(2**63) <= int(text) < 2**64:
        raise ValueError(f"the number {text[:40]}, expected 64 bits")
    return int(text)


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Make the folder of a file that is written in the block, and let an ``OSError`` name the file,
    which a full disk's does not.
    """
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as fault:
        said = fault.strerror or str(fault)
        raise OSError(fault.errno or 0, said, os.fspath(path)) from fault


def write_aside(path: Path, data: str | bytes) -> None:
    """Write a file under another name first: a run that ends in the middle leaves no half of it.

    A device or a pipe would give way to a file, ``/dev/null`` for the whole system: an ``OSError``.
    """
    short = os.fsdecode(os.fsencode(path.name)[:200])
    aside = path.parent / f".{short}.{os.getpid()}"
    with writing(path):
        if path.exists() and not path.is_file():
            raise OSError(errno.EINVAL, "Not a regular file")
        try:
            aside.unlink(missing_ok=True)
            with aside.open("xb") as file:
                # names of folders may hold bytes that are no UTF-8
                file.write(
                    data.encode(errors="backslashreplace") if isinstance(data, str) else data
                )
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)


def file_name(name: str, suffix: str = "") -> str:
    """Return a file name for what comes from a file: names of scenes are no paths.

    Letters, digits and ``-_.`` stay; a name that has others, begins with a dot or is longer than
    100 letters is changed and gets the beginning of its SHA-256, so that two names stay two files.

    Examples:
        >>> file_name("scene-0061", ".html")
        'scene-0061.html'
        >>> file_name("../scene", ".html")
        'scene-0b42f5e4.html'
    """
    plain = re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip(".-")[:100]
    if plain != name or not name:
        digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:8]
        plain = f"{plain[:80]}-{digest}".lstrip("-")
    return plain + suffix
