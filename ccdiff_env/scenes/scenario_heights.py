"""Heights in ScenarioNet scenario descriptions: of tracks, and of the features of maps."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import numpy.typing as npt

from ccdiff_env.scenes.scenario_fields import F64

F32 = npt.NDArray[np.float32]

_HIGHEST_M = 9e3  #: Nothing lies higher above sea level or deeper below, see ``Scene``.
_HEADINGS = ("nuscenes", "nuplan")  #: Data sets whose lines hold headings in the third column.


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
