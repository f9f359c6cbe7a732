"""Egos against adversaries with RLlib: one environment, opposite rewards, a policy for each role.

pip install "ray[rllib,tune]"
python examples/self_play_rllib.py --iterations 50
"""

from __future__ import annotations

import argparse

import numpy as np

try:
    import ray
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.tune.registry import register_env
except ImportError as error:
    raise SystemExit(f"this example needs {error.name}: pip install 'ray[rllib,tune]'") from error

import ccdiff_env
from ccdiff_env.scenes.arguments import add_scene_arguments, place_from

#: Rank 0 is the ego, ranks 1 and 2 the two nearest vehicles, who play against it.
OPTIONS = {"agents": 3, "adversaries": "others", "names": "slot", "traffic": "idm", "info": "end"}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    parser.add_argument("--iterations", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--smoke", action="store_true", help="a short test run")
    return parser.parse_args()


def make(config: dict) -> ParallelPettingZooEnv:
    return ParallelPettingZooEnv(ccdiff_env.parallel_env(scenes=config["scenes"], **OPTIONS))


def role(agent_id: str, *_args, **_kwargs) -> str:
    return "ego" if agent_id.startswith("ego") else "adversary"


def main() -> None:
    args = arguments()
    register_env("ccdiff_game", make)
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    config = (
        PPOConfig()
        .environment(
            "ccdiff_game", env_config={"scenes": str(place_from(args))}, disable_env_checking=True
        )
        .env_runners(num_env_runners=0)
        .multi_agent(policies={"ego", "adversary"}, policy_mapping_fn=role)
        .training(
            gamma=0.98,
            lr=3e-4,
            train_batch_size_per_learner=200 if args.smoke else 4_000,
            minibatch_size=100 if args.smoke else 512,
            num_epochs=1 if args.smoke else 5,
        )
        .learners(num_learners=0)
        .debugging(seed=args.seed, log_level="ERROR")
    )
    algorithm = config.build_algo()
    for i in range(1 if args.smoke else args.iterations):
        runs = algorithm.train()["env_runners"]
        returns = runs.get("module_episode_returns_mean", {})
        shown = ", ".join(f"{name} {np.round(value, 3)}" for name, value in returns.items())
        print(f"iteration {i}: mean return {shown or 'no episode has ended yet'}")
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
