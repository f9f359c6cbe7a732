"""The embedded city as a nuScenes map expansion (version 1.3) and as a coarse mask."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from tools.embedded_city.checks import DrivableArea
from tools.embedded_city.city import LANE_WIDTH_M, PARKING_M, WALKWAY_M, City, Lane, Road
from tools.embedded_city.curves import Curve, Segment, Xy

Record = dict[str, Any]

METRES_PER_PIXEL = 2.0
STRAIGHT_RADIUS_M = 999.999
"""What nuScenes writes as the radius of a path that is straight."""
LAYERS = """
    polygon line node drivable_area road_segment road_block lane ped_crossing walkway stop_line
    carpark_area road_divider lane_divider traffic_light lane_connector
""".split()


class MapWriter:
    """Collects the records of a map expansion; tokens are layer number and running number."""

    def __init__(self, city: City) -> None:
        self.city = city
        self.layers: dict[str, list[Record]] = {layer: [] for layer in LAYERS}
        self.lane_tokens: dict[str, str] = {}
        self.nodes: dict[Xy, str] = {}
        self.paths: dict[str, list[Record]] = {}

    def write(self) -> Record:
        """Return the whole map expansion."""
        self._drivable_area()
        segments = {name: self._road_segment(road) for name, road in self.city.roads.items()}
        for lane in self.city.lanes.values():
            self._lane(lane)
        for road in self.city.roads.values():
            self._dividers(road, segments[road.name])
            self._car_parks(road)
        self._walkways()
        crossings = {
            (c.junction, c.road): self._add(
                "ped_crossing",
                polygon_token=self._polygon(c.polygon),
                road_segment_token=segments[c.road],
            )
            for c in self.city.crossings
        }
        self._stop_lines(crossings)
        return {
            "version": "1.3",
            **self.layers,
            "canvas_edge": list(self.city.canvas),
            "arcline_path_3": self.paths,
            "connectivity": {
                self.lane_tokens[lane.name]: {
                    "incoming": [self.lane_tokens[n] for n in lane.incoming],
                    "outgoing": [self.lane_tokens[n] for n in lane.outgoing],
                }
                for lane in self.city.lanes.values()
            },
        }

    # --- geometry
    # -------------------------------------------------------------------------------------------

    def _add(self, layer: str, **fields: Any) -> str:
        records = self.layers[layer]
        token = f"{LAYERS.index(layer):08x}{len(records):024x}"
        records.append({"token": token, **fields})
        return token

    def _node(self, point: Xy) -> str:
        at = (round(point[0], 3), round(point[1], 3))
        if at not in self.nodes:
            self.nodes[at] = self._add("node", x=at[0], y=at[1])
        return self.nodes[at]

    def _line(self, points: Sequence[Xy]) -> str:
        return self._add("line", node_tokens=[self._node(p) for p in points])

    def _polygon(self, exterior: Sequence[Xy], holes: Sequence[Sequence[Xy]] = ()) -> str:
        return self._add(
            "polygon",
            exterior_node_tokens=[self._node(p) for p in exterior],
            holes=[{"node_tokens": [self._node(p) for p in ring]} for ring in holes],
        )

    def _strip(self, curve: Curve, left_m: float, right_m: float) -> list[Xy]:
        """Return the outline between two parallels of a curve, counter-clockwise."""
        return curve.offset(-right_m).outline() + curve.offset(left_m).outline()[::-1]

    # --- layers
    # ---------------------------------------------------------------------------------------------

    def _drivable_area(self) -> None:
        polygon = self._polygon(self.city.drivable_exterior, self.city.drivable_holes)
        self._add("drivable_area", polygon_tokens=[polygon])

    def _road_segment(self, road: Road) -> str:
        middle = self.city.trimmed(road)
        segment = self._add(
            "road_segment",
            polygon_token=self._polygon(self._strip(middle, road.left_m, road.right_m)),
            is_intersection=False,
            drivable_area_token=self.layers["drivable_area"][0]["token"],
        )
        for curve, width in ((middle, road.right_m), (middle.reversed(), road.left_m)):
            self._add(
                "road_block",
                polygon_token=self._polygon(self._strip(curve, 0.0, width)),
                from_edge_line_token=self._line(
                    [curve.start.xy, curve.start.ahead(0.0, -width).xy]
                ),
                to_edge_line_token=self._line([curve.end.xy, curve.end.ahead(0.0, -width).xy]),
                road_segment_token=segment,
            )
        return segment

    def _lane(self, lane: Lane) -> None:
        half = LANE_WIDTH_M / 2.0
        polygon = self._polygon(self._strip(lane.curve, half, half))
        if lane.is_connector:
            token = self._add("lane_connector", polygon_token=polygon)
        else:
            start, end = lane.curve.start, lane.curve.end
            token = self._add(
                "lane",
                polygon_token=polygon,
                lane_type="CAR",
                from_edge_line_token=self._line(
                    [start.ahead(0.0, half).xy, start.ahead(0.0, -half).xy]
                ),
                to_edge_line_token=self._line([end.ahead(0.0, half).xy, end.ahead(0.0, -half).xy]),
                left_lane_divider_segments=self._divider_segments(lane.curve.offset(half)),
                right_lane_divider_segments=self._divider_segments(lane.curve.offset(-half)),
            )
        self.lane_tokens[lane.name] = token
        self.paths[token] = [_arcline(segment) for segment in lane.curve.segments]

    def _divider_segments(self, curve: Curve) -> list[Record]:
        return [{"node_token": self._node(p), "segment_type": "NIL"} for p in curve.outline()]

    def _dividers(self, road: Road, segment: str) -> None:
        middle = self.city.trimmed(road)
        line = self._line(middle.outline())
        self._add("road_divider", line_token=line, road_segment_token=segment)
        for sign, num in ((-1.0, road.forward), (1.0, road.backward)):
            for i in range(1, num):
                points = middle.offset(sign * i * LANE_WIDTH_M).outline()
                nodes = [
                    {"node_token": self._node(p), "segment_type": "DASHED_WHITE"} for p in points
                ]
                self._add(
                    "lane_divider", line_token=self._line(points), lane_divider_segments=nodes
                )

    def _car_parks(self, road: Road) -> None:
        for right, has_room in ((True, road.parking_right), (False, road.parking_left)):
            if has_room:
                kerb = self.city.kerb(road, right)
                self._add(
                    "carpark_area",
                    polygon_token=self._polygon(self._strip(kerb, PARKING_M, 0.0)),
                    orientation=round(kerb.start.yaw, 4),
                    road_block_token=self.layers["road_block"][0 if right else 1]["token"],
                )

    def _walkways(self) -> None:
        """Add a walkway along every kerb, round the corners too."""
        for road in self.city.roads.values():
            for right in (True, False):
                kerb = self.city.kerb(road, right)
                self._add("walkway", polygon_token=self._polygon(self._strip(kerb, 0.0, WALKWAY_M)))
        for name, arms in self.city.arms.items():
            for index in range(len(arms)):
                inner = self.city.corner_curve(name, index)
                outer = self.city.corner_curve(name, index, WALKWAY_M)
                if inner is not None and outer is not None:
                    ring = outer.outline() + inner.outline()[::-1]
                    self._add("walkway", polygon_token=self._polygon(ring))

    def _stop_lines(self, crossings: dict[tuple[str, str], str]) -> None:
        """Add a stop line across the lanes that lead to a junction with signals, crossings or a
        stem.
        """
        for name, junction in self.city.junctions.items():
            for arm in self.city.arms[name]:
                kind = (
                    "TRAFFIC_LIGHT"
                    if junction.signals
                    else "PED_CROSSING"
                    if junction.crossings
                    else "YIELD"
                )
                if kind == "YIELD" and not arm.road.name.startswith("stem"):
                    continue
                width = arm.toward * LANE_WIDTH_M
                near = arm.outward.ahead(self.city.reach[(name, arm.road.name)])
                far = near.ahead(0.8)
                ring = [near.xy, far.xy, far.ahead(0.0, width).xy, near.ahead(0.0, width).xy]
                line = [near.xy, near.ahead(0.0, width).xy]
                self._add(
                    "stop_line",
                    polygon_token=self._polygon(ring),
                    stop_line_type=kind,
                    ped_crossing_tokens=[crossings[(name, arm.road.name)]]
                    if kind == "PED_CROSSING"
                    else [],
                    traffic_light_tokens=[self._traffic_light(line, near.yaw)]
                    if kind == "TRAFFIC_LIGHT"
                    else [],
                    road_block_token="",
                )

    def _traffic_light(self, line: Sequence[Xy], yaw: float) -> str:
        place = line[1]
        pose = {"tx": round(place[0], 3), "ty": round(place[1], 3), "tz": 4.0, "rx": 0.0, "ry": 0.0}
        colours = ("RED", "YELLOW", "GREEN")
        items = [
            {
                "color": c,
                "shape": "CIRCLE",
                "rel_pos": {"tx": 0.0, "ty": 0.0, "tz": -0.3 * i, "rx": 0.0, "ry": 0.0, "rz": 0.0},
                "to_road_block_tokens": [],
            }
            for i, c in enumerate(colours)
        ]
        return self._add(
            "traffic_light",
            line_token=self._line(line),
            traffic_light_type="VERTICAL",
            from_road_block_token="",
            items=items,
            pose={**pose, "rz": round(yaw, 5)},
        )


def _arcline(segment: Segment) -> Record:
    """Return a segment as a nuScenes arcline path."""
    start, end = segment.start, segment.end
    straight = abs(segment.curvature) < 1e-6
    return {
        "start_pose": [round(start.x, 4), round(start.y, 4), round(start.yaw, 6)],
        "end_pose": [round(end.x, 4), round(end.y, 4), round(end.yaw, 6)],
        "shape": "LSL" if straight or segment.curvature > 0.0 else "RSR",
        "radius": STRAIGHT_RADIUS_M if straight else round(1.0 / abs(segment.curvature), 4),
        "segment_length": [0.0, round(segment.length, 4), 0.0]
        if straight
        else [round(segment.length, 4), 0.0, 0.0],
    }


def mask_png(city: City) -> bytes:
    """Return the drivable area as a grey PNG of 2 m a pixel, 255 where drivable, north up.

    The image data is stored, not compressed, so that its bytes do not depend on the compressor.
    """
    columns, rows = (math.ceil(edge / METRES_PER_PIXEL) for edge in city.canvas)
    middles = (np.arange(columns) + 0.5) * METRES_PER_PIXEL
    area, lines = DrivableArea(city), []
    for row in range(rows):
        at = area.crossings(city.canvas[1] - (row + 0.5) * METRES_PER_PIXEL)
        inside = (at[:, None] > middles).sum(axis=0) % 2 == 1
        lines.append(b"\0" + (inside * 255).astype(np.uint8).tobytes())
    header = struct.pack(">IIBBBBB", columns, rows, 8, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", _stored(b"".join(lines))), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )


def _stored(data: bytes) -> bytes:
    """Return a zlib stream of uncompressed blocks."""
    out = [b"\x78\x01"]
    for start in range(0, len(data), 0xFFFF):
        block = data[start : start + 0xFFFF]
        last = start + 0xFFFF >= len(data)
        out.append(struct.pack("<BHH", last, len(block), len(block) ^ 0xFFFF) + block)
    return b"".join(out) + struct.pack(">I", zlib.adler32(data))
