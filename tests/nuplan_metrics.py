"""nuPlan's own metric classes on recorded episodes, beside the parts of the planner score.

    CCDIFF_NUPLAN=<checkout of nuplan-devkit> PYTHONPATH=. python tests/nuplan_metrics.py \\
        nuscenes:<dataroot>@v1.0-mini/mini_val pdm,lane_idm replay,idm out.json

Needs shapely, scipy and pandas beside the devkit. Road blocks, which scenes have not, are lanes
side by side in one direction; intersections are the surfaces of connectors.
"""

from __future__ import annotations

import json
import os
import sys
from importlib import import_module
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon

import ccdiff_env
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.scenes import SceneSet

PARTS = {
    "no_at_fault_collision": "no_ego_at_fault_collisions",
    "on_road": "drivable_area_compliance",
    "makes_progress": "ego_is_making_progress",
    "right_way": "driving_direction_compliance",
    "ttc": "time_to_collision_within_bound",
    "progress": "ego_progress_along_expert_route",
    "comfort": "ego_is_comfortable",
}
METRICS = "planning.metrics.evaluation_metrics.common"
STATES = "common.actor_state"
#: Places of kinds of agents in nuPlan's list.
KINDS = {"vehicle": 0, "pedestrian": 1, "cyclist": 2, "motorcycle": 2, "static": 6}
#: The rear axle behind the middle of the box, as a share of the length.
REAR_AXLE_SHARE = 0.34
#: What two figures of a part may differ by.
SAME = 0.01


def nuplan(module, *names):
    """Return things of a module; packages for data bases, which metrics do not need, are mocked."""
    if os.environ["CCDIFF_NUPLAN"] not in sys.path:
        sys.path.append(os.environ["CCDIFF_NUPLAN"])
    while True:
        try:
            found = import_module(f"nuplan.{module}")
            return [getattr(found, name) for name in names]
        except ModuleNotFoundError as error:
            if str(error.name).startswith("nuplan"):
                raise
            sys.modules[str(error.name)] = MagicMock()


def surface(area):
    made = shapely.make_valid(Polygon(area["exterior"], [h for h in area["holes"] if len(h) > 2]))
    return shapely.union_all([p for p in getattr(made, "geoms", [made]) if p.area > 0])


def edge(kind, lane, edges):
    """Return a lane or connector; nuPlan's class has methods that no metric asks for."""
    line = LineString(lane["centreline"])
    has_surface = len(lane["polygon"]["exterior"]) > 2
    made = type("Edge", (kind,), {
        "__abstractmethods__": frozenset(),
        "polygon": surface(lane["polygon"]) if has_surface else line.buffer(1.75),
        "baseline_path": SimpleNamespace(linestring=line),
        "incoming_edges": property(lambda _: [edges[i] for i in lane["predecessors"]]),
        "outgoing_edges": property(lambda _: [edges[i] for i in lane["successors"]]),
        "get_roadblock_id": lambda self: self.block,
    })  # fmt: skip
    made.__abstractmethods__ = frozenset()
    return made(lane["id"])


class SceneMap:
    """A scene's map, as far as metrics ask for it."""

    def __init__(self, scene):
        kinds = dict(zip(("lane", "connector"), nuplan(
            "common.maps.abstract_map_objects", "Lane", "LaneConnector"), strict=True))  # fmt: skip
        (layer,) = nuplan("common.maps.maps_datatypes", "SemanticMapLayer")
        layers, edges = scene.map_layers(), []
        edges += [edge(kinds[lane["kind"]], lane, edges) for lane in layers["lanes"]]
        lanes, links = ([e for e in edges if isinstance(e, k)] for k in kinds.values())
        self.blocks = {}
        self._join(lanes)
        for link in links:
            ends = [[e.block for e in side if e in lanes][:1]
                    for side in (link.incoming_edges, link.outgoing_edges)]  # fmt: skip
            link.block = " to ".join(ends[0] + ends[1]) if all(ends) else link.id
            self.blocks.setdefault(link.block, []).append(link)
        self.road = shapely.union_all([surface(area) for area in layers["drivable_area"]])
        self.layers = {layer.LANE: lanes, layer.LANE_CONNECTOR: links, layer.INTERSECTION: links,
                       layer.DRIVABLE_AREA: [SimpleNamespace(polygon=self.road)]}  # fmt: skip
        self.trees = {k: shapely.STRtree([o.polygon for o in v]) for k, v in self.layers.items()}

    def _join(self, lanes):
        """Put lanes side by side into one block."""
        tree = shapely.STRtree([lane.polygon for lane in lanes])
        for lane in lanes:
            lane.block = lane.id
            self.blocks[lane.id] = [lane]
        for lane in lanes:
            for k in tree.query(lane.polygon.buffer(0.5), predicate="intersects"):
                other = lanes[k]
                if lane.block != other.block and (beside(lane, other) or beside(other, lane)):
                    for moved in self.blocks.pop(other.block):
                        moved.block = lane.block
                        self.blocks[lane.block].append(moved)

    def get_all_map_objects(self, point, layer):
        found = self.trees[layer].query(Point(point.x, point.y), predicate="intersects")
        return [self.layers[layer][i] for i in sorted(found)]

    def get_one_map_object(self, point, layer):
        at, found = Point(point.x, point.y), self.get_all_map_objects(point, layer)
        return min(found, key=lambda e: e.baseline_path.linestring.distance(at), default=None)

    def is_in_layer(self, point, layer):
        return bool(self.get_all_map_objects(point, layer))

    def get_map_object(self, name, layer):
        return SimpleNamespace(
            contains_point=lambda point: any(e.contains_point(point) for e in self.blocks[name])
        )

    def get_distance_to_nearest_map_object(self, point, layer):
        return "road", self.road.distance(Point(point.x, point.y))


