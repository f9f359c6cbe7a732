"""Import of ScenarioNet scenario descriptions: nuScenes, Waymo, nuPlan and Argoverse exports.

A scenario description is a pickled dictionary of plain containers and numpy arrays; what reads it
without running code is in :mod:`ccdiff_env.scenes.scenario_pickle`.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env._native import EGO_AXLE_TO_CENTRE_M, Scene, complete_map
from ccdiff_env.errors import DatasetError, DatasetNotFoundError
from ccdiff_env.scenes.load_report import CacheReport, LoadReport, SceneReport
from ccdiff_env.scenes.scenario_fields import F64, Heights, ScenarioFields, ground
from ccdiff_env.scenes.scenario_lights import read_lights
from ccdiff_env.scenes.scenario_pickle import load_scenario_dict
from ccdiff_env.scenes.scene_types import OWN_LAYERS, Lane, MapLayers, Polygon
from ccdiff_env.system.files import reading

#: Type and kind. The category tells motorcycles and bicycles apart where the data has one.
_KINDS = {
    "VEHICLE": "vehicle",
    "PEDESTRIAN": "pedestrian",
    "CYCLIST": "cyclist",
    "MOTORCYCLIST": "motorcycle",
    "TRAFFIC_CONE": "static",
    "TRAFFIC_BARRIER": "static",
}
_KINDS_OF_CATEGORIES = {"vehicle.motorcycle": "motorcycle", "vehicle.bicycle": "cyclist"}

_EGO_ID = "ego"
_INDEX_FILES = ("dataset_summary.pkl", "dataset_mapping.pkl")
_ROAD_EDGES = ("ROAD_EDGE_BOUNDARY", "ROAD_EDGE_MEDIAN", "ROAD_EDGE_UNKNOWN", "ROAD_EDGE")
_CENTRELINE_SPACING_M = 1.0

_FARTHEST_M = 1e6  #: Map points lie as near to the origin as tracks must, see ``Scene``.


@dataclass
class _Track:
    """One agent in the global frame."""

    id: str
    kind: str
    category: str
    size: tuple[float, float, float]
    position: F64
    heading: F64
    velocity: F64
    valid: npt.NDArray[np.bool_]
    #: Ground below the box [T], metres; nothing where the file does not tell heights.
    elevation: F64 | None


def _states(
    source: ScenarioFields, key: str, track: Mapping[str, Any], num_steps: int
) -> _Track | None:
    """One track, or ``None`` (counted) where there is nothing to show."""
    where = f"tracks[{key!r}]"
    state = source.mapping(track.get("state"), f"{where}.state")
    own = track.get("metadata")
    metadata = source.mapping({} if own is None else own, f"{where}.metadata")
    type_name = source.text(track.get("type"), f"{where}.type") or "None"
    category = source.text(metadata.get("type"), f"{where}.metadata.type") or type_name
    kind = _KINDS_OF_CATEGORIES.get(category) or _KINDS.get(type_name)
    if metadata.get("kind") in _KINDS.values():  # of a file that this package wrote
        kind = str(metadata["kind"])
    if kind is None:
        source.dropped[f"{category}: unknown type"] += 1
        return None

    def values(name: str, columns: int | None = None) -> F64:
        if name not in state:
            raise source.fault(f"{where}.state", sorted(map(str, state)), f"an entry {name!r}")
        array = source.array(state[name], f"{where}.state.{name}", columns=columns)
        if len(array) != num_steps:
            raise source.fault(f"length of {where}.state.{name}", len(array), f"{num_steps}")
        return array

    valid = np.abs(values("valid")) > 0.0  # not where it is NaN
    if valid.sum() < 2:
        source.dropped[f"{category}: fewer than 2 steps"] += 1
        return None
    sizes = []
    for name in ("length", "width", "height"):
        shown = values(name)[valid] if name in state else np.zeros(1)
        known = shown[np.isfinite(shown) & (shown > 0)]
        sizes.append(float(np.median(known)) if len(known) else 0.0)
    if min(sizes[:2]) <= 0:
        raise source.fault(f"size of {where}", sizes, "a positive length and width")
    heading = values("heading").copy()
    heading[valid] = np.unwrap(heading[valid])
    centre, velocity = values("position", 2), values("velocity", 2)[:, :2]
    position, elevation = centre[:, :2], ground(centre, sizes[2], valid)
    if elevation is None and centre.shape[1] > 2:
        source.notes.append(f"no heights in {where}: the scene is taken as flat")
    for name, array in (("position", position), ("heading", heading), ("velocity", velocity)):
        bad = valid & ~np.isfinite(array.reshape(num_steps, -1)).all(axis=1)
        if bad.any():
            step = f"{where}.state.{name} at step {int(bad.argmax())}"
            raise source.fault(step, array[bad][0], "finite numbers where valid")
    size = (sizes[0], sizes[1], sizes[2])
    return _Track(key, kind, category, size, position, heading, velocity, valid, elevation)


def _nuscenes_ego(source: ScenarioFields, ego: _Track, dt: float, reference: str) -> None:
    """Bring an ego of nuScenes from its rear axle to its centre; mend its swapped sides."""
    length, width, height = ego.size
    if width > length:  # of the converter, scenarionet#68
        ego.size = (width, length, height)
        source.notes.append(f"ego {length:.2f} m long and {width:.2f} m wide: sides swapped")
    if reference == "rear_axle":
        shown, heading = ego.valid, ego.heading[ego.valid]
        ahead = EGO_AXLE_TO_CENTRE_M * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        ego.position, ego.velocity = ego.position.copy(), ego.velocity.copy()
        ego.position[shown] += ahead
        ego.velocity[shown] += np.gradient(ahead, dt * np.flatnonzero(shown), axis=0)


def _time_step(source: ScenarioFields, metadata: Mapping[str, Any], num_steps: int) -> float:
    """Seconds between steps, from the time stamps or the sample rate."""
    name = "ts" if "ts" in metadata else "timestep"
    stamps = metadata.get(name)
    times = np.zeros(0) if stamps is None else source.array(stamps, f"metadata.{name}")
    if stamps is not None and len(times) < num_steps:
        raise source.fault(f"length of metadata.{name}", len(times), f"{num_steps}")
    if len(times) > 1:
        steps = np.diff(times)
        dt = float(np.median(steps))
        if not (np.isfinite(steps).all() and dt > 0):
            raise source.fault(f"metadata.{name}", steps[:3], "times in seconds that increase")
        off = int((np.abs(steps - dt) > 0.2 * dt).sum())
        if off:
            source.notes.append(f"{off} time steps differ from {dt:.3f} s by more than a fifth")
        # 0.1 is 0.1 in spite of jitter, but 30 Hz are not 0.033 s
        return rounded if abs((rounded := round(dt, 3)) - dt) < 2e-3 * dt else dt
    rate = metadata.get("sample_rate", 0.1)
    if not (isinstance(rate, (int, float)) and 0 < rate <= 1):
        raise source.fault("metadata.sample_rate", rate, "seconds between steps, at most 1")
    return float(rate)


def _resampled(source: ScenarioFields, name: str, points: F64) -> F64:
    """A line [P, 3] with points about a metre apart; empty where it has no length."""
    if len(points) < 2:
        return points[:0]
    steps = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1)
    points = points[np.concatenate([[True], steps > 1e-6])]
    if len(points) < 2:
        return points[:0]
    steps = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    count = max(int(np.ceil(along[-1] / _CENTRELINE_SPACING_M)), 1) + 1
    source.spend(2 * count, f"{name} of {along[-1]:.0f} m")
    at = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(at, along, points[:, i]) for i in range(3)], axis=1)


def _own_layers(source: ScenarioFields, origin: F64) -> MapLayers | None:
    """Layers that only files written by this package have; ``None`` in others."""
    own = source.part("metadata").get("ccdiff_env")
    if own is None:
        return None
    where = "metadata.ccdiff_env"
    own = source.mapping(own, where)
    shift = source.array(own.get("origin", (0.0, 0.0)), f"{where}.origin") - origin

    def ring(value: object, name: str) -> npt.NDArray[np.float32]:
        points = source.array(value, name, columns=2)[:, :2] + shift
        return points.astype(np.float32)

    def polygons(layer: str) -> list[Polygon]:
        name = f"{where}.{layer}"
        found: list[Polygon] = []
        for polygon in source.items(own.get(layer), name):
            if not isinstance(polygon, dict) or "exterior" not in polygon:
                raise source.fault(name, type(polygon).__name__, "polygons with an exterior")
            holes = [ring(hole, name) for hole in source.items(polygon.get("holes"), name)]
            found.append({"exterior": ring(polygon["exterior"], name), "holes": holes})
        return found

    layers: MapLayers = {name: polygons(name) for name in OWN_LAYERS}  # type: ignore[assignment]
    if own.get("elevation_m") is not None:
        name = f"{where}.elevation_m"
        heights = source.mapping(own["elevation_m"], name).items()
        layers["elevation_m"] = {
            source.text(layer, name): source.array(pairs, name, columns=2)[:, :2].astype(np.float32)
            for layer, pairs in heights
        }
    return layers


def _origin(source: ScenarioFields, tracks: Sequence[_Track]) -> F64:
    """Origin of the scene frame: the file's own, else where the ego or the middle of all is."""
    own = source.part("metadata").get("ccdiff_env")
    if isinstance(own, dict) and "origin" in own:
        origin = source.array(own["origin"], "metadata.ccdiff_env.origin")
        if origin.shape != (2,) or not np.isfinite(origin).all():
            raise source.fault("metadata.ccdiff_env.origin", origin, "two finite numbers")
        return origin
    if tracks[0].id == _EGO_ID:
        return np.asarray(np.round(tracks[0].position[tracks[0].valid][0]))
    every = np.concatenate([track.position[track.valid] for track in tracks])
    return np.asarray(np.round(every.mean(axis=0)))


