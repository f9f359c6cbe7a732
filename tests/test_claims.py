"""Scenes that trained or chose something never report it."""

from __future__ import annotations

import json

import pytest

import ccdiff_env
from tools import expectations
from tools.results import DATA, USED_FOR

FILES = [path for path in sorted(DATA.glob("*.json")) if '"scenes"' in path.read_text("utf-8")]


def scenes_of(splits: str) -> set[str]:
    """Names of scenes of splits that are joined by ``+``, of nuScenes or of the package."""
    if splits.startswith("embedded/") or splits == "city":
        return {f"embedded {s.name}" for s in ccdiff_env.load(f"embedded/{splits.split('/')[-1]}")}
    return {name for split in splits.split("+") for name in ccdiff_env.scenes.splits()[split]}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_scenes_that_trained_or_chose_never_report(path):
    kept = json.loads(path.read_text(encoding="utf-8"))
    reported = scenes_of(kept["scenes"].split(" of ")[-1])
    assert reported
    named = {value for row in kept["rows"] for value in row.values() if isinstance(value, str)}
    used = [splits for name, splits in USED_FOR.items() if name in named]
    for splits in [*used, *(kept[key] for key in ("trained_on", "chosen_on") if key in kept)]:
        assert not reported & scenes_of(splits), f"{path.name} reports on scenes of {splits}"


def test_the_shipped_egos_are_covered():
    named = {
        row["planner"]
        for path in FILES
        for row in json.loads(path.read_text(encoding="utf-8"))["rows"]
        if "planner" in row
    }
    assert named & set(USED_FOR)


def test_the_table_of_expectations_is_that_of_its_results():
    rows = json.loads(expectations.DATA.read_text(encoding="utf-8"))["rows"]
    assert expectations.table(rows) in expectations.PAGE.read_text(encoding="utf-8")
    curve = next(row["curve"] for row in rows if "curve" in row)
    assert curve[-1][2] > curve[0][2] + 0.2
