"""Traffic of the embedded city: drivers that follow paths, keep distance, stop at red and give way.

Longitudinal control is the intelligent driver model (Treiber, Hennecke, Helbing 2000) towards the
nearest thing in the way: a box ahead on the path, a red light, or the place where a path with the
right of way crosses. Steering is not simulated: a box sits on its path with the path's direction.
Step 0.1 s, plain ``float`` and element-wise numpy only, no randomness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tools.embedded_city.curves import Pose
from tools.embedded_city.paths import Floats, Path

DT_S = 0.1
WARM_UP_S = 2.0
"""Simulated before the scene begins, so that it begins with settled speeds."""

# A second IDM beside that of the traffic (rust/sim/src/policy/idm.rs), on purpose: the embedded
# scenes are made by this one, bit for bit, and it is softer where somebody cuts in, see `_follow`.
ACCELERATION_MPS2 = 1.6
BRAKING_MPS2 = 2.0
HEADWAY_S = 1.2
STANDSTILL_M = 2.4
HARDEST_MPS2 = 7.5
LOOK_AHEAD_M = 60.0
SIDE_ROOM_M = 0.3
CREEP_MPS = 4.0
"""Speed at which a driver nears a place where someone with the right of way is about to be gone."""


@dataclass(frozen=True)
class Kind:
    """A category of the data set and a size in metres."""

    category: str
    length: float
    width: float
    height: float

    @property
    def is_driven(self) -> bool:
        """Whether it is a vehicle, cycles included."""
        return self.category.startswith("vehicle.")

    @property
    def is_walker(self) -> bool:
        """Whether it is a pedestrian."""
        return self.category.startswith("human.")


@dataclass(frozen=True)
class Braking:
    """A driver's sudden stop."""

    at_s: float
    hold_s: float
    """How long it stands before it goes on."""
    deceleration_mps2: float = 6.0


@dataclass
class Actor:
    """A road user or an obstacle, and what it wants."""

    kind: Kind
    path: Path | None = None
    """None for what never moves."""
    place: Pose | None = None
    """Where it stands, if it has no path."""
    along_m: float = 0.0
    speed_mps: float = 0.0
    """Speed at the start."""
    wanted_mps: float = 0.0
    rank: int = 0
    """Who goes first where paths cross: lower before higher."""
    departs_s: float = -WARM_UP_S
    slower: tuple[float, float] | None = None
    """From a time (s) on, another wanted speed (m/s)."""
    braking: Braking | None = None
    red_lights: tuple[tuple[float, float, float], ...] = ()
    """Place on the path (m), and from when until when (s) the light there is red."""
    is_parked: bool = False
    arrives_m: float = math.inf
    """Where a pedestrian stops for good (m along the path)."""
    cuts_in: bool = False
    """Whether it changes lanes without regard: nobody sees it coming, and it waits for nobody."""
    poses: list[Pose | None] = field(default_factory=list)
    """Result: the pose at each step from time 0 on, None once it has left."""


@dataclass(frozen=True)
class Conflict:
    """Where one path meets another, in distances along both."""

    mine: tuple[float, float]
    theirs: tuple[float, float]
    is_merge: bool


