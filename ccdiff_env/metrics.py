"""Evaluation metrics of recorded roll-outs, and the paper's scores.

A recorded scene is a :class:`Rollout`: states of A agents over T steps. Rates over scenes are
means of what its methods give per scene. Everything is computed by the Rust code that the running
world uses; docs/evaluation.md defines each number and says where it differs from the paper.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.errors import ConfigError, ShapeError

__all__ = [
    "PAPER_BOUNDS",
    "VARIANTS",
    "Collisions",
    "ComfortDistance",
    "Displacement",
    "GradientConflict",
    "OffRoad",
    "Rollout",
    "comfort_distance",
    "estimate_histograms",
    "generational_distance",
    "gradient_conflict",
    "pearson",
    "scores",
    "speed_limit",
    "total_variation",
]

Variant = Literal["all", "controlled", "new", "controlled_new"]

VARIANTS: tuple[Variant, ...] = ("all", "controlled", "new", "controlled_new")
"""What a collision rate can count: every contact; those that involve a controlled agent; those of
pairs that touch neither at the first step nor in the log at the same step; both."""

PAPER_BOUNDS: Mapping[str, tuple[float, float]] = {
    "scr": (0.31, 0.58),
    "orr": (0.51, 12.21),
    "fde": (3.20, 15.00),
    "cfd": (1.88, 11.65),
}
"""Bounds over the paper's six methods and eleven columns: :func:`scores` on the paper's scale."""


@dataclass(frozen=True)
class Collisions:
    """All contacts of one scene."""

    contacts: npt.NDArray[np.int64]
    """[N, 3]: step and the two agents, the smaller index first; by step, then agents."""
    controlled: npt.NDArray[np.bool_]
    """[N]: whether the contact involves a controlled agent."""
    new: npt.NDArray[np.bool_]
    """[N]: whether the pair touches neither at the first step nor in the log at this step."""
    first_kind: list[str | None]
    """Side on which every agent is hit at its first contact: "front", "rear" or "side"."""
    agents: Mapping[Variant, npt.NDArray[np.bool_]]
    """[A] per variant: whether an agent is ever in a contact that counts."""
    agent_rate: Mapping[Variant, float]
    """Share of the agents that are ever there that collide, per variant."""

    def any(self, variant: Variant = "all") -> bool:
        """Tell whether any contact counts: the scene's entry in the scene collision rate (SCR)."""
        return bool(self.agents[variant].any())

    def matrix(self, variant: Variant = "all") -> npt.NDArray[np.bool_]:
        """Return [A, A], whether two agents ever touch in a contact that counts."""
        counts = np.ones(len(self.contacts), dtype=bool)
        if variant in ("controlled", "controlled_new"):
            counts &= self.controlled
        if variant in ("new", "controlled_new"):
            counts &= self.new
        matrix = np.zeros((len(self.first_kind),) * 2, dtype=bool)
        _, first, second = self.contacts[counts].T
        matrix[first, second] = matrix[second, first] = True
        return matrix


@dataclass(frozen=True)
class OffRoad:
    """Where agents are off the drivable area, and how often."""

    centroid: npt.NDArray[np.bool_]
    """[A, T]: whether the centre is outside; false for absent agents."""
    box: npt.NDArray[np.bool_]
    """[A, T]: whether a corner of the box is outside."""
    centroid_rate: float
    """Share of the present entries with the centre outside: the off-road rate (ORR)."""
    box_rate: float
    """The same for boxes."""
    parity_rate: float
    """The centre variant where agents that vanish between two plans count as outside until the
    next."""


@dataclass(frozen=True)
class Displacement:
    """Errors against the log, metres; NaN for agents that are never there together."""

    ade: npt.NDArray[np.float64]
    """[A]: mean over the common steps."""
    fde: npt.NDArray[np.float64]
    """[A]: at the last common step."""

    def mean(self, counted: npt.ArrayLike | None = None) -> tuple[float, float]:
        """Return mean ADE and FDE over the agents of a mask [A] (all if absent), NaN if none has
        one.
        """
        mask = np.isfinite(self.ade)
        if counted is not None:
            mask &= np.asarray(counted, dtype=bool)
        if not mask.any():
            return float("nan"), float("nan")
        return float(self.ade[mask].mean()), float(self.fde[mask].mean())


