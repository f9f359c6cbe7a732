"""The map of a scene as a map of nuPlan, in the frame of the scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from nuplan.common.actor_state.state_representation import Point2D
from nuplan.common.maps.abstract_map import AbstractMap
from nuplan.common.maps.maps_datatypes import SemanticMapLayer
from shapely import Point, STRtree

from ccdiff_env.errors import MissingFeatureError
from ccdiff_env.interop.nuplan.map_objects import (
    Area,
    Block,
    ConnectorBlock,
    Crossing,
    MapConnector,
    MapLane,
    Network,
    StopArea,
)
from ccdiff_env.interop.nuplan.roads import RoadGraph, lanes_of_route, surface

__all__ = ["SceneMap"]

_LAYER = SemanticMapLayer
#: Layers of scenes by those of nuPlan, and what their surfaces become.
_AREAS = {
    _LAYER.DRIVABLE_AREA: ("drivable_area", Area),
    _LAYER.CROSSWALK: ("ped_crossings", Area),
    _LAYER.WALKWAYS: ("walkways", Area),
    _LAYER.STOP_LINE: ("stop_lines", StopArea),
    _LAYER.CARPARK_AREA: ("carpark_areas", Area),
}


class SceneMap(AbstractMap):
    """The map of a scene from ``Scene.map_layers()``. Identifiers are numbers, as in nuPlan's.

    Differs from nuPlan: road blocks and intersections are found by geometry, see
    :class:`~ccdiff_env.interop.nuplan.roads.RoadGraph`; the drivable area is also a car park,
    since planners treat lanes, connectors and car parks as the road, and lanes of nuScenes leave
    out what lies beside them; there are no traffic lights and no rasters.
    """

    def __init__(self, layers: Mapping[str, Any], name: str) -> None:
        self._given, self._name, self._num_objects = layers, name, 0
        self._network = Network(RoadGraph(layers.get("lanes", [])))
        graph, edges, blocks = self._network.graph, self._network.edges, self._network.blocks
        for i, road in enumerate(graph.roads):
            kind = MapLane if road.is_lane else MapConnector
            edges.append(kind(self._next(), self._network, i))
        for i in range(len(graph.blocks)):
            block = Block if graph.is_lane_block(i) else ConnectorBlock
            blocks.append(block(self._next(), self._network, i))
        self._layers: dict[SemanticMapLayer, list[Any]] = {
            _LAYER.LANE: [e for e in edges if isinstance(e, MapLane)],
            _LAYER.LANE_CONNECTOR: [e for e in edges if isinstance(e, MapConnector)],
            _LAYER.ROADBLOCK: [b for b in blocks if not isinstance(b, ConnectorBlock)],
            _LAYER.ROADBLOCK_CONNECTOR: [b for b in blocks if isinstance(b, ConnectorBlock)],
            _LAYER.INTERSECTION: [Crossing(self._next(), p) for p in graph.intersections()],
        }
        for layer, (key, made) in _AREAS.items():
            found = [surface(polygon) for polygon in layers.get(key, [])]
            self._layers[layer] = [made(self._next(), p) for p in found if not p.is_empty]
        self._layers[_LAYER.CARPARK_AREA] += self._layers[_LAYER.DRIVABLE_AREA]
        self._by_id = {layer: {o.id: o for o in found} for layer, found in self._layers.items()}
        self._trees: dict[SemanticMapLayer, STRtree] = {}

    def _next(self) -> str:
        self._num_objects += 1
        return str(self._num_objects)

    def along(self, route: npt.ArrayLike) -> tuple[SceneMap, list[str]]:
        """Return a map in which lanes lead along a route [P, 2], and its road blocks' identifiers.

        Where lanes leave out a part of the route, the route itself becomes lanes of 3.5 m:
        nuPlan's planners drive along lanes and nowhere else.
        """
        found, blocks = self, self._network.graph.route_blocks(route)
        if blocks is None or len(blocks) < 2:  # the devkit's IDM asserts two
            lanes = list(self._given.get("lanes", []))
            more = lanes_of_route(route, len(lanes))
            found = SceneMap({**self._given, "lanes": [*lanes, *more]}, self._name)
            blocks = list(dict.fromkeys(found._network.graph.block_of[len(lanes) :]))
        return found, [str(found._network.blocks[i].id) for i in blocks]

    @property
    def map_name(self) -> str:
        return self._name

    def get_available_map_objects(self) -> list[SemanticMapLayer]:
        return list(self._layers)

    def get_available_raster_layers(self) -> list[SemanticMapLayer]:
        return []

    def get_raster_map(self, *asked: Any) -> Any:
        raise MissingFeatureError(f"scenes have no raster map, {asked} was asked for")

    get_raster_map_layer = get_distance_to_nearest_raster_layer = get_raster_map

    def initialize_all_layers(self) -> None:
        """Do nothing: all layers are there."""

    def _tree(self, layer: SemanticMapLayer) -> STRtree:
        if layer not in self._layers:
            raise ValueError(f"scenes have no layer {layer.name}")
        if layer not in self._trees:
            self._trees[layer] = STRtree([o.polygon for o in self._layers[layer]])
        return self._trees[layer]

    def _near(self, point: Point2D, layer: SemanticMapLayer, radius_m: float) -> list[Any]:
        at, tree = Point(point.x, point.y), self._tree(layer)
        found = tree.query(at, predicate="dwithin", distance=radius_m).tolist()
        return [self._layers[layer][i] for i in sorted(found)]

    def get_all_map_objects(self, point: Point2D, layer: SemanticMapLayer) -> list[Any]:
        return self._near(point, layer, 0.0)

    def get_one_map_object(self, point: Point2D, layer: SemanticMapLayer) -> Any:
        """Of several return that whose centre line is nearest: lanes of nuScenes overlap."""
        at = Point(point.x, point.y)

        def away_m(found: Any) -> float:
            line = getattr(found, "baseline_path", None)
            return 0.0 if line is None else float(line.linestring.distance(at))

        return min(self.get_all_map_objects(point, layer), key=away_m, default=None)

    def is_in_layer(self, point: Point2D, layer: SemanticMapLayer) -> bool:
        return bool(self.get_all_map_objects(point, layer))

    def get_proximal_map_objects(
        self, point: Point2D, radius: float, layers: list[SemanticMapLayer]
    ) -> dict[SemanticMapLayer, list[Any]]:
        return {layer: self._near(point, layer, radius) for layer in layers}

    def get_map_object(self, object_id: str, layer: SemanticMapLayer) -> Any:
        return self._by_id.get(layer, {}).get(str(object_id))

    def get_distance_to_nearest_map_object(
        self, point: Point2D, layer: SemanticMapLayer
    ) -> tuple[str | None, float | None]:
        # nuPlan's metrics give corners of boxes as points of shapely
        at = point if isinstance(point, Point) else Point(point.x, point.y)
        nearest = self._tree(layer).nearest(at)
        if nearest is None:
            return None, None
        found = self._layers[layer][int(nearest)]
        return str(found.id), float(found.polygon.distance(at))

    def get_distances_matrix_to_nearest_map_object(
        self, points: list[Point2D], layer: SemanticMapLayer
    ) -> npt.NDArray[np.float64]:
        return np.array([[self.get_distance_to_nearest_map_object(p, layer)[1]] for p in points])

    # tuplan_garage looks road blocks up by these

    def _get_roadblock(self, object_id: str) -> Any:
        return self.get_map_object(object_id, _LAYER.ROADBLOCK)

    def _get_roadblock_connector(self, object_id: str) -> Any:
        return self.get_map_object(object_id, _LAYER.ROADBLOCK_CONNECTOR)
