"""Planners of several runs in one page, from their files alone."""

from __future__ import annotations

import csv
import json
import re

import pytest

from ccdiff_env.bench.leaderboard import leaderboard
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env_cli import main


@pytest.fixture
def run(tmp_path):
    """Make a run folder: scores by planner and traffic."""

    def make(name, scores, seed=0, benchmark="planners"):
        folder = tmp_path / name
        folder.mkdir()
        settings = {"benchmark": benchmark, "source": "embedded/val", "seed": seed}
        (folder / "run.json").write_text(json.dumps({**settings, "weights": "abc"}))
        (folder / "report.html").write_text("")
        with (folder / "scores.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["planner", "traffic", "scene", "score"])
            for (planner, traffic), values in scores.items():
                for i, value in enumerate(5 * values):  # verdicts are of ten scenes and more
                    writer.writerow([planner, traffic, f"scene-{i}", value])
        return folder

    return make


def order(table):
    """Planners of a table from the top, and its heads."""
    rows = [re.findall(r"[^|]+", line) for line in table.splitlines() if line.startswith("|")]
    return [row[0].strip() for row in rows[2:]], [cell.strip() for cell in rows[0]]


def test_the_better_mean_stands_higher_in_the_traffic_that_all_runs_have(run, tmp_path, capsys):
    a = run("a", {("idm", "replay"): [1, 0.5], ("idm", "idm"): [0, 0]})
    b = run("b", {("pdm", "replay"): [1, 0.7], ("pdm", "ccdiff-1"): [0.1, 0.1]})
    ((heading, table),) = leaderboard([a, b]).items()
    assert "seed 0" in heading
    assert order(table) == (["pdm", "idm"], ["score", "Log replay", "mean"])
    assert "0.85" in table
    assert "0.75" in table
    page = tmp_path / "pages.html"
    assert main(["bench", "leaderboard", str(a), str(b), "--out", str(page)]) == 0
    assert 'href="b/report.html"' in page.read_text()
    assert "pdm is best over all (0.85)" in capsys.readouterr().out


def test_other_seeds_are_other_tables_and_equal_names_get_their_folder(run):
    a = run("a", {("idm", "replay"): [1]})
    b = run("b", {("idm", "replay"): [0]})
    c = run("c", {("idm", "replay"): [0.5]}, seed=1)
    first, second = leaderboard([a, b, c]).values()
    assert order(first)[0] == ["idm (a)", "idm (b)"]
    assert order(second)[0] == ["idm"]


def test_what_is_no_run_of_planners_is_refused(run, tmp_path):
    with pytest.raises(DatasetNotFoundError, match=r"run\.json"):
        leaderboard([tmp_path])
    with pytest.raises(ConfigError, match="traffic"):
        leaderboard([run("t", {("idm", "replay"): [1]}, benchmark="traffic")])
    with pytest.raises(DatasetError, match="damaged"):
        leaderboard([run("d", {("idm", "replay"): ["x"]})])
    with pytest.raises(DatasetError, match="nonsense"):
        leaderboard([run("n", {("idm", "nonsense"): [1]})])
    apart = [run("e", {("idm", "replay"): [1]}), run("f", {("pdm", "idm"): [1]})]
    with pytest.raises(ConfigError, match="no traffic is in all"):
        leaderboard(apart)
