"""Arrays of float32 in safetensors files, read and written with numpy alone."""

from __future__ import annotations

import json
import math
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.system.files import parse_object, read_bytes, reading, write_aside

F32 = npt.NDArray[np.float32]

MAX_BYTES = 64 << 20  #: Files of policies are far smaller.


def write_tensors(
    path: str | os.PathLike[str], tensors: Mapping[str, F32], metadata: Mapping[str, str]
) -> None:
    """Write arrays and texts; a reader never sees half a file."""
    write_aside(Path(path), tensor_bytes(tensors, metadata))


def tensor_bytes(tensors: Mapping[str, F32], metadata: Mapping[str, str]) -> bytes:
    """Return arrays and texts in the safetensors format."""
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
    return b"".join(parts)


def read_tensors(path: str | os.PathLike[str]) -> tuple[dict[str, F32], dict[str, str]]:
    """Read arrays and texts; anything else than finite float32 is a :class:`DatasetError`."""
    with reading("policy", path):
        data = read_bytes(path, MAX_BYTES)
        (length,) = struct.unpack_from("<Q", data)
        if 8 + length > len(data):
            raise ValueError("the header reaches beyond the end")
        header = parse_object(data[8 : 8 + length])
        metadata = {str(k): str(v) for k, v in header.pop("__metadata__", {}).items()}
        tensors = _arrays(header, data[8 + length :])
        return tensors, metadata


def _arrays(entries: Mapping[str, Any], body: bytes) -> dict[str, F32]:
    """Arrays of the format's rule: one behind the other, without gaps, to the end of the file."""
    found: dict[str, F32] = {}
    at = 0
    for name, entry in sorted(entries.items(), key=lambda item: item[1]["data_offsets"]):
        if entry["dtype"] != "F32":
            raise ValueError(f"{name}: dtype {entry['dtype']}, expected F32")
        shape = [int(size) for size in entry["shape"]]
        end = at + 4 * math.prod(shape)
        if entry["data_offsets"] != [at, end] or min(shape, default=1) < 0:
            raise ValueError(f"{name}: offsets {entry['data_offsets']}, expected {[at, end]}")
        array: F32 = np.frombuffer(body[at:end], "<f4").reshape(shape).astype(np.float32)
        if not np.isfinite(array).all():
            raise ValueError("not all numbers are finite")
        found[name], at = array, end
    if at != len(body):
        raise ValueError(f"{len(body)} bytes of arrays, expected {at}")
    return found
