"""Reports of the benchmarks: pages of tables, plots and links to replays of what was measured."""

import csv
from html import unescape
from html.parser import HTMLParser

import numpy as np
import pytest

from ccdiff_env import cli
from ccdiff_env.bench import plots
from ccdiff_env.bench.intervals import FEW
from ccdiff_env.bench.page import markdown_html, write_report_page
from ccdiff_env.bench.planner_report import verdict, worst_scenes
from ccdiff_env.system.table import Column, Table, document, escaped, link
from ccdiff_env.system.terminal import align

VAL = "embedded/val"


class Parts(HTMLParser):
    """Cells of tables, and what a page points at."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.links, self.sources, self._cell = [], [], [], False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        if tag == "tr":
            self.rows.append([])
        self._cell = tag in ("td", "th", "a", "b") and (self._cell or tag not in "ab")
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag == "a":
            self.links.append(found["href"])
        if tag in ("img", "link", "iframe") or "src" in found:
            self.sources.append(found.get("src") or found.get("href"))

    def handle_data(self, data):
        if self._cell and self.rows:
            self.rows[-1][-1] += data

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self._cell = False


def test_markdown_of_reports_becomes_html():
    text = markdown_html(
        "### A <head>\n\nSome `text`\nin two lines & more\n\n"
        "| scene | why |\n|---|---|\n| [a](replays/a.html#t=1.0&follow=ego) | x < y |\n| | |\n"
    )
    assert text.startswith(
        '<h3 id="a-head-">A &lt;head&gt;</h3>\n<p>Some `text` in two lines &amp; more</p>'
    )
    found = Parts(text)
    assert found.rows == [["scene", "why"], ["a", "x < y"], ["", ""]]
    assert found.links == ["replays/a.html#t=1.0&follow=ego"]


NAMES = (
    "a|b",
    "<script>alert(1)</script>",
    "50% & x_1",
    "**x**",
    "[a](b:c)",
    "`_x_` \\| &amp; #",
    "\\",
)


def test_names_are_only_names_for_all_readers(tmp_path):
    rows = [[name, 0.5, link(name, "a b(1).html")] for name in NAMES]
    made = Table(["name", Column("score", best=True), Column("page", NAMES[0])], rows, NAMES[3])
    text = document(made, escaped("; ".join(NAMES)))
    lines = align(text).splitlines()
    assert lines[:3] == [NAMES[3], "", f"{'name':<25}   score  a|b"]
    assert [line.split("  0.50 *  ") for line in lines[4:11]] == [[f"{n:<25}", n] for n in NAMES]
    assert lines[12] == "; ".join(NAMES)
    page = Parts(markdown_html(text))
    assert page.rows == [["name", "score", "a|b"], *([name, "0.50", name] for name in NAMES)]
    assert page.links == ["a%20b%281%29.html"] * len(NAMES)
    assert "<script" not in markdown_html(text)
    assert r"50\% \& x\_1 & \textbf{0.50} & 50\% \& x\_1 \\" in made.latex()
    made.write_csv(tmp_path / "t.csv")
    assert [row[0] for row in csv.reader((tmp_path / "t.csv").open())][1:] == [*NAMES]


def test_names_in_plots_are_only_names(tmp_path):
    pytest.importorskip("matplotlib")
    names, ends = (
        ("a$\\frac$b", "$x$", *NAMES[:3]),
        [(0.0, (0.5, 0.4, 0.6)), (1.0, (0.5, 0.4, 0.6))],
    )
    lines = {name: (name, 5.0, ends) for name in names}
    path = plots.plot_lines({"$score$": lines}, "$across$", tmp_path / "a.svg")
    text = unescape(path.read_text(encoding="utf-8"))
    assert all(name in text for name in (*names, "$score$", "$across$"))


def test_markdown_of_names_is_that_of_commonmark():
    markdown = pytest.importorskip("markdown_it").MarkdownIt().enable("table")
    table = Table(["name"], [[name] for name in NAMES])
    assert Parts(markdown.render(str(table))).rows[1:] == [[name] for name in NAMES]


def test_pages_need_nothing_else(tmp_path):
    plot, page = tmp_path / "plot.svg", tmp_path / "report.html"
    plot.write_text('<?xml version="1.0"?>\n<svg width="1"><path d=""/></svg>')
    write_report_page(page, title="A & B", line="{line}", plots=[plot], parts={"T": "x", "E": " "})
    found = Parts(page.read_text(encoding="utf-8"))
    assert found.links == ["#t"]
    assert all(source.startswith("data:") for source in found.sources)
    assert '<svg role="img" aria-label="plot" width="1">' in page.read_text(encoding="utf-8")


def replays(folder):
    links = Parts((folder / "report.html").read_text(encoding="utf-8")).links
    return list(dict.fromkeys(link for link in links if link.startswith("replays/")))


@pytest.fixture(scope="module")
def planners(tmp_path_factory):
    """A run folder with replays."""
    folder = tmp_path_factory.mktemp("planners")
    command = ["bench", "planners", "--out", str(folder), "--quiet", "--limit", "4"]
    command += ["--planners", "idm,replay", "--traffic", "replay,ccdiff-1", "--replays", "2"]
    assert cli.main(command) == 0
    return folder


def test_the_worst_scenes_of_every_planner_have_replays(planners):
    folder = planners
    links = replays(folder)
    assert len(links) == 4
    for address in links:
        page = folder / address.partition("#")[0]
        assert 10_000 < page.stat().st_size < 1_000_000
    assert (folder / "table.md").read_text(encoding="utf-8").count("](replays/") == 4
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "made by <code>" in page


def test_a_report_and_its_replays_open_from_the_disc(planners, browser):
    page = browser.new_page(viewport={"width": 390, "height": 800})
    faults = []
    page.on("console", lambda m: m.type in ("error", "warning") and faults.append(m.text))
    page.goto((planners / "report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    # the first screen says who is best, and where it breaks
    for part in ("h2 + p", "table.good"):
        box = page.locator(part).first.bounding_box()
        assert box["y"] + box["height"] < 800
    page.locator('a[href^="replays/"]').first.click()
    page.wait_for_selector("body[data-ready=yes]")
    assert not faults
    page.close()


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_in_a_report(planners, browser, axe, theme):
    context = browser.new_context(color_scheme=theme, bypass_csp=True)
    page = context.new_page()
    page.goto((planners / "report.html").as_uri())
    assert axe(page) == []
    context.close()


def test_cells_of_a_matrix_are_tinted_and_the_best_is_emphasised():
    text = markdown_html("| score | x |\n|---|---:|\n| a | **0.90** [0.8, 1.0] |\n| b | |\n")
    assert 'style="--v:0.90"' in text
    assert "<b>0.90</b><small>[0.8, 1.0]</small>" in text
    assert text.count("style=") == 1


def rows_of(**scores):
    return {
        (p, t): [{"scene": f"{i}", "score": v} for i, v in enumerate(5 * values)]
        for (p, t), values in ((tuple(k.split("__")), v) for k, v in scores.items())
    }


def test_the_verdict_names_the_best_and_what_breaks():
    found = rows_of(
        idm__replay=[0.9, 0.9], idm__idm=[0.8, 0.8],
        pdm__replay=[0.5, 0.5], pdm__idm=[0.0, 0.2],
    )  # fmt: skip
    text = verdict(found)
    assert text.startswith(
        "IDM on the log's path has the best mean (0.85) and leads in all traffic. "
    )
    assert "PDM-Closed loses most, from 0.50 (Log replay) to 0.10 (IDM)" in text
    assert text.endswith("10 scenes.")
    near = rows_of(idm__replay=[0.0, 1.0], pdm__replay=[0.0, 0.9])
    assert "not significantly above PDM-Closed (paired, p >= 0.05)" in verdict(near)
    few = {key: rows[:9] for key, rows in found.items()}
    assert verdict(few) == FEW


def test_the_worst_come_first_once_each_and_close_calls_break_ties():
    def row(scene, score, ttc):
        return {"scene": scene, "score": score, "min_ttc_s": ttc}

    found = {
        ("idm", "replay"): [row("a", 0.5, 1.0), row("b", 0.0, 2.0), row("c", 0.2, 3.0)],
        ("idm", "idm"): [row("a", 0.0, 1.0), row("b", 0.9, 0.1), row("c", 0.3, 3.0)],
        ("pdm", "idm"): [row("a", 0.0, 0.0)],
    }
    wanted = [("idm", "a"), ("replay", "b"), ("replay", "c")]
    for count in (2, 5):
        worst = worst_scenes(found, "idm", count)
        assert [(name, r["scene"]) for name, r in worst] == wanted[:count]


def test_reports_of_scenarios_link_to_replays(tmp_path):
    few = ["--quiet", "--limit", "3", "--replays", "1"]
    scenarios = ["bench", "scenarios", "--out", str(tmp_path / "s"), "--generators", "idm", *few]
    assert cli.main([*scenarios, "--planners", "idm,replay"]) == 0
    links = replays(tmp_path / "s")
    assert links
    for address in links:
        assert (tmp_path / "s" / address.partition("#")[0]).exists()


def test_without_matplotlib_a_plot_is_left_out_and_said(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(plots, "find_spec", lambda name: None)
    found = rows_of(idm__calm=[0.5], idm__critical=[0.5])
    assert plots.plot_robustness(found, {"calm": 0.0, "critical": 1.0}, str, tmp_path / "x") is None
    assert "pip install matplotlib" in capsys.readouterr().out
    assert not list(tmp_path.iterdir())


def test_names_of_lines_lie_above_the_axis_and_clear_of_one_another():
    pytest.importorskip("matplotlib")
    _, axes = plots.new_plot(4, 3)
    axes.set_ylim(0.0, 1.0)
    plots.name_ends(axes, [(0.9, 1.0, "a", "k"), *((0.0, 1.0, name, "k") for name in "bcd")])
    heights = [text.xyann[1] for text in axes.texts]
    assert heights[0] == 0.9
    assert min(heights) > 0.02
    assert np.all(np.diff(sorted(heights)) > 0.04)
