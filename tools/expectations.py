"""What to expect of training: ``python -m tools.expectations`` runs it and writes the tables.

Runs examples/train_ego_sb3.py with some seeds, and keeps how the held-out episodes of its egos, of
IDM and of PDM-Closed end, and their scores: in docs/results, from which the tables of
docs/learning.md are written. ``parts`` runs it without one part of the recipe after the other.
``matrix`` trains egos in each traffic of :data:`TRAINED`, ``data`` on more and more scenes; both
test them on scenes that they never drove. What has finished is not repeated.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.intervals import difference, mean_interval, scene_means
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.bench.provenance import package_digest, sha256_of
from ccdiff_env.scenes import SceneSet
from ccdiff_env.scenes.arguments import (
    add_other_scenes,
    add_scene_arguments,
    other_place,
    place_from,
)
from ccdiff_env.scenes.sources import load
from ccdiff_env.system.settings import kept_settings, sha256
from ccdiff_env.system.table import Cell, Column, Figure, Markdown, Table
from ccdiff_env.training.outcomes import OUTCOMES
from ccdiff_env_cli import parse
from tools import pages
from tools.pages import ROOT, keep

PLANNERS = {
    "ego": "PPO of stable-baselines3",
    "replay": "the log",
    "idm": "IDM on the log's path",
    "pdm": "PDM-Closed",
}
SCORED = ("score", "comfort")  #: Figures of the benchmark beside the shares of the ends.
#: Arguments of the example that leave out a part of its recipe, or put a default in its place.
PARTS = {
    "the whole recipe": "",
    "no clone of the log": "--shown 0",
    "the log's ego alone": '--option ego="ego" standing_share=0',
    "default dynamics": "--dynamics unicycle",
    "default reward": "--option reward={}",
    "ends at the goal": "--option terminate_at_goal=true",
    "decisions of one step": "--option decision_steps=1",
}
#: Arguments of ``train-ego`` for the recipe of the example.
SAME = "--dynamics unicycle --any-ego --worlds 512 --threads 1"
#: Traffic of trainings, as ``train-ego`` takes it, by name of their rows.
TRAINED = {
    "IDM": "idm",
    "swift, criticality 0 to 2": "swift --criticality 2",
    "log replay": "replay",
    # a decision takes more than ten times as long as one of the others
    "CCDiff, criticality 0 to 2": "ccdiff --criticality 2 --decisions 60000",
}
#: Traffic of tests by head of their columns.
TESTED = {
    "replay": "log replay",
    "idm": "IDM",
    "swift": "swift",
    "ccdiff": "CCDiff",
    "ccdiff-1-one-step": "CCDiff, criticality 1",
    "ccdiff-2-one-step": "CCDiff, criticality 2",
}
SCENES = (40, 160, None)  #: Numbers of scenes to train on; the last is all.
MORE = "embedded/city"  #: Scenes beside all of them, in one more row.
DATA_TESTED = ("idm", "ccdiff-1-one-step")  #: Traffic of the tests of ``data``.
#: Figure of each study.
FIGURE = {"matrix": "collision", "data": "success"}
FIGURES = ("collision", "success", "no_at_fault_collision", "on_road", "score")


def trained(args: argparse.Namespace, seed: int, words: str = "") -> tuple[str, Any]:
    """Train by the example, unless it has been done; return the ego's file, and how it went."""
    said = re.sub(r"\W+", "-", words)
    folder: Path = args.out / f"{other_place(args).split}-{args.decisions}-{seed}{said}"
    given = {"scenes": str(place_from(args)), "test_scenes": str(other_place(args))}
    kept_settings(folder / "run.json", given)
    if not (folder / "curve.json").is_file():
        script = [sys.executable, str(ROOT / "examples" / "train_ego_sb3.py")]
        script += ["--scenes", str(place_from(args)), "--test-scenes", str(other_place(args))]
        script += ["--decisions", str(args.decisions), "--seed", str(seed), "--out", str(folder)]
        subprocess.run([*script, *words.split()], check=True)
    run = json.loads((folder / "curve.json").read_text(encoding="utf-8"))
    return str(folder / "ego.zip"), run


