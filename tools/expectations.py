"""What to expect of training: ``python -m tools.expectations`` runs it and writes the table.

Runs examples/train_ego_sb3.py with each algorithm, then drives the held-out scenes with what it
learned and with planners that learn nothing. ``--parts`` instead trains PPO without each part of
the defaults. Keeps the figures in docs/results and writes the tables of docs/learning.md. A
training that has finished is not repeated.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import ccdiff_env
from ccdiff_env.bench.intervals import mean_interval
from ccdiff_env.bench.planners import TRAFFIC, play
from ccdiff_env.system.table import Cell, Column, Table

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "learning.md"
DATA, PARTS_DATA = (ROOT / "docs" / "results" / f"{n}.json" for n in ("expectations", "parts"))
#: The second chose observation, reward and settings, too.
TRAIN, TEST, PARTS_TEST = "embedded/city", "embedded/val", "embedded/train+val"
#: Title, action, and arguments of the example; ``{out}`` is the folder of all runs.
TRAININGS = {
    "ppo": ("PPO", "unicycle", []),
    "ppo_ccdiff": (
        "PPO, then live CCDiff at criticality 1",
        "unicycle",
        [
            *("--traffic", "ccdiff", "--criticality", "1"),
            *("--decisions", "50000", "--start", "{out}/ppo"),
        ],
    ),
    "sac": ("SAC", "unicycle", ["--algorithm", "sac"]),
    "ppo_assisted": ("PPO", "changes of IDM", ["--dynamics", "assisted", "--decisions", "200000"]),
}
#: PPO with all of the defaults, and without a part of them: title and options of the example.
PARTS = {
    "all": ("all of the defaults", []),
    "held": ("a decision every step, discount 0.986", ["decision_steps=1", "gamma=0.986"]),
    "weights": (
        "larger reward weights",
        [
            'reward={"progress": 0.1, "collision": -10, "off_road": -5, "goal": 2, '
            '"speed_limit": -0.05, "lane_keeping": -0.02}'
        ],
    ),
    "gamma": ("discount 0.99", ["gamma=0.99"]),
    "lean": (
        "observation of 1,250 numbers, with the map",
        [
            'config={"observation": {"num_map_segments": 64, "num_neighbors": 16, '
            '"num_route_points": 20}}'
        ],
    ),
}
TRAININGS |= {
    f"part_{name}": (title, "", ["--decisions", "200000", "--option", *options])
    for name, (title, options) in PARTS.items()
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


def figures(planner: str, file: Path, test: str, tested: Sequence[str]) -> dict[str, list[float]]:
    """Success in IDM traffic and scores, with intervals over the scenes, unless a file has them."""
    if not file.is_file():
        scenes, found = ccdiff_env.load(test), {}
        for traffic in tested:
            draws = SEEDS if "ccdiff" in traffic else SEEDS[:1]
            rows = [row for k in draws for row in play(scenes, planner, TRAFFIC[traffic], seed=k)]
            for figure in ("success", "score") if traffic == "idm" else ("score",):
                found[f"{figure} {traffic}"] = [round(v, 4) for v in mean_interval(rows, figure)]
        file.write_text(json.dumps(found), encoding="utf-8")
    kept: dict[str, list[float]] = json.loads(file.read_text(encoding="utf-8"))
    return kept


def table(rows: list[dict[str, Any]]) -> str:
    """Return a table in Markdown, with the columns that its rows have."""
    heads: dict[str, Column | str] = {
        "title": "planner",
        "action": "action",
        "decisions": "decisions",
        "cpu_s": "CPU s",
        "success idm": Column("success, IDM"),
        "score idm": Column("score, IDM"),
        "score ccdiff": Column("score, CCDiff"),
        "score ccdiff-1": Column("score, CCDiff at criticality 1"),
    }
    heads = {name: head for name, head in heads.items() if any(row.get(name) for row in rows)}
    forms = {"decisions": "{:,}", "cpu_s": "{:.0f}"}

    def cell(row: dict[str, Any], name: str) -> Cell:
        value = row.get(name, "")
        return tuple(value) if " " in name else forms.get(name, "{}").format(value) if value else ""

    shown = [[cell(row, name) for name in heads] for row in rows]
    return str(Table([*heads.values()], shown))


def main() -> None:
    """Train, drive, and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/expectations"))
    names = [name for name in TRAININGS if not name.startswith("part_")]
    parser.add_argument("--only", nargs="+", choices=names, default=names)
    parser.add_argument("--parts", action="store_true", help="PPO without parts of the defaults")
    args = parser.parse_args()
    out, rows = args.out, list[dict[str, Any]]()
    test, tested, file = (
        (PARTS_TEST, TESTED[:1], PARTS_DATA) if args.parts else (TEST, TESTED, DATA)
    )
    if args.parts:
        args.only = [f"part_{name}" for name in PARTS]
    for name in args.only:
        title, action, _ = TRAININGS[name]
        curve = trained(name, out)
        if name == "ppo":
            rows.append({"title": "PPO, untrained", "action": action})
            found = figures(str(out / name / "untrained.zip"), out / "untrained.json", test, tested)
            rows[-1] |= found
        made = {"decisions": int(curve[-1][0]), "cpu_s": curve[-1][1], "curve": curve}
        rows.append({"title": title, "action": action, **made})
        rows[-1] |= figures(str(out / name / "ego.zip"), out / f"{name}.json", test, tested)
    for planner, (title, action) in ({} if args.parts else OTHERS).items():
        found = figures(planner, out / f"{planner}.json", test, tested)
        rows.append({"title": title, "action": action, **found})
    which = "--parts" if args.parts else f"--only {' '.join(args.only)}"
    kept = {"command": f"python -m tools.expectations {which}", "scenes": test}
    kept |= {"trained_on": TRAIN, "chosen_on": TRAIN}
    lines = ",\n  ".join(json.dumps(row) for row in rows)
    file.write_text(json.dumps(kept, indent=1)[:-2] + f',\n "rows": [\n  {lines}\n ]\n}}\n')
    render(file)


def render(file: Path) -> None:
    """Write a table into the page."""
    mark, end = f"<!-- table: {file.stem} -->\n", "<!-- end -->"
    head, _, rest = PAGE.read_text(encoding="utf-8").partition(mark)
    rows = json.loads(file.read_text(encoding="utf-8"))["rows"]
    tail = rest[rest.index(end) :]
    PAGE.write_text(f"{head}{mark}\n{table(rows)}\n\n{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
