"""What to expect of training: ``python -m tools.expectations`` runs it and writes the table.

Runs examples/train_ego_sb3.py with some seeds, and keeps how the held-out episodes of its egos, of
IDM and of PDM-Closed end, and their scores: in docs/results, from which the tables of
docs/learning.md are written. A training that has finished is not repeated.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.intervals import mean_interval
from ccdiff_env.bench.planners import TRAFFIC, play
from ccdiff_env.envs import make_vec
from ccdiff_env.envs.outcomes import OUTCOMES, play_episodes
from ccdiff_env.planners import load_ego
from ccdiff_env.scenes import SceneSet
from ccdiff_env.scenes.arguments import (
    add_other_scenes,
    add_scene_arguments,
    other_place,
    place_from,
)
from ccdiff_env.scenes.sources import load
from ccdiff_env.system.table import Cell, Column, Table
from tools import pages
from tools.pages import ROOT, keep

PLANNERS = {
    "ego": "PPO of stable-baselines3",
    "set": "PPO of train-ego",
    "idm": "IDM on the log's path",
    "pdm": "PDM-Closed",
}
#: Arguments of ``train-ego`` for the same recipe.
SAME = "--dynamics unicycle --any-ego --traffic idm --worlds 512 --threads 1"


def trained(args: argparse.Namespace, seed: int) -> Path:
    """Train by the example, unless it has been done; return the folder."""
    folder: Path = args.out / f"{other_place(args).split}-{args.decisions}-{seed}"
    if not (folder / "curve.json").is_file():
        script = [sys.executable, str(ROOT / "examples" / "train_ego_sb3.py")]
        script += ["--scenes", str(place_from(args)), "--test-scenes", str(other_place(args))]
        script += ["--decisions", str(args.decisions), "--seed", str(seed), "--out", str(folder)]
        subprocess.run(script, check=True)
    return folder


def trained_set(args: argparse.Namespace, seed: int, folder: Path) -> str:
    """Train by ``train-ego``, which does not repeat what is done; return the policy's file."""
    out = folder.with_name(f"{folder.name}-set")
    words = ["--scenes", str(place_from(args)), "--decisions", str(args.decisions)]
    words += ["--seed", str(seed), *SAME.split(), "--out", str(out)]
    subprocess.run([sys.executable, "-m", "ccdiff_env.cli", "train-ego", *words], check=True)
    return str(out / "ego.safetensors")


def ends(scenes: SceneSet, file: str) -> Any:
    """Return the shares of OUTCOMES in the test episodes of a policy, as the example has them."""
    policy = load_ego(file)
    begins: dict[str, Any] = {"scene_order": "sequential", "start_spread_steps": 30, "info": "end"}
    begins |= {"autoreset_mode": "same_step", "traffic": "idm", **policy.env_options}
    return play_episodes(make_vec(8 * len(scenes), scenes=scenes, **begins), policy.act)


def learned(args: argparse.Namespace) -> None:
    """Train egos with all seeds, drive the test scenes, and write."""
    folders = [trained(args, seed) for seed in range(args.seeds)]
    runs = [json.loads((f / "curve.json").read_text(encoding="utf-8")) for f in folders]
    scenes, rows = load(other_place(args)), list[dict[str, Any]]()
    sets = [trained_set(args, seed, folder) for seed, folder in enumerate(folders)]
    for run, file in zip(runs, sets, strict=True):
        run["outcomes"]["set"] = ends(scenes, file)
    for planner, title in PLANNERS.items():
        own = planner == "ego"
        driven = {"ego": [str(f / "ego.zip") for f in folders], "set": sets}.get(planner, [planner])
        played = [row for p in driven for row in play(scenes, p, TRAFFIC["idm"])]
        row: dict[str, Any] = {"title": title}
        if own:
            curves = [run["curve"] for run in runs]
            shown = [[*map(float, np.mean(at, axis=0))] for at in zip(*curves, strict=True)]
            spread = [[min(c[i][2] for c in curves), max(c[i][2] for c in curves)]
                      for i in range(len(shown))]  # fmt: skip
            row |= {"decisions": int(shown[-1][0]), "cpu_s": shown[-1][1], "curve": shown}
            row |= {"spread": spread, "seeds": [round(c[-1][2], 4) for c in curves]}
        if planner == "set":
            row |= {"decisions": args.decisions}
            row |= {"seeds": [round(float(run["outcomes"]["set"][0]), 4) for run in runs]}
        shares = np.mean([run["outcomes"][planner] for run in runs], axis=0)
        row |= {name: round(100.0 * share, 1) for name, share in zip(OUTCOMES, shares, strict=True)}
        for figure in ("score", "comfort"):
            row[figure] = [round(v, 4) for v in mean_interval(played, figure)]
        rows.append(row)
    trained_on, tested_on = place_from(args), other_place(args)
    command = f"python -m tools.expectations --decisions {args.decisions} --seeds {args.seeds}"
    if trained_on.path:
        data = f"--scenes nuscenes:<folder>/{trained_on.split}"
        command += f" {data} --test-scenes nuscenes:<folder>/{tested_on.split}"
    kept = {"command": command, "scenes": tested_on.split, "episodes": 8 * len(scenes)}
    name = "expectations_nuscenes" if trained_on.path else "expectations"
    keep(name, kept | {"trained_on": trained_on.split}, rows)


def table(rows: list[dict[str, Any]]) -> str:
    """Return a table in Markdown, with the columns that its rows have."""
    heads: dict[str, Column | str] = {
        "title": "planner",
        "decisions": "decisions",
        "cpu_s": "CPU s",
        **{name: Column(name, digits=1) for name in OUTCOMES},
        "score": Column("score"),
        "comfort": Column("comfort"),
    }
    heads = {name: head for name, head in heads.items() if any(name in row for row in rows)}

    def cell(row: dict[str, Any], name: str) -> Cell:
        value = row.get(name, "")
        if isinstance(value, list):
            mean, low, high = value
            return mean, low, high
        if isinstance(value, str):
            return value
        return float(value) if name in OUTCOMES else f"{value:,.0f}"

    shown = [[cell(row, name) for name in heads] for row in rows]
    return str(Table([*heads.values()], shown))


def main() -> None:
    """Train, drive, and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/expectations"))
    parser.add_argument("--decisions", type=int, default=700_000, help="of each training by PPO")
    parser.add_argument("--seeds", type=int, default=3, help="trainings")
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    parser.set_defaults(scenes="embedded/city")
    learned(parser.parse_args())


if __name__ == "__main__":
    main()
    pages.write()
