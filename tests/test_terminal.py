"""What commands say on a terminal."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ccdiff_env.cli import main
from ccdiff_env.system.terminal import align


def test_tables_are_aligned_numbers_to_the_right_and_the_best_is_marked():
    text = align(
        "Idm is best.\n\n### Scores\n\n| planner | score |\n|---|---:|\n"
        "| idm | **0.90** |\n| constant velocity | 10.25 [1, 2] |\n\nMeans."
    )
    assert text.splitlines() == [
        "Idm is best.",
        "",
        "Scores",
        "",
        "planner                   score",
        "─────────────────  ────────────",
        "idm                      0.90 *",
        "constant velocity  10.25 [1, 2]",
        "",
        "Means.",
    ]


def test_tables_without_rows_and_empty_cells_stay():
    assert align("| a | b |\n|---|---|\n") == "a  b\n─  ─\n"
    assert align("| a | b |\n|---|---|\n| x | |\n").splitlines()[2] == "x"


def test_output_that_nobody_reads_on_ends_without_a_word():
    command = [sys.executable, "-m", "ccdiff_env.cli", "scenes"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 1


WIDE = (
    "Idm is best over all, and this sentence is so long that it would leave a window of eighty.\n\n"
    "| score | Log replay | CCDiff, no guidance | CCDiff, criticality 1 | mean | worst of all |\n"
    "|---|---:|---:|---:|---:|---:|\n"
    "| IDM on the log's path | **0.90 [0.85, 0.95]** | 0.8 [0.75, 0.85] | 0.7 [0.6, 0.8] "
    "| 0.8 [0.7, 0.9] | 0.7 [0.6, 0.8] |\n"
    "| constant velocity | 0.50 [0.45, 0.55] | 0.4 [0.3, 0.5] | 0.3 [0.2, 0.4] | 0.4 | 0.3 |\n"
)


def test_no_line_is_wider_than_the_window_and_no_figure_is_lost():
    for width in (80, 60, 40):
        text = align(WIDE, width=width)
        assert max(map(len, text.splitlines())) <= width
        assert [text.count(word) for word in ("0.90 *", "0.8", "0.3")] == [1, 2, 2]
        assert "[" not in text
    assert "[0.85, 0.95] *" in align(WIDE)


def test_a_terminal_shows_bold_and_keeps_the_columns():
    plain = align(WIDE, width=80).replace(" *", "  ")
    bold = align(WIDE, width=80, bold=True)
    assert "\033[1m0.90\033[0m" in bold
    bare = bold.replace("\033[1m", "").replace("\033[0m", "")
    assert [line.split() for line in bare.splitlines()] == [
        line.split() for line in plain.splitlines()
    ]


SHORT = "--limit 1 --quiet --out"
#: What verbs that print tables are called with; a run folder of the one before where it says RUN.
VERBS = {
    "scenes": "scenes",
    "doctor": "doctor",
    "planners": "bench planners --planners idm,constant_velocity --traffic replay,idm,ccdiff,"
    f"ccdiff-1 --seeds 0 {SHORT}",
    "verify": "bench verify RUN/planners --episodes 1",
    "leaderboard": "bench leaderboard RUN/planners --out",
    "traffic": f"bench traffic --methods constant_velocity,idm --k 1,2,3,4,5,10,Full {SHORT}",
    "scenarios": f"bench scenarios --generators idm --planners idm,replay --plans 8 {SHORT}",
    "realism": f"bench realism --methods replay,constant_velocity,idm --samples 2 {SHORT}",
}


@pytest.mark.timeout(300)
def test_no_verb_prints_lines_wider_than_a_window_of_eighty(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    for name, words in VERBS.items():
        folder = [str(tmp_path / name)] if words.endswith("--out") else []
        command = words.replace("RUN", str(tmp_path)).split() + folder
        assert main(command) == 0, name
        out, err = capsys.readouterr()
        lines = out.replace(str(tmp_path), "").splitlines()
        assert len(lines) > 1, name
        assert [line for line in lines if len(line) > 80] == []
        assert "\r" not in err
        assert " 1 scenes" not in out
