"""Road blocks, sides of lanes and routes, which nuPlan's maps have and those of scenes do not.

A road block is what lies side by side in one direction: lanes, or the connectors from one road
block to another. Everything is in the frame of the scene, metres and radians.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely
from shapely import LineString, Point, Polygon, STRtree

F64 = npt.NDArray[np.float64]
#: Distances between centre lines of lanes side by side, how far one may lie past the end of the
#: other, m, and the least cosine between their directions.
BESIDE_M, BEYOND_M, AGREE_COS = (1.5, 6.5), 3.0, 0.9
#: Half of a lane's width where its surface does not say, and least and greatest, m.
HALF_WIDTH_M, HALF_WIDTHS_M = 1.75, (0.5, 6.0)
#: Distance between places of a route at which its lane is asked for, how far away a lane's centre
#: line may be there, m, and the least cosine between the directions.
SAMPLE_M, REACH_M, ALONG_COS = 2.0, 6.0, 0.7
#: Metres of a route without a lane from which on the route itself is the lane, and the length of
#: the lanes that it becomes.
GAP_M, PIECE_M = 10.0, 30.0
#: Costs of a route's way from lane to lane, m²: to one that follows, to one beside, to any other.
FOLLOW_COST, BESIDE_COST, JUMP_COST = 0.1, 4.0, 400.0
MOST_LINKS = 6  #: Road blocks at most between two of a route that do not follow one another.


def wrap(angle_rad: float) -> float:
    """Return an angle in (-pi, pi]."""
    return float(np.arctan2(np.sin(angle_rad), np.cos(angle_rad)))


def surface(polygon: Mapping[str, Any]) -> Polygon:
    """Return a valid polygon of a map layer: the largest part of one that was none."""
    if len(polygon["exterior"]) < 3:
        return Polygon()
    holes = [np.asarray(ring, np.float64) for ring in polygon["holes"] if len(ring) >= 3]
    return largest(shapely.make_valid(Polygon(np.asarray(polygon["exterior"], np.float64), holes)))


def largest(shape: Any) -> Polygon:
    """Return the largest polygon of a shape; an empty one where there is none."""
    parts = shapely.get_parts(shapely.get_parts(shape)).tolist()
    flat = [part for part in parts if isinstance(part, Polygon)]
    return max(flat, key=lambda part: part.area, default=Polygon())


class Centreline:
    """A line [P, 2] by its arc length."""

    def __init__(self, points: npt.ArrayLike) -> None:
        given = np.asarray(points, np.float64)
        apart = np.ones(len(given), np.bool_)
        apart[1:] = np.linalg.norm(np.diff(given, axis=0), axis=1) > 1e-3
        self.points: F64 = given[apart]  #: Points [P, 2], none twice.
        if len(self.points) < 2:
            self.points = np.stack([given[0], given[0] + (1e-2, 0.0)])
        steps = np.diff(self.points, axis=0)
        self._along: F64 = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
        headings = np.arctan2(steps[:, 1], steps[:, 0])
        #: Headings [P]; that of the last point is that of the one before.
        self.headings: F64 = np.append(headings, headings[-1])
        self.length_m = float(self._along[-1])
        self.shape = LineString(self.points)

    def heading_at(self, along_m: float) -> float:
        """Return the heading after so many metres."""
        i = int(np.searchsorted(self._along, along_m, side="right")) - 1
        return float(self.headings[np.clip(i, 0, len(self.headings) - 1)])

    def project(self, x: float, y: float) -> float:
        """Return the metres along the line at which a place is nearest."""
        return float(self.shape.project(Point(x, y)))

    def pose(self, along_m: float) -> tuple[float, float, float]:
        """Return x, y and heading after so many metres."""
        at = self.shape.interpolate(along_m)
        return at.x, at.y, self.heading_at(along_m)

    def offset(self, x: float, y: float) -> tuple[float, float, float]:
        """Return how far ahead and to the left of the nearest place of the line a place is, m, and
        the heading there.
        """
        near_x, near_y, heading = self.pose(self.project(x, y))
        dx, dy = x - near_x, y - near_y
        cos, sin = np.cos(heading), np.sin(heading)
        return float(dx * cos + dy * sin), float(dy * cos - dx * sin), heading


class Road:
    """A lane or connector: its line, surface and neighbours by number."""

    def __init__(self, lane: Mapping[str, Any]) -> None:
        self.line = Centreline(lane["centreline"])
        self.is_lane: bool = lane["kind"] != "connector"
        #: Whether it is a piece of a route, which has no lanes beside it.
        self.alone: bool = lane["kind"] == "route"
        self.speed_limit_mps: float | None = lane["speed_limit_mps"]
        self.after = [int(i) for i in lane["successors"]]
        self.before = [int(i) for i in lane["predecessors"]]
        found = surface(lane["polygon"])
        self.surface = self.line.shape.buffer(HALF_WIDTH_M) if found.is_empty else found

    @cached_property
    def sides(self) -> tuple[F64, F64]:
        """Left and right edges [P, 2]: where normals of the centre line leave the surface."""
        line, edge = self.line, self.surface.exterior
        normals = np.stack([-np.sin(line.headings), np.cos(line.headings)], axis=1)

        def side(sign: float) -> F64:
            ends = line.points + sign * HALF_WIDTHS_M[1] * normals
            rays = shapely.linestrings(np.stack([line.points, ends], axis=1))
            hits = shapely.intersection(rays, edge)
            widths = shapely.distance(shapely.points(line.points), hits)
            widths = np.where(np.nan_to_num(widths) > 0, widths, HALF_WIDTH_M)
            edges: F64 = line.points + sign * np.clip(widths, *HALF_WIDTHS_M)[:, None] * normals
            return edges

        return side(1.0), side(-1.0)


class RoadGraph:
    """Roads of a scene, ``Scene.map_layers()["lanes"]``, with the road blocks that they make.

    Differs from nuPlan: blocks are found by geometry, for the lanes of scenes do not name them.
    """

    def __init__(self, lanes: Iterable[Mapping[str, Any]]) -> None:
        self.roads = [Road(lane) for lane in lanes]
        self._tree = STRtree([road.surface for road in self.roads])
        #: Numbers of the roads of each block, from left to right.
        self.blocks: list[list[int]] = []
        self.block_of: list[int] = [-1] * len(self.roads)  #: Block of each road.
        self._add_blocks(self._beside())
        self._add_blocks(self._between())

    def _add_blocks(self, groups: Iterable[Sequence[int]]) -> None:
        for group in groups:
            first, left = self.roads[group[0]].line, {group[0]: 0.0}
            for line, i in ((self.roads[i].line, i) for i in group[1:]):
                left[i] = first.offset(*line.pose(0.5 * line.length_m)[:2])[1]
            for i in group:
                self.block_of[i] = len(self.blocks)
            self.blocks.append(sorted(group, key=lambda i: -left[i]))

    def _beside(self) -> list[list[int]]:
        """Lanes side by side, never one with what follows it."""
        groups = {i: [i] for i, road in enumerate(self.roads) if road.is_lane}
        for i in [i for i in groups if not self.roads[i].alone]:
            near = self._tree.query(self.roads[i].surface.buffer(0.5), predicate="intersects")
            for j in sorted(near.tolist()):
                if j not in groups or groups[j] is groups[i] or self.roads[j].alone:
                    continue
                both = groups[i] + groups[j]
                follows = any(k in both for member in both for k in self.roads[member].after)
                if not follows and self._is_beside(i, j):
                    groups.update(dict.fromkeys(both, both))
        return list({id(group): group for group in groups.values()}.values())

    def _is_beside(self, one: int, other: int) -> bool:
        """Whether the middle of one of two lanes lies beside the other one."""
        lines = self.roads[one].line, self.roads[other].line
        for line, beside in (lines, lines[::-1]):
            x, y, heading = line.pose(0.5 * line.length_m)
            ahead, left, there = beside.offset(x, y)
            fits = abs(ahead) < BEYOND_M and BESIDE_M[0] < abs(left) < BESIDE_M[1]
            if fits and np.cos(there - heading) > AGREE_COS:
                return True
        return False

    def _between(self) -> list[list[int]]:
        """Connectors from one block to another."""
        groups: dict[Any, list[int]] = {}
        for i, road in enumerate(self.roads):
            if not road.is_lane:
                ends = [[self.block_of[k] for k in side] for side in (road.before, road.after)]
                known = all(end and end[0] >= 0 for end in ends)
                groups.setdefault((ends[0][0], ends[1][0]) if known else i, []).append(i)
        return list(groups.values())

    def neighbours(self, block: int, *, after: bool) -> list[int]:
        """Return the blocks that follow a block, or lead to it."""
        roads = (self.roads[i] for i in self.blocks[block])
        found = (self.block_of[k] for road in roads for k in (road.after if after else road.before))
        return list(dict.fromkeys(found))

    def is_lane_block(self, block: int) -> bool:
        """Return whether a block is of lanes, not of connectors."""
        return self.roads[self.blocks[block][0]].is_lane

    def block_surface(self, block: int) -> Polygon:
        """Return the surface of a block."""
        parts = [self.roads[i].surface.buffer(0.05) for i in self.blocks[block]]
        return largest(shapely.union_all(parts))

    def intersections(self) -> list[Polygon]:
        """Return where connectors that come from different blocks overlap."""
        links = [b for b in range(len(self.blocks)) if not self.is_lane_block(b)]
        if not links:  # shapely finds nothing wrong with an empty tree, but with an empty query
            return []
        shapes = [self.block_surface(b) for b in links]
        origins = [set(self.neighbours(b, after=False)) for b in links]
        crossed = set()
        for i, j in STRtree(shapes).query(shapes, predicate="intersects").T.tolist():
            apart = origins[i] and origins[j] and origins[i] != origins[j]
            if apart and shapes[i].intersection(shapes[j]).area > 1.0:
                crossed.add(i)
        joined = shapely.union_all([shapes[i].buffer(0.1) for i in sorted(crossed)])
        return [part for part in shapely.get_parts(joined).tolist() if not part.is_empty]

    def route_blocks(self, route: npt.ArrayLike, ahead_m: float = 150.0) -> list[int] | None:
        """Return the blocks along a route [P, 2], and straight on for so many metres after it.

        ``None`` where the route leaves the lanes for more than :data:`GAP_M`.
        """
        roads = self._roads_along(Centreline(route))
        if not roads:
            return None
        blocks = [self.block_of[roads[0]]]
        for block in (self.block_of[road] for road in roads[1:]):
            if block != blocks[-1]:
                blocks += [*self._linked(blocks[-1], block), block]
        end = roads[-1]
        while ahead_m > 0 and (after := self.roads[end].after):
            heading = self.roads[end].line.headings[-1]
            turns = [abs(wrap(self.roads[k].line.headings[-1] - heading)) for k in after]
            end = after[int(np.argmin(turns))]
            ahead_m -= self.roads[end].line.length_m
            if self.block_of[end] not in blocks:
                blocks.append(self.block_of[end])
        return blocks

    def _roads_along(self, route: Centreline) -> list[int]:
        """The cheapest way through the lanes near a route, each following the one before."""
        #: Cost of the best way to each road, and the way.
        ways: dict[int, tuple[float, list[int]]] = {}
        gap_m = 0.0
        for along_m in np.arange(0.0, route.length_m + SAMPLE_M, SAMPLE_M):
            here = self._near(*route.pose(along_m))
            gap_m = 0.0 if here else gap_m + SAMPLE_M
            if gap_m > GAP_M:
                return []
            before, ways = ways, {} if here else ways
            for road, own in here.items():
                reach = [
                    (cost + self._step_cost(way[-1], road), way) for cost, way in before.values()
                ]
                cost, way = min(reach, key=lambda found: found[0], default=(0.0, []))
                ways[road] = own + cost, [*way, road]
        _, best = min(ways.values(), key=lambda found: found[0], default=(0.0, []))
        return list(dict.fromkeys(best))

    def _near(self, x: float, y: float, heading: float) -> dict[int, float]:
        """Roads at a place in its direction, with the squares of their distances, m²."""
        found: dict[int, float] = {}
        near = self._tree.query(Point(x, y), predicate="dwithin", distance=0.5 * REACH_M)
        for i in sorted(near.tolist()):
            ahead, left, there = self.roads[i].line.offset(x, y)
            away = ahead**2 + left**2
            if np.cos(there - heading) > ALONG_COS and away < REACH_M**2:
                found[i] = away
        return found

    def _step_cost(self, last: int, road: int) -> float:
        if road == last:
            return 0.0
        if road in self.roads[last].after:
            return FOLLOW_COST
        return BESIDE_COST if self.block_of[road] == self.block_of[last] else JUMP_COST

    def _linked(self, start: int, end: int) -> list[int]:
        """Blocks between two that do not follow one another; none where nothing links them."""
        paths = [[start]]
        for _ in range(MOST_LINKS):
            steps = ((path, self.neighbours(path[-1], after=True)) for path in paths)
            paths = [
                [*path, block] for path, found in steps for block in found if block not in path
            ]
            if whole := next((path for path in paths if path[-1] == end), None):
                return whole[1:-1]
        return []


def lanes_of_route(route: npt.ArrayLike, first: int) -> list[dict[str, Any]]:
    """Return a route [P, 2] as lanes one after another, numbered from ``first`` on.

    They are lanes as those of :meth:`ccdiff_env.Scene.map_layers`, of kind ``"route"``, 3.5 m wide.
    """
    line = Centreline(route)
    count = max(round(line.length_m / PIECE_M), 2)
    ends = np.linspace(0.0, line.length_m, count + 1)
    places = [np.linspace(a, b, max(round(b - a), 1) + 1) for a, b in pairwise(ends)]
    return [
        {
            "kind": "route",
            "centreline": np.array([line.pose(along_m)[:2] for along_m in piece]),
            "polygon": {"exterior": [], "holes": []},
            "successors": [first + i + 1] if i + 1 < count else [],
            "predecessors": [first + i - 1] if i else [],
            "speed_limit_mps": None,
        }
        for i, piece in enumerate(places)
    ]
