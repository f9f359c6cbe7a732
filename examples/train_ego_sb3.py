"""Train a PPO ego with stable-baselines3 in a traffic of your choice, and evaluate it.

    python examples/train_ego_sb3.py --traffic ccdiff --criticality 1 --steps 300000

--scenes names others than the embedded ones.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from stable_baselines3 import PPO

import ccdiff_env
from ccdiff_env.bench.intervals import mean_interval
from ccdiff_env.bench.planners import Traffic, play
from ccdiff_env.envs.sb3 import SB3VecEnv
from ccdiff_env.scenes.arguments import add_other_scenes, add_scene_arguments, scenes_from

FIGURES = ("score", "success", "collision", "no_at_fault_collision", "on_road", "progress")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    parser.add_argument("--traffic", default="idm", help="replay, idm, constant_velocity or ccdiff")
    parser.add_argument("--criticality", type=float, default=0.0, help="of ccdiff traffic")
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--worlds", type=int, default=32)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/train_ego"))
    parser.add_argument("--smoke", action="store_true", help="a run of seconds")
    return parser.parse_args()


def main() -> None:
    args = arguments()
    train, held_out = scenes_from(args), scenes_from(args, other=True)
    if args.smoke:
        args.steps, args.worlds, held_out = 256, 4, held_out[:1]
    critical = args.traffic == "ccdiff"
    options = {"criticality": args.criticality, "denoising_steps": 1} if critical else {}
    native = ccdiff_env.make_vec(
        args.worlds,
        scenes=train,
        autoreset_mode="same_step",
        info="end",
        traffic=args.traffic,
        ccdiff=options,
    )
    model = PPO(
        "MlpPolicy",
        SB3VecEnv(native),
        n_steps=max(2048 // args.worlds, 16) if not args.smoke else 64,
        batch_size=256,
        gamma=0.98,
        seed=args.seed,
        verbose=0 if args.smoke else 1,
        device="cpu",
    )
    model.learn(args.steps)
    args.out.mkdir(parents=True, exist_ok=True)
    model.save(args.out / "ego.zip")
    print(f"{len(held_out)} held-out scenes, {args.traffic} traffic:")
    rows = play(held_out, str(args.out / "ego.zip"), Traffic("", args.traffic, options))
    for name in FIGURES:
        print(f"  {name:22s} {mean_interval(rows, name)[0]:.3f}")
    print(f"policy in {args.out / 'ego.zip'}")


if __name__ == "__main__":
    main()
