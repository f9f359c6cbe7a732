"""Scores of a run, recomputed from its raw results alone."""

import json
import re

import pytest

from ccdiff_env.bench.planner_score import score_of
from ccdiff_env.bench.planners import TRAFFIC
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.record import Record
from ccdiff_env.errors import DatasetError

PARTS = [*PROTOCOL.fields["score"]["gates"], *PROTOCOL.fields["score"]["weights"]]
TEN = [0.0, 1.0] * 5
IDM = "IDM on the log's path"
EGO = "trained ego"
MARKED = f"{IDM} †"


def row(scene, value, seed=0):
    """An episode all of whose graded parts have a value."""
    parts = dict.fromkeys(PARTS, 1.0) | dict.fromkeys(PROTOCOL.fields["score"]["weights"], value)
    more = {"collision": 0.0, "success": 1.0, "min_ttc_s": 1.0, "digest": "d"}
    return {"scene": scene, "seed": seed, **parts, **more, "score": score_of(parts)}


def raw(planner, traffic, values, *, seed=0, source=None, scenes="", **made_from):
    """A raw result: values by scene, `scenes` is the beginning of their hashes."""
    names = [f"scene-{i:02d}" for i in range(len(values))]
    return {
        "function": "ccdiff_env.bench.planners:evaluate",
        "arguments": {
            "source": "embedded/val",
            "names": names,
            "planner": planner,
            "traffic": traffic,
            "seed": seed,
            "sources": {"planner": source, "traffic": None},
        },
        "made_from": {
            "version": "1",
            "package": "p",
            "weights": "w",
            "protocol": PROTOCOL.sha256,
            "scenes": {name: f"{scenes}{name}" for name in names},
            **made_from,
        },
        "result": [row(name, value, seed) for name, value in zip(names, values, strict=True)],
        "seconds": 1.0,
    }


def write_run(folder, *results, **settings):
    """Write a run folder; returns it."""
    (folder / "raw").mkdir(parents=True)
    (folder / "run.json").write_text(json.dumps({"benchmark": "planners", **settings}))
    for i, result in enumerate(results):
        (folder / "raw" / f"{i}.json").write_text(json.dumps(result))
    return folder


def tables(folder, *results):
    return Record.read(write_run(folder, *results)).tables()


def order(table):
    """Planners of a table from the top, and its heads."""
    table = table.partition("\n\n|")[2].partition("\n\n")[0]
    rows = [re.findall(r"[^|]+", line) for line in table.splitlines()]
    return [row[0].strip() for row in rows[2:]], [cell.strip() for cell in rows[0]]


def test_the_better_mean_stands_higher(tmp_path):
    idm = raw("idm", "replay", [0.75] * 10), raw("idm", "idm", TEN)
    pdm = raw("pdm", "replay", [0.85] * 10), raw("pdm", "idm", TEN)
    ((heading, table),) = tables(tmp_path, *idm, *pdm)
    assert "seed 0" in heading
    assert order(table) == (["PDM-Closed", MARKED], ["score", "Log replay", "IDM", "mean", "worst"])
    assert "0.85" in table
    assert "0.75" in table
    assert f"| PDM-Closed | {IDM} | +0.050 [" in table
    assert "PDM-Closed has the best mean (0.68)" in table


def test_all_are_compared_with_both_idm_and_not_the_best_alone(tmp_path):
    scores = {"idm": 0.2, "lane_idm": 0.4, "pdm": 0.9, "ego": 0.6}
    ((_, table),) = tables(tmp_path, *(raw(n, "replay", [v] * 10) for n, v in scores.items()))
    for pair in (
        (EGO, IDM, "+0.400"),
        (EGO, "IDM on lanes", "+0.200"),
        ("PDM-Closed", EGO, "+0.300"),
    ):
        assert "| {} | {} | {} [".format(*pair) in table


