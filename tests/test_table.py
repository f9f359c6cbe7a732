"""One value per table: what readers and files see of it."""

import csv
import math

from ccdiff_env.system.table import Column, Table, document

NAN = math.nan


def table():
    columns = (Column("hit", unit="%", digits=1, factor=100.0), Column("gap", "distance", "m"))
    return Table(
        ["name", "count", *columns],
        [["a", 3, (0.25, 0.125, 0.5), 1.5], ["b", 4, (NAN, NAN, NAN), None]],
        "Two",
    )


def test_readers_see_units_digits_and_intervals():
    assert str(table()).splitlines() == [
        "### Two",
        "",
        "| name | count | hit % | distance m |",
        "|---|---|---|---|",
        "| a | 3 | 25.0 [12.5, 50.0] | 1.50 |",
        "| b | 4 | n/a | |",
    ]


def test_latex_has_the_same_cells_with_its_letters_escaped():
    cells = [["a_b & c", 0.25], ["[d](page.html)", 0.5]]
    text = Table(["name", Column("hit", unit="%", best=True)], cells, "Two_").latex()
    assert text.splitlines() == [
        r"\begin{table}",
        r"\caption{Two\_}",
        r"\begin{tabular}{lc}",
        r"\toprule",
        r"name & hit \% \\",
        r"\midrule",
        r"a\_b \& c & 0.25 \\",
        r"d & \textbf{0.50} \\",
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]


def test_files_have_the_values_themselves(tmp_path):
    table().write_csv(tmp_path / "t.csv")
    rows = list(csv.reader((tmp_path / "t.csv").open()))
    assert rows[0] == ["name", "count", "hit", "hit_low", "hit_high", "gap"]
    assert rows[1:] == [["a", "3", "0.25", "0.125", "0.5", "1.5"], ["b", "4", "", "", "", ""]]


def test_the_highest_as_shown_are_emphasised():
    cells = (0.901, "[0.90](#a) [0.80, 0.95]", 0.894, NAN, None)
    lines = str(Table([Column("score", best=True)], [[cell] for cell in cells])).splitlines()
    shown = ["**0.90**", "**[0.90](#a) [0.80, 0.95]**", "0.89", "n/a"]
    assert lines[2:] == [*(f"| {cell} |" for cell in shown), "| |"]


def test_a_document_leaves_out_what_has_nothing():
    assert document("First.", "", Table(["a"], []), "Last.") == "First.\n\nLast.\n"