def _polygon(ring: F64, holes: Iterable[F64] = ()) -> Polygon:
    outer, *inner = [np.ascontiguousarray(r[:, :2], np.float32) for r in (ring, *holes)]
    return {"exterior": outer, "holes": inner}


#: Types of surfaces and their layers; the last three are of py123d alone.
_AREAS = {
    "CROSSWALK": "ped_crossings", "ROAD_EDGE_SIDEWALK": "walkways", "DRIVEWAY": "surfaces",
    "STOP_LINE": "stop_lines", "CARPARK": "carpark_areas", "DRIVABLE_AREA": "drivable_area",
}  # fmt: skip


class _Features:
    """Sorts map features into our layers.

    ``seeds`` [N, 3] are places where vehicles were, ``places`` [N, 3] those of all agents, nothing
    where the file does not tell their heights.
    """

    def __init__(
        self,
        source: ScenarioFields,
        origin: F64,
        seeds: npt.NDArray[np.float32],
        places: npt.NDArray[np.float32] | None,
    ) -> None:
        self._source = source
        self._origin = origin
        self._unused: Counter[str] = Counter()
        self._own = _own_layers(source, origin)
        #: Lines with the road on their left, and surfaces without lanes that vehicles use.
        self._edges: list[npt.NDArray[np.float32]] = []
        self._surfaces: list[Polygon] = []
        self._heights = Heights(source.part("metadata").get("dataset"))
        self._speed_limits = source.part("metadata").get("dataset") != "nuscenes"
        given = set(MapLayers.__annotations__) - {"elevation_m", "lights"}
        self.layers: MapLayers = {name: [] for name in sorted(given)}  # type: ignore[assignment]
        features = source.part("map_features")
        lanes: dict[str, tuple[Lane, Mapping[str, Any]]] = {}
        for key, feature in features.items():
            name = source.text(key, "a key of map_features")
            self._sort(name, source.mapping(feature, f"map_features[{name!r}]"), lanes)
        self._link(lanes)
        self.road = "given"
        if self._own is None:
            self.layers, self.road, bounds = complete_map(
                self.layers,
                edges=self._edges,
                surfaces=self._surfaces,
                seeds=np.ascontiguousarray(seeds[:, :2]),
                tracks=places,
                heights=None if places is None else self._heights.of_layers(seeds[:, 2]),
            )
            self.has_levels = bool(bounds)
        else:  # its edges are the rings of the drivable area
            self.layers.update(self._own)
            self.has_levels = "elevation_m" in self._own
            for lane in () if self.has_levels else self.layers["lanes"]:
                del lane["elevation_m"]
            self.road = "given" if self._own["drivable_area"] else "none"
        if self.has_levels:
            source.notes.append(
                "levels of roads: agents more than 2.5 m higher or lower are out of reach; "
                "networks see the roads of all levels"
            )
        for name, count in sorted(self._unused.items()):
            source.notes.append(f"{count} map features of type {name} have no layer here")

    def _points(self, key: str, feature: Mapping[str, Any], name: str) -> F64:
        value, where = feature.get(name), f"map_features[{key!r}].{name}"
        if value is None or (isinstance(value, (list, tuple)) and not value):
            return np.zeros((0, 3))
        found = self._source.array(value, where, columns=2)
        points = found[:, :2] - self._origin
        if not (np.abs(points) <= _FARTHEST_M).all():
            raise self._source.fault(
                where, "not finite or far away", f"points within {_FARTHEST_M:.0f} m of the origin"
            )
        if name == "polygon" and feature.get("polyline") is not None:  # of a lane: its line tells
            return points
        return np.column_stack([points, self._heights.read(found)])

    def _ring(self, key: str, feature: Mapping[str, Any]) -> F64:
        ring = self._points(key, feature, "polygon")
        if len(ring) > 1 and np.allclose(ring[0, :2], ring[-1, :2]):
            ring = ring[:-1]
        return ring

    def _sort(
        self, key: str, feature: Mapping[str, Any], lanes: dict[str, tuple[Lane, Mapping[str, Any]]]
    ) -> None:
        kind = self._source.text(feature.get("type"), f"map_features[{key!r}].type") or "None"
        layers = self.layers
        if kind.startswith("LANE_") and "BIKE" not in kind:
            points = self._points(key, feature, "polyline")
            line = _resampled(self._source, f"map_features[{key!r}].polyline", points)
            if len(line) < 2:
                self._unused[f"{kind} without length"] += 1
                return
            limit = feature.get("speed_limit_kmh") if self._speed_limits else None
            # Waymo has 0 where no limit is known, MetaDrive 1000
            if not (isinstance(limit, (int, float, np.floating)) and 0 < limit < 1e3):
                limit = None
            lane: Lane = {
                "id": key,
                "kind": "connector" if kind == "LANE_SURFACE_UNSTRUCTURE" else "lane",
                "centreline": np.ascontiguousarray(line[:, :2], np.float32),
                "elevation_m": line[:, 2].astype(np.float32),
                "polygon": _polygon(self._ring(key, feature)),
                "successors": [],
                "predecessors": [],
                "speed_limit_mps": None if limit is None else float(limit) / 3.6,
            }
            lanes[key] = (lane, feature)
        elif kind.startswith("ROAD_LINE_"):
            # yellow lines part the directions of traffic
            points = self._points(key, feature, "polyline")
            name = "road_dividers" if "YELLOW" in kind else "lane_dividers"
            self._add_line(name, layers[name], points)  # type: ignore[literal-required]
        elif kind in _ROAD_EDGES:
            self._add_line("edges", self._edges, self._points(key, feature, "polyline"))
        elif kind in _AREAS:
            ring, name = self._ring(key, feature), _AREAS[kind]
            layer = self._surfaces if name == "surfaces" else layers[name]  # type: ignore[literal-required]
            if len(ring) >= 3:
                where = f"map_features[{key!r}].holes"
                holes = self._source.items(feature.get("holes"), where)
                arrays = (self._source.array(hole, where, columns=2)[:, :2] for hole in holes)
                layer.append(_polygon(ring, (hole - self._origin for hole in arrays)))
                self._heights.add(name, ring[:, 2])
            else:
                self._unused[f"{kind} without an area"] += 1
        else:
            self._unused[kind] += 1

    def _add_line(self, name: str, layer: list[npt.NDArray[np.float32]], points: F64) -> None:
        if len(points) >= 2:
            layer.append(np.ascontiguousarray(points[:, :2], np.float32))
            self._heights.add(name, points[:, 2])

    def _link(self, lanes: Mapping[str, tuple[Lane, Mapping[str, Any]]]) -> None:
        """Link lanes with their successors; lanes that are not in the file are left out."""
        index = {key: i for i, key in enumerate(lanes)}
        edges: set[tuple[int, int]] = set()
        for here, (key, (_, feature)) in enumerate(lanes.items()):
            for name in ("exit_lanes", "entry_lanes"):
                where = f"map_features[{key!r}].{name}"
                for other in self._source.items(feature.get(name), where):
                    there = index.get(self._source.text(other, where))
                    if there is not None:
                        edges.add((here, there) if name == "exit_lanes" else (there, here))
        listed = [lane for lane, _ in lanes.values()]
        for start, end in sorted(edges):
            listed[start]["successors"].append(end)
            listed[end]["predecessors"].append(start)
        self.layers["lanes"] = listed


