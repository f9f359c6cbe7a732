"""Tables of results: ``python -m tools.results [NAME ...] --scenes SOURCE`` runs their benchmarks.

A run keeps what a table shows in ``docs/results/NAME.json``: command, version, commit, hash of the
weights, processor, date, rows; ``tools.pages`` writes the tables into the pages. A run on other
scenes than the kept table's, as 150 of ``val``, is kept beside it, as ``NAME_150``. ``grid`` has a
row per method, and a figure in a column per K and T. A run that was interrupted is resumed.
"""

from __future__ import annotations

import argparse
import csv
import datetime
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.methods import METHODS, label_of
from ccdiff_env.bench.planner_report import short_name
from ccdiff_env.bench.planners import TRAFFIC, is_privileged
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.scenes.sources import parse
from ccdiff_env.system.table import Cell, Column, Table, TableRows, document
from tools import charts, pages
from tools.pages import keep, kept

#: Splits of nuScenes that trained or chose what the package has: they must not report it.
USED_FOR = dict.fromkeys(("ego", "ego_replay", "ppo", "ccdiff", "tokens"), "train+train_val")


@dataclass(frozen=True)
class Made:
    """A command of ``ccdiff-env``, a file that it writes, and which of its figures the docs show.

    ``keys`` name a row, of rows that have the values ``where``; those of the same keys are
    averaged. With ``pivot`` each value of that field is a column, whose figure is the score.
    ``part`` is what follows the folder of the scenes, where it is not the source's own.
    """

    command: str
    keys: tuple[str, ...]
    columns: dict[str, Column]
    where: Mapping[str, str] = field(default_factory=dict)
    pivot: str | None = None
    file: str = "figures.csv"
    part: str = ""


_PLANNERS = Made(
    f"bench planners --protocol {PROTOCOL.name} --level smoke --planners "
    "lane_idm,pdm,ego,ppo,idm,replay,constant_velocity,noop,ccdiff,ego_replay",
    ("planner",),
    {
        "mean": Column("mean"),
        "worst": Column("worst"),
        "replay": Column("replay", interval=False),
        "IDM calm": Column("idm-calm", interval=False),
        "IDM": Column("idm", interval=False),
        "IDM hasty": Column("idm-hasty", interval=False),
        "CCDiff 0": Column("ccdiff", interval=False),
        "CCDiff 1": Column("ccdiff-1", interval=False),
        "CCDiff 2": Column("ccdiff-2", interval=False),
        "tokens": Column("tokens", interval=False),
    },
    pivot="traffic",
)
_EGOS = (
    "bench planners --planners idm,lane_idm,pdm,ego,ppo --seeds 0,1,2 "
    "--traffic replay,idm,ccdiff,ccdiff-1,ccdiff-2"
)
_NUPLAN = Made(
    "bench planners --planners nuplan:pdm_closed_planner,pdm "
    "--traffic replay,idm,ccdiff-1 --seeds 0 --nuplan-score",
    ("traffic", "figure"),
    {
        "original": Column("value", digits=3),
        "ours": Column("other", digits=3),
        "difference": Column("difference", digits=3, sign="+"),
        "p": Column("p", digits=4),
    },
    where={"planner": "nuplan:pdm_closed_planner", "against": "pdm"},
    file="pairs.csv",
)
_SCR, _ORR = Column("scr"), Column("orr", interval=False)
_FDE, _CFD = Column("fde", digits=1, interval=False), Column("cfd", digits=1, interval=False)
_TRAFFIC = {"SCR": _SCR, "off road %": _ORR, "FDE m": _FDE, "CFD": _CFD}
_GUIDED = {**_TRAFFIC, "moved at 2 s m": Column("moved_m", interval=False)}

_REALISM = Made(
    "bench realism --samples 16 --methods replay,constant_velocity,idm,swift,ccdiff_one_sample,"
    "ccdiff_careful,ccdiff_one_step_one_sample,ccdiff_routes_careful,ccdiff_routes_calibrated,"
    "tokens_careful,tokens_routes_one_sample,tokens_routes_careful",
    ("method",),
    {
        "realism": Column("realism", digits=3),
        "kinematic": Column("kinematic", digits=3),
        "at 0.5 s": Column("kinematic_half_s", digits=3, interval=False),
        "own kinematic": Column("own_kinematic", digits=3, interval=False),
        "interactive": Column("interactive", digits=3),
        "map": Column("map", digits=3),
        "min ADE m": Column("min_ade_m", interval=False),
        "SCR": Column("scr", digits=3, interval=False),
        "off road %": Column("orr", factor=100.0, interval=False),
    },
)

