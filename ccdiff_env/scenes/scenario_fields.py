"""Fields of a scenario description, checked: no value may cost more than its size in the file; and
the heights in it, of tracks and of the features of maps.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.errors import DatasetError

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

#: Numbers that one scenario may hold. A list that many fields share counts each time, and so does
#: a point that resampling adds.
_MOST_NUMBERS = 20_000_000
#: What an item of a list counts as: lanes that share a list make a link of each of its items.
_NUMBERS_OF_AN_ITEM = 20
_MOST_COLUMNS = 16
_NUMBERS = (int, float, np.number, np.bool_)
_LONGEST_TEXT = 1000
_HIGHEST_M = 9e3  #: Nothing lies higher above sea level or deeper below, see ``Scene``.
_HEADINGS = ("nuscenes", "nuplan")  #: Data sets whose lines hold headings in the third column.


def _short(value: object) -> bool:
    return isinstance(value, int) and abs(value) < 2**63


@dataclass
class ScenarioFields:
    """The fields of one file, what was dropped of them, and what is to be reported about them."""

    path: Path
    data: dict[str, Any]
    notes: list[str] = field(default_factory=list)
    dropped: Counter[str] = field(default_factory=Counter)
    numbers: int = 0
    form: str = "scenarionet"  #: What the description is read from.

    def part(self, name: str) -> dict[Any, Any]:
        """Return a dictionary of the description."""
        return self.mapping(self.data.get(name), name)

    def fault(self, field_name: str, got: object, expected: str) -> DatasetError:
        """Return the error for a field that breaks a rule."""
        listed = got if isinstance(got, (list, tuple)) else (got,)
        if not all(isinstance(part, (str, float, np.ndarray)) or _short(part) for part in listed):
            got = type(got).__name__  # its text may have no end
        return DatasetError(f"{field_name} is {str(got)[:200]}, expected {expected}: {self.path}")

    def mapping(self, value: object, name: str) -> dict[Any, Any]:
        """Return a dictionary as it is."""
        if not isinstance(value, dict):
            raise self.fault(name, type(value).__name__, "a dictionary")
        return value

    def items(self, value: object, name: str) -> Sequence[Any]:
        """Return the items of a list, tuple or array; nothing where there is none."""
        if value is None:
            return ()
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if not isinstance(value, (list, tuple)):
            raise self.fault(name, type(value).__name__, "a list")
        self.spend(_NUMBERS_OF_AN_ITEM * len(value), name)
        return value

    def text(self, value: object, name: str) -> str:
        """Return a name or number as text; nothing where there is none."""
        if value is None:
            return ""
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, float) or _short(value):
            return str(value)
        if not (isinstance(value, str) and value.isprintable() and len(value) <= _LONGEST_TEXT):
            raise self.fault(
                name, type(value).__name__, f"text of at most {_LONGEST_TEXT} letters, or a number"
            )
        return value

    def name(self, paths: Sequence[str], default: str) -> str:
        """Return the first of these fields that says something, else the default."""
        for path in paths:
            *parts, last = path.split(".")
            found = self.text((self.part(parts[0]) if parts else self.data).get(last), path)
            if found:
                return found
        return default

    def spend(self, count: int, name: str) -> None:
        """Count numbers that are made for a field."""
        self.numbers += count
        if self.numbers > _MOST_NUMBERS:
            raise self.fault(
                f"{name}: numbers so far", self.numbers, f"at most {_MOST_NUMBERS} in a scenario"
            )

    def array(self, value: object, name: str, *, columns: int | None = None) -> F64:
        """Return numbers as an array: [N] where ``columns`` is None, else [N, >= columns]."""
        if not isinstance(value, np.ndarray):
            value = self._rows(value, name)
        elif value.dtype.kind not in "biuf":
            raise self.fault(name, f"an array of {value.dtype}", "an array of numbers")
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise self.fault(name, type(value).__name__, "an array of numbers") from error
        self.spend(array.size, name)
        if columns is None:
            array = array.reshape(-1) if array.ndim == 2 and array.shape[1] == 1 else array
            if array.ndim != 1:
                raise self.fault(f"shape of {name}", array.shape, "[T]")
        elif array.ndim != 2 or not columns <= array.shape[1] <= _MOST_COLUMNS:
            raise self.fault(f"shape of {name}", array.shape, f"[N, {columns}] or more columns")
        return array

    def _rows(self, value: object, name: str) -> Sequence[Any]:
        """Return a list of numbers, or of short rows of numbers: nothing deeper."""
        if not isinstance(value, (list, tuple)):
            raise self.fault(name, type(value).__name__, "an array of numbers")
        for row in value:
            flat = isinstance(row, (list, tuple)) and len(row) <= _MOST_COLUMNS
            if isinstance(row, np.ndarray):
                flat = row.ndim == 1 and len(row) <= _MOST_COLUMNS
            if not all(isinstance(n, _NUMBERS) for n in (row if flat else (row,))):
                raise self.fault(name, "a nested list", "numbers, or rows of numbers")
        return value


def ground(centre: F64, height_m: float, valid: npt.NDArray[np.bool_]) -> F64 | None:
    """Return the elevations [T] of the ground below the centres [T, 2 or more] of boxes.

    ``None`` where they are not told, or where one is no height on Earth.
    """
    if centre.shape[1] < 3 or not (np.abs(centre[valid, 2]) <= _HIGHEST_M).all():
        return None
    return np.where(valid, centre[:, 2] - 0.5 * height_m, 0.0)


class Heights:
    """Heights of the points of a map's features, by layer."""

    def __init__(self, dataset: object) -> None:
        self.known = dataset not in _HEADINGS  #: Whether every point so far has a height.
        self._of: defaultdict[str, list[F32]] = defaultdict(list)

    def read(self, points: F64) -> F64:
        """Return the heights [P] of points [P, 2 or more]; 0 where they are not known."""
        heights = points[:, 2] if points.shape[1] > 2 else np.full(len(points), np.nan)
        self.known = self.known and bool((np.abs(heights) <= _HIGHEST_M).all())
        return heights if self.known else np.zeros(len(points))

    def add(self, layer: str, heights: F64) -> None:
        """Note the heights [P] of the next line or ring of a layer."""
        self._of[layer].append(heights.astype(np.float32))

    def of_layers(self, seeds: F32) -> dict[str, list[F32]] | None:
        """Return the heights of all layers, of places ``seeds`` [N] last; ``None`` if not known."""
        if not self.known:
            return None
        dividers, areas = ("road_dividers", "lane_dividers"), ("ped_crossings", "walkways")
        layers = ("edges", "surfaces", *dividers, *areas)
        return {layer: self._of[layer] for layer in layers} | {"seeds": [seeds]}
