"""Certified episodes, simulated again."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.envs.single import EgoEnv
from ccdiff_env.errors import SnapshotError
from ccdiff_env.record.certificate import Certificate, schema_digest
from ccdiff_env.worlds import Scenes, scene_set


@dataclass(frozen=True)
class Replay:
    """A certified episode, simulated again."""

    env: EgoEnv  #: The environment at the end of the episode.
    rewards: npt.NDArray[np.float64]  #: Rewards [T].


def replay(
    certificate: Certificate | str | os.PathLike[str],
    scenes: Scenes = None,
) -> Replay:
    """Simulate a certified episode again and check that it comes out the same, bit for bit.

    Args:
        certificate: A certificate, or the path of its file.
        scenes: Scenes among which the certified one is; by default the embedded ones.

    Returns:
        Replay: The environment at the end of the episode and the rewards.

    Raises:
        SnapshotError: If the scene, the schema or the outcome is another one.
    """
    if not isinstance(certificate, Certificate):
        certificate = Certificate.load(certificate)
    known = scene_set("all" if scenes is None else scenes)
    if (name := certificate.scene) not in known:
        raise SnapshotError(f"certificate: scene {name!r} is not among the scenes given")
    scene = known[name]
    if scene.hash != certificate.scene_hash:
        raise SnapshotError(
            f"certificate: scene {name!r} has hash {scene.hash}, expected {certificate.scene_hash}"
        )
    env = EgoEnv(scenes=[scene], config=certificate.config)
    if schema_digest(env.worlds) != certificate.schema:
        raise SnapshotError(
            f"certificate: made by version {certificate.package}, whose observations or info "
            "columns differ from this one's"
        )
    chosen: dict[str, Any] = {"style": certificate.style}
    if certificate.ego is not None:
        chosen |= {"scene": name, "ego": certificate.ego, "start": certificate.start_step}
    for i in range(certificate.episode_idx + 1):
        last = i == certificate.episode_idx
        env.reset(seed=None if i else certificate.seed, options=chosen if last else None)
    rewards = []
    shape, width = env.action_space.shape or (), env.worlds.native.action_width
    if certificate.actions.shape[1] != width:
        raise SnapshotError(
            f"certificate: actions have shape {certificate.actions.shape}, expected [T, {width}]"
        )
    for row in certificate.actions:
        action = row.reshape(shape) if shape else np.int64(row[0])
        rewards.append(env.step(action)[1])
    if env.certificate().digest != certificate.digest:
        raise SnapshotError("certificate: the episode came out differently")
    return Replay(env, np.array(rewards))
