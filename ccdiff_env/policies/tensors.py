"""Arrays of float32 in safetensors files, read and written with numpy alone."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.errors import DatasetError, DatasetNotFoundError

F32 = npt.NDArray[np.float32]

#: Files of policies are far smaller.
MAX_BYTES = 64 << 20


def write_tensors(
    path: str | os.PathLike[str], tensors: Mapping[str, F32], metadata: Mapping[str, str]
) -> None:
    """Write arrays and texts; a reader never sees half a file."""
    header: dict[str, Any] = {"__metadata__": dict(metadata)}
    offset = 0
    for name, array in tensors.items():
        end = offset + 4 * array.size
        header[name] = {"dtype": "F32", "shape": list(array.shape), "data_offsets": [offset, end]}
        offset = end
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    parts = [struct.pack("<Q", len(text)), text]
    parts += [np.ascontiguousarray(array, "<f4").tobytes() for array in tensors.values()]
    target = Path(path)
    half = target.with_name(target.name + ".tmp")
    half.write_bytes(b"".join(parts))
    half.replace(target)


def read_tensors(path: str | os.PathLike[str]) -> tuple[dict[str, F32], dict[str, str]]:
    """Read arrays and texts.

    Raises
    ------
    DatasetNotFoundError
        If there is no such file.
    DatasetError
        If it is damaged, too large, or holds anything else than finite float32.
    """
    if not Path(path).is_file():
        raise DatasetNotFoundError(f"no policy at {os.fspath(path)}")
    if Path(path).stat().st_size > MAX_BYTES:
        raise DatasetError(f"policy: more than {MAX_BYTES} bytes, {os.fspath(path)}")
    data = Path(path).read_bytes()
    try:
        (length,) = struct.unpack_from("<Q", data)
        if 8 + length > len(data):
            raise ValueError("the header reaches beyond the end")
        header = json.loads(data[8 : 8 + length])
        metadata = {str(k): str(v) for k, v in header.pop("__metadata__", {}).items()}
        tensors = {name: _array(entry, data[8 + length :]) for name, entry in header.items()}
    except (struct.error, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DatasetError(f"policy: damaged ({error}), {os.fspath(path)}") from None
    return tensors, metadata


def _array(entry: Mapping[str, Any], body: bytes) -> F32:
    if entry["dtype"] != "F32":
        raise ValueError(f"dtype {entry['dtype']}, expected F32")
    begin, end = entry["data_offsets"]
    array: F32 = np.frombuffer(body[begin:end], "<f4").reshape(entry["shape"]).astype(np.float32)
    if not np.isfinite(array).all():
        raise ValueError("not all numbers are finite")
    return array
