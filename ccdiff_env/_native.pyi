"""The compiled extension; arrays are C-contiguous."""

# fmt: off
from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np
import numpy.typing as npt

from ccdiff_env.scenes.scene_types import (
    F32,
    F64,
    U8,
    Bool,
    Light,
    MapLayers,
    Polygon,
    StateArrays,
    TrackArrays,
)

_Places = tuple[Sequence["Scene"], npt.NDArray[np.int64], F32, F32, F32]

def causal_pairs(of_contact: bool, states: F32, sizes: F32, valid: Bool) -> F32: ...

GRAPH_THRESHOLDS: tuple[float, float]

def causal_rank(
    ranker: str, top_k: int, valid: Bool, ttc: F32 | None, distance: F32 | None,
    agents: list[int] | None, scores: F32 | None, weights: F32 | None, seed: int,
    settings: tuple[float, int, int, int],
) -> tuple[list[int], int, bool]: ...
def render_arrays(
    position_m: F32, heading_rad: F32, size_m: F32, kind: U8, driver: U8, collided: Bool,
    parked: Bool, arrived: Bool, *, scene: Scene | None, step_idx: int, size: tuple[int, int],
    span_m: float, centre_m: tuple[float, float], up_rad: float, route_m: F32,
    trails: list[tuple[F32, int]] = ..., samples: list[tuple[F32, int]] = ...,
    plans: list[tuple[F32, int]] = ..., collisions_m: F32, names: list[str], caption: str,
    scale_bar: bool, legend: list[tuple[tuple[int, int, int], str]], theme: str, svg: bool = False,
) -> U8 | str: ...
def render_look() -> list[tuple[str, float]]: ...
def render_legend(theme: str) -> list[tuple[str, tuple[int, int, int]]]: ...

@final
class Trajectories:
    def __new__(
        cls, dt_s: float, x: F32, y: F32, heading: F32, valid: Bool, size: F32,
        elevation_m: F32 | None = None,
    ) -> Trajectories: ...
    def contacts(self) -> tuple[npt.NDArray[np.uint32], F32, list[str | None]]: ...
    def off_road(
        self, drivable: list[tuple[list[list[float]], list[list[list[float]]]]],
        elevations: list[list[float]],
    ) -> tuple[Bool, Bool]: ...
    def comfort(self, axes: str, end_bins: bool, stride: int) -> F64: ...
    def harsh_motion(self) -> npt.NDArray[np.uint32]: ...
    def min_ttc(self) -> list[float]: ...
    def over_speed(self, limit_mps: float, at_least_s: float) -> list[bool]: ...

