"""Recorded scenes and what is measured on one of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.errors import SceneError, ShapeError, expect_shape

Variant = Literal["all", "controlled", "new", "controlled_new", "by_controlled"]

#: What a collision rate can count: every contact; those that involve a controlled agent; those of
#: pairs that touch neither at the first step nor in the log at the same step; both; of these the
#: ones that a controlled agent brings about.
VARIANTS: tuple[Variant, ...] = ("all", "controlled", "new", "controlled_new", "by_controlled")


@dataclass(frozen=True)
class Collisions:
    """All contacts of one scene."""

    #: [N, 3]: step and the two agents, the smaller index first; by step, then agents.
    contacts: npt.NDArray[np.int64]
    controlled: npt.NDArray[np.bool_]  #: [N]: whether the contact involves a controlled agent.
    #: [N]: whether the pair touches neither at the first step nor in the log at this step.
    new: npt.NDArray[np.bool_]
    #: [N, 2]: speed of each of the two towards the other, across the edge at which they overlap
    #: least, m/s. Who comes faster at a pair's first new contact brings it about.
    approach_mps: npt.NDArray[np.float32]
    #: Side on which every agent is hit at its first contact: "front", "rear" or "side".
    first_kind: list[str | None]
    #: [A] per variant: whether an agent is ever in a contact that counts.
    agents: Mapping[Variant, npt.NDArray[np.bool_]]
    #: Share of the agents that are ever there that collide, per variant.
    agent_rate: Mapping[Variant, float]

    def any(self, variant: Variant = "all") -> bool:
        """Tell whether any contact counts: the scene's entry in the scene collision rate (SCR)."""
        return bool(self.agents[variant].any())


@dataclass(frozen=True)
class OffRoad:
    """Where agents are off the drivable area, and how often."""

    #: [A, T]: whether the centre is outside; false for absent agents.
    centroid: npt.NDArray[np.bool_]
    box: npt.NDArray[np.bool_]  #: [A, T]: whether a corner of the box is outside.
    #: Share of the present entries with the centre outside: the off-road rate (ORR).
    centroid_rate: float
    box_rate: float  #: The same for boxes.
    #: The centre variant where agents that vanish between two plans count as outside until the
    #: next.
    reference_impl_rate: float


@dataclass(frozen=True)
class Displacement:
    """Errors against the log, metres; NaN for agents that are never there together."""

    ade: npt.NDArray[np.float64]  #: [A]: mean over the common steps.
    fde: npt.NDArray[np.float64]  #: [A]: at the last common step.

    def mean(self, counted: npt.ArrayLike | None = None) -> tuple[float, float]:
        """Return mean ADE and FDE over the agents of a mask [A] (all if absent), NaN if none has
        one.
        """
        mask = np.isfinite(self.ade)
        if counted is not None:
            mask &= booleans(counted)
        if not mask.any():
            return float("nan"), float("nan")
        return float(self.ade[mask].mean()), float(self.fde[mask].mean())


