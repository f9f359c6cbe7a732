"""Planners of several runs in one page, recomputed from their raw results alone."""

import re
from dataclasses import replace

import pytest
from planner_run import raw, write_run

from ccdiff_env.bench import leaderboard as module
from ccdiff_env.bench.planners import TRAFFIC
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.record import Record, submit
from ccdiff_env.errors import DatasetError
from ccdiff_env_cli import main

TEN = [0.0, 1.0] * 5
IDM = "IDM on the log's path"
MARKED = f"{IDM} †"


def leaderboard(*folders):
    return module.leaderboard([Record.read(folder) for folder in folders])


def order(table):
    """Planners of a table from the top, and its heads."""
    table = table.partition("\n\n|")[2].partition("\n\n")[0]
    rows = [re.findall(r"[^|]+", line) for line in table.splitlines()]
    return [row[0].strip() for row in rows[2:]], [cell.strip() for cell in rows[0]]


def test_the_better_mean_stands_higher(tmp_path, capsys):
    a = write_run(tmp_path / "a", raw("idm", "replay", [0.75] * 10), raw("idm", "idm", TEN))
    b = write_run(tmp_path / "b", raw("pdm", "replay", [0.85] * 10), raw("pdm", "idm", TEN))
    ((heading, table),) = leaderboard(a, b).items()
    assert "seed 0" in heading
    assert order(table) == (["PDM-Closed", MARKED], ["score", "Log replay", "IDM", "mean", "worst"])
    assert "0.85" in table
    assert "0.75" in table
    assert f"| PDM-Closed | {IDM} | +0.050 [" in table
    page = tmp_path / "pages.html"
    assert main(["bench", "leaderboard", str(a), str(b), "--out", str(page)]) == 0
    assert 'href="b/report.html"' in page.read_text()
    assert "PDM-Closed is best over all (0.68)" in capsys.readouterr().out


def test_all_are_compared_with_both_idm_and_not_the_best_alone(tmp_path):
    scores = {"idm": 0.2, "lane_idm": 0.4, "pdm": 0.9, "ego": 0.6}
    runs = [write_run(tmp_path / n, raw(n, "replay", [v] * 10)) for n, v in scores.items()]
    (table,) = leaderboard(*runs).values()
    for other, less in ((IDM, "+0.400"), ("IDM on lanes", "+0.200"), ("PDM-Closed", "-0.300")):
        assert f"| trained ego | {other} | {less} [" in table


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
def test_runs_that_do_not_agree_stand_apart_and_none_is_lost(tmp_path, other):
    given = {"planner": "idm", "traffic": "replay", "values": TEN}
    a = write_run(tmp_path / "a", raw(**given))
    b = write_run(tmp_path / "b", raw(**given | other))
    tables = leaderboard(a, b)
    assert len(tables) == 2
    assert all(order(table)[0] == [MARKED] for table in tables.values())


def test_results_of_a_level_share_a_table_whatever_their_seeds_and_other_networks(tmp_path):
    hashes = PROTOCOL.fields["levels"]["smoke"]["hashes"]
    runs = []
    for planner, weights, seed in (("idm", "with rivals", 12), ("pdm", "without", 11)):
        given = {"values": [0.5] * 12, "weights": weights, "seed": seed}
        results = [raw(planner, traffic, **given) for traffic in PROTOCOL.panel]
        for result in results:
            result["arguments"]["names"] = list(hashes)
            result["made_from"]["scenes"] = hashes
            for row, name in zip(result["result"], hashes, strict=True):
                row["scene"] = name
        runs.append(write_run(tmp_path / planner, *results))
    ((heading, table),) = leaderboard(*runs).items()
    assert heading == "planner-1.3 smoke, version 1"
    assert set(order(table)[0]) == {MARKED, "PDM-Closed"}
    assert f"Seeds: {IDM} 12; PDM-Closed 11" in table


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
    own = write_run(tmp_path / "own", raw("pdm", "replay", [0.4] * 10))
    folder = write_run(tmp_path / "mine", raw(planner, "replay", TEN, source="a"))
    (table,) = leaderboard(own, folder).values()
    assert order(table)[0] == [f"{shown} (no code)", "PDM-Closed"]
    record = replace(Record.read(folder), code="https://example.org/x")
    (table,) = module.leaderboard([record, Record.read(own)]).values()
    assert order(table)[0] == [shown, "PDM-Closed"]


def test_a_title_of_the_package_is_no_own_traffics():
    assert [TRAFFIC[name].label for name in ("x:IDM", "x:Mine")] == ["x:IDM", "Mine"]


def test_names_of_planners_are_of_ascii(tmp_path):
    for number, planner in enumerate(("mine:Cruise \u2020", "PDM\u2011Closed", "mine:\u0130dm")):
        folder = write_run(tmp_path / str(number), raw(planner, "replay", TEN, source="a"))
        with pytest.raises(DatasetError, match="letters of ASCII"):
            Record.read(folder)


def test_runs_of_one_name_are_all_there_wherever_the_data_lies(tmp_path):
    runs = []
    for name in "abc":
        made = raw("idm", "replay", TEN)
        made["arguments"]["source"] = f"nuscenes:/{name}@v1.0-mini/all"
        runs.append(write_run(tmp_path / name / "run", made))
    (table,) = leaderboard(*runs).values()
    assert order(table)[0] == [f"{IDM} (run) †", f"{IDM} (run) #2 †", f"{IDM} (run) #3 †"]


def test_privileged_planners_are_marked(tmp_path):
    made = raw("mine:Ego", "replay", TEN, source="a", privileged=True)
    (table,) = leaderboard(write_run(tmp_path / "a", made)).values()
    assert order(table)[0] == ["mine:Ego (no code) †"]


def test_two_states_of_a_planner_are_not_mixed(tmp_path):
    old = raw("mine:Ego", "replay", [0.2] * 10, source="old")
    new = raw("mine:Ego", "idm", [0.9] * 10, source="new")
    tables = leaderboard(write_run(tmp_path / "a", old, new))
    assert [order(table)[1][1:-2] for table in tables.values()] == [["Log replay"], ["IDM"]]


def test_runs_that_are_unfinished_or_in_no_known_traffic_are_refused(tmp_path):
    with pytest.raises(DatasetError, match="nonsense"):
        leaderboard(write_run(tmp_path / "n", raw("idm", "nonsense", [1])))
    unfinished = [raw("idm", "replay", TEN), raw("idm", "idm", TEN, seed=1)]
    with pytest.raises(DatasetError, match="10 of 20 episodes; finish the run"):
        leaderboard(write_run(tmp_path / "u", *unfinished))


def test_a_run_and_its_submission_are_one_row_and_the_panel_has_its_order(tmp_path):
    traffic = [name for name in PROTOCOL.panel if name in ("replay", "tokens", "ccdiff-1")]
    results = [raw("idm", name, TEN) for name in reversed(traffic)]
    run = write_run(tmp_path / "a", *results, source="embedded/val")
    submit(run, tmp_path / "a.zip", code="https://example.org/mine")
    (table,) = leaderboard(run, tmp_path / "a.zip").values()
    assert table.count("\n| IDM on the log's path") == 1
    head = next(line for line in table.splitlines() if line.startswith("| score"))
    titles = [TRAFFIC[name].label for name in traffic]
    assert [cell for cell in head.split(" | ") if cell in titles] == titles