class Simulation:
    """Moves actors for a given time."""

    def __init__(self, actors: Sequence[Actor]) -> None:
        self.actors = actors
        self.s = [a.along_m for a in actors]
        self.v = [a.speed_mps for a in actors]
        self.a = [0.0] * len(actors)
        self.committed: set[tuple[int, int]] = set()
        self.conflicts: list[list[tuple[int, Conflict]]] = [
            self._conflicts_of(i) for i in range(len(actors))
        ]
        self.pose: list[Pose | None] = [self._pose(i) for i in range(len(actors))]

    def run(self, duration_s: float) -> None:
        """Simulate from the warm-up to ``duration_s`` and write each actor's poses."""
        num_warm_up = round(WARM_UP_S / DT_S)
        for step in range(-num_warm_up, round(duration_s / DT_S) + 1):
            if step >= 0:
                for actor, pose in zip(self.actors, self.pose, strict=True):
                    actor.poses.append(pose)
            self._step(step * DT_S)

    def _pose(self, i: int) -> Pose | None:
        actor = self.actors[i]
        if actor.path is None:
            return actor.place
        return actor.path.at(self.s[i]) if self.s[i] < actor.path.length - 0.5 else None

    def _step(self, time_s: float) -> None:
        points = self._box_points()
        wanted = [self._acceleration(i, time_s, points) for i in range(len(self.actors))]
        for i, actor in enumerate(self.actors):
            if actor.path is None or self.pose[i] is None:
                continue
            change = min(max(wanted[i] - self.a[i], -1.5), 0.5)
            self.a[i] = min(max(self.a[i] + change, -HARDEST_MPS2), ACCELERATION_MPS2)
            before = self.v[i]
            self.v[i] = max(before + self.a[i] * DT_S, 0.0)
            if self.v[i] == 0.0:
                self.a[i] = max(self.a[i], 0.0)
            self.s[i] += 0.5 * (before + self.v[i]) * DT_S
            self.pose[i] = self._pose(i)

    def _box_points(self) -> tuple[Floats, Floats]:
        """Return x and y of eight points round each actor's box, shape [A, 8]; absent actors are
        far away.
        """
        x, y = np.full((len(self.actors), 8), 1e6), np.full((len(self.actors), 8), 1e6)
        for i, (actor, pose) in enumerate(zip(self.actors, self.pose, strict=True)):
            if pose is None:
                continue
            a, b = actor.kind.length / 2.0, actor.kind.width / 2.0
            corners = ((a, b), (a, 0.0), (a, -b), (0.0, -b), (-a, -b), (-a, 0.0), (-a, b), (0.0, b))
            c, s = math.cos(pose.yaw), math.sin(pose.yaw)
            x[i] = [pose.x + c * u - s * v for u, v in corners]
            y[i] = [pose.y + s * u + c * v for u, v in corners]
        return x, y

    def _acceleration(self, i: int, time_s: float, points: tuple[Floats, Floats]) -> float:
        actor = self.actors[i]
        if actor.path is None or self.pose[i] is None:
            return 0.0
        wanted = actor.wanted_mps
        if actor.slower is not None and time_s >= actor.slower[0]:
            wanted = actor.slower[1]
        if actor.kind.is_walker:
            return self._walk(i, time_s, wanted)
        braking = actor.braking
        if braking is not None and braking.at_s <= time_s:
            stop_s = actor.wanted_mps / braking.deceleration_mps2
            if time_s < braking.at_s + stop_s + braking.hold_s:
                return -braking.deceleration_mps2
        out = self._free(i, wanted)
        for gap, speed in [
            self._leader(i, points),
            *self._red(i, time_s),
            *self._giving_way(i, time_s),
        ]:
            out = min(out, _follow(self.v[i], gap, speed))
        return out

    def _walk(self, i: int, time_s: float, wanted: float) -> float:
        actor = self.actors[i]
        is_going = time_s >= actor.departs_s and self.s[i] < actor.arrives_m
        target = wanted if is_going else 0.0
        return min(max((target - self.v[i]) / 0.4, -3.0), 1.5)

    def _free(self, i: int, wanted: float) -> float:
        path = self.actors[i].path
        assert path is not None
        v = self.v[i]
        limit = min(wanted, path.limit_at(self.s[i] + 0.4 * v))
        if v > limit:
            return max(-1.8 * (v - limit), -3.5)
        return ACCELERATION_MPS2 * (1.0 - (v / max(limit, 0.1)) ** 4)

    def _leader(self, i: int, points: tuple[Floats, Floats]) -> tuple[float, float]:
        """Return gap to and speed of the nearest box on the path ahead, (inf, 0) if the path is
        free.
        """
        actor, path = self.actors[i], self.actors[i].path
        assert path is not None
        near = path.ahead(self.s[i] + 0.3 * actor.kind.length, LOOK_AHEAD_M)
        s, px, py, c, sn = (v[near, None] for v in (path.s, path.x, path.y, path.cos, path.sin))
        if len(s) == 0:
            return math.inf, 0.0
        x, y = points
        room = actor.kind.width / 2.0 + 1.0
        near_x = (x.max(axis=1) > px.min() - room) & (x.min(axis=1) < px.max() + room)
        near_y = (y.max(axis=1) > py.min() - room) & (y.min(axis=1) < py.max() + room)
        others = np.flatnonzero(near_x & near_y)
        others = others[others != i]
        if len(others) == 0:
            return math.inf, 0.0
        x, y = x[others].reshape(1, -1), y[others].reshape(1, -1)
        dx, dy = x - px, y - py
        along, aside = c * dx + sn * dy, np.abs(c * dy - sn * dx)
        hit = (np.abs(along) < 0.6) & (aside < actor.kind.width / 2.0 + SIDE_ROOM_M)
        gaps = np.where(hit, s + along, np.inf).min(axis=0).reshape(-1, 8).min(axis=1)
        best = (math.inf, 0.0)
        front = self.s[i] + actor.kind.length / 2.0
        for k in np.flatnonzero(gaps < np.inf):
            j = int(others[k])
            gap = float(gaps[k]) - front
            speed = self._speed_along(j, path, float(gaps[k]))
            if not self._will_clear(i, j, gap, speed) and gap < best[0]:
                best = (gap, max(speed, 0.0))
        return best

    def _speed_along(self, j: int, path: Path, along_m: float) -> float:
        pose = self.pose[j]
        assert pose is not None
        return self.v[j] * math.cos(pose.yaw - path.at(along_m).yaw)

    def _will_clear(self, i: int, j: int, gap: float, along_mps: float) -> bool:
        """Return whether a crossing box will be gone before this actor gets there."""
        speed = self.v[j]
        if speed < 1.0 or along_mps > 0.8 * speed:
            return False
        kind = self.actors[j].kind
        return gap / max(self.v[i], 1.0) > (kind.length + self.actors[i].kind.width) / speed + 1.0

    def _red(self, i: int, time_s: float) -> list[tuple[float, float]]:
        front = self.s[i] + self.actors[i].kind.length / 2.0
        out = []
        for at, start, until in self.actors[i].red_lights:
            gap = at - front
            if start <= time_s < until and gap > -0.5 and self.v[i] ** 2 < 9.0 * max(gap, 0.5):
                out.append((gap + 1.2, 0.0))
        return out

    def _giving_way(self, i: int, time_s: float) -> list[tuple[float, float]]:
        """Return gaps and speeds of what this actor has to wait for."""
        out = []
        for j, conflict in self.conflicts[i]:
            if self.pose[j] is None or (i, j) in self.committed:
                continue
            if self._is_held(j, conflict.theirs[0], time_s):
                continue
            wait = (
                self._merge(i, j, conflict)
                if conflict.is_merge
                else self._cross(i, j, conflict, time_s)
            )
            if wait is not None:
                out.append(wait)
        return out

    def _is_held(self, j: int, entry_m: float, time_s: float) -> bool:
        """Return whether an actor stands at a red light before a place on its path."""
        front = self.s[j] + self.actors[j].kind.length / 2.0
        return self.v[j] < 1.0 and any(
            start <= time_s < until and front <= at + 0.5 and at < entry_m + 1.0
            for at, start, until in self.actors[j].red_lights
        )

    def _merge(self, i: int, j: int, conflict: Conflict) -> tuple[float, float] | None:
        me, other = self.actors[i].kind, self.actors[j].kind
        mine, theirs = conflict.mine[0] - self.s[i], conflict.theirs[0] - self.s[j]
        if mine < 0.0:
            self.committed.add((i, j))
            return None
        if mine > 45.0:
            return None
        lead = mine - theirs - (me.length + other.length) / 2.0
        if lead > 0.0:
            return lead, self.v[j]
        behind = theirs - mine - (me.length + other.length) / 2.0
        if behind > 3.0 + max(self.v[j], 2.0) * 1.1 and self.v[i] > self.v[j] - 2.0:
            return None
        if self.v[j] < 3.0 or self.v[i] < self.v[j] - 2.0:
            return mine - me.length / 2.0 + STANDSTILL_M, 0.7 * self.v[j]
        # side by side: fall back gently, as if it were just ahead and a little slower
        return STANDSTILL_M + 0.8 * HEADWAY_S * self.v[i], max(self.v[j] - 1.5, 0.0)

    def _cross(
        self, i: int, j: int, conflict: Conflict, time_s: float
    ) -> tuple[float, float] | None:
        me, other = self.actors[i], self.actors[j]
        half, their_half = me.kind.length / 2.0, other.kind.length / 2.0
        to_entry = conflict.mine[0] - self.s[i] - half
        to_exit = conflict.mine[1] - self.s[i] + half
        their_entry = conflict.theirs[0] - self.s[j] - their_half
        their_exit = conflict.theirs[1] - self.s[j] + their_half
        if their_exit < 0.0 or to_entry > 50.0:
            return None
        if to_entry < 0.0 or self.v[i] ** 2 > 11.0 * to_entry:
            self.committed.add((i, j))
            return None
        pause = max(other.departs_s - time_s, 0.0)
        fast = max(self.v[j], 0.8 * other.wanted_mps if self.v[j] > 0.3 else 0.5 * other.wanted_mps)
        slow = max(self.v[j], 0.5)
        arrival, clear = pause + max(their_entry, 0.0) / fast, pause + their_exit / slow
        if _time_to(to_exit, self.v[i], me) + 1.2 < arrival:
            return None
        slack = to_entry / max(self.v[i], 0.5) - clear
        if slack > 0.5:
            # gone before this one gets there: mind it a little
            return None if slack > 2.0 else (to_entry + STANDSTILL_M, CREEP_MPS)
        return to_entry + STANDSTILL_M - 1.2, 0.0

    def _conflicts_of(self, i: int) -> list[tuple[int, Conflict]]:
        """Return whom an actor has to give way to, and where."""
        me = self.actors[i]
        if me.path is None or me.kind.is_walker or me.cuts_in:
            return []
        out = []
        for j, other in enumerate(self.actors):
            if i == j or other.path is None or other.cuts_in:
                continue
            if other.kind.is_walker or (me.rank, i) > (other.rank, j):
                conflict = _conflict(me, me.path, other, other.path)
                if conflict is not None:
                    out.append((j, conflict))
        return out


