"""Learn which vehicle to turn on an ego, when and how strongly; compare with rules.

    python examples/train_adversary_selection.py --dataroot <nuscenes> --split train \
        --test-split val+train_val --seeds 3

MaskablePPO of sb3-contrib decides once per plan of CCDiff traffic. Guidance is cheap at first, and
dearer afterwards: where it is dear from the beginning, nobody is all that is learned. Policies,
curve, table and picture go to ``--out``; traffic reads a policy by
``ccdiff={"adversary_policy": "<out>/policy-0.safetensors", "replan_steps": 20}``.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback

from ccdiff_env import AdversarySelectionVectorEnv
from ccdiff_env.bench import selection
from ccdiff_env.envs.sb3 import SelectionSB3VecEnv
from ccdiff_env.envs.selection.sb3_policy import CandidatePolicy, save_policy
from ccdiff_env.scenes.arguments import add_other_scenes, add_scene_arguments, scenes_from
from ccdiff_env.system.table import document

#: Cost per standard deviation of shift, by stage.
SHIFT_COSTS = (0.03, 0.05)
#: Seeds of two trainings share no world.
SEED_STRIDE = 1_000_003


class Curve(BaseCallback):
    """Step, mean return and share of successes of the episodes that ended in each rollout."""

    def _init_callback(self) -> None:
        self.rows, self.recent = [], []

    def _on_step(self) -> bool:
        ended = (i for i in self.locals["infos"] if "episode" in i)
        self.recent += [(i["episode"]["r"], float(i["is_success"])) for i in ended]
        return True

    def _on_rollout_end(self) -> None:
        if self.recent:
            self.rows.append([float(self.num_timesteps), *np.mean(self.recent, axis=0).tolist()])
            self.recent = []


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    parser.add_argument("--ego", default="idm", help="planner of the ego")
    parser.add_argument("--steps", type=int, default=64_000, help="decisions of each stage")
    parser.add_argument("--worlds", type=int, default=128)
    parser.add_argument("--seeds", type=int, default=1, help="policies that are trained")
    parser.add_argument("--test-seeds", type=int, default=1, help="episodes of each test scene")
    parser.add_argument("--out", type=Path, default=Path("runs/adversary_selection"))
    parser.add_argument("--smoke", action="store_true", help="a run of seconds")
    return parser.parse_args()


def hit_by_all(scenes, ego: str) -> np.ndarray:
    """How often each scene's ego collides where all vehicles are guided at strength 4, of two."""
    everybody = selection.Choice(
        "all", "4", lambda env: [(None, 4.0)] * env.num_envs, {"num_guided": None}
    )
    rows = selection.play(scenes, everybody, ego=ego, seeds=(0, 1), plan_radius_m=40.0)
    hits = {scene.name: 0.0 for scene in scenes}
    for row in rows:
        hits[row["scene"]] += row["is_success"]
    return np.array(list(hits.values()))


def train(args: argparse.Namespace, scenes, weights: np.ndarray, seed: int) -> list[list[float]]:
    """Train one policy in stages; returns its curve."""
    env = AdversarySelectionVectorEnv(
        args.worlds, scenes=scenes, ego=args.ego, num_threads=1, ccdiff={"plan_radius_m": 40.0}
    )
    env.worlds.set_scene_weights(0.5 + weights)
    per_episode = max(env.worlds.config.horizon_steps // env.decision_steps, 1)
    model = MaskablePPO(
        CandidatePolicy,
        SelectionSB3VecEnv(env),
        learning_rate=lambda left: 1e-3 * max(left, 0.05),
        n_steps=2 * per_episode,
        batch_size=per_episode * args.worlds // 2,
        n_epochs=4,
        gamma=1.0,
        ent_coef=0.01,
        seed=seed * SEED_STRIDE,
        device="cpu",
    )
    curve = []
    for stage, cost in enumerate(SHIFT_COSTS):
        env.shift_cost = cost
        callback = Curve()
        model.learn(args.steps, callback=callback)
        curve += [[step + stage * args.steps, *rest] for step, *rest in callback.rows]
    model.save(args.out / f"policy-{seed}.zip")
    notes = {"ego": args.ego, "steps": args.steps, "costs": SHIFT_COSTS, "seed": seed}
    save_policy(model, args.out / f"policy-{seed}.safetensors", env.strengths, notes)
    return curve


def main() -> None:
    args = arguments()
    torch.set_num_threads(1)
    scenes, unseen = scenes_from(args), scenes_from(args, other=True)
    choices = selection.rivals(forks=False)
    if args.smoke:
        args.steps, args.worlds, scenes, unseen = 64, 4, scenes[:2], unseen[:1]
        choices = choices[:3]
    args.out.mkdir(parents=True, exist_ok=True)
    begun = time.process_time()
    weights = hit_by_all(scenes, args.ego)
    for seed in range(args.seeds):
        if not (args.out / f"policy-{seed}.safetensors").exists():
            curve = train(args, scenes, weights, seed)
            (args.out / f"curve-{seed}.json").write_text(json.dumps(curve))
            spent = f"{time.process_time() - begun:.0f} s of a processor"
            hits = f"{curve[0][2]:.0%}, then {curve[-1][2]:.0%}"
            print(f"policy {seed}: the ego collides in {hits}; {spent}")
    choices += [
        selection.learned("learned", args.out / f"policy-{seed}.safetensors")
        for seed in range(args.seeds)
    ]
    played = {
        (choice.line, choice.point): selection.play(
            unseen, choice, ego=args.ego, seeds=range(args.test_seeds)
        )
        for choice in choices
    }
    (args.out / "rows.json").write_text(
        json.dumps([{"line": k[0], "point": k[1], "rows": rows} for k, rows in played.items()])
    )
    what = f"{len(unseen)} unseen scenes, {args.test_seeds} episodes of each, ego {args.ego}."
    text = document(what, *selection.table(played, ["learned"]))
    (args.out / "table.md").write_text(text)
    selection.plot(played, ["learned"], args.out / "tradeoff.png", ego=args.ego)
    print(text)


if __name__ == "__main__":
    main()
