"""Replay certificates: small files from which an episode is simulated again, bit for bit."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import os
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import SnapshotError
from ccdiff_env.system.files import parse_object, read_text, reading, write_aside
from ccdiff_env.system.version import __version__
from ccdiff_env.worlds import fit

if TYPE_CHECKING:
    from ccdiff_env.worlds import Worlds

FORMAT = "ccdiff-env certificate 2"
MOST_EPISODES = 100_000  #: Episodes since the seed that a replay goes through.


def schema_digest(worlds: Worlds) -> str:
    """Digest of what observations and info columns mean."""
    return fit.schema_digest(worlds.native.layout_json, _native.schema("columns"))


def _state_digest(worlds: Worlds) -> str:
    """Digest of the bits of all present states and of the metrics of the episode."""
    hasher = hashlib.blake2b(digest_size=16)
    for _, array in sorted(dict[str, Any](worlds.native.states(0)).items()):
        hasher.update(array.tobytes())
    s = worlds.native.status(0)
    hasher.update(struct.pack("<4Q", s.seed, s.episode, s.step_idx, s.elapsed_steps))
    hasher.update(worlds.native.metrics(0).tobytes())
    return hasher.hexdigest()


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Everything that one episode follows from, and a digest of how it came out."""

    package: str  #: Version of the package.
    schema: str  #: Digest of what observations and info columns mean.
    scene: str  #: Name of the scene.
    scene_hash: str  #: Content hash of the scene.
    config: WorldConfig  #: Configuration.
    seed: int  #: Seed of the world.
    episode_idx: int  #: Number of the episode since that seed.
    #: Actions [T, W] float32 as handed to the world (grid indices for discrete ones).
    actions: npt.NDArray[np.float32] = field(repr=False)
    digest: str  #: Digest of the final states and of the metrics of the episode.
    ego: str | None = None  #: Id of an ego that was drawn.
    start_step: int | None = None  #: First step of an ego that was drawn.
    style: dict[str, float] | None = None  #: Factors of reward weights that were drawn or set.

    @classmethod
    def of(cls, worlds: Worlds, actions: bytes) -> Certificate:
        """Return the certificate of the present episode of a single world."""
        status = worlds.native.status(0)
        scene = worlds.scenes[status.scene_idx]
        rows = np.frombuffer(actions, np.float32).reshape(-1, worlds.native.action_width)
        config = worlds.config
        if 0 in worlds.criticality:  # drawn by a curriculum
            config = config.with_criticality(worlds.criticality[0])
        if worlds.drivers.get(0):  # chosen at the reset
            config = config.with_options(drivers={**config.drivers, **worlds.drivers[0]})
        drawn: dict[str, Any] = {}
        if config.controlled == "any" and status.ego_idx is not None:
            drawn["ego"] = scene.agent_ids[status.ego_idx]
            drawn["start_step"] = status.step_idx - status.elapsed_steps
        if config.style:
            drawn["style"] = worlds.native.drawn(0)[0]["style"]
        return cls(
            package=__version__,
            schema=schema_digest(worlds),
            scene=scene.name,
            scene_hash=scene.hash,
            config=config,
            seed=status.seed,
            episode_idx=status.episode - 1,
            actions=rows,
            digest=_state_digest(worlds),
            **drawn,
        )

    def to_json(self) -> str:
        """Return the certificate as JSON."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        fields = {name: value for name, value in fields.items() if value is not None}
        fields["config"] = json.loads(self.config.to_json())
        fields["actions"] = {
            "shape": list(self.actions.shape),
            "float32": base64.b64encode(self.actions.astype("<f4").tobytes()).decode(),
        }
        return json.dumps({"format": FORMAT, **fields}, indent=1)

    @classmethod
    def from_json(cls, text: str) -> Certificate:
        """Read what :meth:`to_json` wrote.

        Raises:
            SnapshotError: If the text is damaged or of another format.
        """
        try:
            fields = parse_object(text)
            if (found := fields.pop("format")) != FORMAT:
                raise SnapshotError(f"certificate: format {found!r}, this release reads {FORMAT!r}")
            packed = fields["actions"]
            data = base64.b64decode(packed["float32"], validate=True)
            fields["actions"] = np.frombuffer(data, "<f4").reshape(packed["shape"])
            fields["config"] = WorldConfig.from_json(json.dumps(fields["config"]))
            kinds = {"seed": int, "episode_idx": int, "scene": str, "digest": str}
            for name, kind in kinds.items():
                if type(fields[name]) is not kind:
                    raise SnapshotError(f"certificate: {name} is {fields[name]!r}")
            if not 0 <= fields["episode_idx"] <= MOST_EPISODES:
                raise SnapshotError(
                    f"certificate: episode_idx is {fields['episode_idx']}, expected 0 to "
                    f"{MOST_EPISODES}: it is played from its seed on"
                )
            if fields["actions"].ndim != 2 or not 0 <= fields["seed"] < 2**64:
                raise SnapshotError("certificate: actions or seed, expected [T, W] and 64 bits")
            return cls(**fields)
        except SnapshotError:
            raise
        except (ValueError, KeyError, TypeError) as error:
            raise SnapshotError(f"certificate: damaged ({error})") from None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the certificate to a file."""
        write_aside(Path(path), self.to_json())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Certificate:
        """Read a file that :meth:`save` wrote.

        Raises:
            DatasetNotFoundError, SnapshotError: If there is no such file, or it is damaged or of
                another format.
        """
        with reading("certificate", path, SnapshotError):
            return cls.from_json(read_text(path))
