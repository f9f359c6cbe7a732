"""Traffic: who can drive the vehicles, the options of each, and custom models."""

from __future__ import annotations

from ccdiff_env.traffic.ccdiff import PAPER_PROTOCOL, TrafficPlan
from ccdiff_env.traffic.kinds import (
    EGOS,
    KINDS,
    NETWORKS,
    SWIFT,
    Kind,
    NamedDriver,
    driver_names,
    driver_titles,
    read_driver,
)
from ccdiff_env.traffic.options import CcdiffConfig, EgosConfig, IdmConfig
from ccdiff_env.traffic.python import LoggedFuture, PythonTraffic, TrafficBatch

__all__ = [
    "EGOS", "KINDS", "NETWORKS", "PAPER_PROTOCOL", "SWIFT", "CcdiffConfig", "EgosConfig",
    "IdmConfig", "Kind", "LoggedFuture", "NamedDriver", "PythonTraffic", "TrafficBatch",
    "TrafficPlan", "driver_names", "driver_titles", "read_driver",
]  # fmt: skip
