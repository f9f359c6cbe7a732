"""How an ego fares in scenes it learned in and in others, over the number of scenes.

    python examples/known_and_unseen.py --dataroot <nuscenes> --split train+train_val \
        --test-split val --counts 40 160 640 --seeds 3

Egos learn in log replay, in traffic that reacts, and as any vehicle in both, with hidden
differences. It prints tables. The same command again goes on.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from ccdiff_env import cli
from ccdiff_env.bench.jobs import use_one_thread
from ccdiff_env.bench.planners import TRAFFIC, play
from ccdiff_env.scenes.arguments import (
    add_other_scenes,
    add_scene_arguments,
    other_place,
    place_from,
)
from ccdiff_env.scenes.sources import load, parse
from ccdiff_env.system.table import Column, Table

TRAININGS = {
    "log replay": ("--traffic", "replay"),
    "any vehicle, reacting traffic, differences": (
        *("--any-ego", "--traffic", "replay", "styles"),
        *("--differences", "0.1"),
    ),
    "reacting traffic": ("--traffic", "styles"),
}
TESTS = ("replay", "idm", "ccdiff-1")
FIGURES = {
    "score": Column("score", interval=False),
    "collision": Column("collision", head="collides %", digits=1, factor=100.0, interval=False),
}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    parser.add_argument("--counts", type=int, nargs="+", default=[5, 10, 20], help="of scenes")
    parser.add_argument("--seeds", type=int, default=1, help="trainings of each kind")
    parser.add_argument("--decisions", default="1e6", help="of each training")
    parser.add_argument("--dynamics", default="unicycle", help="as `ccdiff-env train-ego`")
    parser.add_argument("--workers", type=int, default=2, help="processes, of a thread each")
    parser.add_argument("--out", type=Path, default=Path("runs/known_and_unseen"))
    parser.add_argument("--smoke", action="store_true", help="a run of seconds")
    return parser.parse_args()


def trained(folder: Path, train: str, test: str, words: list[str], smoke: bool) -> list[dict]:
    """Train an ego, and drive as many known scenes as unseen ones; rows of figures."""
    use_one_thread()
    kept = folder / "figures.json"
    if kept.is_file():
        return json.loads(kept.read_text())
    resumed = ["--resume"] if (folder / "checkpoint.pt").is_file() else []
    if cli.main(["train-ego", "--scenes", train, "--out", str(folder), *words, *resumed]):
        raise SystemExit(2)
    unseen, known = load(parse(test)), load(parse(train))
    places = {"known": known[: len(unseen)], "unseen": unseen}
    rows = []
    for name, scenes in places.items():
        for traffic in TESTS[:1] if smoke else TESTS:
            ego = str(folder / "ego.safetensors")
            played = [
                row
                for i in range(0, len(scenes), 8)
                for row in play(scenes[i : i + 8], ego, TRAFFIC[traffic])
            ]
            means = {figure: float(np.mean([row[figure] for row in played])) for figure in FIGURES}
            rows.append({"scenes": name, "traffic": traffic, **means})
    kept.write_text(json.dumps(rows))
    return rows


def main() -> None:
    args = arguments()
    train, test, tests = place_from(args), other_place(args), TESTS
    if args.smoke:
        args.counts, test, tests = [2, 4], replace(test, limit=2), TESTS[:1]
    runs = {}
    with ProcessPoolExecutor(args.workers, mp_context=get_context("spawn")) as pool:
        for key in product(TRAININGS, args.counts, range(args.seeds)):
            title, count, seed = key
            own = ["--decisions", args.decisions, "--seed", str(seed), "--threads", "1"]
            own += ["--dynamics", args.dynamics, *["--smoke"] * args.smoke, *TRAININGS[title]]
            folder = args.out / f"{[*TRAININGS].index(title)}-{count}-{seed}"
            place = str(replace(train, limit=count))
            runs[key] = pool.submit(trained, folder, place, str(test), own, args.smoke)
        found = {
            (*key, row["scenes"], row["traffic"]): row
            for key, job in runs.items()
            for row in job.result()
        }

    places = [(scenes, traffic) for traffic in tests for scenes in ("known", "unseen")]
    for figure, column in FIGURES.items():
        heads = [replace(column, head=f"{traffic}, {scenes}") for scenes, traffic in places]
        rows = []
        for title, count in product(TRAININGS, args.counts):
            means = [
                float(np.mean([found[(title, count, s, *at)][figure] for s in range(args.seeds)]))
                for at in places
            ]
            rows.append([title, count, *means])
        print(f"{Table(['training', 'scenes', *heads], rows, column.title)}\n")
    print(f"Means of {args.seeds} trainings of {args.decisions} decisions, {args.dynamics}.")


if __name__ == "__main__":
    main()
