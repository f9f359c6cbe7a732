"""What commands say on a terminal."""

from __future__ import annotations

from ccdiff_env.terminal import align


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