def beside(lane, other):
    """Whether the middle of a lane lies beside another one of the same direction."""
    own, line = lane.baseline_path.linestring, other.baseline_path.linestring

    def way(of, along):
        ends = (np.array(of.interpolate(along + d).coords[0]) for d in (-0.5, 0.5))
        step = np.subtract(*reversed(list(ends)))
        return step / max(np.hypot(*step), 1e-9)

    middle = own.interpolate(0.5 * own.length)
    along = line.project(middle)
    unit = way(line, along)
    d = np.subtract(middle.coords[0], line.interpolate(along).coords[0])
    across, beyond = abs(unit[0] * d[1] - unit[1] * d[0]), abs(unit @ d)
    return bool(beyond < 3.0 and 1.5 < across < 6.5 and unit @ way(own, 0.5 * own.length) > 0.9)


def ego_states(position, heading, velocity, accelerations, size, times_us):
    """Return nuPlan's states of an ego from those of the middle of its box."""
    (footprint,) = nuplan(f"{STATES}.car_footprint", "CarFootprint")
    (motion,) = nuplan(f"{STATES}.dynamic_car_state", "DynamicCarState")
    (state,) = nuplan(f"{STATES}.ego_state", "EgoState")
    (parameters,) = nuplan(f"{STATES}.vehicle_parameters", "VehicleParameters")
    se2, pair, time = nuplan(
        f"{STATES}.state_representation", "StateSE2", "StateVector2D", "TimePoint"
    )
    length, width = float(size[0]), float(size[1])
    back = REAR_AXLE_SHARE * length
    sides = (width, length / 2 + back, length / 2 - back, 0.4 * length, 0.6 * length)
    car, out = parameters(*sides, "ego", "ego", 1.5), []
    for p, h, v, a, t in zip(position, heading, velocity, accelerations, times_us, strict=True):
        cos, sin = np.cos(h), np.sin(h)
        axle = se2(p[0] - back * cos, p[1] - back * sin, float(h))
        moves = motion(back, pair(v[0] * cos + v[1] * sin, v[1] * cos - v[0] * sin), pair(*a))
        box = footprint.build_from_rear_axle(axle, car)
        out.append(state(box, moves, 0.0, True, time(int(t))))
    return out


def observed(rollout, k, ego):
    """Return nuPlan's tracks of the agents at a step, without the ego."""
    (agent,) = nuplan(f"{STATES}.agent", "Agent")
    (obstacle,) = nuplan(f"{STATES}.static_object", "StaticObject")
    (box,) = nuplan(f"{STATES}.oriented_box", "OrientedBox")
    (meta,) = nuplan(f"{STATES}.scene_object", "SceneObjectMetadata")
    se2, pair = nuplan(f"{STATES}.state_representation", "StateSE2", "StateVector2D")
    (kinds,) = nuplan(f"{STATES}.tracked_objects_types", "TrackedObjectType")
    (tracks,) = nuplan(f"{STATES}.tracked_objects", "TrackedObjects")
    found = []
    for i in np.flatnonzero(rollout.valid[:, k]):
        if i != ego:
            name = rollout.scene.agent_types[i]
            pose = se2(*(float(v) for v in (*rollout.position[i, k], rollout.heading[i, k])))
            body = box(pose, *(float(v) for v in rollout.scene.sizes[i]))
            of = list(kinds)[KINDS[name]], body
            about = meta(k, str(i), int(i), str(i))
            velocity = pair(*(float(v) for v in rollout.velocity[i, k]))
            made = obstacle(*of, about) if name == "static" else agent(*of, velocity, about)
            found.append(made)
    return SimpleNamespace(tracked_objects=tracks(found))


