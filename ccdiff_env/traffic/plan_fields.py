"""Fields of a plan's record, written by `python -m tools.configuration`: do not edit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

#: Arrays of a plan: type, axes, whether it may be missing. M planned and R ranked agents, N
#: samples, T steps, J objectives.
PLAN_ARRAYS: dict[str, tuple[Any, str, bool]] = {
    "agents": (np.int64, "M", False),
    "follows_plan": (np.bool_, "M", False),
    "guided": (np.bool_, "M", False),
    "graph": (np.bool_, "MM", False),
    "ttc_s": (np.float32, "MM", False),
    "attention": (np.float32, "MM", True),
    "ranking": (np.int64, "R", False),
    "samples": (np.float32, "NMT3", False),
    "selected_sample": (np.int64, "M", False),
    "losses": (np.float32, "JNM", False),
    "realism_cost": (np.float32, "M", False),
    "shift_sigmas": (np.float32, "M", False),
    "gradient_cosine": (np.float32, "JJ", True),
    "realism_cosine": (np.float32, "M", True),
    "conflict_share": (np.float32, "M", True),
}


@dataclass(frozen=True, eq=False, kw_only=True)
class PlanFields:
    """Fields of :class:`ccdiff_env.traffic.TrafficPlan`."""

    #: Steps since the episode (in a recording: since that) began when the plan was made.
    made_at: int
    #: Agents that were planned for, indices in the scene, [M].
    agents: npt.NDArray[np.int64]
    #: Whether an agent follows the plan; the others were predicted only, [M].
    follows_plan: npt.NDArray[np.bool_]
    #: Whether guidance moved its plan, [M].
    guided: npt.NDArray[np.bool_]
    #: Decision causal graph G, [M, M].
    graph: npt.NDArray[np.bool_]
    #: Times to contact (s), 20 where there is none sooner, [M, M].
    ttc_s: npt.NDArray[np.float32]
    #: Attention, mean over heads, zero outside of G. Not kept unless ``explain`` is set. [M, M].
    attention: npt.NDArray[np.float32] | None
    #: Agents that may be guided, by falling importance, indices in the scene, [R].
    ranking: npt.NDArray[np.int64]
    #: Number of samples N.
    num_samples: int
    #: Number of steps T.
    num_steps: int
    #: x, y (m) and heading (rad) in the scene frame after each step, [N, M, T, 3].
    samples: npt.NDArray[np.float32]
    #: Sample that each agent follows, [M].
    selected_sample: npt.NDArray[np.int64]
    #: Names of the guidance objectives, J of them.
    objectives: tuple[str, ...]
    #: Loss of each objective without its weight, [J, N, M].
    losses: npt.NDArray[np.float32]
    #: Total variation of guided and unguided actions in [0, 1], the paper's C(tau); NaN for
    #: networks that do not denoise, [M].
    realism_cost: npt.NDArray[np.float32]
    #: Move of the guidance over all denoising steps in standard deviations of the process: the same
    #: as the realism cost, which is erf(shift / sqrt(8)), but it does not saturate. NaN where it
    #: was not recorded. [M].
    shift_sigmas: npt.NDArray[np.float32]
    #: Mean cosine of the gradients of two objectives over guided agents. Not kept unless
    #: ``explain`` is set. [J, J].
    gradient_cosine: npt.NDArray[np.float32] | None
    #: Mean cosine of the gradients of realism and guidance; 0 for an agent without a gradient. Not
    #: kept without guidance, and unless ``explain`` is set. [M].
    realism_cosine: npt.NDArray[np.float32] | None
    #: Share of samples and denoising steps in which that cosine is negative. Not kept likewise.
    #: [M].
    conflict_share: npt.NDArray[np.float32] | None
