"""Train an ego against recorded critical traffic; compare it where it learned and elsewhere.

    python examples/train_ego.py --dataroot <nuscenes> --split train --test-split val

The recipe of the shipped ``ego``: banks of CCDiff traffic against PDM-Closed, then PPO that changes
what PDM-Closed does. ``--dynamics unicycle`` imitates PDM-Closed first, and drives without it. The
same command again goes on.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from ccdiff_env import cli
from ccdiff_env.bench.intervals import LEAST_SCENES, permutation_p
from ccdiff_env.bench.jobs import results, run_jobs
from ccdiff_env.bench.planners import TRAFFIC, planner_jobs
from ccdiff_env.record.bank import record_bank
from ccdiff_env.scenes.arguments import (
    add_other_scenes,
    add_scene_arguments,
    other_place,
    place_from,
)
from ccdiff_env.scenes.sources import load
from ccdiff_env.system.table import Column, Table

#: Criticalities of the banks.
BANKS = (1.0, 2.0)
#: The dial: ranges of factors of reward weights.
DIAL = (
    *("--style", "progress", "0.25", "2"),
    *("--style", "collision", "0.5", "4"),
    *("--style", "comfort", "0", "4"),
)
RECIPES = {
    "assisted": ("--base", "pdm", "--anchor", "zero", "--noise", "0.2", "0.1", *DIAL),
    "unicycle": ("--dynamics", "unicycle", "--teacher", "pdm", "--noise", "0.15", "0.08"),
}
OTHERS = ["ego", "pdm", "idm"]
FIGURES = {
    "score": Column("score", head="score"),
    "collision": Column("collision", head="collides %", digits=1, factor=100.0),
}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    parser.add_argument("--dynamics", default="assisted", choices=RECIPES, help="of the ego")
    parser.add_argument("--decisions", default="1e6", help="of training")
    parser.add_argument("--seed", default="0", help="of training")
    parser.add_argument("--workers", type=int, default=2, help="processes, and threads of training")
    parser.add_argument("--out", type=Path, default=Path("runs/train_ego"))
    parser.add_argument("--smoke", action="store_true", help="a run of seconds")
    return parser.parse_args()


def driven(place, planners, traffic, folder: Path, workers: int):
    """Rows of every planner in every traffic, the scenes in the same order."""
    jobs = planner_jobs(str(place), planners, traffic)
    run_jobs(jobs, folder, workers=workers)
    by_name, found = results(jobs, folder), {}
    for job in jobs:
        key = job.arguments["planner"], job.arguments["traffic"]
        found.setdefault(key, []).extend(by_name[job.name])
    return found


def main() -> None:
    args = arguments()
    train, test = place_from(args), other_place(args)
    traffic = ["replay", "ccdiff", "ccdiff-1", "ccdiff-2"]
    scenes = load(train)[: 2 if args.smoke else None]
    banks = [str(args.out / f"bank-{criticality:g}") for criticality in BANKS]
    for bank, criticality in zip(banks, BANKS, strict=True):
        record_bank(scenes, bank, ego="pdm", criticality=criticality, workers=args.workers)
    words = ["--scenes", str(train), "--decisions", args.decisions, "--seed", args.seed]
    words += ["--threads", str(args.workers), "--out", str(args.out)]
    words += [*RECIPES[args.dynamics], "--traffic", "replay", *["bank"] * 3, "--bank", *banks]
    words += ["--resume"] * (args.out / "checkpoint.pt").is_file() + ["--smoke"] * args.smoke
    if cli.main(["train-ego", *words]):
        raise SystemExit(2)
    if args.smoke:
        test, traffic, args.workers = replace(test, limit=2), traffic[:1], 1
    new = str(args.out / "ego.safetensors")
    planners = [new, *OTHERS]
    # as many scenes of training as there are others
    places = {"trained": replace(train, limit=min(len(load(test)), len(load(train))))}
    places["unseen"] = test
    found = {
        name: driven(place, planners, traffic, args.out / name, args.workers)
        for name, place in places.items()
    }
    for figure, column in FIGURES.items():
        heads = [replace(column, head=p) for p in ("new", *OTHERS)]
        less = [replace(column, head="new - idm", sign="+"), Column("p", digits=4)]
        rows = []
        for name, by_key in found.items():
            for t in traffic:
                values = {p: np.array([row[figure] for row in by_key[p, t]]) for p in planners}
                pairs = values[new] - values["idm"]
                means = [float(v.mean()) for v in (*values.values(), pairs)]
                p = permutation_p(pairs) if len(pairs) >= LEAST_SCENES else np.nan
                rows.append([name, TRAFFIC[t].label, *means, p])
        print(f"{Table(['scenes', 'traffic', *heads, *less], rows, column.title)}\n")
    print(f"{len(load(test))} scenes of each; p of the permutation test of signs.")


if __name__ == "__main__":
    main()
