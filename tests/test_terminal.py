"""What commands say on a terminal."""

from __future__ import annotations

import subprocess
import sys

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