_ABLATION = Made(
    "bench traffic --k 1,2 --methods "
    "ccdiff,ccdiff_no_enc,ccdiff_distance,ccdiff_first,ccdiff_random,ccdiff_reach",
    ("method", "K", "replan_s"),
    _GUIDED,
)
_RANKINGS = replace(
    _ABLATION,
    keys=("method", "K", "moving"),
    columns={
        "scenes": Column("scenes", digits=0, interval=False),
        "SCR less random": Column("scr_controlled", sign="+"),
        "brought about less random": Column("scr_by_controlled", sign="+"),
    },
    file="rankings.csv",
)
_ONE = "_one_sample"
_STEPS = (4_000, 10_000, 20_000, 40_000, 120_000)  #: Of trainings, at which the docs show them.

_MATCHED = Made(
    "bench traffic --k 5 --match 0.3,0.5,0.7 --strengths 0.5,1,1.5,3 --methods "
    "ccdiff_equal,ccdiff_one_step,simnet,trafficsim,strive,bits,ctg,ctgpp",
    ("at_scr", "method"),
    {
        "FDE m": Column("fde", digits=1),
        "CFD": Column("cfd", digits=1),
        "end-bin CFD": Column("cfd_end_bins", digits=1),
        "hard accel. %": Column("hard_acceleration", digits=1, interval=False),
        "hard jerk %": Column("hard_jerk", digits=1, interval=False),
        "off road %": Column("orr_box", interval=False),
    },
    where={"less": ""},
    file="matched.csv",
)