def _tracks(source: ScenarioFields, num_steps: int, ego: str | None) -> list[_Track]:
    tracks = source.part("tracks")
    named = {source.text(key, "a key of tracks"): track for key, track in tracks.items()}
    if ego is not None and ego not in named:
        raise source.fault("metadata.sdc_id", repr(ego), "the id of a track")
    found = []
    for key, track in named.items():
        states = _states(source, key, source.mapping(track, f"tracks[{key!r}]"), num_steps)
        if states is not None:
            found.append(states)
    found.sort(key=lambda track: track.id != ego)
    if found and found[0].id == ego:
        found[0].id = _EGO_ID
    return found


def read_description(
    source: ScenarioFields, taken: Collection[str] = (), *, ego_reference: str
) -> tuple[Scene | None, SceneReport]:
    """Return the scene of a description, under a name that is not taken, and its report."""
    path, metadata = source.path, source.part("metadata")
    num_steps = source.data.get("length")
    if not (isinstance(num_steps, (int, np.integer)) and 0 < num_steps < 2**31):
        raise source.fault("length", num_steps, "a positive number of steps")
    num_steps = int(num_steps)
    name = source.name(("metadata.scenario_id", "id"), path.stem)
    if name in taken:
        source.notes.append(f"another scenario is called {name}: the file's name is added")
        name = f"{name} ({path.stem})"
    sdc_id = metadata.get("sdc_id")
    ego = None if sdc_id is None else source.text(sdc_id, "metadata.sdc_id")
    tracks = _tracks(source, num_steps, ego)
    dt = _time_step(source, metadata, num_steps)
    if tracks and tracks[0].id == _EGO_ID and metadata.get("dataset") == "nuscenes":
        _nuscenes_ego(source, tracks[0], dt, ego_reference)
    scene: Scene | None = None
    filled, absences = 0, 0
    road = "none"
    if tracks:
        given, road = _assemble(source, name, dt, tracks)
        scene, (filled, absences), notes = given._mended()
        source.notes.extend(notes)
        if [track.id for track in tracks] == [_EGO_ID]:
            source.notes.append("nobody but the ego: no annotations")
    counts = Counter(track.category for track in tracks)
    report = SceneReport(
        name=name,
        key_frames=num_steps,
        tracks=dict(sorted(counts.items())),
        annotations=int(sum(track.valid.sum() for track in tracks)),
        dropped=dict(sorted(source.dropped.items())),
        filled_gaps=filled,
        absences=absences,
        ego_channel=None if sdc_id is None else "sdc",
        road=road,
        notes=tuple(source.notes),
    )
    return scene, report


