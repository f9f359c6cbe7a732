"""Train an ego from nothing with stable-baselines3, and watch it learn on scenes it never drives.

    python examples/train_ego_sb3.py
    python examples/train_ego_sb3.py --algorithm sac
    python examples/train_ego_sb3.py --traffic swift --criticality 1 --start runs/train_ego --out on

The first takes two minutes of one core, the last continues it. Each draws its success rate.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize

import ccdiff_env
from ccdiff_env.bench.planners import Traffic, play
from ccdiff_env.envs.sb3 import PPO_SETTINGS, SAC_SETTINGS, SB3VecEnv, save_policy
from ccdiff_env.scenes.arguments import add_other_scenes, add_scene_arguments, scenes_from
from ccdiff_env.system.settings import keep_settings

#: Algorithm, its settings, worlds, and decisions that take about two minutes of one core.
ALGORITHMS = {"ppo": (PPO, PPO_SETTINGS, 128, 1_000_000), "sac": (SAC, SAC_SETTINGS, 32, 50_000)}
FIGURES = ("score", "success", "collision", "on_road", "progress", "comfort")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    parser.add_argument("--algorithm", default="ppo", choices=ALGORITHMS)
    parser.add_argument("--traffic", default="idm", help="driver of the other vehicles")
    parser.add_argument("--criticality", type=float, help="of traffic that can be guided")
    parser.add_argument("--dynamics", default="unicycle", help="model of motion")
    parser.add_argument("--decisions", type=int, help="training decisions (default: two minutes)")
    parser.add_argument("--start", type=Path, help="folder of a run to continue from")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--option", nargs="*", default=[], help="NAME=JSON of worlds or algorithm")
    parser.add_argument("--out", type=Path, default=Path("runs/train_ego"))
    parser.add_argument("--smoke", action="store_true", help="a short test run")
    parser.set_defaults(scenes="embedded/city")  # more is learnt from 200 scenes than from 29
    return parser.parse_args()


def success_rate(model, env: VecNormalize) -> float:
    """Share of successes in one episode of every world, without exploration noise."""
    ended: list[float] = []

    def note(seen: dict, _: dict) -> None:
        if seen["done"]:
            ended.append(seen["info"]["is_success"])

    env.seed(0)
    evaluate_policy(model, env, n_eval_episodes=env.num_envs, callback=note, warn=False)
    return float(np.mean(ended))


class Curve(BaseCallback):
    """Evaluates ten times in a training: decisions, CPU seconds of training, success rate."""

    def __init__(self, env: VecNormalize, decisions: int) -> None:
        super().__init__()
        self.env, self.decisions, self.every = env, decisions, max(decisions // 10, 1)
        self.rows, self.evaluating_s, self.begin_s = [], 0.0, time.process_time()

    def evaluate(self) -> None:
        before = time.process_time()
        rate, taken = success_rate(self.model, self.env), before - self.begin_s - self.evaluating_s
        self.rows.append((self.num_timesteps, taken, rate))
        print(f"{self.num_timesteps:9,d} {taken:5.0f} s {rate:5.0%}", "█" * round(40 * rate))
        self.evaluating_s += time.process_time() - before

    _on_training_start = _on_training_end = evaluate

    def _on_step(self) -> bool:
        if len(self.rows) * self.every <= self.num_timesteps < self.decisions:
            self.evaluate()
        return True


def draw(rows: list[tuple[int, float, float]], path: Path) -> None:
    """Draw the success rate over CPU seconds."""
    last = rows[-1][1]
    points = " ".join(f"{50 + 430 * s / last:.1f},{250 - 230 * rate:.1f}" for _, s, rate in rows)
    line = '<path d="M50 {0}h430" stroke="#ddd"/><text x="8" y="{0}">{1:.0%}</text>'
    lines = "".join(line.format(250 - 230 * share, share) for share in (0, 0.25, 0.5, 0.75, 1))
    path.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="500" height="300" font-family="sans-serif" '
        f'font-size="12"><rect width="500" height="300" fill="#fff"/>{lines}'
        f'<polyline points="{points}" fill="none" stroke="#1f77b4" stroke-width="3"/>'
        '<text x="50" y="285">held-out episodes that succeed, over CPU seconds of training</text>'
        f'<text x="45" y="266">0</text><text x="455" y="266">{last:.0f} s</text></svg>\n'
    )


def main() -> None:
    args = arguments()
    algorithm, settings, worlds, decisions = ALGORITHMS[args.algorithm]
    decisions, held_out = args.decisions or decisions, scenes_from(args, other=True)
    tests = 8 * len(held_out)
    if args.smoke:
        worlds, decisions, tests, held_out = 4, 8, 2, held_out[:1]
        settings = settings | ({"n_steps": 2, "batch_size": 8} if args.algorithm == "ppo" else {})
    options = {"traffic": args.traffic, "dynamics": args.dynamics, "decision_steps": 3}
    options |= {"ccdiff": {"denoising_steps": 1}} if args.traffic == "ccdiff" else {}
    options |= (guided := {"criticality": args.criticality} if args.criticality is not None else {})
    given = {n: json.loads(v) for n, _, v in (word.partition("=") for word in args.option)}
    settings = settings | {n: given.pop(n) for n in [*given] if n in settings}
    options |= {n: ccdiff_env.WorldConfig(**v) if n == "config" else v for n, v in given.items()}
    train = {"start_spread_steps": 50} | options | {"scenes": scenes_from(args)}
    env = VecNormalize(SB3VecEnv(ccdiff_env.make_vec(worlds, **train)), norm_reward=False)
    keep_settings(args.out / "run.json", {n: of and str(of) for n, of in vars(args).items()})
    if args.start:
        env = VecNormalize.load(str(args.start / "normalize.pkl"), env.venv)
    test = options | {"scenes": held_out, "scene_order": "sequential", "start_spread_steps": 30}
    test_env = VecNormalize(SB3VecEnv(ccdiff_env.make_vec(tests, **test)), False, norm_reward=False)
    test_env.obs_rms = env.obs_rms
    model = algorithm("MlpPolicy", env, seed=args.seed, device="cpu", **settings)
    first = args.out / ("start.zip" if args.start else "untrained.zip")
    if args.start:
        started = ccdiff_env.planners.load(args.start / "ego.zip").model
        if type(started) is not algorithm:
            raise SystemExit(f"{args.start} is of {type(started).__name__}, not {args.algorithm}")
        model.set_parameters(started.get_parameters())
    save_policy(model, first)
    print(f"in {args.out}: decisions, CPU seconds, success in {tests} held-out episodes:")
    curve = Curve(test_env, decisions)
    model.learn(decisions, callback=curve)
    save_policy(model, args.out / "ego.zip")
    env.save(str(args.out / "normalize.pkl"))
    draw(curve.rows, args.out / "curve.svg")
    (args.out / "curve.json").write_text(json.dumps(curve.rows) + "\n")
    print(f"\n{'planner':18s}" + "".join(map("{:>10s}".format, FIGURES)))
    traffic = Traffic("", args.traffic, options.get("ccdiff", {}) | guided)
    for planner in (str(first), f"{args.out}/ego.zip", "constant_velocity", "idm"):
        rows = play(held_out, planner, traffic)
        means = (np.mean([row[name] for row in rows]) for name in FIGURES)
        print(f"{Path(planner).stem:18s}" + "".join(f"{mean:10.2f}" for mean in means))


if __name__ == "__main__":
    main()