TABLES: dict[str, Made] = {
    **{
        f"planners_{level}": replace(
            _PLANNERS,
            command=_PLANNERS.command.replace("smoke", level)
            + f" --seeds {','.join(map(str, range(fields['num_seeds'])))}",
        )
        for level, fields in PROTOCOL.fields["levels"].items()
    },
    "realism": _REALISM,
    "realism_rivals": replace(
        _REALISM,
        command="bench realism --samples 16 --methods simnet_unguided,trafficsim_one_sample,"
        "strive_one_sample,bits_one_sample,ctg_one_sample,ctgpp_one_sample,ccdiff_equal_one_sample",
    ),
    "egos": Made(
        _EGOS,
        ("planner", "traffic"),
        {
            "score": Column("score", digits=3),
            "collides %": Column("collision", digits=1, factor=100.0),
            "not at fault": Column("no_at_fault_collision", digits=3, interval=False),
            "comfort": Column("comfort", digits=3, interval=False),
        },
    ),
    "ego_pairs": Made(
        _EGOS,
        ("against", "traffic"),
        {
            "ppo less it": Column("difference", digits=3, sign="+"),
            "p": Column("p", digits=4, interval=False),
        },
        where={"planner": "ppo", "figure": "score"},
        file="pairs.csv",
    ),
    "dial": Made(
        "bench planners --planners idm --seeds 0 --traffic ccdiff,ccdiff-1,ccdiff-1-one-step,"
        "ccdiff-1-routes,ccdiff-1-routes-one-step,tokens,tokens-1,ccdiff-2,ccdiff-2-one-step,"
        "ccdiff-2-routes,ccdiff-2-routes-one-step,tokens-2",
        ("traffic",),
        {
            "IDM collides %": Column("collision", digits=1, factor=100.0),
            "score": Column("score", interval=False),
        },
    ),
    "dial_planners": Made(
        "bench planners --planners lane_idm,pdm,ego --seeds 0 --traffic "
        "ccdiff,ccdiff-0.5,ccdiff-1,ccdiff-1.5,ccdiff-2",
        ("planner", "traffic"),
        {
            "collides %": Column("collision", digits=1, factor=100.0),
            "without fault in a collision": Column("no_at_fault_collision"),
        },
    ),
    "swift": Made(
        "bench planners --planners idm,pdm,ego --seeds 0,1,2 --traffic swift,swift-1,swift-2",
        ("planner", "traffic"),
        {"collides %": Column("collision", digits=1, factor=100.0)},
    ),
    "matrix": Made(
        "bench scenarios --limit 40 --generators idm,lane_idm,constant_velocity,replay,pdm,"
        "ccdiff,ego --planners idm,lane_idm,constant_velocity,pdm,ego",
        ("planner",),
        {
            "collides": Column("collision", interval=False),
            "at fault": Column("at_fault", interval=False),
            "score": Column("score", interval=False),
        },
        where={"scenarios": "avoidable"},
    ),
    "nuplan": _NUPLAN,
    "nuplan_idm": replace(
        _NUPLAN,
        command=_NUPLAN.command.replace("pdm_closed_planner,pdm", "idm_planner,lane_idm"),
        where={"planner": "nuplan:idm_planner", "against": "lane_idm"},
    ),
    "grid": Made(
        "bench traffic --k 2,5,Full --methods simnet,trafficsim,strive,bits,ctg,ctgpp,ccdiff_equal",
        ("method", "K", "replan_s"),
        {**_GUIDED, "CS": Column("cs"), "RS": Column("rs")},
    ),
    "matched": _MATCHED,
    "matched_less": replace(
        _MATCHED,
        keys=("method",),
        columns={
            head: replace(column, interval=True, sign="+")
            for head, column in _MATCHED.columns.items()
        },
        where={"less": "ccdiff_equal", "at_scr": "0.5"},
    ),
    "samples": Made(
        "bench traffic --k 2,5,Full --methods simnet_unguided,trafficsim_samples,"
        "strive_one_sample,bits_samples,ctg,ccdiff_equal",
        ("method", "K", "replan_s"),
        {"SCR": _SCR, "CS": Column("cs"), "RS": Column("rs")},
    ),
    "ablation": _ABLATION,
    "rankings": _RANKINGS,
    "rankings_dense": replace(_RANKINGS, part="@v1.0-mini/val"),
    "rankings_idm": Made(
        f"{_ABLATION.command.replace('1,2', '1').replace('ccdiff_no_enc,', '')} --others idm",
        ("method",),
        {
            "SCR": Column("scr_controlled", interval=False),
            "brought about": Column("scr_by_controlled", interval=False),
        },
        where={"K": "1"},
    ),
    "training": Made(
        "train",
        ("method",),
        {
            **{f"{step // 1000}k steps": Column(str(step)) for step in _STEPS},
            "ADE at last": Column("ade_m"),
        },
    ),
    "seeds": Made(
        "bench realism --samples 16, with --weights of tools.train_all",
        ("method",),
        {f"realism {k}": Column(f"realism_{k}", digits=3, interval=False) for k in range(2)},
    ),
    "interventional": Made(
        "bench traffic --k 5 --methods ccdiff_unguided,ccdiff_cfg-1.3_unguided,"
        "ccdiff_cfg-1.6_unguided,ccdiff_cfg-1.9_unguided,"
        "ccdiff,ccdiff_cfg-1.3,ccdiff_cfg-1.6,ccdiff_cfg-1.9",
        ("method",),
        _GUIDED,
    ),
    "steps": Made(
        "bench traffic --k 5 --methods ccdiff_one_sample,ccdiff_one_step_one_sample,"
        "ccdiff,ccdiff_one_step",
        ("method",),
        _GUIDED,
    ),
}


def record(name: str, source: str, workers: int, folder: Path) -> None:
    """Run the command of a table, and keep what the docs show."""
    table = TABLES[name]
    if name == "training":
        head = {
            "command": "python -m tools.train_all",
            "held_out": "every 16th scene of train and train_val",
        }
        keep(name, head | {"date": datetime.date.today().isoformat()}, _curves(folder.parent))
        return
    if name == "seeds":
        about, figures = _seeds(folder, source, workers)
    else:
        folder_of = f"nuscenes:{parse(source).path}"
        scenes = ["--scenes", folder_of + table.part if table.part else source]
        if "--protocol" in table.command:
            own = "embedded" in PROTOCOL.fields["levels"][name.removeprefix("planners_")]
            scenes = [] if own else ["--scenes", folder_of]
        about, rows = _run([*shlex.split(table.command), *scenes], folder, workers, table.file)
        figures = _kept(table, rows)
    made = about["made_with"]
    head = {
        "command": f"ccdiff-env {table.command}",
        "scenes": about["coverage"],
        "weights": about["weights"],
        **{key: made[key] for key in ("version", "commit", "processor")},
        "date": datetime.date.today().isoformat(),
    }
    keep(_own_name(name, about["coverage"]), head, figures)