def _states(name: str, values: npt.ArrayLike, shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    array = np.ascontiguousarray(values, dtype=np.float32)
    if array.shape != shape:
        raise ShapeError(f"{name} has shape {array.shape}, expected {shape}")
    return array


class Rollout:
    """One recorded scene: states of A agents over T steps.

    Parameters
    ----------
    position : [A, T, 2], metres. Entries that are not finite are absent.
    heading : [A, T], radians.
    size : [A, 2], length and width, metres.
    valid : bool [A, T], optional.
    dt_s : time between steps, seconds.

    Raises
    ------
    ShapeError
        Where shapes do not agree.

    Examples
    --------
    A car drives into one that stands:

    >>> x = np.stack([np.arange(0.0, 10.0), np.full(10, 9.0)])
    >>> position = np.stack([x, np.zeros_like(x)], axis=-1)
    >>> rollout = Rollout(position, np.zeros((2, 10)), [[4.5, 2.0]] * 2)
    >>> found = rollout.collisions(controlled=[True, False])
    >>> found.any("controlled_new"), found.first_kind
    (True, ['front', 'rear'])
    """

    def __init__(
        self,
        position: npt.ArrayLike,
        heading: npt.ArrayLike,
        size: npt.ArrayLike,
        valid: npt.ArrayLike | None = None,
        *,
        dt_s: float = 0.1,
    ) -> None:
        points = np.asarray(position, dtype=np.float32)
        if points.ndim != 3 or points.shape[-1] != 2:
            raise ShapeError(f"position has shape {points.shape}, expected [A, T, 2]")
        shape = points.shape[:2]
        headings = _states("heading", heading, shape)
        there = np.isfinite(points).all(axis=-1) & np.isfinite(headings)
        if valid is not None:
            given = np.asarray(valid, dtype=bool)
            if given.shape != shape:
                raise ShapeError(f"valid has shape {given.shape}, expected {shape}")
            there &= given
        self.num_agents, self.num_steps = shape
        self.valid: npt.NDArray[np.bool_] = there
        self._native: Any = _native.Rollout(
            dt_s,
            np.ascontiguousarray(points[..., 0]),
            np.ascontiguousarray(points[..., 1]),
            headings,
            np.ascontiguousarray(there),
            _states("size", size, (shape[0], 2)),
        )

    def _mask(self, name: str, mask: npt.ArrayLike | None, default: bool) -> npt.NDArray[np.bool_]:
        if mask is None:
            return np.full(self.num_agents, default)
        array = np.ascontiguousarray(mask, dtype=bool)
        if array.shape != (self.num_agents,):
            raise ShapeError(f"{name} has shape {array.shape}, expected ({self.num_agents},)")
        return array

    def collisions(
        self, *, controlled: npt.ArrayLike | None = None, log: Rollout | None = None
    ) -> Collisions:
        """Find the contacts of oriented boxes, touching included.

        Parameters
        ----------
        controlled : bool [A], agents driven by the method under test; none if absent.
        log : the recorded traffic of the same agents and steps, for the variants "new".
        """
        rows, with_controlled, new, kinds, agents, rates = self._native.collisions(
            self._mask("controlled", controlled, False), None if log is None else log._native
        )
        return Collisions(
            contacts=np.asarray(rows, dtype=np.int64).reshape(-1, 3),
            controlled=np.asarray(with_controlled, dtype=bool),
            new=np.asarray(new, dtype=bool),
            first_kind=kinds,
            agents={v: np.asarray(a, dtype=bool) for v, a in zip(VARIANTS, agents, strict=True)},
            agent_rate=dict(zip(VARIANTS, rates, strict=True)),
        )

    def off_road(
        self,
        drivable: Iterable[tuple[npt.ArrayLike, Sequence[npt.ArrayLike]]],
        *,
        counted: npt.ArrayLike | None = None,
        replan_steps: int = 5,
    ) -> OffRoad:
        """Test every agent at every step against the drivable area.

        Parameters
        ----------
        drivable : polygons as (exterior [N, 2], holes); a point is drivable if any of them holds
            it.
        counted : bool [A], agents that the rates count; all if absent.
        replan_steps : steps between plans, for the parity rate.
        """

        def ring(points: npt.ArrayLike) -> list[list[float]]:
            array = np.asarray(points, dtype=np.float32)
            if array.ndim != 2 or array.shape[1] != 2:
                raise ShapeError(f"a ring of drivable has shape {array.shape}, expected [N, 2]")
            rows: list[list[float]] = array.tolist()
            return rows

        polygons = [(ring(outer), [ring(hole) for hole in holes]) for outer, holes in drivable]
        centroid, box, rates = self._native.off_road(
            polygons, self._mask("counted", counted, True), replan_steps
        )
        return OffRoad(centroid, box, *rates)

    def displacement(self, log: Rollout) -> Displacement:
        """Compare with the log of the same agents and steps."""
        ade, fde = self._native.displacement(log._native)
        return Displacement(ade=np.asarray(ade), fde=np.asarray(fde))

    def comfort(
        self, *, axes: Literal["body", "parity"] = "body", stride: int = 5
    ) -> npt.NDArray[np.float64]:
        """Return histograms [3, 20] of longitudinal and lateral acceleration and jerk of moving
        agents.

        Bins are equal over [-2, 2], [-2, 2] m/s2 and [-1, 1] m/s3; a row sums to 1, or to 0 where
        no
        agent moves.

        Parameters
        ----------
        axes : ``"body"`` projects on the agent's axes; ``"parity"`` multiplies the size of the
            acceleration by cosine and sine of the heading in the world, as the release does.
        stride : steps between entries; 5 steps of 0.1 s as the release.
        """
        histograms: npt.NDArray[np.float64] = self._native.comfort(axes, stride)
        return histograms

    def min_ttc(self) -> npt.NDArray[np.float32]:
        """Return each agent's least time to contact with any other [A], seconds, capped at 20."""
        return np.asarray(self._native.min_ttc(), dtype=np.float32)

    def post_encroachment_time(self) -> npt.NDArray[np.float32]:
        """Return each agent's least post-encroachment time [A], seconds; infinite beyond 5 s."""
        return np.asarray(self._native.post_encroachment_time(), dtype=np.float32)

    def over_speed(
        self,
        limit_mps: float,
        *,
        at_least_s: float = 0.5,
        counted: npt.ArrayLike | None = None,
    ) -> npt.NDArray[np.bool_]:
        """Tell which agents [A] exceed a speed for some time without a break.

        The scene over-speed rate (SOR) is the share of scenes in which a controlled agent does.

        Parameters
        ----------
        limit_mps : the limit; :func:`speed_limit` takes one from traffic.
        at_least_s : for how long.
        counted : bool [A], agents asked for; all if absent.
        """
        mask = self._mask("counted", counted, True)
        return np.asarray(self._native.over_speed(limit_mps, at_least_s, mask), dtype=bool)


def speed_limit(speed: npt.ArrayLike) -> float:
    """Return the 0.75 quantile of the speeds above 1 m/s, NaN where nobody moves.

    Parameters
    ----------
    speed : any shape, metres per second; NaN is passed over.
    """
    values = np.ascontiguousarray(speed, dtype=np.float32).ravel()
    limit = _native.metrics_speed_limit(values)
    return float("nan") if limit is None else float(limit)


def _histograms(name: str, values: npt.ArrayLike, ndim: int) -> npt.NDArray[np.float64]:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != ndim or array.shape[-2:] != (3, 20):
        raise ShapeError(f"{name} has shape {array.shape}, expected {['S'] * (ndim - 2)} + [3, 20]")
    return array


def estimate_histograms(
    rollouts: Iterable[Rollout], *, axes: Literal["body", "parity"] = "body", stride: int = 5
) -> npt.NDArray[np.float64]:
    """Estimate the reference histograms [3, 20] from logs: the mean over scenes of
    :meth:`Rollout.comfort`.

    Scenes without a moving agent count as zeros, so that rows may sum to less than 1.
    """
    scenes = [rollout.comfort(axes=axes, stride=stride) for rollout in rollouts]
    stacked = _histograms("rollouts", np.stack(scenes) if scenes else np.zeros((0, 3, 20)), 3)
    mean: npt.NDArray[np.float64] = _native.metrics_comfort_mean(stacked)
    return mean


@dataclass(frozen=True)
class ComfortDistance:
    """Earth mover's distances of comfort histograms, not scaled."""

    longitudinal: float
    """Of longitudinal acceleration, m/s2."""
    lateral: float
    """Of lateral acceleration, m/s2."""
    jerk: float
    """Of jerk, m/s3."""
    cfd: float
    """Their mean, the comfort distance. The paper's figures are near 100 times this."""


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

    Parameters
    ----------
    scr, orr, fde, cfd : one shape, usually [methods, columns].
    bounds : (least, largest) per metric name; of the whole arrays for those not given. A score
        depends on its bounds: compare only what shares them. :data:`PAPER_BOUNDS` are the paper's.

    Returns
    -------
    cs, rs : in the shape of the tables. Not clipped where bounds are given.

    Raises
    ------
    ShapeError
        Where shapes differ.
    ConfigError
        For bounds of an unknown name, or that are not finite and in order.
    """
    tables = {"scr": scr, "orr": orr, "fde": fde, "cfd": cfd}
    arrays = {name: np.asarray(table, dtype=np.float64) for name, table in tables.items()}
    shape = arrays["scr"].shape
    for name, array in arrays.items():
        if array.shape != shape:
            raise ShapeError(f"{name} has shape {array.shape}, expected {shape}")
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
    cs, rs = _native.metrics_scores(
        arrays["scr"].ravel(),
        arrays["orr"].ravel(),
        arrays["fde"].ravel(),
        arrays["cfd"].ravel(),
        given,
    )
    return np.asarray(cs).reshape(shape), np.asarray(rs).reshape(shape)


def generational_distance(
    *, cs: npt.ArrayLike, rs: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Compute the generational distance and its inverse to the Pareto front of all methods.

    Parameters
    ----------
    cs, rs : [methods, columns], larger is better.

    Returns
    -------
    gd, igd : [methods]. GD is the root mean square distance of a method's points to the front of
        the
        union, IGD that of the front to the method's points; smaller is better.
    """
    control = np.ascontiguousarray(cs, dtype=np.float64)
    realism = np.ascontiguousarray(rs, dtype=np.float64)
    if control.ndim != 2 or control.shape != realism.shape:
        got = f"cs {control.shape} and rs {realism.shape}"
        raise ShapeError(f"{got}, expected [methods, columns] both")
    gd, igd = _native.metrics_generational_distance(control, realism)
    return np.asarray(gd), np.asarray(igd)


def total_variation(
    mean_one: npt.ArrayLike, mean_other: npt.ArrayLike, std_dev: npt.ArrayLike
) -> npt.NDArray[np.float64]:
    """Compute the total-variation distance of Gaussians of equal variance, in [0, 1].

    Parameters
    ----------
    mean_one, mean_other : [..., D].
    std_dev : [D] or a number, one standard deviation per independent dimension.

    Returns
    -------
    [...], erf(d / (2 sqrt 2)) with d the distance of the means in standard deviations.
    """
    one = np.asarray(mean_one, dtype=np.float32)
    other = np.asarray(mean_other, dtype=np.float32)
    if one.ndim == 0 or one.shape != other.shape:
        raise ShapeError(f"means have shapes {one.shape} and {other.shape}, expected [..., D] both")
    width = one.shape[-1]
    if width == 0:
        raise ShapeError("means have no dimension")
    deviation = np.asarray(std_dev, dtype=np.float32)
    if deviation.shape not in ((), (width,)):
        raise ShapeError(f"std_dev has shape {deviation.shape}, expected ({width},) or a number")
    deviation = np.ascontiguousarray(np.broadcast_to(deviation, (width,)))
    distances = _native.metrics_total_variation(
        np.ascontiguousarray(one.reshape(-1, width)),
        np.ascontiguousarray(other.reshape(-1, width)),
        deviation,
    )
    return np.asarray(distances, dtype=np.float64).reshape(one.shape[:-1])


@dataclass(frozen=True)
class GradientConflict:
    """How far the gradients of realism and guidance pull against each other."""

    cosine: npt.NDArray[np.float64]
    """[A]: cosine between the two gradients, 0 where one is zero."""
    conflict_share: float
    """Share of the agents with a negative inner product."""
    mean_negative_cosine: float
    """Mean of the negative cosines with their sign turned, 0 where there is none."""


def gradient_conflict(realism: npt.ArrayLike, guidance: npt.ArrayLike) -> GradientConflict:
    """Compare two gradients per agent.

    Parameters
    ----------
    realism, guidance : [A, ...], one shape.
    """
    one = np.asarray(realism, dtype=np.float32)
    other = np.asarray(guidance, dtype=np.float32)
    if one.ndim < 2 or one.shape != other.shape:
        raise ShapeError(
            f"gradients have shapes {one.shape} and {other.shape}, expected [A, ...] both"
        )
    rows = [
        np.ascontiguousarray(g.reshape(len(g), int(np.prod(g.shape[1:])))) for g in (one, other)
    ]
    cosine, share, mean = _native.metrics_gradient_conflict(*rows)
    return GradientConflict(np.asarray(cosine), share, mean)


def pearson(x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[float, float]:
    """Compute Pearson's correlation r of paired samples and its two-sided p value.

    Parameters
    ----------
    x, y : [N], at least three samples that vary.
    """
    first = np.ascontiguousarray(x, dtype=np.float64).ravel()
    second = np.ascontiguousarray(y, dtype=np.float64).ravel()
    r, p = _native.metrics_pearson(first, second)
    return float(r), float(p)