def _assemble(
    source: ScenarioFields, name: str, dt: float, tracks: Sequence[_Track]
) -> tuple[Scene, str]:
    valid = np.stack([track.valid for track in tracks])
    origin = _origin(source, tracks)
    position = np.stack([track.position for track in tracks]) - origin
    told = all(track.elevation is not None for track in tracks)
    # elevations [A, T] of the ground below all agents, 0 where it is not told
    heights = np.stack(
        [np.zeros(valid.shape[1]) if t.elevation is None else t.elevation for t in tracks]
    )
    vehicles = [i for i, track in enumerate(tracks) if track.kind == "vehicle"] or [0]
    seeds, places = (
        np.column_stack([position[i][valid[i]], heights[i][valid[i]]]).astype(np.float32)
        for i in (vehicles, slice(None))
    )
    features = _Features(source, origin, seeds, places if told else None)
    if lights := read_lights(source, features.layers["lanes"], origin):
        features.layers["lights"] = lights
    scene = Scene.from_arrays(
        name,
        agent_ids=[track.id for track in tracks],
        agent_types=[track.kind for track in tracks],
        agent_categories=[track.category for track in tracks],
        sizes=np.array([track.size for track in tracks], dtype=np.float32),
        position=np.where(valid[..., None], position, 0.0).astype(np.float32),
        heading=np.stack([track.heading for track in tracks]).astype(np.float32),
        velocity=np.stack([track.velocity for track in tracks]).astype(np.float32),
        valid=valid,
        dt=dt,
        token=source.name(("metadata.scenario_token", "id"), name),
        location=source.name(("metadata.map",), ""),
        source=f"{source.form} {source.name(('metadata.dataset',), 'unknown')}",
        origin=(float(origin[0]), float(origin[1])),
        map_layers=features.layers,
        elevation_m=heights.astype(np.float32) if told and features.has_levels else None,
        mend=False,
    )
    return scene, features.road


