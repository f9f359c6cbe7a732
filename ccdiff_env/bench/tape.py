"""Tapes of benchmarked episodes: what was done in them, and a digest of every bit that came of it.

A tape is enough to play an episode again without the planner.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.errors import DatasetError
from ccdiff_env.worlds import Worlds

F32 = npt.NDArray[np.float32]


class Tape:
    """Takes down one world of a batch while it is driven.

    The digest is over the scene's hash, the seed, and of every step the action, the columns of
    ``info``, and the states of all agents. Actions are kept where the ego's ``driver`` is external.
    """

    def __init__(self, worlds: Worlds, world_idx: int, driver: str) -> None:
        self._worlds, self._world_idx = worlds, world_idx
        self._actions: list[F32] | None = [] if driver == "external" else None
        status = worlds.native.status(world_idx)
        head = f"{worlds.scenes[status.scene_idx].hash} {status.seed} {status.step_idx}"
        self._hash = hashlib.blake2b(head.encode(), digest_size=16)
        self._add_states()

    def _add_states(self) -> None:
        for _, array in sorted(dict[str, Any](self._worlds.native.states(self._world_idx)).items()):
            self._hash.update(array.tobytes())

    def step(self, action: F32, columns: F32) -> None:
        """Take down a step: the action [W] that led to it, and its columns [M]."""
        if self._actions is not None:
            self._actions.append(action.copy())
            self._hash.update(action.tobytes())
        self._hash.update(columns.tobytes())
        self._add_states()

    def entries(self) -> dict[str, Any]:
        """Return ``digest``, and of an ego that is driven from outside its ``actions`` [T, W] and
        what they mean, ``action``.
        """
        if self._actions is None:
            return {"digest": self._hash.hexdigest()}
        data = np.array(self._actions, "<f4").tobytes()
        return {
            "digest": self._hash.hexdigest(),
            "actions": base64.b64encode(data).decode(),
            "action": json.loads(self._worlds.config.to_json())["action"],
        }


class Recorded:
    """A planner that does again what tapes of a batch hold.

    ``rows`` are of the scenes of the batch in order, with :meth:`Tape.entries`; ``name`` is the
    planner's. Raises :class:`DatasetError` if a tape is damaged.
    """

    def __init__(self, rows: Sequence[Mapping[str, Any]], name: str = "recorded") -> None:
        self.__name__ = name
        try:
            self._data = [np.frombuffer(base64.b64decode(row["actions"]), "<f4") for row in rows]
            #: What the actions mean.
            self.env_options: dict[str, Any] = {"action": dict(rows[0]["action"])}
        except (KeyError, TypeError, ValueError, binascii.Error) as error:
            raise DatasetError(f"damaged actions of an episode ({error!r})") from None

    def reset(self, worlds: Worlds, indices: npt.NDArray[np.int64]) -> None:
        """Begin at the first action."""
        self._worlds = worlds

    def __call__(self, obs: Any) -> npt.NDArray[Any]:
        """Return the actions [E, W] of the present step; zeros where they have ended."""
        native = self._worlds.native
        width = native.action_width
        found = np.zeros((len(self._data), width), np.float32)
        for i, data in enumerate(self._data):
            step = native.status(i).elapsed_steps
            if (step + 1) * width <= len(data):
                found[i] = data[step * width : (step + 1) * width]
        return found if native.num_actions is None else found[:, 0].astype(np.int64)
