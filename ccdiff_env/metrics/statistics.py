"""Figures over scenes and methods: references, comfort distance, scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.errors import ConfigError, ShapeError, expect_shape

#: Bounds over the paper's six methods and eleven columns: :func:`scores` on the paper's scale.
PAPER_BOUNDS: Mapping[str, tuple[float, float]] = {
    "scr": (0.31, 0.58),
    "orr": (0.51, 12.21),
    "fde": (3.20, 15.00),
    "cfd": (1.88, 11.65),
}


def speed_limit(speed: npt.ArrayLike) -> float:
    """Return the 0.75 quantile of the speeds above 1 m/s, NaN where nobody moves.

    Args:
        speed: any shape, metres per second; NaN is passed over.
    """
    values = np.ascontiguousarray(speed, dtype=np.float32).ravel()
    limit = _native.metrics_speed_limit(values)
    return float("nan") if limit is None else float(limit)


def _histograms(name: str, values: npt.ArrayLike, ndim: int) -> npt.NDArray[np.float64]:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != ndim or array.shape[-2:] != (3, 20):
        raise ShapeError(f"{name} has shape {array.shape}, expected {['S'] * (ndim - 2)} + [3, 20]")
    return array


@dataclass(frozen=True)
class ComfortDistance:
    """Earth mover's distances of comfort histograms, not scaled."""

    longitudinal: float  #: Of longitudinal acceleration, m/s2.
    lateral: float  #: Of lateral acceleration, m/s2.
    jerk: float  #: Of jerk, m/s3.
    cfd: float  #: Their mean, the comfort distance. The paper's figures are near 100 times this.


def comfort_distance(one: npt.ArrayLike, other: npt.ArrayLike) -> ComfortDistance:
    """Compare two sets of histograms [3, 20], each row scaled to a sum of 1 first.

    A row without any mass is infinitely far from everything.
    """
    rows, mean = _native.metrics_comfort_distance(
        _histograms("one", one, 2), _histograms("other", other, 2)
    )
    longitudinal, lateral, jerk = rows
    return ComfortDistance(longitudinal, lateral, jerk, mean)


def scores(
    *,
    scr: npt.ArrayLike,
    orr: npt.ArrayLike,
    fde: npt.ArrayLike,
    cfd: npt.ArrayLike,
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Compute the controllability score (CS) and the realism score (RS) of tables of results.

    CS is SCR scaled to [0, 1] by its bounds, RS one minus the mean of the scaled ORR, FDE and CFD.

    Args:
        scr, orr, fde, cfd: one shape, usually [methods, columns].
        bounds: (least, largest) per metric name; of the whole arrays for those not given. A score
            depends on its bounds: compare only what shares them. :data:`PAPER_BOUNDS` are the
            paper's.

    Returns:
        cs, rs: in the shape of the tables. Not clipped where bounds are given.

    Raises:
        ShapeError: Where shapes differ.
        ConfigError: For bounds of an unknown name, or that are not finite and in order.
    """
    tables = {"scr": scr, "orr": orr, "fde": fde, "cfd": cfd}
    arrays = {name: np.asarray(table, dtype=np.float64) for name, table in tables.items()}
    shape = arrays["scr"].shape
    for name, array in arrays.items():
        expect_shape(name, array, shape)
    given = None
    if bounds is not None:
        for name, (least, largest) in bounds.items():
            if name not in tables:
                raise ConfigError(f"bounds name {name!r}, expected one of {sorted(tables)}")
            if not (np.isfinite(least) and np.isfinite(largest) and least <= largest):
                raise ConfigError(
                    f"bounds of {name} are {(least, largest)}, expected (least, largest)"
                )
        given = [bounds.get(name) for name in tables]
    flat = [array.ravel() for array in arrays.values()]
    cs, rs = _native.metrics_scores(flat[0], flat[1], flat[2], flat[3], given)
    return np.asarray(cs).reshape(shape), np.asarray(rs).reshape(shape)


def generational_distance(
    *, cs: npt.ArrayLike, rs: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Compute the generational distance and its inverse to the Pareto front of all methods.

    Args:
        cs, rs: [methods, columns], larger is better.

    Returns:
        gd, igd: [methods]. GD is the root mean square distance of a method's points to the front of
            the union, IGD that of the front to the method's points; smaller is better.
    """
    control = np.ascontiguousarray(cs, dtype=np.float64)
    realism = np.ascontiguousarray(rs, dtype=np.float64)
    if control.ndim != 2 or control.shape != realism.shape:
        got = f"cs {control.shape} and rs {realism.shape}"
        raise ShapeError(f"{got}, expected [methods, columns] both")
    gd, igd = _native.metrics_generational_distance(control, realism)
    return np.asarray(gd), np.asarray(igd)
