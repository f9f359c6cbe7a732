"""The compiled extension; arrays are C-contiguous."""

from typing import Any

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]

def causal_ttc(
    x: F32,
    y: F32,
    heading: F32,
    speed: F32,
    length: F32,
    width: F32,
    valid: Bool,
    method: str,
) -> F32: ...
def causal_distance(x: F32, y: F32, valid: Bool) -> F32: ...
def causal_graph(
    ttc_s: F32, distance_m: F32, max_ttc_s: float, max_distance_m: float, symmetric: bool
) -> tuple[Bool, float]: ...
def causal_clique_occurrences(
    measure: F64, threshold: float, min_size: int, top_per_frame: int, node_limit: int
) -> tuple[list[int], list[int], int, bool]: ...
def causal_greedy_order(weights: F64, order: str) -> list[int]: ...
def causal_rank(
    ranker: str,
    top_k: int,
    valid: Bool,
    ttc: F32 | None,
    distance: F32 | None,
    agents: list[int] | None,
    scores: F32 | None,
    seed: int,
    settings: tuple[float, int, int, int],
) -> tuple[list[int], int, bool]: ...
def render_arrays(
    position_m: F32,
    heading_rad: F32,
    size_m: F32,
    kind: U8,
    driver: U8,
    collided: Bool,
    *,
    size: tuple[int, int],
    span_m: float,
    centre_m: tuple[float, float],
    up_rad: float,
    route_m: F32,
    trails: list[tuple[F32, int]],
    samples: list[tuple[F32, int]],
    arrows: list[tuple[int, int, float]],
    collisions_m: F32,
    caption: str,
    scale_bar: bool,
) -> U8: ...
def render_legend() -> list[tuple[str, tuple[int, int, int]]]: ...

class Rollout:
    def __init__(
        self, dt_s: float, x: F32, y: F32, heading: F32, valid: Bool, size: F32
    ) -> None: ...
    def collisions(
        self, controlled: Bool, log: Rollout | None
    ) -> tuple[
        npt.NDArray[np.uint32],
        list[bool],
        list[bool],
        list[str | None],
        list[list[bool]],
        list[float],
    ]: ...
    def off_road(
        self,
        drivable: list[tuple[list[list[float]], list[list[list[float]]]]],
        counted: Bool,
        replan_steps: int,
    ) -> tuple[Bool, Bool, list[float]]: ...
    def displacement(self, log: Rollout) -> tuple[list[float], list[float]]: ...
    def comfort(self, axes: str, stride: int) -> F64: ...
    def min_ttc(self) -> list[float]: ...
    def post_encroachment_time(self) -> list[float]: ...
    def over_speed(self, limit_mps: float, at_least_s: float, counted: Bool) -> list[bool]: ...

def metrics_scores(
    scr: F64, orr: F64, fde: F64, cfd: F64, bounds: list[tuple[float, float] | None] | None
) -> tuple[list[float], list[float]]: ...
def metrics_generational_distance(cs: F64, rs: F64) -> tuple[list[float], list[float]]: ...
def metrics_comfort_mean(scenes: F64) -> F64: ...
def metrics_comfort_distance(one: F64, other: F64) -> tuple[list[float], float]: ...
def metrics_speed_limit(speeds: F32) -> float | None: ...
def metrics_total_variation(mean_one: F32, mean_other: F32, std_dev: F32) -> list[float]: ...
def metrics_gradient_conflict(realism: F32, guidance: F32) -> tuple[list[float], float, float]: ...
def metrics_pearson(x: F64, y: F64) -> tuple[float, float]: ...
def __getattr__(name: str) -> Any: ...