@final
class Scene:
    """Logged tracks of A agents over T steps on a map, in the scene's own frame. Immutable."""

    @staticmethod
    def from_arrays(
        name: str, *, agent_ids: Sequence[str], agent_types: Sequence[str], sizes: F32,
        position: F32 | F64, heading: F32, velocity: F32, valid: Bool, dt: float = 0.1,
        agent_categories: Sequence[str] | None = None, token: str = "", location: str = "",
        source: str = "", origin: tuple[float, float] = ..., map_layers: MapLayers | None = None,
        elevation_m: F32 | None = None, mend: bool = True,
    ) -> Scene:
        """Build a scene from arrays shaped as ``tracks``, ``sizes`` and ``map_layers`` return.

        With ``elevation_m`` agents more than 2.5 m higher or lower are out of each other's reach,
        and so are lanes and roads whose elevations ``map_layers`` tells.

        ``mend`` does what the loaders do: gaps of up to two seconds are filled, vehicles that run
        against their heading are turned by half a turn, and velocities that contradict the change
        of place for a second are replaced by it, with a warning.

        Where the first place is more than 5 km away, positions and map are moved to it by whole
        metres, which ``origin`` then has in addition. Give such positions and points in float64:
        single precision has centimetres there, of which a warning tells.
        """

    def _mended(self) -> tuple[Scene, list[int], list[str]]: ...
    @staticmethod
    def from_bytes(data: bytes) -> Scene: """Read what ``to_bytes`` wrote."""
    def to_bytes(self) -> bytes:
        """Return the whole scene as bytes; equal scenes give equal bytes."""

    @property
    def name(self) -> str: """Name, such as ``scene-0061``."""
    @property
    def token(self) -> str: """Token of the data set."""
    @property
    def location(self) -> str: """Map location, such as ``boston-seaport``."""
    @property
    def source(self) -> str: """Data set and version, or file."""
    @property
    def origin(self) -> tuple[float, float]:
        """Global x, y of the scene frame's origin, metres: global = origin + scene frame."""

    @property
    def dt(self) -> float: """Seconds between steps."""
    @property
    def num_steps(self) -> int: """Logged steps T."""
    @property
    def num_agents(self) -> int: """Agents A."""
    @property
    def agent_ids(self) -> list[str]: """Instance tokens; the ego is ``"ego"`` and comes first."""
    @property
    def agent_types(self) -> list[str]:
        """``vehicle``, ``pedestrian``, ``cyclist``, ``motorcycle`` or ``static`` for each agent."""

    @property
    def towed(self) -> list[tuple[int, int]]:
        """Towed agents and their towers: boxes that overlap in line and move together."""

    def ranked_vehicles(self, step: int, ranking: str) -> list[int]:
        """Rank the vehicles that are there at a step of the log, those that others tow left out.

        The ego comes first, else the first vehicle. ``"cliques"`` looks at the three seconds before
        the step as well. Agents on another level count as farthest.

        Raises:
            ConfigError: For a step beyond the log or another ranking.
        """

    @property
    def agent_categories(self) -> list[str]: """The data set's own category of each agent."""
    @property
    def has_road(self) -> bool:
        """Whether the map has a drivable area; else figures that need a road are not there."""

    @property
    def has_lanes(self) -> bool: """Whether the map has lanes."""
    @property
    def sizes(self) -> F32: """Length, width, height [A, 3], metres."""
    @property
    def hash(self) -> str: """Content hash, 32 hexadecimal digits, the same on every machine."""
    def tracks(self) -> TrackArrays:
        """Return new arrays in the scene frame; rows that are not valid are zero.

        position [A, T, 2] m, heading [A, T] rad (unwrapped), velocity [A, T, 2] m/s, valid [A, T].
        """

    def map_layers(self) -> MapLayers:
        """Return map layers as new arrays [P, 2] in metres; rings are not closed."""

    def with_lights(self, lights: Sequence[Light]) -> Scene:
        """Return the scene with these traffic lights in place of its own, as ``map_layers`` has
        them, ``stop_line`` in the scene frame.

        Raises:
            DatasetError: If there is no such lane or state.
            SceneError: If there are not as many states as logged steps.
        """

    def with_ego(self, agent_id: str) -> Scene:
        """Return the scene with another agent as its ego; the former one is ``"former ego"``.

        Raises:
            UnknownNameError: If there is no such agent.
        """

    def __reduce__(self) -> tuple[Callable[[bytes], Scene], tuple[bytes]]: ...
    def __copy__(self) -> Scene: ...
    def __deepcopy__(self, _memo: dict[int, Any], /) -> Scene: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __hash__(self) -> int: ...

LEVEL_M: float
EGO_AXLE_TO_CENTRE_M: float
ROUTE_SPACING_M: float

def traffic_batch_from_log(
    scenes: Sequence[Scene], steps: Sequence[int], num_states: int, num_points: int,
    num_future: int, seed: int,
) -> tuple[dict[str, Any], dict[str, Any]]: ...
def map_road_distance(places: _Places) -> F32: ...
def map_lane_ahead(
    places: _Places, num_points: int, spacing_m: float, reach_m: float,
) -> tuple[F32, Bool, npt.NDArray[np.int64], F32, F32]: ...
def load_nuscenes(
    dataroot: str, version: str, *, names: list[str] | None, exactly: bool, dt: float, timing: str,
    interpolation: str, ego_reference: str, kinds: list[str] | None, map_margin: float,
    cache_directory: str | None,
) -> tuple[list[Scene], str]: ...
def load_gpudrive(paths: list[str], *, cache_directory: str | None) -> tuple[list[Scene], str]: ...
def complete_map(
    layers: MapLayers, *, edges: list[F32], surfaces: list[Polygon], seeds: F32,
    tracks: F32 | None = None, heights: dict[str, list[F32]] | None = None,
) -> tuple[MapLayers, str, list[float]]: ...
def drivers() -> list[tuple[str, str, int]]: ...

@final
class WorldStatus:
    @property
    def scene_idx(self) -> int: ...
    @property
    def seed(self) -> int: ...
    @property
    def episode(self) -> int: ...
    @property
    def step_idx(self) -> int: ...
    @property
    def elapsed_steps(self) -> int: ...
    @property
    def ego_idx(self) -> int | None: ...

@final
class EgoNetwork:
    def __new__(cls, observation: str, action: str, tensors: dict[str, F32]) -> EgoNetwork: ...
    def act(self, obs: F32) -> F32: ...

@final
class Planner:
    def __new__(cls, kind: str) -> Planner: ...

