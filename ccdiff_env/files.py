"""Files that come from others or go to them: names, JSON, and writing that is never half done."""

from __future__ import annotations

import hashlib
import json
import os
import re
from pathlib import Path
from typing import Any

__all__ = ["file_name", "parsed_object", "write_aside"]


def parsed_object(text: str | bytes) -> dict[str, Any]:
    """Return the object that a JSON text from a file holds.

    Raises
    ------
    ValueError
        If it is no JSON, nested too deep, or no object.
    """
    try:
        value = json.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None
    if not isinstance(value, dict):
        raise ValueError(f"a JSON {type(value).__name__}, expected an object")
    return value


def write_aside(path: Path, text: str) -> None:
    """Write a file under another name first: a run that ends in the middle leaves no half of it."""
    aside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        aside.write_text(text, encoding="utf-8")
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)


def file_name(name: str, suffix: str = "") -> str:
    """Return a file name for what comes from a file: names of scenes are no paths.

    Letters, digits and ``-_.`` stay; a name that has others, begins with a dot or is longer than
    100 letters is changed and gets the beginning of its SHA-256, so that two names stay two files.

    Examples
    --------
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
