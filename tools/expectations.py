"""What to expect of training: ``python -m tools.expectations`` runs it and writes the table.

Runs examples/train_ego_sb3.py with each algorithm, then drives the held-out scenes with what it
learned and with planners that learn nothing. ``--traffics`` instead trains egos in kinds of traffic
and drives the test scenes in five-step CCDiff at criticality 1. Keeps the figures in docs/results
and writes the tables of docs/learning.md. A training that has finished is not repeated.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import ccdiff_env
from ccdiff_env.bench.intervals import difference, mean_interval, scene_means
from ccdiff_env.bench.planners import TRAFFIC, play
from ccdiff_env.scenes.arguments import (
    add_other_scenes,
    add_scene_arguments,
    other_place,
    place_from,
)
from ccdiff_env.scenes.sources import load
from ccdiff_env.system.table import Cell, Column, Table
from ccdiff_env.traffic import SWIFT
from tools import pages
from tools.pages import ROOT, keep

TRAIN, TEST = "embedded/city", "embedded/val"
#: Title, and arguments of the example; ``{out}`` is the folder of all runs.
TRAININGS = {
    "ppo": ("PPO", []),
    "ppo_ccdiff": (
        "PPO, then live CCDiff at criticality 1",
        [
            *("--traffic", "ccdiff", "--criticality", "1"),
            *("--decisions", "50000", "--start", "{out}/ppo"),
        ],
    ),
    "sac": ("SAC", ["--algorithm", "sac"]),
    "ppo_assisted": ("PPO, changes of IDM", ["--dynamics", "assisted", "--decisions", "200000"]),
}
#: Traffic to train in, and about how many decisions PPO makes in a second of a processor in
#: each, for egos that begin with nothing and for those that change PDM-Closed: options of the verb.
TRAFFICS = {
    "from nothing": (
        ["--dynamics", "unicycle"],
        {"ccdiff": 1_000, SWIFT: 9_000, "bank": 11_000, "idm": 10_000},
    ),
    "about PDM-Closed": (
        ["--base", "pdm", "--anchor", "zero", "--noise", "0.2", "0.1"],
        {"ccdiff": 600, SWIFT: 1_200, "bank": 1_400, "idm": 1_300},
    ),
}
TESTED = ("idm", "ccdiff", "ccdiff-1")
SEEDS = range(3)  #: Of draws.
#: Planners that learn nothing.
OTHERS = {
    "constant_velocity": "constant velocity, as the zero action",
    "idm": "IDM on the log's path",
    "pdm": "PDM-Closed",
}


def trained(name: str, out: Path, seed: int) -> Path:
    """Train, unless it has been done; return the folder."""
    folder = out / (f"{name}-{seed}" if seed else name)
    if not (folder / "curve.json").is_file():
        words = [word.replace("{out}", str(out)) for word in TRAININGS[name][1]]
        script = [
            sys.executable,
            str(ROOT / "examples" / "train_ego_sb3.py"),
            "--scenes",
            TRAIN,
            *words,
            *("--seed", str(seed)),
        ]
        subprocess.run([*script, "--out", str(folder)], check=True)
    return folder


def figures(planners: Sequence[Path | str], file: Path) -> dict[str, list[float]]:
    """Success in IDM traffic and scores, with intervals over the scenes, unless a file has them."""
    if not file.is_file():
        scenes, found = ccdiff_env.load(TEST), {}
        for traffic in TESTED:
            draws = product(planners, SEEDS if "ccdiff" in traffic else SEEDS[:1])
            rows = [r for p, k in draws for r in play(scenes, str(p), TRAFFIC[traffic], seed=k)]
            for figure in ("success", "score") if traffic == "idm" else ("score",):
                found[f"{figure} {traffic}"] = [round(v, 4) for v in mean_interval(rows, figure)]
        file.write_text(json.dumps(found), encoding="utf-8")
    kept: dict[str, list[float]] = json.loads(file.read_text(encoding="utf-8"))
    return kept


def table(rows: list[dict[str, Any]]) -> str:
    """Return a table in Markdown, with the columns that its rows have."""
    heads: dict[str, Column | str] = {
        "title": "planner",
        "traffic": "trained in",
        "decisions": "decisions",
        "cpu_s": "CPU s",
        "success idm": Column("success, IDM"),
        "score idm": Column("score, IDM"),
        "score ccdiff": Column("score, CCDiff"),
        "score ccdiff-1": Column("score, CCDiff at criticality 1"),
        "time cpu_s": "CPU s",
        "time score": Column("score", interval=False),
        "time less live": Column("less live CCDiff", sign="+"),
        "decisions cpu_s": "CPU s, equal decisions",
        "decisions score": Column("score", interval=False),
        "decisions less live": Column("less live CCDiff", sign="+"),
    }
    heads = {name: head for name, head in heads.items() if any(row.get(name) for row in rows)}

    def cell(row: dict[str, Any], name: str) -> Cell:
        value = row.get(name, "")
        if isinstance(value, list):
            return tuple(value)
        return value if isinstance(value, str) else f"{value:,.0f}"

    shown = [[cell(row, name) for name in heads] for row in rows]
    return str(Table([*heads.values()], shown))


def trained_in(
    args: argparse.Namespace, ego: str, traffic: str, decisions: int, seed: int
) -> dict[str, Any]:
    """Train an ego in some traffic, unless it has been done; return CPU time and test figures."""
    folder: Path = args.out / f"{ego.split()[-1]}-{traffic}-{decisions}-{seed}"
    if not (folder / "figures.json").is_file():
        words = ["train-ego", *TRAFFICS[ego][0], "--scenes", str(place_from(args)), "--traffic"]
        words += [traffic, "--criticality", "2", "--worlds", "256", "--decisions", str(decisions)]
        words += ["--bank", str(args.out / "bank")] if traffic == "bank" else []
        words += ["--threads", "1", "--seed", str(seed), "--out", str(folder)]
        begun = sum(os.times()[2:4])
        subprocess.run([sys.executable, "-m", "ccdiff_env.cli", *words], check=True)
        found: dict[str, Any] = {"cpu_s": sum(os.times()[2:4]) - begun}
        policy = str(folder / "ego.safetensors")
        found["rows"] = play(load(other_place(args)), policy, TRAFFIC["ccdiff-1"], seed=seed)
        (folder / "figures.json").write_text(json.dumps(found, default=float), encoding="utf-8")
    kept: dict[str, Any] = json.loads((folder / "figures.json").read_text(encoding="utf-8"))
    return {"decisions": decisions, **kept}


def traffics(args: argparse.Namespace) -> None:
    """Train egos in each traffic for equal time and for equal decisions, drive, and write."""
    ccdiff_env.record_bank(
        load(place_from(args)), args.out / "bank", ego="idm", criticality=1.0, workers=1
    )
    runs: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for seed, (ego, (_, paces)) in product(range(args.seeds), TRAFFICS.items()):
        for budget, traffic in product(("time", "decisions"), paces):
            pace = paces["ccdiff" if budget == "decisions" else traffic]
            run = trained_in(args, ego, traffic, args.seconds * pace, seed)
            runs.setdefault((ego, budget, traffic), []).append(run)
    table_rows: dict[tuple[str, str], dict[str, Any]] = {}
    for (ego, budget, traffic), of in runs.items():
        if traffic == "ccdiff" and budget == "decisions":  # the same as for equal time
            continue
        some, live = (
            [row for run in each for row in run["rows"]]
            for each in (of, runs[ego, budget, "ccdiff"])
        )
        own, other = ([*scene_means(rows, "score").values()] for rows in (some, live))
        less, p = difference(np.subtract(own, other))
        row = table_rows.setdefault((ego, traffic), {"title": ego, "traffic": traffic})
        row.setdefault("decisions", of[0]["decisions"])
        row[f"{budget} cpu_s"] = float(np.mean([run["cpu_s"] for run in of]))
        row[f"{budget} score"] = [round(v, 4) for v in mean_interval(some, "score")]
        if traffic != "ccdiff":
            row[f"{budget} less live"] = [round(v, 4) for v in less]
            row[f"{budget} p"] = round(p, 4)
    kept = {"command": "python -m tools.expectations --traffics", "seconds": args.seconds}
    places = {"scenes": other_place(args), "trained_on": place_from(args)}
    kept |= {name: place.split if place.path else str(place) for name, place in places.items()}
    keep("traffics", kept | {"seeds": args.seeds}, table_rows.values())


def main() -> None:
    """Train, drive, and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/expectations"))
    parser.add_argument("--only", nargs="+", choices=TRAININGS, default=[*TRAININGS])
    parser.add_argument("--traffics", action="store_true", help="egos trained in kinds of traffic")
    parser.add_argument("--seconds", type=int, default=60, help="of a processor, of --traffics")
    parser.add_argument("--seeds", type=int, default=3, help="trainings of ppo or --traffics each")
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    args = parser.parse_args()
    if args.traffics:
        return traffics(args)
    out, rows = args.out, list[dict[str, Any]]()
    for name in args.only:
        folders = [trained(name, out, k) for k in range(args.seeds if name == "ppo" else 1)]
        if name == "ppo":
            untrained = [folder / "untrained.zip" for folder in folders]
            rows.append({"title": "PPO, untrained", **figures(untrained, out / "untrained.json")})
        curves = [json.loads((f / "curve.json").read_text(encoding="utf-8")) for f in folders]
        curve = np.mean(curves, axis=0).tolist()
        made = {"decisions": int(curve[-1][0]), "cpu_s": curve[-1][1], "curve": curve}
        found = figures([folder / "ego.zip" for folder in folders], out / f"{name}.json")
        rows.append({"title": TRAININGS[name][0], **made, **found})
    for planner, title in OTHERS.items():
        rows.append({"title": title, **figures([planner], out / f"{planner}.json")})
    which = f"--only {' '.join(args.only)} --seeds {args.seeds}"
    kept = {"command": f"python -m tools.expectations {which}", "scenes": TEST}
    keep("expectations", kept | {"trained_on": TRAIN, "chosen_on": TRAIN}, rows)


if __name__ == "__main__":
    main()
    pages.write()