def _follow(v: float, gap: float, lead_mps: float) -> float:
    """Return the interaction-limited acceleration of the intelligent driver model."""
    if math.isinf(gap):
        return math.inf
    closing = v * (v - lead_mps) / (2.0 * math.sqrt(ACCELERATION_MPS2 * BRAKING_MPS2))
    wanted = STANDSTILL_M + max(v * HEADWAY_S + closing, 0.0)
    model = ACCELERATION_MPS2 * (1.0 - (wanted / max(gap, 0.1)) ** 2)
    if gap < 2.0:
        return model
    # the model overreacts to a small gap at equal speeds (someone cuts in); no more than the
    # situation asks for
    needed = max(v - lead_mps, 0.0) ** 2 / (2.0 * max(gap - 1.0, 0.3))
    return max(model, -1.8 * needed - 2.6)


def _time_to(distance_m: float, v: float, actor: Actor) -> float:
    """Return how long an actor needs for a distance when it accelerates to its wanted speed."""
    rate, top = 0.9 * ACCELERATION_MPS2, max(min(actor.wanted_mps, 7.0), v)
    run_up = (top * top - v * v) / (2.0 * rate)
    if run_up < distance_m:
        return (top - v) / rate + (distance_m - run_up) / top
    return (math.sqrt(v * v + 2.0 * rate * distance_m) - v) / rate


