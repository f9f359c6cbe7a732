"""How long PPO takes until most training episodes succeed: ``python benchmarks/race.py``.

PPO of stable-baselines3 in log replay, unicycle actions held for three steps, with the settings of
:data:`ccdiff_env.envs.sb3.PPO_SETTINGS`, less exploration noise and a learning rate that decays.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from ccdiff_env.config import RewardConfig, WorldConfig
from ccdiff_env.envs import make_vec
from ccdiff_env.envs.sb3 import PPO_SETTINGS, SB3VecEnv
from ccdiff_env.envs.sb3_rows import rows_policy
from ccdiff_env.policies.ego import OBSERVATION
from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from
from ccdiff_env.system.table import Table

#: Decisions over which the learning rate decays to a twentieth; the race ends there.
DECISIONS = 3_000_000


class Watch(BaseCallback):
    """Notes when the newest episodes reach each share of successes, and ends the training."""

    def __init__(self, goals: list[float], episodes: int, max_s: float) -> None:
        super().__init__()
        self.left, self.episodes, self.max_s = list(goals), episodes, max_s
        self.newest: list[bool] = []
        self.rows: list[list[str]] = []
        self.clock, self.processor = time.perf_counter(), time.process_time()

    def note(self, what: str) -> None:
        spent = time.perf_counter() - self.clock, time.process_time() - self.processor
        self.rows.append([what, *(f"{x:,.0f}" for x in (self.model.num_timesteps, *spent))])

    def _on_step(self) -> bool:
        for i in np.flatnonzero(self.locals["dones"]):
            self.newest.append(self.locals["infos"][i]["is_success"])
        del self.newest[: -self.episodes]
        if len(self.newest) == self.episodes:
            while self.left and np.mean(self.newest) >= self.left[0]:
                self.note(f"{self.left.pop(0):.0%}")
        return bool(self.left) and time.perf_counter() - self.clock <= self.max_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    parser.add_argument("--goals", type=float, nargs="+", default=[0.8, 0.95])
    parser.add_argument("--episodes", type=int, default=1000, help="newest ones, of the share")
    parser.add_argument("--worlds", type=int, default=512)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--max-s", type=float, default=600.0, help="seconds of the clock")
    args = parser.parse_args()
    config = WorldConfig().with_options(
        observation=dict(OBSERVATION),
        decision_steps=3,
        reward=RewardConfig().scaled(0.2),
        start_spread_steps=50,
    )
    options = {"autoreset_mode": "same_step", "info": "end"}
    env = SB3VecEnv(make_vec(args.worlds, scenes=scenes_from(args), config=config, **options))
    policy = {**rows_policy(env.env.worlds.layout), "net_arch": [128, 128], "log_std_init": -1.7}
    rate = PPO_SETTINGS["learning_rate"]
    settings = {**PPO_SETTINGS, "learning_rate": lambda left: rate * max(left, 0.05)}
    model = PPO("MlpPolicy", env, seed=args.seed, device="cpu", policy_kwargs=policy, **settings)
    watch = Watch(args.goals, args.episodes, args.max_s)
    model.learn(DECISIONS, callback=watch)
    if watch.left:
        watch.note("ended before the next goal")
    heads = ("episodes that succeed", "decisions", "wall time s", "processor time s")
    print(Table(heads, watch.rows))


if __name__ == "__main__":
    main()
