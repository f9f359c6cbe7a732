"""``ccdiff-env bench leaderboard``: planners of several run folders in one table."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ccdiff_env.bench.page import write_report_page
from ccdiff_env.bench.planner_report import summary, verdict
from ccdiff_env.bench.planners import TRAFFIC
from ccdiff_env.bench.scenes import source_title
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.files import parsed_object, read_text, reading

__all__ = ["leaderboard", "write_leaderboard"]

#: Settings of a run that must be the same for its figures to be compared.
SETTINGS = ("source", "seed", "weights")


def write_leaderboard(folders: Sequence[Path], out: Path) -> dict[str, str]:
    """Write the page of :func:`leaderboard`, with links to the reports; return the tables."""
    tables = leaderboard(folders)
    links = [
        f"[{folder.name}]({Path(os.path.relpath(folder / 'report.html', out.parent)).as_posix()})"
        for folder in folders
        if (folder / "report.html").is_file()
    ]
    line = f"{len(folders)} runs; score of nuPlan's closed loop, mean over scenes"
    parts = {**tables, "Reports of the runs": ", ".join(links)}
    write_report_page(out, title="Leaderboard", line=line, plots=[], parts=parts)
    return tables


def leaderboard(folders: Sequence[Path]) -> dict[str, str]:
    """Compare the planners of runs of ``bench planners``.

    Parameters
    ----------
    folders
        Run folders. Those that agree in scenes, seed and weights share a table, of the traffic
        that all of them have. A planner that is in several of them is named with its folder.

    Returns
    -------
    dict
        Heading and Markdown of each table.

    Raises
    ------
    DatasetNotFoundError, DatasetError
        If a folder holds no finished run of planners, or a damaged one.
    ConfigError
        If runs that share a table share no traffic.
    """
    groups: dict[str, list[tuple[Path, dict[str, Any]]]] = {}
    for folder in folders:
        settings = _settings(folder)
        key = json.dumps({name: settings.get(name) for name in SETTINGS}, sort_keys=True)
        groups.setdefault(key, []).append((folder, settings))
    return dict(_table(members) for members in groups.values())


def _settings(folder: Path) -> dict[str, Any]:
    for name in ("run.json", "scores.csv"):
        if not (folder / name).is_file():
            raise DatasetNotFoundError(f"no finished run of `bench planners`: no {folder / name}")
    with reading("settings of a run", folder / "run.json"):
        settings = parsed_object(read_text(folder / "run.json"))
    if settings.get("benchmark") != "planners":
        raise ConfigError(f"{folder} is a run of {settings.get('benchmark')!r}, expected planners")
    try:
        source_title(settings.get("source", {}))
    except ConfigError as error:
        raise DatasetError(f"damaged settings of a run ({error}): {folder / 'run.json'}") from None
    if not isinstance(settings.get("seed"), int):
        found = settings.get("seed")
        raise DatasetError(f"damaged settings of a run (seed {found!r}): {folder / 'run.json'}")
    return settings


def _table(members: Sequence[tuple[Path, dict[str, Any]]]) -> tuple[str, str]:
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    read = [(folder, _scores(folder / "scores.csv")) for folder, _ in members]
    names = [planner for _, rows in read for planner in {p for p, _ in rows}]
    for folder, rows in read:
        for (planner, name), scenes in rows.items():
            several = names.count(planner) > 1
            found[f"{planner} ({folder.name})" if several else planner, name] = scenes
    planners = list(dict.fromkeys(p for p, _ in found))
    traffic = [
        t for t in dict.fromkeys(t for _, t in found) if all((p, t) in found for p in planners)
    ]
    if not traffic:
        raise ConfigError(f"no traffic is in all of {', '.join(str(f) for f, _ in members)}")
    settings = members[0][1]
    heading = f"{source_title(settings['source'])}, seed {settings['seed']}"
    text = [verdict(found, planners, traffic), "", *summary(found, planners, traffic)]
    return f"{heading}, weights {str(settings.get('weights'))[:8]}", "\n".join(text) + "\n"


def _scores(path: Path) -> dict[tuple[str, str], list[dict[str, Any]]]:
    """Rows of each planner in each traffic: a dictionary per scene."""
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    with reading("scores of a run", path):
        for row in csv.DictReader(io.StringIO(read_text(path)), restval=""):
            key = row["planner"], row["traffic"]
            value = float(row["score"])
            if not 0.0 <= value <= 1.0:
                raise ValueError(f"score {value}, expected 0 to 1")
            if "|" in key[0] or not key[0].isprintable():
                raise ValueError(f"planner {key[0]!r}")
            score = {"scene": row["scene"], "score": value}
            found.setdefault(key, []).append(score)
    unknown = {traffic for _, traffic in found if traffic not in TRAFFIC}
    if not found or unknown:
        raise DatasetError(f"damaged scores of a run (traffic {sorted(unknown)}): {path}")
    return found
