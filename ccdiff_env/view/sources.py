"""Where rollouts come from: files, folders of files, and the logs of scenes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.errors import ConfigError, UnknownNameError, meant
from ccdiff_env.record.rollout import DRIVER_NAMES, Rollout
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.embedded import embedded_splits
from ccdiff_env.scenes.sources import DEFAULT, Place, load
from ccdiff_env.traffic import NETWORKS, SWIFT
from ccdiff_env.view.link import is_drive, play_drive

SAMPLES = 8  #: Samples per plan of CCDiff in episodes that are played for a page.
LOG = "log"  #: Stands for the log of the scene of the other run.


def log_rollout(scene: Scene, *, like: Rollout | None = None) -> Rollout:
    """Return the log of a scene as a rollout.

    Args:
        scene: The scene; all agents follow the log.
        like: Only the time of this rollout, where the log reaches so far; the whole log by default.
    """
    tracks = scene.tracks()
    start = like.start_step if like is not None else 0
    end = start + like.num_steps if like is not None else scene.num_steps
    window = slice(start, min(end, scene.num_steps))
    return Rollout(
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


def play_scene(
    scene: Scene,
    *,
    traffic: str = "ccdiff",
    driver: str = "idm",
    seed: int = 0,
    ccdiff: Mapping[str, Any] | None = None,
    **options: Any,
) -> Rollout:
    """Simulate a scene once and return what happened.

    Args:
        scene: The scene.
        traffic, driver: Who drives the other vehicles, and the ego: ``"ccdiff"``, ``"idm"``,
            ``"replay"`` or ``"constant_velocity"``; the ego also a policy of
            :mod:`ccdiff_env.planners`, by name or the path of its file (``.safetensors``).
        seed: Seed of the episode.
        ccdiff: Settings of CCDiff and of other networks
            (:class:`~ccdiff_env.traffic.CcdiffConfig`); :data:`SAMPLES` per plan unless they say
            otherwise.
        options: Further ones of :class:`~ccdiff_env.EgoEnv`.

    Raises:
        ConfigError: If an option is unknown or out of range, or if the ego would be driven from
            outside.
        SceneError: If the scene cannot be played: it has no ego, or is too short.
    """
    # imported here: most pages are of recorded episodes
    from ccdiff_env.envs import EgoEnv
    from ccdiff_env.planners.built_in import ego_driver
    from ccdiff_env.record.episode import play
    from ccdiff_env.record.recorder import Recorder

    name, seat = ego_driver(driver)
    if seat is not None:
        options = {"config": seat.config.with_options(decision_steps=1), **options}
    settings = dict(ccdiff or {})
    if {traffic, name} & {*NETWORKS} - {SWIFT}:
        settings = {"num_samples": SAMPLES, **settings}
    env = EgoEnv(scenes=scene, traffic=traffic, driver=name, ccdiff=settings, **options)
    env.reset(seed=seed)
    recorder = Recorder(env, planner=driver)
    if seat is not None:
        seat.begin(env.worlds)
    for _ in play(env.worlds, seat, recorders={0: recorder}):
        pass
    env.close()
    return recorder.rollout()


def find_rollout(
    name: str, place: Place | str = DEFAULT, *, like: Rollout | None = None
) -> Rollout:
    """Return the rollout that a word of the command line names: a file of one, a link to a drive,
    else a scene of a place; ``"log"`` is the log of ``like``, with which it is compared.

    Raises:
        UnknownNameError: If there is neither such a file nor such a scene.
        DatasetError: If the file is damaged.
    """
    if is_drive(name):
        return play_drive(name, place)
    path = Path(name)
    if path.is_file():
        if path.suffix in {".zip", ".safetensors"}:
            raise ConfigError(f"{name} is a policy, not a rollout: --driver {name} drives by it")
        return Rollout.load(path)
    if name == LOG:
        if like is None:
            raise ConfigError(f"{LOG!r} stands for the log of another run: use it with --compare")
        return log_rollout(like.scene, like=like)
    return log_rollout(find_scene(name, place))


def find_scene(name: str, place: Place | str = DEFAULT) -> Scene:
    """Return a scene of a place by name; none is an :class:`UnknownNameError`."""
    try:
        return load(place, names=[name])[0]
    except UnknownNameError as error:
        own = [known for names in embedded_splits().values() for known in names]
        hint = meant(name, own) or "ccdiff-env scenes lists them, --scenes names another source"
        hint = "" if "did you mean" in str(error) else f"; {hint}"
        raise UnknownNameError(f"no file {name!r}, and in {place}: {error}{hint}") from None
