"""Learn which vehicles to turn against an ego, and compare with simple adversary policies.

    python examples/train_adversary_selection.py --ego idm --budget 2 --steps 20000

MaskablePPO of sb3-contrib acts once per plan of CCDiff traffic. ``--ego`` may be the ``ego.zip`` of
train_ego_sb3.py.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from sb3_contrib import MaskablePPO

from ccdiff_env import AdversarySelectionEnv, AdversarySelectionVectorEnv
from ccdiff_env.envs.sb3 import SelectionSB3VecEnv
from ccdiff_env.scenes.arguments import add_other_scenes, add_scene_arguments, scenes_from


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    parser.add_argument("--ego", default="idm", help="replay, idm, constant_velocity or a .zip")
    parser.add_argument("--budget", type=int, default=2)
    parser.add_argument("--steps", type=int, default=20_000, help="decisions")
    parser.add_argument("--worlds", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/adversary_selection"))
    parser.add_argument("--smoke", action="store_true", help="a run of seconds")
    return parser.parse_args()


def evaluate(choose, scenes, options: dict) -> tuple[float, float, float]:
    """Share of scenes with a collision caused, mean realism cost, mean return."""
    env = AdversarySelectionEnv(scenes=scenes, **options)
    rows = []
    for scene in scenes:
        obs, _ = env.reset(seed=0, options={"scene": scene.name})
        done, total = False, 0.0
        while not done:
            obs, reward, terminated, truncated, info = env.step(choose(env, obs))
            done, total = terminated or truncated, total + reward
        rows.append((info["is_success"], info["metrics"]["mean_realism_cost"], total))
    return tuple(np.mean(rows, axis=0))


def main() -> None:
    args = arguments()
    train, held_out = scenes_from(args), scenes_from(args, other=True)
    options = {"ego": args.ego, "budget": args.budget, "max_agents": 8}
    options["ccdiff"] = {"denoising_steps": 5, "criticality": 1.0}
    if args.smoke:
        args.steps, args.worlds, train, held_out = 16, 2, train[:2], held_out[:1]
        options |= {"horizon_steps": 10, "ccdiff": {"denoising_steps": 2, "criticality": 1.0}}
    env = SelectionSB3VecEnv(AdversarySelectionVectorEnv(args.worlds, scenes=train, **options))
    model = MaskablePPO(
        "MultiInputPolicy",
        env,
        n_steps=8 if args.smoke else 64,
        batch_size=16 if args.smoke else 128,
        gamma=0.95,
        ent_coef=0.01,
        seed=args.seed,
        verbose=0 if args.smoke else 1,
        device="cpu",
    )
    model.learn(args.steps)
    args.out.mkdir(parents=True, exist_ok=True)
    model.save(args.out / "adversary_policy.zip")

    def learned(env, obs):
        return model.predict(obs, action_masks=env.action_masks(), deterministic=True)[0]

    policies = {"PPO": learned}
    for name in (
        ("none", "causal") if args.smoke else ("none", "random", "nearest", "ttc", "causal")
    ):
        policies[name] = lambda env, obs, name=name: env.baseline(name)
    print(f"{len(held_out)} held-out scenes, ego {args.ego}, at most {args.budget} adversaries:")
    print(f"  {'policy':10s} {'collisions':>10s} {'realism cost':>13s} {'return':>8s}")
    for name, choose in policies.items():
        hits, cost, total = evaluate(choose, held_out, options)
        print(f"  {name:10s} {hits:10.3f} {cost:13.3f} {total:8.3f}")


if __name__ == "__main__":
    main()
