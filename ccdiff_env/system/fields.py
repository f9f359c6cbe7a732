"""Fields of data classes where ``help()`` and ``print()`` show them."""

from __future__ import annotations

import dataclasses
import inspect
import re
from typing import Any, TypeVar

_Class = TypeVar("_Class", bound=type)
_FIELD = re.compile(r"    (\w+): (.+?)(?: = .+?)?(?:  #: (.*))?$")


class Documented:
    """Docstring of a class that ends with its fields: what ``#:`` says of each in the source."""

    listed = True  #: Whether fields are listed; the site's generator shows them by itself.

    def __init__(self, text: str) -> None:
        self._text = text

    def __get__(self, _: object, of: type) -> str:
        if not self.listed:
            return self._text
        try:
            lines = [text for kind in reversed(of.__mro__[:-1]) for text in _fields(kind)]
        except (OSError, TypeError):  # no source
            return self._text
        return "\n".join([inspect.cleandoc(self._text), "", "Fields:", *lines])


def _fields(of: type) -> list[str]:
    found, said = list[str](), list[str]()
    for line in inspect.getsource(of).splitlines():
        field = _FIELD.match(line)
        if line.startswith("    #: "):
            said.append(line[7:])
        elif field and (field[3] or said):
            found.append(f"    {field[1]}: {field[3] or ' '.join(said)}")
        if not line.startswith("    #: "):
            said = []
    return found


def documented(of: _Class) -> _Class:
    """Let ``help()`` of a class list its fields."""
    of.__doc__ = Documented(of.__doc__ or "")  # type: ignore[assignment]
    return of


def shapes(self: Any) -> str:
    """Return the text of an object: its fields, arrays by type and shape."""
    parts = []
    for name in (f.name for f in dataclasses.fields(self) if f.repr):
        value = getattr(self, name)
        shape = getattr(value, "shape", None)
        told = repr(value) if shape is None else f"{value.dtype}{list(shape)}"
        parts.append(f"{name}={told}")
    return f"{type(self).__name__}({', '.join(parts)})"
