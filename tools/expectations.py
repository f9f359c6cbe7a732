"""What to expect of training: ``python -m tools.expectations`` runs it and writes the table.

Runs examples/train_ego_sb3.py with each algorithm, then drives the held-out scenes with what it
learned and with planners that learn nothing. Keeps the figures in docs/results/expectations.json
and writes the table of docs/learning.md. A training that has finished is not repeated.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import ccdiff_env
from ccdiff_env.bench.intervals import mean_interval
from ccdiff_env.bench.planners import TRAFFIC, play
from ccdiff_env.system.table import Column, Table

ROOT = Path(__file__).resolve().parents[1]
DATA, PAGE = ROOT / "docs" / "results" / "expectations.json", ROOT / "docs" / "learning.md"
TRAIN, TEST = "embedded/city", "embedded/val"
#: Title, action, and arguments of the example; ``{out}`` is the folder of all runs.
TRAININGS = {
    "ppo": ("PPO", "unicycle", []),
    "ppo_ccdiff": (
        "the same, then in live CCDiff at criticality 1",
        "unicycle",
        [
            *("--traffic", "ccdiff", "--criticality", "1"),
            *("--decisions", "50000", "--start", "{out}/ppo"),
        ],
    ),
    "sac": ("SAC", "unicycle", ["--algorithm", "sac"]),
    "ppo_assisted": (
        "PPO",
        "changes of IDM",
        ["--dynamics", "assisted", "--decisions", "200000"],
    ),
}
#: What plain PPO is without a part of the default: title and options of the example.
WITHOUT = {
    "held": ("actions held for three steps", ["decision_steps=1", "gamma=0.986"]),
    "lean": (
        "the lean observation",
        ['observation={"num_map_segments": 64, "num_neighbors": 16, "num_route_points": 20}'],
    ),
    "weights": (
        "small reward weights",
        [
            'reward={"progress": 0.1, "collision": -10, "off_road": -5, "goal": 2, '
            '"speed_limit": -0.05, "lane_keeping": -0.02}'
        ],
    ),
    "starts": ("starts all over the log", ["start_spread_steps=0"]),
    "gamma": ("the discount of 0.96", ["gamma=0.99"]),
    "noise": ("little noise at first", ['policy_kwargs={"log_std_init": 0.0}']),
}
TRAININGS |= {
    f"without_{name}": (f"PPO without {title}", "unicycle", ["--option", *options])
    for name, (title, options) in WITHOUT.items()
}
TESTED = ("idm", "ccdiff", "ccdiff-1")
SEEDS = range(3)


#: Planners that learn nothing: title and action.
OTHERS = {
    "noop": ("zero action", "unicycle"),
    "constant_velocity": ("constant velocity", ""),
    "idm": ("IDM on the log's path", ""),
    "pdm": ("PDM-Closed", ""),
}


def trained(name: str, out: Path) -> list[list[float]]:
    """Train, unless it has been done; return the learning curve."""
    curve = out / name / "curve.json"
    if not curve.is_file():
        words = [word.replace("{out}", str(out)) for word in TRAININGS[name][2]]
        script = [
            sys.executable,
            str(ROOT / "examples" / "train_ego_sb3.py"),
            "--scenes",
            TRAIN,
            *words,
        ]
        subprocess.run([*script, "--out", str(out / name)], check=True)
    rows: list[list[float]] = json.loads(curve.read_text(encoding="utf-8"))
    return rows


def figures(planner: str, file: Path) -> dict[str, list[float]]:
    """Success in IDM traffic and scores, with intervals over the scenes, unless a file has them."""
    if not file.is_file():
        scenes, found = ccdiff_env.load(TEST), {}
        for traffic in TESTED:
            draws = SEEDS if "ccdiff" in traffic else SEEDS[:1]
            rows = [row for k in draws for row in play(scenes, planner, TRAFFIC[traffic], seed=k)]
            for figure in ("success", "score") if traffic == "idm" else ("score",):
                found[f"{figure} {traffic}"] = [round(v, 4) for v in mean_interval(rows, figure)]
        file.write_text(json.dumps(found), encoding="utf-8")
    kept: dict[str, list[float]] = json.loads(file.read_text(encoding="utf-8"))
    return kept


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table in Markdown."""
    heads = {
        "success idm": Column("success, IDM"),
        "score idm": Column("score, IDM"),
        "score ccdiff": Column("score, CCDiff"),
        "score ccdiff-1": Column("score, CCDiff at criticality 1"),
    }
    shown = [
        [
            row["title"],
            row["action"],
            f"{row['decisions']:,}" if "decisions" in row else "",
            f"{row['cpu_s']:.0f}" if "cpu_s" in row else "",
            *(tuple(row[name]) for name in heads),
        ]
        for row in rows
    ]
    return str(Table(["planner", "action", "decisions", "CPU s", *heads.values()], shown))


def main() -> None:
    """Train, drive, and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/expectations"))
    parser.add_argument("--only", nargs="+", choices=TRAININGS, default=[*TRAININGS])
    args = parser.parse_args()
    out, rows = args.out, list[dict[str, Any]]()
    for name in args.only:
        title, action, _ = TRAININGS[name]
        curve = trained(name, out)
        if name == "ppo":
            rows.append({"title": "PPO, untrained", "action": action})
            rows[-1] |= figures(str(out / name / "untrained.zip"), out / "untrained.json")
        made = {"decisions": int(curve[-1][0]), "cpu_s": curve[-1][1], "curve": curve}
        rows.append({"title": title, "action": action, **made})
        rows[-1] |= figures(str(out / name / "ego.zip"), out / f"{name}.json")
    for planner, (title, action) in OTHERS.items():
        found = figures(planner, out / f"{planner}.json")
        rows.append({"title": title, "action": action, **found})
    kept = {"command": f"python -m tools.expectations --only {' '.join(args.only)}"}
    kept["scenes"] = TEST
    # the second chose observation, reward and settings
    kept |= {"trained_on": TRAIN, "chosen_on": "embedded/city"}
    lines = ",\n  ".join(json.dumps(row) for row in rows)
    DATA.write_text(json.dumps(kept, indent=1)[:-2] + f',\n "rows": [\n  {lines}\n ]\n}}\n')
    render()


def render() -> None:
    """Write the table into the page."""
    mark, end = "<!-- table: expectations -->\n", "<!-- end -->"
    head, _, rest = PAGE.read_text(encoding="utf-8").partition(mark)
    rows = json.loads(DATA.read_text(encoding="utf-8"))["rows"]
    tail = rest[rest.index(end) :]
    PAGE.write_text(f"{head}{mark}\n{table(rows)}\n\n{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
