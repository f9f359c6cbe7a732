"""Traffic of planning networks: their names, the paper's protocol, and what their plans say."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.errors import DatasetError, DatasetNotFoundError, takes_former_names
from ccdiff_env.files import parsed_object

__all__ = [
    "NETWORKS",
    "PAPER_PROTOCOL",
    "TrafficPlan",
    "read_ranking",
]

#: Networks whose plans traffic may follow: names of drivers, and of the kinds of their weights.
NETWORKS = (
    "ccdiff",
    "simnet",
    "trafficsim",
    "trafficsim_port",
    "strive",
    "bits",
    "ctg",
    "ctgpp",
)


@takes_former_names(chosen="selected_sample", executed="follows_plan")
@dataclass(frozen=True, eq=False)
class TrafficPlan:
    """A plan that a world follows, and what it was made from: M vehicles, N samples, T steps.

    Row i of the matrices looks at column j.
    """

    #: Steps since the episode began when the plan was made.
    made_at: int
    #: Vehicles that were planned for, indices in the scene, [M].
    agents: npt.NDArray[np.int64]
    #: Whether a vehicle follows the plan, [M]; the others were predicted only.
    follows_plan: npt.NDArray[np.bool_]
    #: Whether guidance moved its plan, [M].
    guided: npt.NDArray[np.bool_]
    #: Decision causal graph G, [M, M].
    graph: npt.NDArray[np.bool_]
    #: Times to contact, s, [M, M].
    ttc_s: npt.NDArray[np.float32]
    #: Attention, mean over heads, zero outside of G, [M, M]; ``None`` unless ``explain`` is set.
    attention: npt.NDArray[np.float32] | None
    #: Vehicles that may be guided, by falling importance.
    ranking: npt.NDArray[np.int64]
    #: x, y (m) and heading (rad) in the scene frame after each step, [N, M, T, 3].
    samples: npt.NDArray[np.float32]
    #: Sample that each vehicle follows, [M].
    selected_sample: npt.NDArray[np.int64]
    #: Names of the guidance objectives, [J].
    objectives: tuple[str, ...]
    #: Their losses without weights, [J, N, M].
    losses: npt.NDArray[np.float32]
    #: Total variation of guided and unguided actions in [0, 1], the paper's C(tau), [M]; NaN for
    #: networks that do not denoise.
    realism_cost: npt.NDArray[np.float32]
    #: Move of the guidance over all denoising steps in standard deviations of the process, [M]: the
    #: same as the realism cost, which is erf(shift / sqrt(8)), but it does not saturate.
    shift_sigmas: npt.NDArray[np.float32]
    #: Mean cosine of the gradients of two objectives, [J, J]; ``None`` unless ``explain`` is set.
    gradient_cosine: npt.NDArray[np.float32] | None
    #: Mean cosine of the gradients of realism and guidance, [M]; 0 for a vehicle without a
    #: gradient, ``None`` without guidance, and unless ``explain`` is set.
    realism_cosine: npt.NDArray[np.float32] | None
    #: Share of samples and denoising steps in which it is negative, [M]; ``None`` likewise.
    conflict_share: npt.NDArray[np.float32] | None
    #: Samples N and steps T.
    num_samples: int
    num_steps: int


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
        "others": "replay",
        "frozen": "standing",
        "partners": "all",
        "criticality": 1.0,
    },
}


def read_ranking(path: str | os.PathLike[str]) -> dict[str, tuple[str, ...]]:
    """Read who matters in each scene, most important first, as a person may have listed it.

    Parameters
    ----------
    path
        JSON: ``{"scene-0103": ["<instance token>", "ego", ...], ...}``. Vehicles
        that are not listed come after these: nearest time to contact first, then distance.

    Raises
    ------
    DatasetNotFoundError
        If there is no such file.
    DatasetError
        If it holds anything else, naming the scene.
    """
    try:
        found = parsed_object(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DatasetNotFoundError(f"no ranking at {os.fspath(path)}") from None
    except (OSError, ValueError) as error:
        raise DatasetError(f"no ranking in JSON ({error}): {os.fspath(path)}") from None
    for scene, ids in found.items():
        if not isinstance(ids, list) or not all(isinstance(i, str) for i in ids):
            raise DatasetError(f"{os.fspath(path)}: {scene}: {ids!r}, expected a list of agent ids")
    return {scene: tuple(ids) for scene, ids in found.items()}