@pytest.mark.parametrize(
    "other",
    [
        {"seed": 1},
        {"scenes": "other "},
        {"weights": "other"},
        {"version": "2"},
        {"package": "other"},
        {"protocol": "other"},
        {"traffic": "idm"},
        {"values": [0.5] * 11},
    ],
    ids=lambda other: next(iter(other)),
)
def test_results_that_do_not_agree_stand_apart_and_none_is_lost(tmp_path, other):
    given = {"traffic": "replay", "values": TEN}
    found = tables(tmp_path, raw("idm", **given), raw("pdm", **given | other))
    assert [order(table)[0] for _, table in found] == [[MARKED], ["PDM-Closed"]]


def test_results_of_a_level_are_headed_by_it(tmp_path):
    hashes = PROTOCOL.fields["levels"]["smoke"]["hashes"]
    results = [raw("idm", traffic, [0.5] * 12) for traffic in reversed(PROTOCOL.panel)]
    for result in results:
        result["arguments"]["names"] = list(hashes)
        result["made_from"]["scenes"] = hashes
        for row, name in zip(result["result"], hashes, strict=True):
            row["scene"] = name
    ((heading, table),) = tables(tmp_path, *results)
    assert heading == "planner-1.4 smoke, seed 0, version 1"
    assert order(table)[1][1:-2] == [TRAFFIC[name].label for name in PROTOCOL.panel]


@pytest.mark.parametrize(
    ("planner", "shown"),
    [
        ("x/PDM-Closed", "x/PDM-Closed"),
        ("x/PDM-Closed.zip", "PDM-Closed.zip"),
        ("PDM-Closed", "PDM-Closed (not of the package)"),
        ("x/pdm closed", "x/pdm closed"),
        ("x/idm", "x/idm"),
        ("IDM on the log's path", "IDM on the log's path (not of the package)"),
        ("x/mine.zip", "mine.zip"),
        ("mine:Ego", "mine:Ego"),
    ],
)
def test_a_label_of_the_package_is_nobody_elses(tmp_path, planner, shown):
    mine = raw(planner, "replay", TEN, source="a")
    ((_, table),) = tables(tmp_path, raw("pdm", "replay", [0.4] * 10), mine)
    assert order(table)[0] == [shown, "PDM-Closed"]


def test_a_title_of_the_package_is_no_own_traffics():
    assert [TRAFFIC[name].label for name in ("x:IDM", "x:Mine")] == ["x:IDM", "Mine"]


def test_names_of_planners_are_of_ascii(tmp_path):
    for number, planner in enumerate(("mine:Cruise \u2020", "PDM\u2011Closed", "mine:\u0130dm")):
        folder = write_run(tmp_path / str(number), raw(planner, "replay", TEN, source="a"))
        with pytest.raises(DatasetError, match="letters of ASCII"):
            Record.read(folder)


def test_planners_of_one_name_are_all_there(tmp_path):
    named = [raw(f"{place}/ego.zip", "replay", TEN, source="a") for place in "abc"]
    ((_, table),) = tables(tmp_path, *named)
    assert order(table)[0] == ["ego.zip", "ego.zip #2", "ego.zip #3"]


def test_privileged_planners_are_marked(tmp_path):
    ((_, table),) = tables(tmp_path, raw("mine:Ego", "replay", TEN, source="a", privileged=True))
    assert order(table)[0] == ["mine:Ego †"]


def test_two_states_of_a_planner_are_not_mixed(tmp_path):
    old = raw("mine:Ego", "replay", [0.2] * 10, source="old")
    new = raw("mine:Ego", "idm", [0.9] * 10, source="new")
    found = tables(tmp_path, old, new)
    assert [order(table)[1][1:-2] for _, table in found] == [["Log replay"], ["IDM"]]


def test_runs_that_are_unfinished_or_in_no_known_traffic_are_refused(tmp_path):
    with pytest.raises(DatasetError, match="nonsense"):
        tables(tmp_path / "n", raw("idm", "nonsense", [1]))
    with pytest.raises(DatasetError, match="10 of 20 episodes; finish the run"):
        tables(tmp_path / "u", raw("idm", "replay", TEN), raw("idm", "idm", TEN, seed=1))
