"""Steps per second of PPO of stable-baselines3: small minibatches and the recommended settings.

    python benchmarks/sb3.py --rounds 3

Both take turns, on the embedded scenes in log replay. Seconds are those of the processors (user and
system time of all threads), so that other processes count for little, and of the clock.
"""

from __future__ import annotations

import argparse
import time

import torch
from stable_baselines3 import PPO

import ccdiff_env
from ccdiff_env.envs.sb3 import PPO_SETTINGS, SB3VecEnv
from ccdiff_env.envs.sb3_rows import rows_policy
from ccdiff_env.policies.ego import OBSERVATION

#: Name: worlds, options of make_vec, settings of PPO.
SIDES = {
    "small": (
        64,
        {},
        {"n_steps": 128, "batch_size": 512, "n_epochs": 6, "gamma": 0.98},
    ),
    "recommended": (
        512,
        {
            "info": "end",
            "config": ccdiff_env.WorldConfig().with_options(
                observation=dict(OBSERVATION), decision_steps=3
            ),
        },
        PPO_SETTINGS,
    ),
}


class Timed(SB3VecEnv):
    """Worlds that count their own seconds."""

    seconds = 0.0

    def step_wait(self):
        begin = time.process_time()
        found = super().step_wait()
        self.seconds += time.process_time() - begin
        return found


def measure(name: str, updates: int) -> tuple[float, float, float]:
    """Steps of the worlds per second of the processors and of the clock; share of the worlds."""
    worlds, options, settings = SIDES[name]
    env = Timed(ccdiff_env.make_vec(worlds, autoreset_mode="same_step", **options))
    policy = {**rows_policy(env.env.worlds.layout), "net_arch": [128, 128]}
    model = PPO("MlpPolicy", env, seed=0, device="cpu", policy_kwargs=policy, **settings)
    model.learn(worlds * settings["n_steps"])  # warm
    env.seconds = 0.0
    clock, processors = time.perf_counter(), time.process_time()
    decisions = updates * worlds * settings["n_steps"]
    model.learn(decisions)
    clock, processors = time.perf_counter() - clock, time.process_time() - processors
    steps = decisions * env.env.config.decision_steps
    return steps / processors, steps / clock, env.seconds / processors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--updates", type=int, default=2, help="of each side and round")
    parser.add_argument("--threads", type=int, default=1, help="of torch")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    print("| round | settings | steps/s of processor | steps/s of clock | share of the worlds |")
    print("|---:|---|---:|---:|---:|")
    for i in range(args.rounds):
        for name in SIDES:
            per_processor, per_clock, share = measure(name, args.updates)
            print(f"| {i} | {name} | {per_processor:,.0f} | {per_clock:,.0f} | {share:.0%} |")


if __name__ == "__main__":
    main()
