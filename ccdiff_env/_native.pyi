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
def __getattr__(name: str) -> Any: ...
