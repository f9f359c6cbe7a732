"""Traffic of planning networks: the paper's protocol, and what plans say."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ccdiff_env import _native
from ccdiff_env.errors import ShapeError, expect_shape
from ccdiff_env.traffic.plan_fields import PlanFields

_KINDS = {"Vec<usize>": np.int64, "Vec<bool>": np.bool_, "Vec<Real>": np.float32}
#: Arrays of a plan: type, axes (as in :class:`PlanFields`), whether it may be missing.
PLAN_ARRAYS: dict[str, tuple[Any, str, bool]] = {
    entry["name"]: (_KINDS[entry["kind"]], "".join(entry["axes"]), entry["optional"])
    for entry in json.loads(_native.schema("plan_fields"))
    if entry["kind"] in _KINDS
}


@dataclass(frozen=True, eq=False, kw_only=True)
class TrafficPlan(PlanFields):
    """A plan that a world follows, and what it was made from: M agents, N samples, T steps.

    Row i of the matrices looks at column j.

    Raises:
        ShapeError: If an array does not have the shape of its field.
    """

    def __post_init__(self) -> None:
        sizes = {"M": len(self.agents), "R": len(self.ranking), "J": len(self.objectives), "3": 3}
        sizes |= {"N": self.num_samples, "T": self.num_steps}
        for name, (_, axes, optional) in PLAN_ARRAYS.items():
            array = getattr(self, name)
            if array is None and optional:
                continue
            expect_shape(f"plan.{name}", array, tuple(sizes[axis] for axis in axes))
        selected = self.selected_sample
        if len(selected) and not 0 <= selected.min() <= selected.max() < self.num_samples:
            raise ShapeError(
                f"plan.selected_sample is {selected}, expected less than {self.num_samples}"
            )


#: Options of an environment that follow the paper's evaluation as released
#: (reference.md#closed-loop-evaluation): start at step 31, 10 s, agents of the start only, vanish
#: with the log, contacts without consequence, the guided vehicles found once, everybody else
#: replays the log.
PAPER_PROTOCOL: Mapping[str, Any] = {
    "history_steps": 31,
    "horizon_steps": 100,
    "traffic": "ccdiff",
    "driver": "ccdiff",
    "late_arrivals": False,
    "vanish_with_log": True,
    "on_collision": "ignore",
    "on_traffic_collision": "ignore",
    "on_off_road": "ignore",
    "terminate_at_goal": False,
    "ccdiff": {
        "replan_steps": 5,
        "num_samples": 5,
        "num_guided": 5,
        "rerank": False,
        "background_driver": "replay",
        "parked_rule": "standing",
        "collision_targets": "all",
        "criticality": 1.0,
    },
}
