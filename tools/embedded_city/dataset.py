"""The embedded data set: generated, and packed into the file that the package ships.

Layout of a data set folder: ``v1.0-embedded/*.json`` (tables), ``maps/expansion/ccdiff-town.json``,
``maps/ccdiff-town.png`` and ``splits.json`` (scene names of ``train`` and ``val``).
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

from ccdiff_env.scenes.embedded import VERSION
from tools.embedded_city.layout import LOCATION, build_city
from tools.embedded_city.maps import MapWriter, mask_png
from tools.embedded_city.scenes import SHIPPED, Recipe, build_scenes
from tools.embedded_city.tables import write_tables

ZIP_TIME = (2020, 1, 1, 0, 0, 0)


def generate(recipe: Recipe = SHIPPED) -> dict[str, bytes]:
    """Return the members of the data set by path; the same bytes at every call."""
    city = build_city()
    scenes = list(build_scenes(city, recipe))
    splits = {s.split: [t.name for t in scenes if t.split == s.split] for s in scenes}
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
