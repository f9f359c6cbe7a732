"""Train one policy for several vehicles at once, then let it play a PettingZoo environment.

    python examples/multi_agent_pettingzoo.py --agents 6 --steps 200000
    python examples/multi_agent_pettingzoo.py --agents 3 --adversaries 1

All controlled vehicles of all worlds are rows of one native vector environment, so that PPO of
stable-baselines3 learns a shared policy from them. The same policy then drives each agent of the
PettingZoo form. With --adversaries, egos and adversaries have opposite rewards and a policy each is
the next step: here the shared policy learns from egos and adversaries alike.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from stable_baselines3 import PPO

import ccdiff_env
from ccdiff_env import AgentVectorEnv
from ccdiff_env.envs.sb3 import AgentSB3VecEnv
from ccdiff_env.scenes.arguments import add_other_scenes, add_scene_arguments, scenes_from


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    parser.add_argument("--agents", type=int, default=4)
    parser.add_argument("--adversaries", type=int)
    parser.add_argument("--steps", type=int, default=200_000, help="of all vehicles together")
    parser.add_argument("--worlds", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/multi_agent"))
    parser.add_argument("--smoke", action="store_true", help="a run of seconds")
    return parser.parse_args()


def play(env, act, scene: str) -> dict[str, dict]:
    """One episode; returns the metrics of every agent."""
    observations, _ = env.reset(seed=0, options={"scene": scene})
    metrics = {}
    while env.agents:
        actions = {name: act(observations[name]) for name in env.agents}
        observations, _, terminations, truncations, infos = env.step(actions)
        for name in infos:
            if terminations[name] or truncations[name]:
                metrics[name] = infos[name].get("metrics", {})
    return metrics


def main() -> None:
    args = arguments()
    train, held_out = scenes_from(args), scenes_from(args, other=True)
    if args.smoke:
        args.steps, args.worlds, held_out = 256, 2, held_out[:1]
    options = {"agents": args.agents, "adversaries": args.adversaries, "traffic": "idm"}
    rows = AgentVectorEnv(args.worlds, scenes=train, **options)
    model = PPO(
        "MlpPolicy",
        AgentSB3VecEnv(rows),
        n_steps=32 if args.smoke else 128,
        batch_size=256,
        gamma=0.98,
        seed=args.seed,
        verbose=0 if args.smoke else 1,
        device="cpu",
    )
    model.learn(args.steps)
    args.out.mkdir(parents=True, exist_ok=True)
    model.save(args.out / "shared.zip")

    env = ccdiff_env.parallel_env(scenes=held_out, info="end", **options)
    rng = np.random.default_rng(args.seed)
    policies = {
        "learned": lambda obs: model.predict(obs, deterministic=True)[0],
        "random": lambda obs: rng.uniform(-1, 1, 2).astype(np.float32),
    }
    print(f"{len(held_out)} held-out scenes, {args.agents} vehicles each:")
    for name, act in policies.items():
        ended = [m for s in held_out for m in play(env, act, s.name).values() if m]
        means = {k: np.mean([m[k] for m in ended]) for k in ("collision", "off_road", "progress")}
        print(f"  {name:8s}", "  ".join(f"{k} {v:.3f}" for k, v in means.items()))
    print(f"policy in {args.out}")


if __name__ == "__main__":
    main()
