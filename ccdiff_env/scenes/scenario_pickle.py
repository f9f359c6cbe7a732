"""Reading of scenario descriptions without running code from them.

A pickle is a program for a small machine. This module runs the part of that machine that builds
plain containers, keyed by text or numbers. Arrays of numbers and text are made here from their
bytes; the file neither calls a function of another library nor gives an object of one a state.
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

__all__ = ["load_scenario_dict"]

#: Kinds and sizes, in bytes, of numbers in arrays; the size of text is in characters.
_DTYPE = re.compile(r"b1|[iu][1248]|f[248]|[US]\d{1,4}")
_KEYS = (str, int, float, bytes, np.generic, type(None))
#: Keys and members of sets that are no text, in a file.
_MOST_NUMBERS = 10_000


def _refusal(what: str) -> DatasetError:
    return DatasetError(f"the pickle asks for {what}, expected numpy arrays and containers only")


class _Maker:
    """Stands for a global of the pickle: ``REDUCE`` may call it, nothing else may be done."""

    def __init__(self, make: Callable[..., Any]) -> None:
        self.make = make


class _Dtype:
    """A dtype whose byte order comes with its state."""

    memo_key: int | None = None

    def __init__(self, code: object, align: object = False, copy: object = True) -> None:
        if not (isinstance(code, str) and _DTYPE.fullmatch(code)):
            raise _refusal(f"numpy.dtype {_shown(code)}")
        self.dtype: np.dtype[Any] = np.dtype(code)

    def built(self, state: Any) -> _Dtype:
        """Return the dtype in the byte order of a state that says nothing else."""
        _, order, *rest = state
        if order not in ("<", ">", "=", "|") or any(rest[i] is not None for i in range(3)):
            raise _refusal(f"numpy.dtype {self.dtype} with fields or a shape")
        made = _Dtype(self.dtype.str[1:])
        made.dtype = self.dtype.newbyteorder(order)
        return made


class _Array:
    """An array whose shape, dtype and bytes come with its state."""

    memo_key: int | None = None

    def built(self, state: Any) -> npt.NDArray[Any]:
        """Return the array of a state."""
        _, shape, dtype, by_column, data = state
        return _array(data, dtype, shape, "F" if by_column else "C")


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


def _encoded(text: Any, codec: Any) -> bytes:
    if not (isinstance(text, str) and codec == "latin1"):
        raise _refusal(f"_codecs.encode of {type(text).__name__} to {_shown(codec)}")
    return text.encode("latin1")


def _dict(*_: object) -> dict[Any, Any]:
    return {}


#: Globals that a scenario may name. Those without a function stand as arguments of others only.
_GLOBALS: dict[str, Callable[..., Any] | None] = {
    "numpy.ndarray": None,
    "numpy.dtype": _Dtype,
    "numpy.core.multiarray._reconstruct": lambda *_: _Array(),
    "numpy.core.multiarray.scalar": _scalar,
    "numpy.core.numeric._frombuffer": _array,
    "_codecs.encode": _encoded,
    "collections.OrderedDict": _dict,
    "collections.defaultdict": _dict,
    **dict.fromkeys(f"builtins.{name}" for name in ("dict", "float", "int", "list", "str")),
}


#: Steps of the machine that are harmless as they are.
_STEPS = (
    "proto frame mark stop pop pop_mark dup none false true int binint binint1 binint2 long long1 "
    "long4 float binfloat unicode binunicode binunicode8 short_binunicode binbytes binbytes8 "
    "short_binbytes tuple empty_tuple tuple1 tuple2 tuple3 list empty_list empty_dictionary "
    "empty_set global stack_global get binget long_binget put binput long_binput memoize"
)


class _Memo(dict[int, Any]):
    """The memo of the machine; what is still without its state learns where it is kept."""

    def __setitem__(self, key: int, value: Any) -> None:
        if isinstance(value, (_Dtype, _Array)):
            value.memo_key = key
        super().__setitem__(key, value)


# The machine in Python and not the one in C: its steps can be replaced, and that one in C takes as
# much memory as a file says (LONG_BINPUT).
class _Unpickler(pickle._Unpickler):
    """Builds numbers, text, plain containers and arrays; refuses any other step."""

    stack: list[Any]
    append: Callable[[Any], None]
    pop_mark: Callable[[], list[Any]]

    def __init__(self, data: bytes) -> None:
        super().__init__(io.BytesIO(data))
        self.memo = _Memo()
        self._num_numbers = 0

    def _key(self, value: Any) -> Any:
        """Return a key: no tuple, as the time of a hash grows with 2 to the depth of nested ones,
        and few numbers, as there are numbers without end that share a hash.
        """
        if not isinstance(value, _KEYS):
            raise _refusal(f"a {type(value).__name__} as a key")
        if not isinstance(value, (str, bytes)):
            self._num_numbers += 1
            if self._num_numbers > _MOST_NUMBERS:
                raise _refusal(f"more than {_MOST_NUMBERS} numbers as keys")
        return value

    def _members(self, values: Any = ()) -> set[Any]:
        if not isinstance(values, (list, tuple)):
            raise _refusal(f"a set of {type(values).__name__}")
        return {self._key(value) for value in values}

    def find_class(self, module: str, name: str) -> Any:
        """Return what stands for an allowed global."""
        known = f"{module}.{name}".replace("numpy._core", "numpy.core")
        if known in ("builtins.set", "builtins.frozenset"):
            return _Maker(self._members)
        if known not in _GLOBALS:
            raise _refusal(f"{module}.{name}"[:80])
        make = _GLOBALS[known]
        return None if make is None else _Maker(make)

    def load_reduce(self) -> None:
        """Call a stand-in."""
        arguments = self.stack.pop()
        maker = self.stack.pop()
        if not isinstance(maker, _Maker):
            raise _refusal(f"a call of {type(maker).__name__}")
        self.append(maker.make(*arguments))

    def load_build(self) -> None:
        """Give a dtype or an array its state: a new object takes its place."""
        state = self.stack.pop()
        part = self.stack.pop()
        if not isinstance(part, (_Dtype, _Array)):
            raise _refusal(f"a state of {type(part).__name__}")
        made = part.built(state)
        if part.memo_key is not None:
            self.memo[part.memo_key] = made
        self.append(made)

    def load_append(self) -> None:
        """Append one value to a list."""
        self._extend([self.stack.pop()])

    def load_appends(self) -> None:
        """Append values to a list."""
        self._extend(self.pop_mark())

    def _extend(self, values: list[Any]) -> None:
        if type(self.stack[-1]) is not list:
            raise _refusal(f"values appended to {type(self.stack[-1]).__name__}")
        self.stack[-1].extend(values)

    def load_setitem(self) -> None:
        """Put one entry into a dictionary."""
        value = self.stack.pop()
        self._update([self.stack.pop(), value])

    def load_setitems(self) -> None:
        """Put entries into a dictionary."""
        self._update(self.pop_mark())

    def _update(self, items: list[Any]) -> None:
        if type(self.stack[-1]) is not dict:
            raise _refusal(f"entries of {type(self.stack[-1]).__name__}")
        for key, value in zip(items[::2], items[1::2], strict=True):
            self.stack[-1][self._key(key)] = value

    def load_dict(self) -> None:
        """Build a dictionary."""
        items = self.pop_mark()
        self.append({})
        self._update(items)

    def load_additems(self) -> None:
        """Put members into a set."""
        items = self.pop_mark()
        if type(self.stack[-1]) is not set:
            raise _refusal(f"members of {type(self.stack[-1]).__name__}")
        self.stack[-1].update(self._members(items))

    def load_frozenset(self) -> None:
        """Build a set."""
        items = self.pop_mark()
        self.append(self._members(items))

    dispatch: ClassVar[dict[int, Any]] = {
        code: step
        for code, step in pickle._Unpickler.dispatch.items()
        if step.__name__.removeprefix("load_") in _STEPS.split()
    } | {
        pickle.REDUCE[0]: load_reduce,
        pickle.BUILD[0]: load_build,
        pickle.APPEND[0]: load_append,
        pickle.APPENDS[0]: load_appends,
        pickle.SETITEM[0]: load_setitem,
        pickle.SETITEMS[0]: load_setitems,
        pickle.DICT[0]: load_dict,
        pickle.ADDITEMS[0]: load_additems,
        pickle.FROZENSET[0]: load_frozenset,
        # numpy's buffers; the machine's own takes as much memory as the file says
        pickle.BYTEARRAY8[0]: pickle._Unpickler.dispatch[pickle.BINBYTES8[0]],
    }


def load_scenario_dict(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a scenario description without running code from it.

    Arrays are read-only.

    Raises
    ------
    DatasetNotFoundError
        There is no such file.
    DatasetError
        The file is damaged, or its pickle asks for anything but numpy arrays and plain containers.
    """
    with reading("scenario", path):
        scenario = _Unpickler(read_bytes(path)).load()
        if not isinstance(scenario, dict):
            raise DatasetError(f"a {type(scenario).__name__}, expected a dictionary")
        return scenario
