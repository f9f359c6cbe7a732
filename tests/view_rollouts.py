"""A small made-up rollout that has everything a replay can show."""

from dataclasses import replace
from functools import cache

import numpy as np

from ccdiff_env import embedded_scenes
from ccdiff_env.record.rollout import Rollout, RolloutEvent
from ccdiff_env.traffic import TrafficPlan
from ccdiff_env.view import log_rollout

NUM_STEPS = 81


@cache
def planned_rollout(name: str = "left-turn-00") -> Rollout:
    """Eight seconds of a log as if CCDiff had driven agents 1 and 2 (2 guided), with events."""
    log = log_rollout(embedded_scenes()[name])
    rng = np.random.default_rng(7)
    ids = log.agent_ids
    position = log.position[:, :NUM_STEPS].copy()
    position[1:3] += np.linspace(0.0, 2.0, NUM_STEPS, dtype=np.float32)[:, None]
    drivers = log.drivers.copy()
    drivers[1:3] = 4
    plans = tuple(_plan(position, step, rng) for step in range(0, NUM_STEPS - 1, 10))
    return replace(
        log,
        position=position,
        heading=log.heading[:, :NUM_STEPS],
        velocity=log.velocity[:, :NUM_STEPS],
        valid=log.valid[:, :NUM_STEPS],
        drivers=drivers,
        plans=plans,
        events=(
            RolloutEvent(30, "ego", ids[1], "collision_front", True),
            RolloutEvent(30, ids[1], "ego", "collision_side"),
        ),
        info={
            "route_distance": np.linspace(-1.0, 3.0, NUM_STEPS - 1, dtype=np.float32),
            "collision": np.zeros(NUM_STEPS - 1, np.float32),
        },
        meta={"seed": 7, "planner": "idm", "traffic": "ccdiff"},
    )


def plan_of(made_at: int, agents: list[int], samples: np.ndarray, **fields) -> TrafficPlan:
    """A plan with samples [N, M, T, 2] or [.., 3] of which nothing else is worth telling."""
    n, m, t, _ = samples.shape
    poses = np.zeros((n, m, t, 3), np.float32)
    poses[..., : samples.shape[-1]] = samples
    plain = {
        "follows_plan": np.ones(m, bool),
        "guided": np.zeros(m, bool),
        "graph": np.eye(m, dtype=bool),
        "ttc_s": np.full((m, m), np.inf, np.float32),
        "ranking": np.array(agents, np.int64),
        "selected_sample": np.zeros(m, np.int64),
        "losses": np.zeros((0, n, m), np.float32),
        "objectives": (),
    }
    optional = (
        "attention", "gradient_cosine", "realism_cosine", "conflict_share", "moved_m",
    )  # fmt: skip
    return TrafficPlan(
        made_at=made_at,
        agents=np.array(agents, np.int64),
        samples=poses,
        num_samples=n,
        num_steps=t,
        **{**plain, **dict.fromkeys(optional), **fields},
    )


def _plan(position: np.ndarray, step: int, rng: np.random.Generator) -> TrafficPlan:
    ahead = np.minimum(step + 1 + np.arange(20), NUM_STEPS - 1)
    spread = rng.normal(size=(4, 2, 1, 2)) * (np.arange(20) / 10.0)[:, None]
    return plan_of(
        step,
        [1, 2],
        (position[1:3][:, ahead] + spread).astype(np.float32),
        selected_sample=np.array([1, 3]),
        moved_m=np.array([0.0, 0.25], np.float32),
        graph=np.array([[True, True], [False, True]]),
        guided=np.array([False, True]),
    )
