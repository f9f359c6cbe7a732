"""How gradients of realism and guidance agree in guided traffic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from ccdiff_env.bench.episode import Episode
from ccdiff_env.models import Planner, shipped_weights

__all__ = ["conflicts"]

_NAMES = ("gradient_cosine", "conflict_share")


def conflicts(
    played: Sequence[Episode],
    settings: Mapping[str, Any],
    *,
    num_guided: int | None,
    step: int,
    seed: int,
) -> list[dict[str, float | None]]:
    """Return how gradients of realism and guidance agree at the first plan of each episode.

    The plan is made again from the logged history.

    Parameters
    ----------
    played
        The episodes.
    settings
        Fields of :class:`~ccdiff_env.traffic.CcdiffConfig` of the method.
    num_guided
        Vehicles of the control set that are guided; all if ``None``.
    step
        Step of the log at which the episodes start.
    seed
        Seed of the noise.

    Returns
    -------
    list of dict
        ``gradient_cosine``: mean cosine of the two gradients over guided vehicles;
        ``conflict_share``: share of denoising steps and samples in which it is negative, mean over
        them. ``None`` without guidance.
    """
    nothing: dict[str, float | None] = dict.fromkeys(_NAMES)
    if not settings.get("criticality"):
        return [dict(nothing) for _ in played]
    guided = [episode.chosen[:num_guided] for episode in played]
    plans = _planner().plan(
        [episode.scene for episode in played],
        [step] * len(played),
        seeds=[seed] * len(played),
        num_samples=settings["num_samples"],
        guidance=settings["guidance"],
        guided=guided,
        gradient_statistics=True,
    )
    found = []
    for plan, agents in zip(plans, guided, strict=True):
        rows = np.isin(plan.agents, agents)
        if plan.guidance is None or not rows.any():
            found.append(dict(nothing))
            continue
        found.append({name: float(plan.guidance[name][rows].mean()) for name in _NAMES})
    return found


@lru_cache(maxsize=1)
def _planner() -> Planner:
    return Planner(shipped_weights())
