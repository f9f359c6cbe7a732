"""Shapes of the dictionaries that scenes give and take."""

from __future__ import annotations

from typing import Literal, TypedDict

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]


#: Types of agents, by their numbers in batches and images.
AGENT_KINDS = ("vehicle", "pedestrian", "cyclist", "motorcycle", "static")

#: Layers that ScenarioNet has no feature for.
OWN_LAYERS = ("drivable_area", "walkways", "stop_lines", "carpark_areas")


class Polygon(TypedDict):
    """A polygon with holes; rings are not closed."""

    exterior: F32  #: Outer ring [P, 2], metres.
    holes: list[F32]  #: Inner rings [P, 2] each.


class _Heights(TypedDict, total=False):
    #: Elevation of each point of the centre line [P], metres; only where it is known.
    elevation_m: F32


class Lane(_Heights):
    """A lane or lane connector."""

    id: str  #: Token of the data set.
    kind: Literal["lane", "connector"]  #: A marked lane, or a path through an intersection.
    centreline: F32  #: Points [P, 2] in driving direction, about a metre apart.
    polygon: Polygon  #: Surface; empty exterior where the data has none.
    successors: list[int]  #: Indices of the lanes that follow.
    predecessors: list[int]  #: Indices of the lanes that lead here.
    speed_limit_mps: float | None  #: Posted limit where the data has one.


#: States of lights by their numbers.
LIGHT_STATES = ("unknown", "green", "yellow", "red")


class Light(TypedDict, total=False):
    """A traffic light."""

    #: Ends of the stop line [2, 2], or a point [1, 2] where it runs across the lane, metres; where
    #: the lane begins if left out.
    stop_line: F32
    lane: int  #: Index of the lane or connector behind the stop line.
    states: U8  #: Number in :data:`LIGHT_STATES` at every logged step [T].


class MapLayers(TypedDict, total=False):
    """The map round a scene, in the scene frame."""

    drivable_area: list[Polygon]
    ped_crossings: list[Polygon]
    walkways: list[Polygon]
    stop_lines: list[Polygon]
    carpark_areas: list[Polygon]
    road_dividers: list[F32]  #: Lines [P, 2] between directions of traffic.
    lane_dividers: list[F32]  #: Lines [P, 2] between lanes of one direction.
    lanes: list[Lane]
    lights: list[Light]  #: Only where the scene has lights.
    #: Least and greatest elevation [N, 2] of the N parts of other layers, metres, by layer; only
    #: where roads pass over each other.
    elevation_m: dict[str, F32]


class _TrackHeights(TypedDict, total=False):
    #: Elevation of the ground below the box [A, T], metres; only in scenes with levels.
    elevation_m: F32


class TrackArrays(_TrackHeights):
    """Logged states of A agents over T steps, in the scene frame."""

    position: F32  #: Centre of the box [A, T, 2], metres.
    heading: F32  #: Radians [A, T], unwrapped along each track.
    velocity: F32  #: Metres per second [A, T, 2].
    valid: Bool  #: Whether the agent is present [A, T].


class _StateHeights(TypedDict, total=False):
    elevation_m: F32  #: Elevation of the ground below [A], metres; only in scenes with levels.


class StateArrays(_StateHeights):
    """Present states of A agents of a running world, in the scene frame; zero where not active."""

    position: F32  #: Centre of the box [A, 2], metres.
    heading: F32  #: Heading [A], radians.
    velocity: F32  #: Velocity [A, 2], m/s.
    speed: F32  #: Speed along the heading [A], m/s.
    acceleration: F32  #: Acceleration along the heading [A], m/s².
    yaw_rate: F32  #: Yaw rate [A], rad/s.
    active: Bool  #: Whether the agent is there [A].
