"""Traffic of planning networks: the paper's protocol, and what plans say."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.errors import ShapeError, expect_shape
from ccdiff_env.system.fields import documented, shapes

_KINDS = {"Vec<usize>": np.int64, "Vec<bool>": np.bool_, "Vec<Real>": np.float32}
#: Arrays of a plan: type, axes (as in :class:`TrafficPlan`), whether it may be missing.
PLAN_ARRAYS: dict[str, tuple[Any, str, bool]] = {
    entry["name"]: (_KINDS[entry["kind"]], "".join(entry["axes"]), entry["optional"])
    for entry in json.loads(_native.schema("plan_fields"))
    if entry["kind"] in _KINDS
}


@documented
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TrafficPlan:
    """A plan that a world follows, and what it was made from: M planned and R ranked agents, N
    samples, T steps, J objectives.

    Row i of the matrices looks at column j.

    Raises:
        ShapeError: If an array does not have the shape of its field.
    """

    #: Steps since the episode (in a recording: since that) began when the plan was made.
    made_at: int
    agents: npt.NDArray[np.int64]  #: Agents that were planned for, indices in the scene, [M].
    #: Whether an agent follows the plan; the others were predicted only, [M].
    follows_plan: npt.NDArray[np.bool_]
    guided: npt.NDArray[np.bool_]  #: Whether guidance moved its plan, [M].
    graph: npt.NDArray[np.bool_]  #: Decision causal graph G, [M, M].
    ttc_s: npt.NDArray[np.float32]  #: Times to contact (s), 20 where there is none sooner, [M, M].
    #: Attention, mean over heads, zero outside of G. Not kept unless ``explain`` is set. [M, M].
    attention: npt.NDArray[np.float32] | None
    #: Agents that may be guided, by falling importance, indices in the scene, [R].
    ranking: npt.NDArray[np.int64]
    num_samples: int  #: Number of samples N.
    num_steps: int  #: Number of steps T.
    #: x, y (m) and heading (rad) in the scene frame after each step, [N, M, T, 3].
    samples: npt.NDArray[np.float32]
    selected_sample: npt.NDArray[np.int64]  #: Sample that each agent follows, [M].
    objectives: tuple[str, ...]  #: Names of the guidance objectives, J of them.
    #: Loss of each objective without its weight, [J, N, M]; contacts that are avoided although its
    #: weight seeks them, as with an ego that stands, count negative.
    losses: npt.NDArray[np.float32]
    #: How far guidance moved the plan by 2 s, metres; 0 for agents that are not guided, NaN where
    #: the plan was moved before it was finished, or chosen. Not kept without guidance. [M].
    moved_m: npt.NDArray[np.float32] | None
    #: Mean cosine of the gradients of two objectives over guided agents. Not kept unless
    #: ``explain`` is set. [J, J].
    gradient_cosine: npt.NDArray[np.float32] | None
    #: Mean cosine of the gradients of realism and guidance; 0 for an agent without a gradient. Not
    #: kept without guidance, and unless ``explain`` is set. [M].
    realism_cosine: npt.NDArray[np.float32] | None
    #: Share of samples and denoising steps in which that cosine is negative. Not kept likewise.
    #: [M].
    conflict_share: npt.NDArray[np.float32] | None
    #: The scene, states, drivers by number and drivers of its agents at the time of ``explain()``,
    #: for its picture; ``None`` in a recording.
    moment: tuple[Any, Any, Any, Any] | None = field(default=None, repr=False)

    __repr__ = shapes

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