def _own_name(name: str, coverage: str) -> str:
    """Return the name to keep a table by: one of its own where the kept one is of other scenes."""
    is_kept = (pages.DATA / f"{name}.json").is_file()
    others = is_kept and kept(name)["scenes"] != coverage
    return f"{name}_{coverage.partition(' ')[0]}" if others else name


def _run(
    command: list[str], folder: Path, workers: int, file: str = "figures.csv"
) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """Run a command of ``ccdiff-env``; return what its folder says of it, and rows of a file."""
    run = [sys.executable, "-m", "ccdiff_env.cli", *command, "--workers", str(workers)]
    subprocess.run([*run, "--out", str(folder), "--quiet"], check=True, stdout=subprocess.DEVNULL)
    with (folder / file).open(encoding="utf-8") as rows:
        about = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        return about, list(csv.DictReader(rows))


def _seeds(folder: Path, source: str, workers: int) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Realism of the networks that were trained with two seeds, the first one shipped.

    Weights of the others are in folders beside the run's, named as in tools/trainings.json.
    """
    about, found = dict[str, Any](), list[dict[str, Any]]()
    command = TABLES["realism_rivals"].command.partition("--methods")[0]
    for method in ("bits", "ctgpp", "ccdiff_equal"):
        network = method.removesuffix("_equal")
        (shipped,) = (r for r in kept("realism_rivals")["rows"] if r["method"] == method + _ONE)
        row: dict[str, Any] = {"method": method, "realism_0": shipped["realism"]}
        weights = folder.parent / f"{method}_1" / "weights.safetensors"
        given = ["--methods", network + _ONE, "--weights", f"{network}={weights}"]
        own = [*shlex.split(command), *given, "--scenes", source]
        about, rows = _run(own, folder / f"{method}_1", workers)
        row["realism_1"] = _figure([r for r in rows if r["method"] == network + _ONE], "realism")
        found.append(row)
    return about, found


def _curves(folder: Path) -> list[dict[str, Any]]:
    """Held-out minADE of trainings, each in a folder of its method's name, and the ADE at last."""
    kept = []
    for method in (name for name in METHODS if (folder / name / "validation.csv").is_file()):
        with (folder / method / "validation.csv").open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        found: dict[str, Any] = {"method": method}
        for step in _STEPS:
            until = [row for row in rows if int(row["step"]) <= step <= int(rows[-1]["step"])]
            found[str(step)] = _figure(until[-1:] or [{}], "min_ade_m")
        kept.append(found | {"ade_m": _figure(rows[-1:], "ade_m")})
    return kept


_ENDS = ("mean", "worst")  #: Means over the traffic, which stand beside that of each.


def _kept(table: Made, rows: list[dict[str, str]]) -> list[dict[str, Any]]:
    """Keys and figures of a table's rows, each a value with the ends of its interval."""
    groups: dict[tuple[str, ...], list[dict[str, str]]] = {}
    for row in rows:
        if table.pivot is None and table.file == "figures.csv" and row.get("traffic") in _ENDS:
            continue
        if all(row[name] == value for name, value in table.where.items()):
            groups.setdefault(tuple(row[key] for key in table.keys), []).append(row)
    kept = []
    for keys, group in groups.items():
        found: dict[str, Any] = dict(zip(table.keys, keys, strict=True))
        if table.pivot is not None:
            found |= {row[table.pivot]: _figure([row], "score") for row in group}
        else:
            found |= {c.name: _figure(group, c.name) for c in table.columns.values()}
        kept.append(found)
    return kept


def _figure(rows: list[dict[str, str]], name: str) -> list[float | None]:
    """A figure with its interval; the mean of several rows has none."""
    values = [
        [float(row.get(name + end) or "nan") for end in ("", "_low", "_high")] for row in rows
    ]
    means = np.mean(values, axis=0)
    if len(rows) > 1:
        means[1:] = np.nan
    return [round(v, 6) if np.isfinite(v) else None for v in means.tolist()]


