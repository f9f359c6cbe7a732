"""Where rollouts come from: files, folders of files, and the logs of scenes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ccdiff_env.embedded import embedded_scenes
from ccdiff_env.errors import ConfigError, UnknownNameError
from ccdiff_env.rollout import DRIVER_NAMES, Rollout
from ccdiff_env.scenes import Scene, load_nuscenes
from ccdiff_env.view.contacts import overlaps

LOG = "log"
"""Stands for the log of the scene of the other run."""


def log_rollout(scene: Scene, *, like: Rollout | None = None) -> Rollout:
    """Return the log of a scene as a rollout.

    Parameters
    ----------
    scene
        The scene; all agents follow the log.
    like
        Only the time of this rollout, where the log reaches so far; the whole log by default.
    """
    tracks = scene.tracks()
    start = like.start_step if like is not None else 0
    end = start + like.num_steps if like is not None else scene.num_steps
    window = slice(start, min(end, scene.num_steps))
    rollout = Rollout(
        scene=scene,
        start_step=start,
        dt_s=scene.dt,
        agent_ids=tuple(scene.agent_ids),
        position=np.ascontiguousarray(tracks["position"][:, window]),
        heading=np.ascontiguousarray(tracks["heading"][:, window]),
        velocity=np.ascontiguousarray(tracks["velocity"][:, window]),
        valid=np.ascontiguousarray(tracks["valid"][:, window]),
        drivers=np.full(scene.num_agents, DRIVER_NAMES.index("replay"), np.int64),
        meta={"traffic": "replay", "planner": "log"},
    )
    return replace(rollout, events=overlaps(rollout))


def find_rollout(
    name: str,
    *,
    dataroot: str | Path | None = None,
    version: str = "v1.0-mini",
    like: Rollout | None = None,
) -> Rollout:
    """Return the rollout that a word of the command line names.

    Parameters
    ----------
    name
        File of a rollout, else name of a scene: of nuScenes where ``dataroot`` is given, else of
        the embedded ones. ``"log"`` is the log of ``like``.
    dataroot, version
        Folder of nuScenes, and of its tables.
    like
        The run that this one is compared with.

    Raises
    ------
    UnknownNameError
        If there is neither such a file nor such a scene.
    DatasetError
        If the file is damaged.
    """
    path = Path(name)
    if path.is_file():
        return Rollout.load(path)
    if name == LOG:
        if like is None:
            raise ConfigError(f"{LOG!r} stands for the log of another run: use it with --compare")
        return log_rollout(like.scene, like=like)
    if dataroot is not None:
        return log_rollout(load_nuscenes(dataroot, version, scenes=[name])[0])
    scenes = embedded_scenes()
    if name not in scenes:
        raise UnknownNameError(
            f"no file {name!r}, and no embedded scene of that name "
            f"({', '.join(scenes.names[:4])}, ...); for nuScenes give --dataroot"
        )
    return log_rollout(scenes[name])


def rollout_files(folder: Path) -> list[Path]:
    """Return the files of rollouts below a folder, in order."""
    return sorted(folder.rglob("*.npz"))
