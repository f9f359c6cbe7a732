"""Fields of a plan's record; Rust has the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, eq=False, kw_only=True)
class PlanFields:
    """Fields of :class:`ccdiff_env.traffic.TrafficPlan`: M planned and R ranked agents, N samples,
    T steps, J objectives.
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
    losses: npt.NDArray[np.float32]  #: Loss of each objective without its weight, [J, N, M].
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
