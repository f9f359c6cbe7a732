"""A cost of one's own for guidance, in torch: vehicles that come within 3 m of the ego.

``python examples/own_cost.py`` prints how near guided plans come to the ego, with it and without.
"""

from __future__ import annotations

import numpy as np
import torch

import ccdiff_env

NEAR_M = 3.0


def crowd_the_ego(states: torch.Tensor, batch: dict[str, torch.Tensor]) -> torch.Tensor:
    """Return the squared metres by which plans [N, M, T, 4] miss 3 m from a target, [N, M]."""
    places = states[..., :2]
    apart = torch.linalg.norm(places[:, :, None] - places[:, None] + 1e-3, dim=-1)  # [N, M, M, T]
    apart = apart.masked_fill(~batch["target"][None, None, :, None], torch.inf)
    return (apart.amin(dim=(2, 3)) - NEAR_M).square()


def nearest_m(*objectives: dict[str, object]) -> float:
    """Return how near the guided plans of four worlds come to the ego, mean."""
    guidance = {"objectives": list(objectives)}
    ccdiff = {"criticality": 4.0, "guidance": guidance}
    env = ccdiff_env.make_vec(4, traffic="ccdiff", driver="replay", ccdiff=ccdiff)
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, np.float32))
    found = []
    for plan in map(env.explain, range(4)):
        assert plan is not None
        places = plan.samples[0, :, :, :2]
        ego = np.flatnonzero(plan.agents == 0)
        apart = np.linalg.norm(places[plan.guided] - places[ego], axis=-1)
        found += apart.min(axis=1).tolist()
    return float(np.mean(found))


if __name__ == "__main__":
    own = {"kind": "python", "call": crowd_the_ego}
    print(f"{nearest_m():.1f} m without the cost, {nearest_m(own):.1f} m with it")
