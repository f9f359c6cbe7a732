"""Reading of scenario descriptions without running code from them.

A pickle is a program for a small machine, which calls what ``find_class`` returns. Here that is
one of a few functions of this module, which make arrays of numbers and text from their bytes.
"""

from __future__ import annotations

import io
import os
import pickle
import re
from collections.abc import Callable
from math import prod
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from ccdiff_env.errors import DatasetError
from ccdiff_env.system.files import read_bytes, reading

#: Kinds and sizes, in bytes, of numbers in arrays; the size of text is in characters.
_DTYPE = re.compile(r"b1|[iu][1248]|f[248]|[US]\d{1,4}")


def _refusal(what: str) -> DatasetError:
    return DatasetError(f"the pickle asks for {what}, expected numpy arrays and containers only")


class _Maker:
    """Stands for a global of the pickle, which may call it and change nothing about it."""

    __slots__ = ("_make",)

    def __init__(self, make: Callable[..., Any]) -> None:
        self._make = make

    def __call__(self, *arguments: Any) -> Any:
        return self._make(*arguments)

    def __setstate__(self, state: object) -> None:
        raise _refusal(f"a state of {type(self).__name__}")


class _Dtype:
    """A dtype whose byte order comes with its state."""

    __slots__ = ("dtype",)

    def __init__(self, code: object, align: object = False, copy: object = True) -> None:
        if not (isinstance(code, str) and _DTYPE.fullmatch(code)):
            raise _refusal(f"numpy.dtype {_shown(code)}")
        self.dtype: np.dtype[Any] = np.dtype(code)

    def __setstate__(self, state: Any) -> None:
        _, order, *rest = state
        if order not in ("<", ">", "=", "|") or any(rest[i] is not None for i in range(3)):
            raise _refusal(f"numpy.dtype {self.dtype} with fields or a shape")
        self.dtype = self.dtype.newbyteorder(order)


class _Array(np.ndarray[Any, Any]):
    """An array whose shape, dtype and bytes come with its state."""

    def __setstate__(self, state: Any) -> None:
        _, shape, dtype, by_column, data = state
        made = _array(data, dtype, shape, "F" if by_column else "C")
        super().__setstate__((1, shape, made.dtype, bool(by_column), made.tobytes("A")))
        self.flags.writeable = False


class _Tuple(tuple[Any, ...]):
    """A tuple that is no key: the time of its hash grows with 2 to the depth of nested ones."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]


def _shown(value: object) -> str:
    """Text of a value that is short and takes no time; a container is named by its type."""
    return repr(value)[:80] if isinstance(value, (str, bool, float)) else type(value).__name__


def _array(data: Any, dtype: Any, shape: Any, order: Any) -> npt.NDArray[Any]:
    """Return an array made from exactly the bytes that it needs."""
    if not (isinstance(dtype, _Dtype) and isinstance(data, bytes)):
        raise _refusal(f"an array of {type(dtype).__name__} from {type(data).__name__}")
    if not (isinstance(shape, tuple) and all(type(n) is int and n >= 0 for n in shape)):
        raise _refusal(f"an array of shape {_shown(shape)}")
    kind = dtype.dtype
    if kind.itemsize == 0 or prod(shape) * kind.itemsize != len(data) or order not in ("C", "F"):
        raise _refusal(f"an array of {kind} from {len(data)} bytes, which do not fit its shape")
    made: npt.NDArray[Any] = np.ndarray(shape, kind, data, order=order)
    return made.view(np.uint8) != 0 if kind.kind == "b" else made


def _scalar(dtype: Any, data: Any = b"") -> Any:
    empty = isinstance(dtype, _Dtype) and dtype.dtype.itemsize == 0
    return dtype.dtype.type() if empty else _array(data, dtype, (), "C")[()]


def _encode(text: Any, codec: Any) -> bytes:
    if not (isinstance(text, str) and codec == "latin1"):
        raise _refusal(f"_codecs.encode of {type(text).__name__} to {_shown(codec)}")
    return text.encode("latin1")


#: Globals that a scenario may name. Those without a function stand as arguments of others only.
_GLOBALS: dict[str, Callable[..., Any] | None] = {
    "numpy.ndarray": None,
    "numpy.dtype": _Dtype,
    "numpy.core.multiarray._reconstruct": lambda *_: _Array((0,), "b"),
    "numpy.core.multiarray.scalar": _scalar,
    "numpy.core.numeric._frombuffer": _array,
    "_codecs.encode": _encode,
    **dict.fromkeys(("collections.OrderedDict", "collections.defaultdict"), lambda *_: {}),
    "builtins.set": set,
    "builtins.frozenset": frozenset,
    **dict.fromkeys(f"builtins.{name}" for name in ("dict", "float", "int", "list", "str")),
}


def _bounded(step: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return a step whose result is a quick key: large integers can share one hash."""

    def load(machine: Any) -> None:
        step(machine)
        made = machine.stack[-1]
        if type(made) is tuple:
            machine.stack[-1] = _Tuple(made)
        elif isinstance(made, int) and not -(2**63) <= made < 2**63:
            raise _refusal("a whole number beyond 64 bits")

    return load


# The machine in Python and not the one in C, which takes as much memory as a file says.
class _Unpickler(pickle._Unpickler):
    """Builds numbers, text, plain containers and arrays."""

    dispatch: ClassVar[dict[int, Any]] = {
        code: _bounded(step) if re.search("tuple|int|long", step.__name__) else step
        for code, step in pickle._Unpickler.dispatch.items()
    } | {pickle.BYTEARRAY8[0]: pickle._Unpickler.dispatch[pickle.BINBYTES8[0]]}

    def find_class(self, module: str, name: str) -> Any:
        """Return what stands for an allowed global."""
        known = f"{module}.{name}".replace("numpy._core", "numpy.core")
        if known not in _GLOBALS:
            raise _refusal(f"{module}.{name}"[:80])
        make = _GLOBALS[known]
        return None if make is None else _Maker(make)


def load_scenario_dict(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a scenario description without running code from it; arrays are read-only.

    A pickle that is damaged, or asks for anything but numpy arrays and plain containers, is a
    :class:`DatasetError`.
    """
    with reading("scenario", path):
        data = read_bytes(path)
        if not data.startswith(b"\x80"):
            raise DatasetError("no pickle, expected a scenario description of ScenarioNet (.pkl)")
        scenario = _Unpickler(io.BytesIO(data)).load()
        if not isinstance(scenario, dict):
            raise DatasetError(f"a {type(scenario).__name__}, expected a dictionary")
        return scenario
