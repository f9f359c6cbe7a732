"""Reading of scenario descriptions without running code from them.

Pickles can run code, so they are read with an unpickler that builds plain containers and numpy
arrays and nothing else.
"""

from __future__ import annotations

import io
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.errors import DatasetError, DatasetNotFoundError

__all__ = ["load_scenario_dict"]

#: Globals a scenario may name: what numpy arrays, scalars and plain containers are rebuilt with.
_ALLOWED = frozenset(
    {
        ("numpy", "ndarray"),
        ("numpy", "dtype"),
        ("numpy.core.multiarray", "_reconstruct"),
        ("numpy._core.multiarray", "_reconstruct"),
        ("numpy.core.multiarray", "scalar"),
        ("numpy._core.multiarray", "scalar"),
        ("numpy.core.numeric", "_frombuffer"),
        ("numpy._core.numeric", "_frombuffer"),
        ("collections", "OrderedDict"),
        ("collections", "defaultdict"),
        ("builtins", "dict"),
        ("builtins", "float"),
        ("builtins", "frozenset"),
        ("builtins", "int"),
        ("builtins", "list"),
        ("builtins", "set"),
        ("builtins", "str"),
        ("_codecs", "encode"),
    }
)


class _Unpickler(pickle.Unpickler):
    """Builds numpy arrays and plain containers; refuses any other global by name."""

    def find_class(self, module: str, name: str) -> Any:
        """Return an allowed global."""
        if (module, name) not in _ALLOWED:
            raise DatasetError(
                f"the pickle asks for {module}.{name}, expected numpy arrays and containers only"
            )
        if module.startswith(("numpy.core", "numpy._core")):
            # numpy 2 has moved these; either name is read with either numpy
            module = "numpy._core" if int(np.__version__.split(".")[0]) >= 2 else "numpy.core"
            module += ".numeric" if name == "_frombuffer" else ".multiarray"
        return super().find_class(module, name)


def load_scenario_dict(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a scenario description without running code from it.

    Raises
    ------
    DatasetNotFoundError
        There is no such file.
    DatasetError
        The file is damaged, or its pickle asks for anything but numpy arrays and plain containers.
    """
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError as error:
        raise DatasetNotFoundError(f"no scenario file at {path}") from error
    try:
        scenario = _Unpickler(io.BytesIO(data)).load()
    except DatasetError as error:
        raise DatasetError(f"{error}: {path}") from None
    except Exception as error:
        raise DatasetError(
            f"not a readable pickle ({type(error).__name__}: {error}): {path}"
        ) from error
    if not isinstance(scenario, dict):
        raise DatasetError(f"a {type(scenario).__name__}, expected a dictionary: {path}")
    return scenario
