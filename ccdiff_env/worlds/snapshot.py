"""The bytes of an environment's snapshot: the native world, and the actions of its episode."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from ccdiff_env.errors import SnapshotError
from ccdiff_env.worlds import Worlds, normalize_seed

_MAGIC = b"CCDENV"
_VERSION = 2
#: Magic, version, length of the actions in bytes (-1: not recorded), the criticality that the
#: episode drew (not a number: none).
_HEAD = struct.Struct("<6sHqd")


@dataclass(frozen=True)
class Snapshot:
    """One world at one moment: the native snapshot, and what else the future depends on.

    ``actions`` are those since the episode began, float32 rows, ``None`` where they were not
    recorded; ``criticality`` is what the episode drew.
    """

    world: bytes
    actions: bytes | None = None
    criticality: float | None = None

    @classmethod
    def of(cls, worlds: Worlds, world_idx: int, actions: bytes | None = None) -> Snapshot:
        """Return the snapshot of a world as it is."""
        drawn = worlds.criticality.get(world_idx)
        return cls(worlds.native.snapshot(world_idx), actions, drawn)

    def put(self, worlds: Worlds, world_idx: int, seed: int | None = None) -> None:
        """Put a world into it; with a seed, its future is another one.

        A :class:`SnapshotError` leaves the world as it was. A seed for a world that was never reset
        is a :class:`ResetNeededError`.
        """
        other = None if seed is None else normalize_seed(seed)
        worlds.native.restore(world_idx, self.world)
        worlds.criticality.pop(world_idx, None)
        if self.criticality is not None:
            worlds.criticality[world_idx] = self.criticality
        if other is not None:
            worlds.native.reseed(world_idx, other)
        if worlds.native.begun(world_idx):
            worlds.note_episode(world_idx)

    def to_bytes(self) -> bytes:
        """Return the snapshot as bytes."""
        actions = self.actions or b""
        length = -1 if self.actions is None else len(actions)
        drawn = math.nan if self.criticality is None else self.criticality
        return _HEAD.pack(_MAGIC, _VERSION, length, drawn) + actions + self.world

    @classmethod
    def from_bytes(cls, data: bytes) -> Snapshot:
        """Read what :meth:`to_bytes` wrote; what is something else is a :class:`SnapshotError`."""
        if not isinstance(data, (bytes, bytearray, memoryview)):
            raise SnapshotError(f"snapshot: {type(data).__name__}, expected bytes")
        data = bytes(data)
        if len(data) < _HEAD.size:
            raise SnapshotError(f"snapshot: {len(data)} bytes, too short")
        magic, version, length, drawn = _HEAD.unpack_from(data)
        if magic != _MAGIC:
            raise SnapshotError("snapshot: not the snapshot of an environment")
        if version != _VERSION:
            raise SnapshotError(f"snapshot: version {version}, this release reads {_VERSION}")
        body = data[_HEAD.size :]
        criticality = drawn if math.isfinite(drawn) else None
        if not -1 <= length <= len(body):
            raise SnapshotError(f"snapshot: {length} bytes of actions in {len(body)}")
        if length < 0:
            return cls(body, None, criticality)
        return cls(body[length:], body[:length], criticality)