@final
class VecWorld:
    def __new__(
        cls, scenes: Sequence[Scene], config: str, num_worlds: int, num_threads: int,
        hand: Callable[[str, str, str, int], object] | None = None,
    ) -> VecWorld: ...
    def set_scene_weights(self, weights: Sequence[float] | None) -> None: ...
    def set_autoreset(self, config: str) -> None: ...
    def reset(
        self, seeds: Sequence[int | None], scenes: Sequence[int | None],
        mask: Sequence[bool] | None, out: tuple[object, ...],
        wanted: Sequence[tuple[int | None, int | None, dict[str, float]]] = ...,
    ) -> None: ...
    def step(self, actions: F32, out: tuple[object, ...], active: Bool | None = None) -> None: ...
    def assign(self, world_idx: int, agents: Sequence[int], driver: str) -> None: ...
    def override_plan(
        self, world_idx: int, *, guided: Sequence[int] | None, criticality: float | None,
    ) -> None: ...
    def swift_rows(self, world_idx: int, agents: Sequence[int]) -> F32: ...
    def explain(self, world_idx: int, driver: str | None = None) -> dict[str, Any] | None: ...
    @property
    def driver_table(self) -> list[tuple[str, str]]: ...
    @property
    def planners(self) -> list[str]: ...
    def observe(self, world_idx: int, obs: F32, bev: U8 | None = None) -> None: ...
    @property
    def layout_json(self) -> str: ...
    @property
    def num_worlds(self) -> int: ...
    @property
    def action_width(self) -> int: ...
    @property
    def num_actions(self) -> int | None: ...
    @property
    def action_bounds(self) -> list[tuple[str, float, float]]: ...
    def snapshot(self, world_idx: int) -> bytes: ...
    def restore(self, world_idx: int, snapshot: bytes) -> None: ...
    def reseed(self, world_idx: int, seed: int) -> None: ...
    def digest(self, world_idx: int) -> int: ...
    def begun(self, world_idx: int) -> bool: ...
    def status(self, world_idx: int) -> WorldStatus: ...
    def step_arrays(self) -> list[tuple[str, str, list[int]]]: ...
    def states(self, world_idx: int) -> StateArrays: ...
    def ended_metrics(self, worlds: Sequence[int]) -> F64: ...
    def metrics(self, world_idx: int) -> F64: ...
    def drivers(self, world_idx: int) -> list[str]: ...
    def slot_agents(self, world_idx: int) -> list[int | None]: ...
    def drawn(self, world_idx: int) -> list[dict[str, Any]]: ...
    def slot_alive(self, world_idx: int) -> list[bool]: ...
    def route(self, world_idx: int, slot_idx: int) -> tuple[F32, tuple[float, float]] | None: ...
    def planner_actions(self, planner: Planner, active: list[bool] | None = None) -> F32: ...
    def contacts(self, world_idx: int) -> list[tuple[int, int, str, float, bool]]: ...
    def off_road(self, world_idx: int) -> tuple[Bool, Bool]: ...
    def off_road_m(self, world_idx: int) -> list[float]: ...
    def progress_along_log(
        self, world_idx: int, path: Sequence[Sequence[float]],
    ) -> tuple[float, float] | None: ...
    def score_facts(
        self, world_idx: int, lane_before: int | None, ignored: Sequence[int], horizon_s: float,
    ) -> tuple[tuple[int, float] | None, float | None]: ...
    def candidates(self, world_idx: int, num_rows: int) -> tuple[list[int], F32]: ...
    def guidance(self, world_idx: int) -> tuple[list[int], float] | None: ...
    def expert_actions(self, world_idx: int) -> F32: ...

@final
class TrajectoryModel:
    @property
    def header(self) -> str: ...
    @property
    def num_parameters(self) -> int: ...
    def plan_scenes(
        self, scenes: list[Scene], steps: list[int], seeds: list[int], *, solver_steps: int | None,
        num_samples: int, guidance_weight: float, guidance: str | None,
        guided: list[list[int]] | None, attention: bool, follow_route: bool,
    ) -> list[dict[str, Any]]: ...

def build_mark() -> int: ...
def hold_to_base() -> None: ...
def driver_kinds() -> list[dict[str, Any]]: ...
def schema(name: str) -> str: ...
def check_options(table: str, path: str, options: str) -> None: ...
def needs_torch(path: str) -> bool: ...
def load_network(path: str) -> TrajectoryModel: ...
def swift_bins(changes: list[tuple[float, float]]) -> list[list[int]]: ...
def guidance_preset(name: str) -> str: ...
