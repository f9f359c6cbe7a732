"""Learn which vehicle to turn on an ego, when and how strongly; compare with rules.

    python examples/train_adversary_selection.py --scenes nuscenes:<nuscenes>/train \
        --test-scenes nuscenes:<nuscenes>/val+train_val --seeds 3 --test-seeds 3

MaskablePPO of sb3-contrib decides once per plan of CCDiff traffic. Guidance is free at first, then
its cost rises: at a high cost from the start the policy learns to choose no adversary. Policies,
curve, table and picture go to ``--out``; what is there is not made again. Traffic reads a policy by
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

from ccdiff_env import AdversarySelectionVectorEnv
from ccdiff_env.bench import selection
from ccdiff_env.envs.sb3 import SelectionSB3VecEnv
from ccdiff_env.scenes.arguments import (
    add_other_scenes,
    add_scene_arguments,
    place_from,
    scenes_from,
)
from ccdiff_env.system.settings import keep_settings
from ccdiff_env.system.table import document
from ccdiff_env.training.networks import licence_of
from ccdiff_env.training.selection_policy import CandidatePolicy, save_policy

#: Cost per metre of move, one stage of the training after the other.
MOVE_COSTS = (0.0, 0.01, 0.02, 0.03, 0.04, 0.04, 0.04, 0.04)
SEED_STRIDE = 1_000_003  #: Seeds of two trainings share no world.


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    add = parser.add_argument
    add("--ego", default="idm", help="planner of the ego")
    add("--counts", default="all", help="collisions that count, see docs/tasks.md")
    add("--adversaries", type=int, default=1, help="vehicles guided at a time")
    add("--avoidable", action="store_true", help="only plans that the ego can evade")
    add("--steps", type=int, default=12_800, help="decisions per stage")
    add("--worlds", type=int, default=128)
    add("--seeds", type=int, default=1, help="policies to train")
    add("--test-seeds", type=int, default=1, help="episodes per test scene")
    add("--out", type=Path, default=Path("runs/adversary_selection"))
    add("--smoke", action="store_true", help="a short test run")
    return parser.parse_args()


def train(args: argparse.Namespace, scenes, options: dict, path: Path, seed: int) -> None:
    """Train one policy in stages."""
    env = AdversarySelectionVectorEnv(args.worlds, scenes=scenes, num_threads=1, **options)
    # scenes in which the ego can be hit are sampled more often
    everybody = selection.traffics("all", "4", 4.0, num_guided=None)
    hits = selection.play(scenes, everybody, seeds=(0, 1), **options)["is_success"]
    env.worlds.set_scene_weights(0.5 + 2.0 * np.array(hits))
    per_episode = max(env.worlds.config.horizon_steps // env.decision_steps, 1)
    stages, curve, begun, stage = len(MOVE_COSTS), [], time.process_time(), 0
    model = MaskablePPO(
        CandidatePolicy,
        SelectionSB3VecEnv(env),
        learning_rate=lambda left: 1e-3 * max((stages - stage - 1 + left) / stages, 0.05),
        n_steps=2 * per_episode,
        batch_size=per_episode * args.worlds // 2,
        n_epochs=4,
        gamma=1.0,
        ent_coef=0.01,
        stats_window_size=1000,
        seed=seed * SEED_STRIDE,
        device="cpu",
    )
    print(f"policy {seed}: decisions, cost, share of the latest episodes with a collision")
    for stage, env.move_cost in enumerate(MOVE_COSTS):
        model.learn(args.steps)
        hit = float(np.mean(model.ep_success_buffer))
        curve.append([(stage + 1) * args.steps, env.move_cost, hit])
        print(curve[-1], flush=True)
    seconds = time.process_time() - begun
    print(f"{seconds:.0f} CPU seconds, {curve[-1][0] / seconds:.0f} decisions a second")
    path.with_name(f"curve-{seed}.json").write_text(json.dumps(curve))
    notes = {"ego": args.ego, "steps": args.steps, "costs": MOVE_COSTS, "seed": seed}
    notes |= licence_of(place_from(args))
    save_policy(model, path.with_suffix(".safetensors"), env.strengths, **notes)
    model.save(path)


def main() -> None:
    args = arguments()
    torch.set_num_threads(1)
    scenes, unseen = scenes_from(args), scenes_from(args, other=True)
    options = {"ego": args.ego, "counts": args.counts, "num_adversaries": args.adversaries}
    avoidable = {"avoidable_only": True} if args.avoidable else {}
    if args.smoke:
        args.steps, args.worlds, scenes, unseen = 16, 4, scenes[:2], unseen[:1]
    kept = {n: str(of) for n, of in vars(args).items() if n not in ("out", "seeds")}
    keep_settings(args.out / "run.json", kept)
    paths = [args.out / f"policy-{seed}.zip" for seed in range(args.seeds)]
    for seed, path in enumerate(paths):
        if not path.exists():
            ccdiff = {"plan_radius_m": 40.0, **avoidable}
            train(args, scenes, {**options, "ccdiff": ccdiff}, path, seed)
    options["ccdiff"] = {"denoising_steps": 1, **avoidable}
    file, seeds = args.out / "played.json", range(args.test_seeds)
    played = json.loads(file.read_text()) if file.exists() else {}
    choices = selection.rivals() + selection.gated(scenes, **options)
    models = [selection.learned(MaskablePPO.load(path, device="cpu"), path.stem) for path in paths]
    for choice in [*choices[:: 8 if args.smoke else 1], *models]:
        points = played.setdefault(choice.line, {})
        if choice.point not in points:
            points[choice.point] = selection.play(unseen, choice, seeds=seeds, **options)
            file.write_text(json.dumps(played))
    title = (
        f"{len(unseen)} scenes that no training saw, {len(seeds)} episodes of each, ego {args.ego}."
    )
    text = document(title, *selection.table(played))
    (args.out / "table.md").write_text(text)
    selection.plot(played, args.out / "tradeoff.png", ego=args.ego)
    print(text)


if __name__ == "__main__":
    main()
