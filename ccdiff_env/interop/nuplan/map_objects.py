"""Objects of nuPlan's maps, made of a scene's roads and surfaces."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from nuplan.common.actor_state.state_representation import Point2D, StateSE2
from nuplan.common.maps.abstract_map_objects import (
    Intersection,
    Lane,
    LaneConnector,
    LaneGraphEdgeMapObject,
    PolygonMapObject,
    PolylineMapObject,
    RoadBlockGraphEdgeMapObject,
    StopLine,
)
from nuplan.common.maps.maps_datatypes import IntersectionType, LaneConnectorType, StopLineType
from shapely import Point, Polygon

from ccdiff_env.interop.nuplan.roads import Centreline, Road, RoadGraph, wrap

__all__ = [
    "Area",
    "Block",
    "ConnectorBlock",
    "Crossing",
    "MapConnector",
    "MapLane",
    "Network",
    "StopArea",
]

#: Metres before and after a place over which the curvature of a line is taken.
_CURVATURE_M = 2.0
#: Turns of connectors, rad: up to the first they go straight on, from the second on they turn back.
_STRAIGHT_RAD, _BACK_RAD = np.pi / 6, 0.9 * np.pi


@dataclass
class Network:
    """Roads, and the objects that they are on a map: lanes and connectors, road blocks."""

    graph: RoadGraph
    edges: list[_Edge] = field(default_factory=list)
    blocks: list[Block] = field(default_factory=list)


class Polyline(PolylineMapObject):
    """A line."""

    def __init__(self, name: str, line: Centreline | npt.NDArray[np.float64]) -> None:
        super().__init__(name)
        self._line = line if isinstance(line, Centreline) else Centreline(line)

    linestring: Any = property(lambda self: self._line.shape)
    length: Any = property(lambda self: self._line.length_m)

    @cached_property
    def discrete_path(self) -> list[StateSE2]:
        places = zip(self._line.points.tolist(), self._line.headings.tolist(), strict=True)
        return [StateSE2(x, y, heading) for (x, y), heading in places]

    def get_nearest_arc_length_from_position(self, point: Point2D) -> float:
        return self._line.project(point.x, point.y)

    def get_nearest_pose_from_position(self, point: Point2D) -> StateSE2:
        return StateSE2(*self._line.pose(self._line.project(point.x, point.y)))

    def get_curvature_at_arc_length(self, arc_length: float) -> float:
        low = max(arc_length - _CURVATURE_M, 0.0)
        high = min(arc_length + _CURVATURE_M, self._line.length_m)
        turn = wrap(self._line.heading_at(high) - self._line.heading_at(low))
        return turn / max(high - low, 1e-3)


class _Edge(LaneGraphEdgeMapObject):
    """What lanes and connectors share: the road of a number."""

    def __init__(self, name: str, network: Network, number: int) -> None:
        super().__init__(name)
        self._network, self._number = network, number
        self._road: Road = network.graph.roads[number]
        self._baseline = Polyline(f"{name}-baseline", self._road.line)

    def _edges(self, numbers: list[int]) -> list[_Edge]:
        return [self._network.edges[i] for i in numbers]

    polygon: Any = property(lambda self: self._road.surface)
    baseline_path: Any = property(lambda self: self._baseline)
    incoming_edges: Any = property(lambda self: self._edges(self._road.before))
    outgoing_edges: Any = property(lambda self: self._edges(self._road.after))
    parallel_edges: Any = property(lambda self: self.parent.interior_edges)
    speed_limit_mps: Any = property(lambda self: self._road.speed_limit_mps)
    stop_lines: Any = property(lambda self: [])

    @property
    def parent(self) -> Block:
        return self._network.blocks[self._network.graph.block_of[self._number]]

    def get_roadblock_id(self) -> str:
        return str(self.parent.id)

    def has_traffic_lights(self) -> bool:
        return False

    @property
    def _place(self) -> int:
        """Place in the road block, from the left."""
        graph = self._network.graph
        return graph.blocks[graph.block_of[self._number]].index(self._number)

    def is_left_of(self, other: _Edge) -> bool:
        assert self.is_same_roadblock(other), "lanes of one road block"
        return self._place < other._place

    def is_right_of(self, other: _Edge) -> bool:
        assert self.is_same_roadblock(other), "lanes of one road block"
        return self._place > other._place

    @property
    def adjacent_edges(self) -> tuple[_Edge | None, _Edge | None]:
        row: list[_Edge | None] = [None, *self.parent.interior_edges, None]
        return row[self._place], row[self._place + 2]

    @cached_property
    def left_boundary(self) -> Polyline:
        return Polyline(f"{self.id}-left", self._road.sides[0])

    @cached_property
    def right_boundary(self) -> Polyline:
        return Polyline(f"{self.id}-right", self._road.sides[1])

    def get_width_left_right(
        self, point: Point2D, include_outside: bool = False
    ) -> tuple[float, float]:
        at = Point(point.x, point.y)
        if not include_outside and not self.polygon.contains(at):
            return np.inf, np.inf
        left, right = self.left_boundary.linestring, self.right_boundary.linestring
        return float(left.distance(at)), float(right.distance(at))

    def oriented_distance(self, point: Point2D) -> float:
        ahead, left = self._road.line.offset(point.x, point.y)
        return float(np.copysign(np.hypot(ahead, left), left))


class MapLane(_Edge, Lane):
    """A lane."""

    index: Any = property(lambda self: self._place + 1)


class MapConnector(_Edge, LaneConnector):
    """A way through an intersection."""

    adjacent_edges = LaneConnector.adjacent_edges

    @property
    def turn_type(self) -> LaneConnectorType:
        turn = wrap(self._road.line.headings[-1] - self._road.line.headings[0])
        if abs(turn) < _STRAIGHT_RAD:
            return LaneConnectorType.STRAIGHT
        if abs(turn) > _BACK_RAD:
            return LaneConnectorType.UTURN
        return LaneConnectorType.LEFT if turn > 0 else LaneConnectorType.RIGHT


class Block(RoadBlockGraphEdgeMapObject):
    """Lanes side by side."""

    def __init__(self, name: str, network: Network, number: int) -> None:
        super().__init__(name)
        self._network, self._number = network, number

    @property
    def interior_edges(self) -> list[_Edge]:
        return [self._network.edges[i] for i in self._network.graph.blocks[self._number]]

    @cached_property
    def polygon(self) -> Polygon:
        return self._network.graph.block_surface(self._number)

    def _neighbours(self, after: bool) -> list[Block]:
        numbers = self._network.graph.neighbours(self._number, after=after)
        return [self._network.blocks[i] for i in numbers]

    incoming_edges: Any = property(lambda self: self._neighbours(False))
    outgoing_edges: Any = property(lambda self: self._neighbours(True))
    parallel_edges: Any = property(lambda self: [self])
    children_stop_lines: Any = property(lambda self: [])

    def contains_point(self, point: Point2D) -> bool:
        return any(edge.contains_point(point) for edge in self.interior_edges)


class ConnectorBlock(Block):
    """Connectors from one road block to another."""


# tuplan_garage cuts loops of a route at objects whose class has this name
ConnectorBlock.__name__ = "NuPlanRoadBlockConnector"


class Area(PolygonMapObject):
    """A surface without further properties."""

    def __init__(self, name: str, polygon: Polygon) -> None:
        super().__init__(name)
        self._polygon = polygon

    polygon: Any = property(lambda self: self._polygon)


class Crossing(Intersection):
    """An intersection."""

    def __init__(self, name: str, polygon: Polygon) -> None:
        super().__init__(name, IntersectionType.DEFAULT)
        self._polygon = polygon

    polygon = Area.polygon
    interior_edges: Any = property(lambda self: [])
    incoming_edges: Any = property(lambda self: [])
    is_signaled: Any = property(lambda self: False)


class StopArea(StopLine):
    """A stop line's area; scenes do not say whose."""

    def __init__(self, name: str, polygon: Polygon) -> None:
        super().__init__(name, StopLineType.UNKNOWN)
        self._polygon = polygon

    polygon = Area.polygon
    intersection_from: Any = property(lambda self: None)
    layer_type: Any = property(lambda self: StopLineType.UNKNOWN)
    parent: Any = property(lambda self: None)
