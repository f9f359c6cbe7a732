"""Keywords of environments for checkers, written by `python -m tools.configuration`: do not edit.

Nested configurations may be dictionaries of the fields to change.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, TypedDict

from ccdiff_env.traffic.options import (
    ActionConfig,
    ActionGrid,
    Autoreset,
    BevConfig,
    CcdiffConfig,
    Consequence,
    Controlled,
    Dynamics,
    EgosConfig,
    IdmConfig,
    ObservationConfig,
    Pedestrians,
    Randomization,
    RewardConfig,
    SceneOrder,
    TrafficCollision,
    VehicleRanking,
)
from ccdiff_env.traffic.python import PythonTraffic


class SelectionKeywords(TypedDict, total=False):
    """Keywords of the selection of adversaries."""

    dt_s: float
    history_steps: int
    start_spread_steps: int
    horizon_steps: int
    traffic: str | Mapping[str, float] | PythonTraffic
    pedestrians: Pedestrians
    drivers: Mapping[str, str]
    late_arrivals: bool
    vanish_with_log: bool
    truncate_at_log_end: bool
    on_collision: Consequence
    on_traffic_collision: TrafficCollision
    on_off_road: Consequence
    terminate_at_goal: bool
    success_completion: float
    speed_limit_mps: float
    action: ActionConfig | Mapping[str, Any]
    randomization: Randomization | Mapping[str, Any]
    idm: IdmConfig | Mapping[str, Any]
    named_drivers: Mapping[str, Any]
    scene_order: SceneOrder
    dynamics: (
        Dynamics | Literal["unicycle", "bicycle", "delta_pose", "assisted"] | Mapping[str, Any]
    )
    discrete: bool
    grid: ActionGrid | Mapping[str, Any] | None
    bev: BevConfig | Mapping[str, Any] | None
    python: PythonTraffic | Mapping[str, Any]
    ccdiff: CcdiffConfig | Mapping[str, Any]
    simnet: CcdiffConfig | Mapping[str, Any]
    trafficsim: CcdiffConfig | Mapping[str, Any]
    strive: CcdiffConfig | Mapping[str, Any]
    bits: CcdiffConfig | Mapping[str, Any]
    ctg: CcdiffConfig | Mapping[str, Any]
    ctgpp: CcdiffConfig | Mapping[str, Any]
    tokens: CcdiffConfig | Mapping[str, Any]
    egos: EgosConfig | Mapping[str, Any]
    swift: CcdiffConfig | Mapping[str, Any]


class AgentKeywords(SelectionKeywords, total=False):
    """Keywords of environments of several agents."""

    reward: RewardConfig | str | Mapping[str, Any]
    style: Mapping[str, tuple[float, float]]
    driver: str | PythonTraffic
    decision_steps: int


class EgoKeywords(AgentKeywords, total=False):
    """Keywords of environments of one ego per world."""

    ego: Literal["ego", "any"]
    adversaries: Mapping[str, list[str] | tuple[str, ...]]
    adversary_shaping: float


class WorldKeywords(EgoKeywords, total=False):
    """Keywords of configurations of worlds."""

    observation: ObservationConfig | Mapping[str, Any]
    controlled: Controlled | list[str]
    num_slots: int
    ranking: VehicleRanking
    num_adversaries: int
    autoreset: Autoreset
