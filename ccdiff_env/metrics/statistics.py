"""Figures over scenes and methods: references, comfort distance, scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

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
    values = np.asarray(speed, dtype=np.float32)
    moving = np.sort(values[values > 1.0])
    if not moving.size:
        return float("nan")
    at = 0.75 * (moving.size - 1)
    below, above = moving[int(np.floor(at))], moving[int(np.ceil(at))]
    return float(below + np.float32(at % 1) * (above - below))


def _shares(name: str, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    expect_shape(name, array, (3, 20))
    total = array.cumsum(axis=-1)[:, -1:]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(total > 0.0, array / total, np.nan)


@dataclass(frozen=True)
class ComfortDistance:
    """Earth mover's distances of comfort histograms, not scaled."""

    longitudinal: float  #: Of longitudinal acceleration, m/s2.
    lateral: float  #: Of lateral acceleration, m/s2.
    jerk: float  #: Of jerk, m/s3.
    cfd: float  #: Their mean, the comfort distance. The paper's figures are near 100 times this.


def comfort_distance(one: npt.ArrayLike, other: npt.ArrayLike) -> ComfortDistance:
    """Compare two sets of histograms [3, 20], each row scaled to a sum of 1 first.

    In one dimension the distance is the sum of the differences of the cumulative shares times the
    width of a bin. A row without any mass is infinitely far from everything.
    """
    ahead = np.abs(np.cumsum(_shares("one", one) - _shares("other", other), axis=-1))
    width = 2.0 * np.array([2.0, 2.0, 1.0]) / ahead.shape[-1]
    rows = np.cumsum(ahead * width[:, None], axis=-1)[:, -1]
    rows[np.isnan(rows)] = np.inf
    mean = np.cumsum(rows)[-1] / 3.0
    return ComfortDistance(*(float(np.float32(value)) for value in (*rows, mean)))


def _scaled(
    values: npt.NDArray[np.float64], bounds: tuple[float, float] | None
) -> npt.NDArray[np.float64]:
    if bounds is None:
        finite = values[np.isfinite(values)]
        bounds = (finite.min(), finite.max()) if finite.size else (0.0, 0.0)
    least, largest = bounds
    with np.errstate(invalid="ignore"):
        return (values - least) / (largest - least) if largest > least else 0.0 * values


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
    bounds = bounds or {}
    for name, (least, largest) in bounds.items():
        if name not in tables:
            raise ConfigError(f"bounds name {name!r}, expected one of {sorted(tables)}")
        if not (np.isfinite(least) and np.isfinite(largest) and least <= largest):
            raise ConfigError(f"bounds of {name} are {(least, largest)}, expected (least, largest)")
    scaled = {name: _scaled(array, bounds.get(name)) for name, array in arrays.items()}
    return scaled["scr"], 1.0 - (scaled["orr"] + scaled["fde"] + scaled["cfd"]) / 3.0


def _distance(
    to: npt.NDArray[np.float64], origin: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Root mean square over points [..., N, 2] of the distance to the nearest of [..., M, 2]."""
    apart = origin[..., :, None, :] - to[..., None, :, :]
    nearest = (apart[..., 0] * apart[..., 0] + apart[..., 1] * apart[..., 1]).min(axis=-1)
    squared: npt.NDArray[np.float64] = nearest.cumsum(axis=-1)[..., -1] / nearest.shape[-1]
    return squared**0.5


def generational_distance(
    *, cs: npt.ArrayLike, rs: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Compute the generational distance and its inverse to the Pareto front of all methods.

    Args:
        cs, rs: [methods, columns], larger is better.

    Returns:
        gd, igd: [methods]. GD is the root mean square distance of a method's points to the front of
            the union, IGD that of the front to the method's points; smaller is better.

    Differs from the paper: its formula subtracts ``a`` where it must mean ``d``.
    """
    control, realism = np.asarray(cs, dtype=np.float64), np.asarray(rs, dtype=np.float64)
    if control.ndim != 2 or control.shape != realism.shape or not control.size:
        got = f"cs {control.shape} and rs {realism.shape}"
        raise ShapeError(f"{got}, expected [methods, columns] for both")
    points = np.stack([control, realism], axis=-1)
    if not np.isfinite(points).all():
        raise ConfigError("scores are not finite")
    union = points.reshape(-1, 2)
    as_good = (union[:, None] >= union).all(axis=-1)
    front = union[~(as_good & (union[:, None] != union).any(axis=-1)).any(axis=0)]
    return _distance(front, points), _distance(points, front)