def train(folder: Path, words: str) -> float:
    """Train by ``train-ego``, which does not repeat what is done; return its CPU seconds."""
    from ccdiff_env.training.ppo import settings_of  # torch: tables are written without

    kept, before = folder / "cpu_s.json", resource.getrusage(resource.RUSAGE_CHILDREN)
    command = ["train-ego", *words.split(), *SAME.split(), "--out", str(folder)]
    asked = settings_of(parse(command)).items()  # defaults that the command fills in are None
    kept_settings(folder / "run.json", {n: of for n, of in asked if of is not None})
    if not kept.is_file():
        subprocess.run([sys.executable, "-m", "ccdiff_env.cli", *command], check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        taken_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        kept.write_text(json.dumps(taken_s))
    return float(json.loads(kept.read_text()))


def learned(args: argparse.Namespace) -> None:
    """Train egos with all seeds, drive the test scenes, and write."""
    egos, runs = zip(*(trained(args, seed) for seed in range(args.seeds)), strict=True)
    scenes, rows = load(other_place(args)), list[dict[str, Any]]()
    for planner, title in PLANNERS.items():
        own = planner == "ego"
        driven = egos if own else [planner]
        played = [row for p in driven for row in drive(scenes, p, TRAFFIC["idm"])[0]]
        row: dict[str, Any] = {"title": title}
        if own:
            curves = [run["curve"] for run in runs]
            shown = [[*map(float, np.mean(at, axis=0))] for at in zip(*curves, strict=True)]
            spread = [[min(c[i][2] for c in curves), max(c[i][2] for c in curves)]
                      for i in range(len(shown))]  # fmt: skip
            row |= {"decisions": int(shown[-1][0]), "cpu_s": shown[-1][1], "curve": shown}
            row |= {"spread": spread, "seeds": [round(c[-1][2], 4) for c in curves]}
        shares = np.mean([run["outcomes"][planner] for run in runs], axis=0)
        row |= {name: round(100.0 * share, 1) for name, share in zip(OUTCOMES, shares, strict=True)}
        for figure in SCORED:
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


def parts(args: argparse.Namespace) -> None:
    """Train without each part of the recipe, and keep means, least and most of the seeds."""
    scenes, rows = load(other_place(args)), list[dict[str, Any]]()
    for name, words in PARTS.items():
        row: dict[str, Any] = {"part": name}
        egos, runs = zip(*(trained(args, seed, words) for seed in range(args.seeds)), strict=True)
        driven = [drive(scenes, ego, TRAFFIC["idm"])[0] for ego in egos]
        found = {n: [np.mean([each[n] for each in of]) for of in driven] for n in SCORED}
        found["success"] = [run["outcomes"]["ego"][0] for run in runs]
        for figure, of in found.items():
            row[figure] = [round(float(value), 4) for value in (np.mean(of), min(of), max(of))]
        rows.append(row)
    words = f"--decisions {args.decisions} --seeds {args.seeds}"
    keep("learning_parts", {"command": f"python -m tools.expectations parts {words}"}, rows)


def test(folder: Path, scenes: SceneSet, traffic: str) -> list[dict[str, Any]]:
    """Drive the scenes in a kind of traffic, unless it has been done; figures of each."""
    ego = folder / "ego.safetensors"
    made_of = sha256(package_digest(), sha256_of(ego), *(scene.hash for scene in scenes))
    kept = folder / f"{traffic}-{made_of[:16]}.json"
    if not kept.is_file():
        rows, _ = drive(scenes, str(ego), TRAFFIC[traffic])
        kept.write_text(json.dumps([{n: row[n] for n in ("scene", *FIGURES)} for row in rows]))
    found: list[dict[str, Any]] = json.loads(kept.read_text())
    return found


def cell(figure: Figure, note: str = "") -> str:
    """Return a share in percent with its interval."""
    mean, low, high = (100.0 * value for value in figure)
    return f"{mean:.1f} [{low:.1f}, {high:.1f}]{note}"


def study(args: argparse.Namespace) -> None:
    """Train and test all egos, and keep their table after each row."""
    place, scenes, is_matrix = place_from(args), load(other_place(args)), args.study == "matrix"
    trainings = {name: (words, place) for name, words in TRAINED.items()}
    if not is_matrix:
        parts = {n or len(load(place)): replace(place, limit=n) for n in SCENES}
        trainings = {f"{n}": ("idm", part) for n, part in parts.items()}
        more = f"{max(parts)} + {len(load(MORE))} of `city`"
        trainings[more] = (f"idm --more-scenes {MORE}", place)
    tested = TESTED if is_matrix else {traffic: TESTED[traffic] for traffic in DATA_TESTED}
    figure = FIGURE[args.study]
    words = f"--decisions {args.decisions} --seeds {args.seeds} --scenes nuscenes:<nuscenes>/train"
    head: dict[str, Any] = {"command": f"python -m tools.expectations {args.study} {words}"}
    first = "trained in" if is_matrix else "scenes"
    head |= {"figure": figure, "scenes": f"{len(scenes)} scenes of {other_place(args).split}"}
    head |= {"heads": {"trained": first, "cpu_s": "CPU s", **tested}}
    rows, beside = list[dict[str, Any]](), dict[str, dict[str, float]]()
    for name, (traffic, part) in trainings.items():
        folders, taken_s = list[Path](), list[float]()
        for seed in range(args.seeds):
            meant = traffic.replace(" ", "").replace("/", "-")
            run = f"{meant}-{part.limit}-{args.decisions}-{seed}"
            folders.append(args.out / run)
            words = f"--scenes {part} --decisions {args.decisions} --seed {seed}"
            taken_s.append(train(folders[-1], f"{words} --traffic {traffic}"))
        driven = {t: [row for f in folders for row in test(f, scenes, t)] for t in tested}
        shares = {t: mean_interval(of, figure) for t, of in driven.items()}
        rounded = {t: [round(value, 4) for value in of] for t, of in shares.items()}
        means = {t: scene_means(of, figure) for t, of in driven.items()}
        row = {"trained": name, "cpu_s": round(float(np.mean(taken_s))), "shares": rounded}
        rows.append(row | {t: cell(share) for t, share in shares.items()})
        if is_matrix and beside:
            row = {"trained": f"less {rows[0]['trained']}", "cpu_s": ""}
            for t, of in means.items():
                less, p = difference(np.array([of[s] - beside[t][s] for s in of]))
                row[t] = cell(less, f", p {p:.2g}")
            rows.append(row)
        beside = beside or means
        keep(f"learning_{args.study}", head, rows)


def table(rows: list[dict[str, Any]]) -> str:
    """Return a table in Markdown, which fits a phone: a row per figure, a column per planner."""
    shown: list[list[Cell]] = []
    for name in (*OUTCOMES, *SCORED):
        column = Column(name, digits=1 if name in OUTCOMES else 2)
        figures = (tuple(row[name]) if name in SCORED else row[name] for row in rows)
        shown.append([name, *(Markdown(column.text(figure)) for figure in figures)])
    return str(Table(["figure", *(row["title"] for row in rows)], shown))


STUDIES = {"example": learned, "parts": parts, "matrix": study, "data": study}


def main() -> None:
    """Train, drive, and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", nargs="?", default="example", choices=STUDIES)
    parser.add_argument("--out", type=Path, default=Path("runs/expectations"))
    parser.add_argument("--decisions", type=int, default=850_000, help="of each training")
    parser.add_argument("--seeds", type=int, default=3, help="trainings")
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    args = parser.parse_args()
    if args.study not in FIGURE:
        args.scenes = args.scenes or "embedded/city"
    STUDIES[args.study](args)


if __name__ == "__main__":
    main()
    pages.write()
