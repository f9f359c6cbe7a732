"""A race: how long PPO takes until most episodes in log replay succeed, on scenes of training."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.config import RewardConfig, WorldConfig
from ccdiff_env.system.table import Table

__all__ = ["race", "race_table"]

NUM_ENVS = 512
#: Decisions over which the learning rate falls to a twentieth; the race ends there.
DECISIONS = 3_000_000
#: Episodes that a share of successes is taken over, the newest ones.
EPISODES = 1000


def race(
    source: str,
    goals: Sequence[float] = (0.8, 0.95),
    *,
    seed: int = 0,
    max_s: float = 600.0,
) -> list[dict[str, float]]:
    """Train PPO of stable-baselines3 in log replay until shares of the episodes succeed.

    Unicycle actions held for three steps; settings of :data:`ccdiff_env.envs.sb3.PPO_SETTINGS`, but
    little noise, which fails less often, and a learning rate that falls.

    Parameters
    ----------
    source
        Scenes of training, a text of :func:`ccdiff_env.load`.
    goals
        Shares of successes among the newest episodes, in rising order.
    seed
        Of PPO and of the worlds.
    max_s
        Seconds of the clock after which the race ends, if it has not before.

    Returns
    -------
    list of dict
        For each goal that was reached: ``goal``, ``decisions``, ``clock_s``, ``processor_s``. One
        more row without ``goal`` says where the race ended if it did before the last goal.
    """
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

    from ccdiff_env.envs import make_vec
    from ccdiff_env.envs.sb3 import PPO_SETTINGS, SB3VecEnv
    from ccdiff_env.envs.sb3_rows import rows_policy
    from ccdiff_env.policies.ego import OBSERVATION

    config = WorldConfig().with_options(
        observation=dict(OBSERVATION),
        decision_steps=3,
        reward=RewardConfig().scaled(0.2),
        start_spread_steps=50,
    )
    env = SB3VecEnv(
        make_vec(
            NUM_ENVS,
            scenes=scenes_of(source),
            config=config,
            autoreset_mode="same_step",
            info="end",
        )
    )
    policy = {**rows_policy(env.env.worlds.layout), "net_arch": [128, 128], "log_std_init": -1.7}
    rate = PPO_SETTINGS["learning_rate"]
    settings = {**PPO_SETTINGS, "learning_rate": lambda left: rate * max(left, 0.05)}
    model = PPO("MlpPolicy", env, seed=seed, device="cpu", policy_kwargs=policy, **settings)
    clock, processor = time.perf_counter(), time.process_time()
    rows: list[dict[str, float]] = []
    left = list(goals)

    def now() -> dict[str, float]:
        return {
            "decisions": float(model.num_timesteps),
            "clock_s": time.perf_counter() - clock,
            "processor_s": time.process_time() - processor,
        }

    class Watch(BaseCallback):
        """Notes when goals are reached, and ends the training."""

        def __init__(self) -> None:
            super().__init__()
            self.newest: list[float] = []

        def _on_step(self) -> bool:
            for i in np.flatnonzero(self.locals["dones"]):
                self.newest.append(self.locals["infos"][i]["is_success"])
            del self.newest[:-EPISODES]
            if len(self.newest) == EPISODES:
                while left and np.mean(self.newest) >= left[0]:
                    rows.append({"goal": left.pop(0), **now()})
            return bool(left) and time.perf_counter() - clock <= max_s

    model.learn(DECISIONS, callback=Watch())
    if left:
        rows.append(now())
    env.close()
    return rows


def race_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the race in Markdown."""
    heads = ("episodes that succeed", "decisions", "seconds of the clock", "of the processor")
    shown = [
        [
            f"{row['goal']:.0%}" if "goal" in row else "ended before the next goal",
            *(f"{row[name]:,.0f}" for name in ("decisions", "clock_s", "processor_s")),
        ]
        for row in rows
    ]
    return str(Table(heads, shown))
