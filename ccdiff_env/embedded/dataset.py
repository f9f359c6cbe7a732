"""The embedded data set: generated, packed into the shipped file, and unpacked again.

Layout of a data set folder: ``v1.0-embedded/*.json`` (tables), ``maps/expansion/ccdiff-town.json``,
``maps/ccdiff-town.png`` and ``splits.json`` (scene names of ``train`` and ``val``).
"""

from __future__ import annotations

import json
import zipfile
from importlib.resources import as_file, files
from pathlib import Path

from ccdiff_env.embedded.layout import LOCATION, build_city
from ccdiff_env.embedded.maps import MapWriter, mask_png
from ccdiff_env.embedded.scenes import build_scenes
from ccdiff_env.embedded.tables import VERSION, write_tables
from ccdiff_env.errors import DatasetError

SHIPPED = "data/embedded.zip"
ZIP_TIME = (2020, 1, 1, 0, 0, 0)


def generate() -> dict[str, bytes]:
    """Return the members of the data set by path; the same bytes at every call."""
    city = build_city()
    scenes = list(build_scenes(city))
    splits = {split: [s.name for s in scenes if s.split == split] for split in ("train", "val")}
    out = {f"{VERSION}/{name}.json": _rows(rows) for name, rows in write_tables(scenes).items()}
    out[f"maps/expansion/{LOCATION}.json"] = _dump(MapWriter(city).write())
    out[f"maps/{LOCATION}.png"] = mask_png(city)
    out["splits.json"] = _dump(splits)
    return out


def _dump(value: object) -> bytes:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()


def _rows(rows: list[dict[str, object]]) -> bytes:
    """Return a table with one record a line."""
    return b"[\n" + b",\n".join(_dump(row) for row in rows) + b"\n]\n"


def pack(members: dict[str, bytes], path: Path) -> None:
    """Write members as a zip file with fixed times and order."""
    with zipfile.ZipFile(path, "w") as archive:
        for name in sorted(members):
            info = zipfile.ZipInfo(name, ZIP_TIME)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, members[name], compresslevel=9)


def shipped() -> dict[str, bytes]:
    """Return the members of the shipped data set by path.

    Raises
    ------
    DatasetError
        If the package lacks the file or it is damaged.
    """
    try:
        with as_file(files("ccdiff_env") / SHIPPED) as path, zipfile.ZipFile(path) as archive:
            return {name: archive.read(name) for name in archive.namelist()}
    except (OSError, zipfile.BadZipFile) as error:
        raise DatasetError(f"the package's {SHIPPED} cannot be read: {error}") from error


def unpack(folder: Path) -> None:
    """Write the shipped data set below a folder."""
    for name, data in shipped().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