def _conflict(me: Actor, mine_path: Path, other: Actor, their_path: Path) -> Conflict | None:
    """Return where two actors' paths, from where they start on, come too close; None for one
    behind the other.
    """
    room = (me.kind.width + other.kind.width) / 2.0 + (0.9 if other.kind.is_walker else 0.5)
    a, b = mine_path.ahead(me.along_m, math.inf), their_path.ahead(other.along_m, math.inf)
    if not (
        _spans_meet(mine_path.x[a], their_path.x[b], room)
        and _spans_meet(mine_path.y[a], their_path.y[b], room)
    ):
        return None
    dx = mine_path.x[a, None] - their_path.x[None, b]
    dy = mine_path.y[a, None] - their_path.y[None, b]
    close = dx * dx + dy * dy < room * room
    rows, columns = np.flatnonzero(close.any(axis=1)), np.flatnonzero(close.any(axis=0))
    if len(rows) == 0 or rows[0] <= 1 or columns[0] <= 1:
        return None
    mine, theirs = mine_path.s[a], their_path.s[b]
    yaw_a, yaw_b = mine_path.yaw[a][rows[0]], their_path.yaw[b][columns[0]]
    aligned = math.cos(float(yaw_a) - float(yaw_b)) > 0.3
    merges = (rows[-1] == len(mine) - 1 or columns[-1] == len(theirs) - 1) and len(rows) > 12
    ends = float(mine[rows[-1]]), float(theirs[columns[-1]])
    if merges and not aligned:
        # a turn into the other's lane: from its end on they follow each other
        ends = (
            min(ends[0], float(mine[rows[0]]) + 14.0),
            min(ends[1], float(theirs[columns[0]]) + 14.0),
        )
    return Conflict(
        (float(mine[rows[0]]), ends[0]), (float(theirs[columns[0]]), ends[1]), merges and aligned
    )


def _spans_meet(a: Floats, b: Floats, room_m: float) -> bool:
    """Return whether the ranges of two arrays come within a distance."""
    return bool(a.max() + room_m > b.min() and b.max() + room_m > a.min())
