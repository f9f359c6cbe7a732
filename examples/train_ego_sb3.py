"""Train an ego from nothing with stable-baselines3, and watch it learn on scenes it never drives.

    python examples/train_ego_sb3.py
    python examples/train_ego_sb3.py --algorithm sac
    python examples/train_ego_sb3.py --traffic swift --criticality 1 --start runs/train_ego --out on

They take two and a half and four minutes of one core; the last continues the first.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

import ccdiff_env
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.envs.sb3 import SB3VecEnv, save_policy
from ccdiff_env.scenes.arguments import add_other_scenes, add_scene_arguments, scenes_from
from ccdiff_env.system.settings import keep_settings
from ccdiff_env.training import sb3
from ccdiff_env.training.cloning import demonstrations
from ccdiff_env.training.outcomes import OUTCOMES, play_episodes, red_of_arrivals
from ccdiff_env.training.recipe import LIGHTS, WORLDS, Priced, traffic_options

#: Algorithm, its settings, worlds, and decisions that take two to four minutes of one core.
ALGORITHMS = {
    "ppo": (PPO, sb3.SetPolicy, sb3.PPO_SETTINGS, 512, 850_000),
    "sac": (SAC, "MlpPolicy", sb3.SAC_SETTINGS, 256, 80_000),
}
#: Options of training alone.
TRAINED = {*WORLDS, *LIGHTS} - {"dynamics", "decision_steps"}
FIGURES = ("score", "success", "collision", "on_road", "progress", "comfort")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    parser.add_argument("--algorithm", default="ppo", choices=ALGORITHMS)
    parser.add_argument("--traffic", default="idm", help="driver of the other vehicles")
    parser.add_argument("--criticality", type=float, help="of traffic that can be guided")
    parser.add_argument("--dynamics", help="model of motion (default: the recipe's unicycle)")
    parser.add_argument("--lights", action="store_true", help="scenes have traffic lights")
    parser.add_argument("--decisions", type=int, help="of the training (default: 2 to 4 minutes)")
    parser.add_argument("--shown", type=int, default=100_000, help="logged decisions before PPO's")
    parser.add_argument("--start", type=Path, help="folder of a run to continue from")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--option", nargs="*", default=[], help="NAME=JSON of worlds or algorithm")
    parser.add_argument("--out", type=Path, default=Path("runs/train_ego"))
    parser.add_argument("--smoke", action="store_true", help="a short test run")
    parser.set_defaults(scenes="embedded/city")  # more is learnt from 200 scenes than from 29
    return parser.parse_args()


class Curve(BaseCallback):
    """Evaluates ten times in a training: decisions, CPU seconds of training, success rate."""

    def __init__(self, worlds, act, decisions: int) -> None:
        super().__init__()
        self.worlds, self.act, self.rows, self.begin_s = worlds, act, [], time.process_time()
        self.decisions, self.every = decisions, max(decisions // 10, 1)

    def evaluate(self) -> None:
        taken = (before := time.process_time()) - self.begin_s
        self.shares = play_episodes(self.worlds, self.act)
        rate = float(self.shares[0])
        self.rows.append((self.num_timesteps, taken, rate))
        print(f"{self.num_timesteps:9,d} {taken:5.0f} s {rate:5.0%}", "█" * round(40 * rate))
        self.begin_s += time.process_time() - before

    _on_training_start = _on_training_end = evaluate

    def _on_step(self) -> bool:
        if len(self.rows) * self.every <= self.num_timesteps < self.decisions:
            self.evaluate()
        return True


def table(title: str, heads, rows) -> None:
    print(f"\n{title:18s}" + "".join(map("{:>13s}".format, heads)))
    for name, values in rows:
        print(f"{name:18s}" + "".join(map("{:13.2f}".format, values)))


def main() -> None:
    args = arguments()
    algorithm, policy, settings, worlds, decisions = ALGORITHMS[args.algorithm]
    is_sac = args.algorithm == "sac"
    decisions, held_out = args.decisions or decisions, scenes_from(args, other=True)
    tests, train = 8 * len(held_out), scenes_from(args)
    if args.smoke:
        worlds, decisions, tests, held_out, args.shown = 4, 8, 2, held_out[:1], min(args.shown, 100)
        settings = settings | ({} if is_sac else {"n_steps": 2, "batch_size": 8})
    guided = {"criticality": args.criticality} if args.criticality is not None else {}
    traffic = traffic_options(args.traffic) | guided
    given = {n: json.loads(v) for n, _, v in (word.partition("=") for word in args.option)}
    settings = settings | {n: given.pop(n) for n in [*given] if n in settings}
    given = {n: ccdiff_env.WorldConfig(**v) if n == "config" else v for n, v in given.items()}
    options = WORLDS | (LIGHTS if args.lights else {}) | given
    options |= {"dynamics": args.dynamics} if args.dynamics else {}
    met = {"scenes": train, "info": "end", "num_threads": 1} | traffic | options
    env = SB3VecEnv(Priced(ccdiff_env.make_vec(worlds, **met)), clock_ends=True)
    keep_settings(args.out / "run.json", {n: of and str(of) for n, of in vars(args).items()})
    if args.start:
        started = ccdiff_env.planners.load(args.start / "ego.zip").model
        if type(started) is not algorithm:
            raise SystemExit(f"{args.start} is of {type(started).__name__}, not {args.algorithm}")
    if is_sac:
        kept = args.start and str(args.start / "normalize.pkl")
        env = VecNormalize.load(kept, env) if kept else VecNormalize(env, **sb3.NORMALIZED)
    begins = {"scenes": held_out, "scene_order": "sequential", "start_spread_steps": 30}
    begins |= {"autoreset_mode": "same_step", "info": "end"} | traffic
    given = {n: v for n, v in options.items() if n not in TRAINED}
    if args.lights:
        begins |= {"reward": {"red_light": -1.0}, "observation": LIGHTS["observation"]}
    test = ccdiff_env.make_vec(tests, **begins, **given)
    model = algorithm(policy, env, seed=args.seed, **settings)
    see = env.normalize_obs if is_sac else lambda obs: obs
    act = lambda obs: model.predict(see(obs), deterministic=True)[0]  # noqa: E731
    curve = Curve(test, act, decisions)
    if args.start:
        model.set_parameters(started.get_parameters())
    elif args.shown and args.dynamics != "assisted":
        log = demonstrations(train, args.shown, seed=args.seed, **options)
        planned = Priced(ccdiff_env.make_vec(worlds, driver="pdm", **met)) if is_sac else None
        sb3.clone(model, *log, planned)
    save_policy(model, first := args.out / ("start.zip" if args.start else "clone.zip"))
    red = {"before": red_of_arrivals(test, act, draws=6)} if args.lights else {}
    print(f"in {args.out}: decisions, CPU seconds, success in {tests} held-out episodes:")
    model.learn(decisions, callback=curve)
    save_policy(model, args.out / "ego.zip")
    if is_sac:
        env.save(str(args.out / "normalize.pkl"))
    rules = {n: ccdiff_env.make_vec(tests, driver=n, **begins) for n in ("replay", "idm", "pdm")}
    found = {"ego": curve.shares} | {n: play_episodes(of) for n, of in rules.items()}
    kept = {"curve": curve.rows, "outcomes": {name: [*of] for name, of in found.items()}}
    (args.out / "curve.json").write_text(json.dumps(kept))
    table(f"of {tests} episodes", OUTCOMES, found.items())
    if args.lights:
        red["ego"] = red_of_arrivals(test, act, draws=6)
        red |= {n: red_of_arrivals(of, draws=6) for n, of in rules.items()}
        table("lights", ("arrivals", "that ran red"), red.items())
    seen = replace(of := TRAFFIC[traffic["traffic"]], ccdiff={**of.ccdiff, **guided})
    planners = (str(first), f"{args.out}/ego.zip", "constant_velocity", "idm", "pdm")
    driven = {Path(p).stem: drive(held_out, p, seen)[0] for p in planners}
    means = {p: [np.mean([row[f] for row in of]) for f in FIGURES] for p, of in driven.items()}
    table("in the benchmark", FIGURES, means.items())


if __name__ == "__main__":
    main()