def render(name: str, chosen: str | None = None, only: str | None = None) -> str:
    """Return the table of a name, in Markdown, from what its run kept; all of it by default."""
    if name == "scores":
        return _scores(kept("grid"))
    table = TABLES.get(name) or TABLES[name.rpartition("_")[0]]
    if chosen is not None:
        heads = [head.strip() for head in chosen.split(",")]
        table = replace(table, columns={head: table.columns[head] for head in heads})
    run = kept(name)
    named = only and [name.strip() for name in only.split(",")]
    if "replan_s" in table.keys:
        (column,) = table.columns.values()
        return _grid(run, column, named)
    rows: TableRows = []
    titles: dict[str, Callable[[str], str]] = {
        "planner": _planner,
        "against": _planner,
        "traffic": lambda name: "mean" if name in _ENDS else TRAFFIC[name].label,
        "figure": lambda name: name.replace("_", " "),
    }
    for row in sorted(run["rows"], key=lambda r: -r["mean"][0] if "mean" in r else 0):
        if named and not {row[key] for key in table.keys} & {*named}:
            continue
        cells: list[Cell] = [titles.get(key, label_of)(row[key]) for key in table.keys]
        for column in table.columns.values():
            value, low, high = (np.nan if v is None else v for v in row[column.name])
            cells.append((value, low, high))
        rows.append(cells)
    columns = (replace(column, head=head) for head, column in table.columns.items())
    protocol = re.search(r"--protocol (\S+)", run["command"])
    of = f"{protocol[1]}, " if protocol else ""
    made = f"`{run['command']}`, " if chosen is None else of
    text = f"{made}{run.get('scenes') or run['held_out']}, {run['date']}."
    return document(Table([*table.keys, *columns], rows), text).rstrip()


def _grid(run: dict[str, Any], column: Column, named: Collection[str] | None) -> str:
    """One figure of all methods, or of those named, in a column per K at the first T, then per T
    at K = 5.
    """
    rows = [row for row in run["rows"] if row["K"] != "0"]  # which is the log
    cells = {(row["K"], row["replan_s"]): f"K = {row['K']}" for row in rows}
    first = next(iter(cells))[1]
    cells = {cell: head if cell[1] == first else f"T = {cell[1]} s" for cell, head in cells.items()}
    figures = {(row["method"], row["K"], row["replan_s"]): row[column.name] for row in rows}
    methods = [m for m in dict.fromkeys(row["method"] for row in rows) if not named or m in named]
    table: TableRows = [
        [label_of(method), *(figures[method, k, t][0] for k, t in cells)] for method in methods
    ]
    heads = (replace(column, head=head, interval=False) for head in cells.values())
    return document(Table(["method", *heads], table), f"{run['scenes']}, {run['date']}.").rstrip()


def _scores(run: dict[str, Any]) -> str:
    """SCR of the grid at its three K, and the paper's at these; RS and CS have other bounds."""
    paper = json.loads((pages.ROOT / "ccdiff_env/data/paper_tables.json").read_text())
    numbers = {"2": 0, "5": 3, "Full": 5}  # columns of the paper's 2, 3, 4, 5, 10, Full
    theirs = {
        method: [row[at] for at in numbers.values()]
        for method, row in zip(paper["methods"], paper["scr"], strict=True)
    }
    found = {(row["method"], row["K"]): row["scr"][0] for row in run["rows"] if row["K"] != "0"}
    table: TableRows = [
        [
            label_of(method),
            *(found[method, k] for k in numbers),
            *theirs.get(label_of(method).partition(",")[0], [None] * len(numbers)),
        ]
        for method in dict.fromkeys(method for method, _ in found)
    ]
    columns = [Column(f"{of}K = {k}") for of in ("", "paper: ") for k in numbers]
    return document(Table(["method", *columns], table), f"{run['scenes']}, {run['date']}.").rstrip()


def _planner(name: str) -> str:
    """Title of a planner, with a dagger where it uses what a vehicle cannot know."""
    return short_name(name) + (" †" if is_privileged(name) else "")


def main() -> None:
    """Make tables, and write them into the pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", choices=[*TABLES, []], help="tables; all by default")
    parser.add_argument("--scenes", default="embedded/val", help="source of the scenes")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--runs", type=Path, default=Path("runs/results"), help="run folders")
    args = parser.parse_args()
    for name in args.names or TABLES:
        record(name, args.scenes, args.workers, args.runs / name)
    charts.write()
    pages.write()


if __name__ == "__main__":
    main()
