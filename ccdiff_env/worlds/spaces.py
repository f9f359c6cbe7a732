"""From the native schemas to Gymnasium spaces and arrays."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

F32 = npt.NDArray[np.float32]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]
#: Forms of observations: the row, a dictionary of its entries and the raster, the raster alone.
Form: TypeAlias = Literal["flat", "dict", "bev"]
FORMS: tuple[Form, ...] = ("flat", "dict", "bev")


@dataclass(frozen=True)
class InfoColumn:
    """A column of ``info``: key of ``info``, unit, and what it is."""

    name: str
    unit: str
    doc: str


def read_columns(text: str) -> tuple[InfoColumn, ...]:
    """Read the schema of the info columns of a step."""
    return tuple(InfoColumn(**column) for column in json.loads(text))


@dataclass(frozen=True)
class Entry:
    """A part of the observation row: key and shape in the dictionary form, first float in the row.

    A mask tells which rows of the entry before it are there. Columns, with their bounds, are the
    last axis; masks have none.
    """

    name: str
    shape: tuple[int, ...]
    offset: int
    columns: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    scale: tuple[float, ...]  #: What quantities of the columns are divided by.

    @property
    def size(self) -> int:
        """Number of floats."""
        return int(np.prod(self.shape))

    def bounds(self) -> tuple[F32, F32]:
        """Least and greatest values, in the entry's shape."""
        ends = (self.low, self.high) if self.columns else ((0.0,), (1.0,))
        low, high = (np.broadcast_to(np.array(end, np.float32), self.shape) for end in ends)
        return low, high


@dataclass(frozen=True)
class Layout:
    """The schema of observations: entries of a row of D floats one after the other, and a raster.

    ``raster`` is its shape [channels, S, S], where there is one.
    """

    entries: tuple[Entry, ...]
    size: int
    raster: tuple[int, int, int] | None = None
    channels: tuple[str, ...] = ()

    @classmethod
    def from_json(cls, text: str) -> Layout:
        """Read what the native layout writes."""
        schema: dict[str, Any] = json.loads(text)
        entries = tuple(
            Entry(
                name=entry["name"],
                shape=tuple(entry["shape"]),
                offset=entry["offset"],
                columns=tuple(c["name"] for c in entry["columns"]),
                low=tuple(c["low"] for c in entry["columns"]),
                high=tuple(c["high"] for c in entry["columns"]),
                scale=tuple(c["scale"] for c in entry["columns"]),
            )
            for entry in schema["entries"]
        )
        if (bev := schema["bev"]) is None:
            return cls(entries, schema["size"])
        channels = tuple(channel["name"] for channel in bev["channels"])
        return cls(entries, schema["size"], tuple(bev["shape"]), channels)

    def space(self, form: Form) -> gymnasium.Space[Any]:
        """Space of observations in a form: a Box of the flat row [D], a Dict of the entries (a Box,
        a MultiBinary for each mask) and the raster, or a Box uint8 of the raster alone.
        """
        if form == "flat":
            ends = zip(*(entry.bounds() for entry in self.entries), strict=True)
            low, high = (np.concatenate([part.ravel() for part in end]) for end in ends)
            return spaces.Box(low, high, dtype=np.float32)
        raster = None if self.raster is None else spaces.Box(0, 255, self.raster, np.uint8)
        if form == "bev":
            assert raster is not None, "this form goes with a raster"
            return raster
        parts: dict[str, gymnasium.Space[Any]] = {
            entry.name: spaces.Box(*entry.bounds(), dtype=np.float32)
            if entry.columns
            else spaces.MultiBinary(entry.shape[0])
            for entry in self.entries
        }
        return spaces.Dict(parts if raster is None else {**parts, "bev": raster})

    def observation(self, form: Form, rows: F32, bev: U8 | None) -> Any:
        """Observations in a form, of rows [..., D] and rasters [..., channels, S, S]: views, int8
        arrays for masks.
        """
        if form == "bev":
            assert bev is not None, "this form goes with a raster"
            return bev
        if form == "flat":
            return rows
        parts: dict[str, npt.NDArray[Any]] = {}
        for entry in self.entries:
            part = rows[..., entry.offset : entry.offset + entry.size]
            shaped = part.reshape(*rows.shape[:-1], *entry.shape)
            parts[entry.name] = shaped if entry.columns else (part > 0.5).view(np.int8)
        return parts if bev is None else {**parts, "bev": bev}


class StepArrays(NamedTuple):
    """Arrays that a reset or step writes.

    E worlds, C slots, D floats of a row, M info columns, rasters of P channels.
    """

    obs: F32  #: Observations [E, C, D] float32.
    reward: F32  #: Rewards [E, C] float32.
    terminated: Bool  #: Whether an agent's episode ended by what happened [E, C].
    truncated: Bool  #: Whether it was cut off [E, C].
    alive: Bool  #: Whether the agent goes on [E, C].
    columns: F32  #: Info columns of the step [E, C, M] float32.
    done: Bool  #: Whether the world's episode ended [E].
    was_reset: Bool  #: Whether the observation is the first of an episode [E].
    #: SAME_STEP: last observations of ended episodes [E, C, D]; else ``None``.
    final_obs: F32 | None
    bev: U8 | None  #: Rasters [E, C, P, S, S] uint8; ``None`` without them.
    final_bev: U8 | None  #: Rasters beside ``final_obs``.
