"""Recorded episodes for other viewers: Rerun (``.rrd``) and MCAP (``.mcap``, for Foxglove)."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.errors import ConfigError, MissingFeatureError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.system.files import write_aside
from ccdiff_env.view.captions import driver_of
from ccdiff_env.view.page import colours

__all__ = ["export"]

#: Message schema that Foxglove draws, by its name.
SCHEMA = "foxglove.SceneUpdate"
HEIGHT_M = 1.6


def export(rollout: Rollout, path: str | Path) -> None:
    """Write the boxes of all agents over time; the suffix of the file names the program.

    Parameters
    ----------
    rollout
        A recorded episode.
    path
        ``.rrd`` for Rerun, ``.mcap`` for Foxglove and others that read MCAP with JSON messages.

    Raises
    ------
    ConfigError
        If the suffix is another one.
    MissingFeatureError
        If the library that writes the format is not installed.
    """
    path = Path(path)
    writers = {".rrd": _rerun, ".mcap": _mcap}
    if path.suffix not in writers:
        raise ConfigError(f"{path.name}: suffix is {path.suffix!r}, expected .rrd or .mcap")
    try:
        writers[path.suffix](rollout, path)
    except ImportError as error:
        raise MissingFeatureError(
            f"writing {path.suffix} needs {error.name}: pip install 'ccdiff-env[export]'"
        ) from error


def _boxes(rollout: Rollout) -> tuple[list[str], list[list[int]]]:
    """Driver and colour (red, green, blue, alpha) of each agent."""
    drivers = [driver_of(rollout, i) for i in range(len(rollout.agent_ids))]
    known = colours()["light"]
    found = [known[driver].lstrip("#") for driver in drivers]
    return drivers, [[*bytes.fromhex(text), 255] for text in found]


def _rerun(rollout: Rollout, path: Path) -> None:
    import rerun as rr

    _, rgba = _boxes(rollout)
    size = np.asarray(rollout.scene.sizes[:, :2], np.float32)
    stream = rr.RecordingStream("ccdiff_env")
    stream.save(path)
    for number, layer in enumerate(_lines(rollout)):
        stream.log(f"map/{number}", rr.LineStrips3D([layer], colors=[[150, 150, 150]]), static=True)
    for step in range(rollout.num_steps):
        there = np.flatnonzero(rollout.valid[:, step])
        stream.set_time("episode", duration=step * rollout.dt_s)
        heading = rollout.heading[there, step] / 2.0
        zero = np.zeros_like(heading)
        stream.log(
            "agents",
            rr.Boxes3D(
                centers=np.c_[rollout.position[there, step], np.full(len(there), HEIGHT_M / 2)],
                sizes=np.c_[size[there], np.full(len(there), HEIGHT_M)],
                quaternions=np.stack([zero, zero, np.sin(heading), np.cos(heading)], axis=-1),
                colors=[rgba[i] for i in there],
                labels=[rollout.agent_ids[i] for i in there],
            ),
        )
    stream.disconnect()


def _lines(rollout: Rollout) -> list[Any]:
    """Borders of the road [N, 3]."""
    layers: dict[str, Any] = dict(rollout.scene.map_layers())
    areas = [np.asarray(area["exterior"]) for area in layers.get("drivable_area", [])]
    return [np.c_[area, np.zeros(len(area))] for area in areas]


def _mcap(rollout: Rollout, path: Path) -> None:
    from mcap.writer import Writer

    _, rgba = _boxes(rollout)
    made = io.BytesIO()
    writer = Writer(made)
    writer.start(library="ccdiff-env")
    schema = writer.register_schema(SCHEMA, "jsonschema", b'{"type": "object"}')
    channel = writer.register_channel("/agents", "json", schema)
    for step in range(rollout.num_steps):
        nanoseconds = round(step * rollout.dt_s * 1e9)
        message = json.dumps(_scene_update(rollout, step, nanoseconds, rgba)).encode()
        writer.add_message(channel, nanoseconds, message, nanoseconds)
    writer.finish()
    write_aside(path, made.getvalue())


def _scene_update(
    rollout: Rollout, step: int, nanoseconds: int, rgba: list[list[int]]
) -> dict[str, Any]:
    stamp = {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}
    entities = []
    for i in np.flatnonzero(rollout.valid[:, step]):
        x, y = (float(v) for v in rollout.position[i, step])
        half = float(rollout.heading[i, step]) / 2.0
        length, width = (float(v) for v in rollout.scene.sizes[i, :2])
        cube = {
            "pose": {
                "position": {"x": x, "y": y, "z": HEIGHT_M / 2},
                "orientation": {"x": 0.0, "y": 0.0, "z": np.sin(half), "w": np.cos(half)},
            },
            "size": {"x": length, "y": width, "z": HEIGHT_M},
            "color": dict(zip("rgba", (part / 255.0 for part in rgba[i]), strict=True)),
        }
        entities.append(
            {
                "timestamp": stamp,
                "frame_id": "scene",
                "id": rollout.agent_ids[i],
                "lifetime": {"sec": 0, "nsec": round(rollout.dt_s * 1e9)},
                "cubes": [cube],
            }
        )
    return {"deletions": [], "entities": entities}