def _files(path: Path) -> Iterator[Path]:
    if path.is_file():
        yield path
    elif path.is_dir():
        yield from sorted(p for p in path.rglob("*.pkl") if p.name not in _INDEX_FILES)
    else:
        raise DatasetNotFoundError(f"no scenario file or folder at {path}")


def read_scenarios(
    path: str | os.PathLike[str], ego_reference: str
) -> tuple[list[Scene], LoadReport]:
    """Import a scenario file, or all of a folder; see :func:`ccdiff_env.load_scenarionet`."""
    started = time.perf_counter()
    scenes: list[Scene] = []
    reports: list[SceneReport] = []
    empty: list[str] = []
    taken: set[str] = set()
    for file in _files(Path(path)):
        with reading("scenario", file):
            source = ScenarioFields(file, load_scenario_dict(file))
            scene, report = read_description(source, taken, ego_reference=ego_reference)
        if scene is None:
            empty.append(report.name)
            continue
        taken.add(scene.name)
        scenes.append(scene)
        reports.append(report)
    if not scenes:
        raise DatasetError(f"no scenario with agents in {path}; without agents: {empty}")
    return scenes, LoadReport(
        dataroot=os.fspath(path),
        version="scenarionet",
        scenes=tuple(reports),
        empty=tuple(empty),
        cache=CacheReport(built=len(scenes)),
        seconds=time.perf_counter() - started,
    )
