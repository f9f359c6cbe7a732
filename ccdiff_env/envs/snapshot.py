"""The bytes of an environment's snapshot: the native world, and what Python keeps beside it."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from dataclasses import dataclass

from ccdiff_env.errors import SnapshotError

_MAGIC = b"CCDENV"
_VERSION = 1
_HEAD = struct.Struct("<6sHI")


@dataclass(frozen=True)
class Snapshot:
    """One world at one moment.

    Parameters
    ----------
    world
        The native snapshot.
    tally
        Running sums of the episode.
    actions
        Actions since the episode began, float32 rows; ``None`` where they were not recorded.
    """

    world: bytes
    tally: bytes
    actions: bytes | None = None

    def to_bytes(self) -> bytes:
        """Return the snapshot as bytes."""
        actions = None if self.actions is None else base64.b64encode(self.actions).decode()
        header = {"tally": base64.b64encode(self.tally).decode(), "actions": actions}
        text = json.dumps(header).encode()
        return _HEAD.pack(_MAGIC, _VERSION, len(text)) + text + self.world

    @classmethod
    def from_bytes(cls, data: bytes) -> Snapshot:
        """Read what :meth:`to_bytes` wrote.

        Raises
        ------
        SnapshotError
            If the bytes are damaged or of another version.
        """
        if not isinstance(data, (bytes, bytearray, memoryview)):
            raise SnapshotError(f"snapshot: {type(data).__name__}, expected bytes")
        data = bytes(data)
        if len(data) < _HEAD.size:
            raise SnapshotError(f"snapshot: {len(data)} bytes, too short")
        magic, version, length = _HEAD.unpack_from(data)
        if magic != _MAGIC:
            raise SnapshotError("snapshot: not the snapshot of an environment")
        if version != _VERSION:
            raise SnapshotError(f"snapshot: version {version}, this release reads {_VERSION}")
        body = data[_HEAD.size :]
        try:
            header = json.loads(body[:length])
            tally = base64.b64decode(header["tally"], validate=True)
            actions = header["actions"]
            actions = None if actions is None else base64.b64decode(actions, validate=True)
        except (ValueError, KeyError, TypeError, binascii.Error) as error:
            raise SnapshotError(f"snapshot: damaged header ({error})") from None
        return cls(world=body[length:], tally=tally, actions=actions)