def compare(rollout, row, smap=None):
    """Return by part ours, nuPlan's, and what nuPlan's metric says of it."""
    scene, ego = rollout.scene, rollout.agent_ids.index("ego")
    times = np.arange(rollout.num_steps) * round(rollout.dt_s * 1e6)
    ways = [rollout.info[name] for name in ("acceleration", "lateral_acceleration")]
    accelerations = np.stack([np.concatenate([a[:1], a]) for a in ways], axis=1).astype(float)
    own = (x[ego].astype(float) for x in (rollout.position, rollout.heading, rollout.velocity))
    egos = ego_states(*own, accelerations, scene.sizes[ego], times)
    data = [SimpleNamespace(ego_state=state, observation=observed(rollout, k, ego))
            for k, state in enumerate(egos)]  # fmt: skip
    log, steps = scene.tracks(), slice(rollout.start_step, rollout.start_step + rollout.num_steps)
    there = log["valid"][ego, steps]
    part = [log[n][ego, steps][there].astype(float) for n in ("position", "heading", "velocity")]
    nothing = np.zeros((int(there.sum()), 2))
    expert = ego_states(*part, nothing, scene.sizes[ego], times[: len(nothing)])
    scenario = MagicMock(get_expert_ego_trajectory=lambda: expert)
    history = SimpleNamespace(map_api=smap or SceneMap(scene), data=data, extract_ego_state=egos)
    return {n: [row[n], *theirs] for n, theirs in metrics(history, scenario).items()}


def metrics(history, scenario):
    """Return the scores of nuPlan's metrics, with the bounds of its challenges."""

    def made(module, name, *args):
        return nuplan(f"{METRICS}.{module}", f"{name}Statistics")[0](module, "D", *args)

    lane = made("ego_lane_change", "EgoLaneChange", 0.3)
    bounds = [
        made("ego_jerk", "EgoJerk", 8.37),
        made("ego_lat_acceleration", "EgoLatAcceleration", 4.89),
        made("ego_lon_acceleration", "EgoLonAcceleration", -4.05, 2.40),
        made("ego_lon_jerk", "EgoLonJerk", 4.13),
        made("ego_yaw_acceleration", "EgoYawAcceleration", 1.93),
        made("ego_yaw_rate", "EgoYawRate", 0.95),
    ]
    way = made("ego_progress_along_expert_route", "EgoProgressAlongExpertRoute", 2)
    fault = made("no_ego_at_fault_collisions", "EgoAtFaultCollision", lane, 0, 0, 1)
    against = made("driving_direction_compliance", "DrivingDirectionCompliance", lane, 2, 6, 1)
    bound = ("time_to_collision_within_bound", "TimeToCollision", lane, fault, 0.1, 3.0, 0.95)
    rest = [
        made("drivable_area_compliance", "DrivableAreaCompliance", lane, 0.3),
        made(*bound),
        made("ego_is_comfortable", "EgoIsComfortable", *bounds),
        made("ego_is_making_progress", "EgoIsMakingProgress", way, 0.2),
    ]
    found = {m.name: m.compute(history, scenario)[0]
             for m in (lane, *bounds, way, fault, *rest, against)}  # fmt: skip
    (proper,) = nuplan("common.maps.abstract_map_objects", "Lane")
    lane.ego_driven_route = [[e for e in at if isinstance(e, proper)]
                             for at in lane.ego_driven_route]  # fmt: skip
    without = float(against.compute(history, scenario)[0].metric_score)
    found = {
        ours: [float(found[name].metric_score), {s.name: s.value for s in found[name].statistics}]
        for ours, name in PARTS.items()
    }
    found["right_way"][1]["without connectors"] = without
    return found


def main(source, planners, traffic, out):
    """Drive, compare, and say how many episodes have equal parts, and which have not."""
    found, maps = [], {}
    scenes = SceneSet([s for s in ccdiff_env.load(source) if s.has_lanes])
    for planner in planners.split(","):
        for name in traffic.split(","):
            rows, rollouts = drive(scenes, planner, TRAFFIC[name], seed=0, record=scenes.names)
            for row in rows:
                rollout = rollouts[row["scene"]]
                maps[row["scene"]] = maps.get(row["scene"]) or SceneMap(rollout.scene)
                parts = compare(rollout, row, maps[row["scene"]])
                found.append({"of": [planner, name, row["scene"]], **parts})
            print(planner, name, len(rows), flush=True)
            with open(out, "w") as file:
                json.dump(found, file, default=float)
    for part in PARTS:
        apart = [f for f in found if abs(f[part][0] - f[part][1]) > SAME]
        print(f"{part:24} {len(found) - len(apart)} of {len(found)} equal")
        for f in apart:
            print("   ", *f["of"], *f[part])


if __name__ == "__main__":
    main(*sys.argv[1:5])
