"""Banks: recorded critical traffic as scenes to train in.

CCDiff traffic is far slower than a learner. A bank holds episodes that it made against one ego, as
scenes in which the others do as recorded: they are played as fast as logs, mixed with logs, and
recorded again against the current ego.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.models import weights_path
from ccdiff_env.planners.built_in import ego_driver
from ccdiff_env.record.episode import begin, play, recorders_of, world_of_seat
from ccdiff_env.record.rollout import as_scene
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.system.files import read_bytes, reading, write_aside
from ccdiff_env.system.processes import results_of_processes
from ccdiff_env.system.settings import keep_settings, sha256
from ccdiff_env.traffic.checked_options import check
from ccdiff_env.worlds import Scenes, exact_seed, scene_set

FORMAT = "ccdiff-env bank 1"
#: The world of every episode. It goes on to the end of the horizon, so that slower egos meet the
#: same traffic.
WORLD = WorldConfig().with_options(
    on_collision="stop", on_off_road="ignore", terminate_at_goal=False, autoreset="disabled"
)
SETTINGS = "bank.json"
PIECE = 12  #: Scenes that share a batch of the network, and a file.
MAX_BYTES = 64 << 20  #: A scene in a file is not larger.
#: Bytes of all scenes of a bank: so many, and so many times those of its files. Recorded scenes
#: take three times as many.
LEAST_BYTES, MOST_RATIO = 128 << 20, 30


def record_bank(
    scenes: Scenes,
    folder: str | os.PathLike[str],
    *,
    ego: str = "idm",
    criticality: float = 1.0,
    draws: int = 1,
    seed: int = 0,
    workers: int = 1,
) -> SceneSet:
    """Drive scenes in CCDiff traffic and keep the episodes as scenes.

    A call that was stopped goes on with what the folder lacks. What a bank holds does not depend on
    the number of workers.

    Args:
        scenes: Scenes to drive, as for :func:`ccdiff_env.make_vec`.
        folder: Where the bank goes.
        ego: The ego that the traffic is made against: ``"idm"``, ``"replay"``, ``"pdm"``, a policy
            of :mod:`ccdiff_env.planners`, or the path of one (``.safetensors``, ``.zip``).
        criticality: Strength of the guidance against it.
        draws: Episodes of each scene.
        seed: Seed of the first draw; the others follow.
        workers: Processes.

    Returns:
        SceneSet: The recorded scenes: the others do as recorded, the ego's log stays for its route
            and goal.

    Raises:
        ConfigError: If the folder holds a bank of other settings, or one is out of range.
        DatasetError: If what the folder holds is damaged.
    """
    for name, count in (("draws", draws), ("workers", workers)):
        if type(count) is not int or count < 1:
            raise ConfigError(f"{name} is {count!r}, expected an integer of at least 1")
    check("CcdiffConfig", "", {"criticality": criticality})
    criticality, seed = float(criticality), exact_seed(seed)
    ego_driver(ego)  # what is wrong leaves no folder
    chosen, root = scene_set(scenes), Path(folder)
    settings = {
        "format": FORMAT,
        "ego": f"{Path(ego).name} {sha256(read_bytes(ego))}" if Path(ego).is_file() else ego,
        "criticality": criticality,
        "seed": seed,
        "scenes": sha256(*(scene.hash for scene in chosen)),
        "weights": sha256(read_bytes(weights_path("fast"))),
    }
    keep_settings(root / SETTINGS, settings)
    tag = sha256(json.dumps(settings))[:6]
    jobs = []
    for draw in range(draws):
        for first in range(0, len(chosen), PIECE):
            path = root / f"{first // PIECE:04d}-{draw}.scenes"
            if not path.exists():
                some = [scene.to_bytes() for scene in chosen[first : first + PIECE]]
                who = ego, criticality, seed + draw, f"{tag}-{draw}"
                jobs.append((path, some, *who))
    for _ in map(_record, jobs) if workers == 1 else results_of_processes(_record, jobs, workers):
        pass
    return load_bank(root)


def _record(job: tuple[Path, list[bytes], str, float, int, str]) -> None:
    """Record one part and write its file."""
    path, packed, ego, criticality, seed, tag = job
    scenes = SceneSet([Scene.from_bytes(data) for data in packed])
    driver, seat = ego_driver(ego)
    who = driver if seat is None else seat.name
    fixed = world_of_seat(WORLD, seat, who, fixed_by="a bank", dt_s=scenes[0].dt)
    settings = {"criticality": criticality, "num_samples": 1}
    config = fixed.with_options(traffic="ccdiff", driver=driver, ccdiff=settings)
    worlds = begin(scenes, config, seed)
    if seat is not None:
        seat.begin(worlds)
    recorders = recorders_of(worlds, scenes.names, planner=who)
    for _ in play(worlds, seat, recorders=recorders):
        pass
    parts = []
    for i, recorder in recorders.items():
        scene = as_scene(recorder.rollout(), f"{scenes[i].name} {tag}")
        data = zlib.compress(scene.to_bytes(), 3)
        parts.append(struct.pack("<I", len(data)) + data)
    write_aside(path, b"".join(parts))


def load_bank(folder: str | os.PathLike[str]) -> SceneSet:
    """Return the scenes of a bank that :func:`record_bank` wrote.

    Raises:
        DatasetNotFoundError: If there is none.
        DatasetError: If a file is damaged.
    """
    root = Path(folder)
    if not (root / SETTINGS).is_file():
        raise DatasetNotFoundError(f"no bank in {root}")
    scenes: list[Scene] = []
    spare = LEAST_BYTES
    for path in sorted(root.glob("*.scenes")):
        with reading("bank", path):
            data = read_bytes(path)
            spare += MOST_RATIO * len(data)
            for plain in _unpack(data):
                spare -= len(plain)
                if spare < 0:
                    raise DatasetError("unpacks to far more bytes than expected")
                scenes.append(Scene.from_bytes(plain))
    return SceneSet(scenes)


def _unpack(data: bytes) -> Iterator[bytes]:
    """Scenes of a file, one after the other."""
    at = 0
    while at < len(data):
        (length,) = struct.unpack_from("<I", data, at)
        packed, at = data[at + 4 : at + 4 + length], at + 4 + length
        reader = zlib.decompressobj()
        plain = reader.decompress(packed, MAX_BYTES)
        if not reader.eof:
            raise DatasetError("a scene is cut off or too large")
        yield plain