def booleans(mask: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """A mask in which every byte but zero is true, as bytes of other programs may be."""
    found: npt.NDArray[np.bool_] = np.ascontiguousarray(mask, dtype=bool).view(np.uint8) != 0
    return found


def _states(name: str, values: npt.ArrayLike, shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    array = np.ascontiguousarray(values, dtype=np.float32)
    expect_shape(name, array, shape)
    return array


class Motion:
    """One recorded scene: states of A agents over T steps.

    Args:
        position: [A, T, 2], metres. Entries that are not finite are absent.
        heading: [A, T], radians.
        size: [A, 2], length and width, metres.
        valid: bool [A, T], optional.
        dt_s: time between steps, seconds.
        elevation_m: [A, T], metres, of the ground below the agents in scenes with levels: who is
            more than 2.5 m higher or lower is out of reach.

    Raises:
        ShapeError: Where shapes do not agree.
        SceneError: Where an agent that is there has a size that is negative or not finite.

    Examples:
        A car drives into one that stands:

        >>> x = np.stack([np.arange(0.0, 10.0), np.full(10, 9.0)])
        >>> position = np.stack([x, np.zeros_like(x)], axis=-1)
        >>> motion = Motion(position, np.zeros((2, 10)), [[4.5, 2.0]] * 2)
        >>> found = motion.collisions(controlled=[True, False])
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
        elevation_m: npt.ArrayLike | None = None,
    ) -> None:
        points = np.asarray(position, dtype=np.float32)
        if points.ndim != 3 or points.shape[-1] != 2:
            raise ShapeError(f"position has shape {points.shape}, expected [A, T, 2]")
        shape = points.shape[:2]
        headings = _states("heading", heading, shape)
        there = np.isfinite(points).all(axis=-1) & np.isfinite(headings)
        if valid is not None:
            given = booleans(valid)
            expect_shape("valid", given, shape)
            there &= given
        sizes = _states("size", size, (shape[0], 2))
        if not ((sizes >= 0.0) & np.isfinite(sizes))[there.any(axis=1)].all():
            raise SceneError("size must be finite and not negative, in metres")
        self.num_agents, self.num_steps = shape
        self.valid: npt.NDArray[np.bool_] = there
        #: Positions [A, T, 2], metres, and headings [A, T], radians, as given.
        self.position: npt.NDArray[np.float32] = points.copy()
        self.heading: npt.NDArray[np.float32] = headings.copy()
        heights = None if elevation_m is None else _states("elevation_m", elevation_m, shape)
        self.elevation_m: npt.NDArray[np.float32] | None = heights
        self._native = _native.Trajectories(
            dt_s,
            np.ascontiguousarray(points[..., 0]),
            np.ascontiguousarray(points[..., 1]),
            headings,
            np.ascontiguousarray(there),
            sizes,
            heights,
        )

    def _mask(self, name: str, mask: npt.ArrayLike | None, default: bool) -> npt.NDArray[np.bool_]:
        if mask is None:
            return np.full(self.num_agents, default)
        array = booleans(mask)
        expect_shape(name, array, (self.num_agents,))
        return array

    def collisions(
        self, *, controlled: npt.ArrayLike | None = None, log: Motion | None = None
    ) -> Collisions:
        """Find the contacts of oriented boxes, touching included.

        Args:
            controlled: bool [A], agents driven by the method under test; none if absent.
            log: the recorded traffic of the same agents and steps, for the variants "new".
        """
        numbers = np.array([self.num_agents**2, self.num_agents, 1])
        found, approach_mps, first_kind = self._native.contacts()
        rows = found.astype(np.int64)
        drives = self._mask("controlled", controlled, False)[rows[:, 1:]]
        driven = drives.any(axis=1)
        pairs = rows[:, 1:] @ numbers[1:]
        new = ~np.isin(pairs, pairs[rows[:, 0] == 0])
        if log is not None:
            self._check_same(log)
            new &= ~np.isin(rows @ numbers, log._native.contacts()[0] @ numbers)
        # the first new contact of a pair says who ran into whom
        first = np.flatnonzero(new)[np.unique(pairs[new], return_index=True)[1]]
        mine, theirs = (np.where(of, approach_mps, 0.0).max(axis=1) for of in (drives, ~drives))
        ran_into = (mine > 0.0) & (mine >= theirs)
        by_driven = new & np.isin(pairs, pairs[first[ran_into[first]]])
        everyone, present = np.arange(self.num_agents), max(self.valid.any(axis=1).sum(), 1)
        counts = (np.ones(len(rows), dtype=bool), driven, new, driven & new, by_driven)
        agents = [np.isin(everyone, rows[mask, 1:]) for mask in counts]
        rates = [float(hit.sum() / present) for hit in agents]
        return Collisions(
            contacts=rows,
            controlled=driven,
            new=new,
            approach_mps=approach_mps,
            first_kind=first_kind,
            agents=dict(zip(VARIANTS, agents, strict=True)),
            agent_rate=dict(zip(VARIANTS, rates, strict=True)),
        )

    def _check_same(self, log: Motion) -> None:
        if log.valid.shape != self.valid.shape:
            raise ShapeError(f"log has shape {log.valid.shape}, expected {self.valid.shape}")

    def off_road(
        self,
        drivable: Iterable[tuple[npt.ArrayLike, Sequence[npt.ArrayLike]]],
        *,
        counted: npt.ArrayLike | None = None,
        replan_steps: int = 5,
        elevation_m: npt.ArrayLike | None = None,
    ) -> OffRoad:
        """Test every agent at every step against the drivable area.

        Args:
            drivable: polygons as (exterior [N, 2], holes); a point is drivable if any of them holds
                it.
            counted: bool [A], agents that the rates count; all if absent.
            replan_steps: steps between plans, for the rate of the reference implementation.
            elevation_m: [N, 2], metres, least and greatest elevation of each polygon in scenes with
                levels: agents are on the road of their own level.
        """

        def ring(points: npt.ArrayLike) -> list[list[float]]:
            array = np.asarray(points, dtype=np.float32)
            if array.ndim != 2 or array.shape[1] != 2:
                raise ShapeError(f"a ring of drivable has shape {array.shape}, expected [N, 2]")
            rows: list[list[float]] = array.tolist()
            return rows

        polygons = [(ring(outer), [ring(hole) for hole in holes]) for outer, holes in drivable]
        shape = (len(polygons), 2)
        heights = [] if elevation_m is None else _states("elevation_m", elevation_m, shape).tolist()
        centroid, box = self._native.off_road(polygons, heights)
        mask = self._mask("counted", counted, True)
        plan = np.arange(self.num_steps) // max(replan_steps, 1) * max(replan_steps, 1)
        present = self.valid[mask].sum()
        vanished = (~self.valid & self.valid[:, plan])[mask].sum()
        outside, reaching = centroid[mask].sum(), box[mask].sum()
        return OffRoad(
            centroid,
            box,
            centroid_rate=float(outside / max(present, 1)),
            box_rate=float(reaching / max(present, 1)),
            reference_impl_rate=float((outside + vanished) / max(present + vanished, 1)),
        )

    def displacement(self, log: Motion) -> Displacement:
        """Compare with the log of the same agents and steps."""
        self._check_same(log)
        both = self.valid & log.valid
        with np.errstate(invalid="ignore", over="ignore"):
            x, y = np.moveaxis(self.position - log.position, -1, 0)
            errors = np.sqrt(x * x + y * y)
        total, last = np.zeros(self.num_agents), np.full(self.num_agents, np.nan)
        for there, error in zip(both.T, errors.T, strict=True):
            total[there] += error[there]
            last[there] = error[there]
        steps = both.sum(axis=1)
        return Displacement(ade=np.where(steps, total / np.maximum(steps, 1), np.nan), fde=last)

    def comfort(
        self,
        *,
        axes: Literal["body", "reference_impl"] = "body",
        stride: int = 5,
        end_bins: bool = False,
    ) -> npt.NDArray[np.float64]:
        """Return histograms [3, 20] of longitudinal and lateral acceleration and jerk of moving
        agents.

        Bins are equal over [-2, 2], [-2, 2] m/s2 and [-1, 1] m/s3; a row sums to 1, or to 0 where
        no agent moves.

        Args:
            axes: ``"body"`` projects on the agent's axes; ``"reference_impl"`` multiplies the size
                of the acceleration by cosine and sine of the heading in the world, as the release
                does.
            stride: steps between entries; 5 steps of 0.1 s as the release.
            end_bins: count what lies beyond the bins in the first and the last one; the release
                drops it.
        """
        histograms: npt.NDArray[np.float64] = self._native.comfort(axes, end_bins, stride)
        return histograms

    def harsh(self, *, counted: npt.ArrayLike | None = None) -> tuple[float, float]:
        """Return the shares of accelerations outside of -4.05 to 2.40 m/s2 and of jerks beyond 8.37
        m/s3, nuPlan's limits; NaN where nobody is there for long enough.

        Accelerations along the heading are means of three steps, jerks their differences.

        Args:
            counted: bool [A], agents asked for; all if absent.
        """
        mask = self._mask("counted", counted, True)
        accelerations, hard, jerks = self._native.harsh_motion()[mask].astype(np.int64).sum(axis=0)
        known = max(int(accelerations), 1) if accelerations else np.nan
        return float(hard / known), float(jerks / known)

    def min_ttc(self) -> npt.NDArray[np.float32]:
        """Return each agent's least time to contact with any other [A], seconds, capped at 20."""
        return np.asarray(self._native.min_ttc(), dtype=np.float32)

    def over_speed(
        self, limit_mps: float, *, counted: npt.ArrayLike | None = None
    ) -> npt.NDArray[np.bool_]:
        """Tell which agents [A] exceed a speed for 0.5 s without a break.

        The scene over-speed rate (SOR) is the share of scenes in which a controlled agent does.

        Args:
            limit_mps: the limit; :func:`speed_limit` takes one from traffic.
            counted: bool [A], agents asked for; all if absent.
        """
        mask = self._mask("counted", counted, True)
        over = np.asarray(self._native.over_speed(limit_mps, 0.5), dtype=bool)
        found: npt.NDArray[np.bool_] = mask & over
        return found
