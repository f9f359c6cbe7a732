"""Train the shipped ``ego``: three seeds, the best chosen on one split, reported on another.

    python examples/train_ego.py --scenes nuscenes:<nuscenes>/train \
        --test-scenes nuscenes:<nuscenes>/val

Records banks of CCDiff traffic against PDM-Closed, then trains PPO that changes what PDM-Closed
does. The same command continues a run that was interrupted. The report never uses the scenes that
chose.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from ccdiff_env import cli
from ccdiff_env.bench.intervals import difference, mean_interval, scene_means
from ccdiff_env.bench.jobs import run_jobs
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

BANKS = (1.0, 2.0)  #: Criticalities of the banks.
#: A sixth of the worlds each: the log, IDM, fast critical traffic that reacts, what was recorded.
TRAINED_IN = ("replay", "idm", "swift", "swift", "bank", "bank")
RECIPE = ("--base", "pdm", "--kl", "0.1", "--noise", "0.2", "0.1")
OTHERS = ["pdm", "lane_idm", "idm"]
CHOOSING, REPORTED = ["ccdiff-1", "ccdiff-2"], ["replay", "idm", "ccdiff", "ccdiff-1", "ccdiff-2"]
FIGURES = (
    Column("score", digits=3),
    Column("collision", head="collides %", digits=1, factor=100.0),
    Column("no_at_fault_collision", head="not at fault", digits=3),
    Column("comfort", digits=3),
)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    parser.add_argument(
        "--choose-split", help="scenes that select the seed (default: train_val; embedded: city)"
    )
    parser.add_argument("--decisions", default="7e5", help="decisions per training")
    parser.add_argument("--seeds", type=int, default=3, help="policies to train")
    parser.add_argument("--workers", type=int, default=2, help="processes, and threads of training")
    parser.add_argument("--out", type=Path, default=Path("runs/train_ego"))
    parser.add_argument("--smoke", action="store_true", help="a short test run")
    return parser.parse_args()


def driven(place, planners, traffic, draws: int, folder: Path, workers: int):
    """Rows of every planner and traffic, the scenes in the same order in each draw."""
    jobs = [j for k in range(draws) for j in planner_jobs(str(place), planners, traffic, seed=k)]
    by_name, found = run_jobs(jobs, folder, workers=workers), {}
    for job in jobs:
        key = job.arguments["planner"], job.arguments["traffic"]
        found.setdefault(key, []).extend(by_name[job.name])
    return found


def report(found, planners, traffic) -> tuple[Table, Table]:
    """Figures of all planners, and scores of the first less the others, paired over scenes."""
    rows, pairs = [], []
    for planner, t in product(planners, traffic):
        figures = [mean_interval(found[planner, t], c.name) for c in FIGURES]
        rows.append([Path(planner).stem, TRAFFIC[t].label, *figures])
    for other in planners[1:]:
        for title, some in {"mean of all": traffic, **{t: [t] for t in traffic}}.items():
            new, old = (
                np.mean([[*scene_means(found[who, t], "score").values()] for t in some], axis=0)
                for who in (planners[0], other)
            )
            pairs.append([other, title, *difference(new - old)])
    heads = ["less", "traffic", Column("score", sign="+", digits=3), Column("p", digits=4)]
    return Table(["planner", "traffic", *FIGURES], rows), Table(heads, pairs)


def main() -> None:
    args = arguments()
    train, test = place_from(args), other_place(args)
    choose = replace(train, split=args.choose_split or ("train_val" if train.path else "city"))
    if str(choose) == str(test):
        raise SystemExit(f"{test} cannot both choose and report: name another --choose-split")
    if args.smoke:
        args.seeds, args.workers = 1, 1
        choose, test = replace(choose, limit=1), replace(test, limit=2)
    scenes, draws = load(train)[: 2 if args.smoke else None], 1 if args.smoke else 3
    banks = [str(args.out / f"bank-{criticality:g}") for criticality in BANKS]
    for bank, criticality in zip(banks, BANKS, strict=True):
        record_bank(scenes, bank, ego="pdm", criticality=criticality, workers=args.workers)
    files = []
    for seed in range(args.seeds):
        folder = args.out / f"seed-{seed}"
        files.append(str(folder / "ego.safetensors"))
        words = ["--scenes", str(train), "--decisions", args.decisions, "--seed", str(seed)]
        words += ["--threads", str(args.workers), "--out", str(folder)]
        words += [*RECIPE, "--criticality", "2", "--traffic", *TRAINED_IN]
        words += ["--bank", *banks]
        if cli.main(["train-ego", *words, *["--smoke"] * args.smoke]):
            raise SystemExit(2)
    tried = driven(choose, files, CHOOSING, 1, args.out / "choose", args.workers)
    chose = {f: float(np.mean([r["score"] for t in CHOOSING for r in tried[f, t]])) for f in files}
    new = max(files, key=chose.__getitem__)
    print(f"{new}: the best of {len(files)} on {choose}, {chose[new]:.3f}\n")
    planners, traffic = [new, *OTHERS], REPORTED[: 1 if args.smoke else None]
    found = driven(test, planners, traffic, draws, args.out / "test", args.workers)
    figures, pairs = report(found, planners, traffic)
    print(f"{figures}\n\n{pairs}\n\n{len(load(test))} scenes, {draws} episodes of each;")
    print("95 % intervals; p of the permutation test of signs, paired over scenes.")
    kept = {"trained_on": str(train), "chosen_on": str(choose), "scenes": str(test)}
    kept |= {"choice": chose, "figures": figures.rows, "pairs": pairs.rows}
    (args.out / "result.json").write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
