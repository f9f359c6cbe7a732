"""What README, docs and docstrings show runs; citations and tables of pages hold."""

import argparse
import doctest
import functools
import importlib
import json
import re
import runpy
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from stable_baselines3 import PPO

import ccdiff_env
import ccdiff_env_cli
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.envs.sb3 import SB3VecEnv, save_policy
from ccdiff_env.scenes import SceneSet
from ccdiff_env.scenes.embedded import unpack
from ccdiff_env.view.captions import guided_agents
from ccdiff_env.view.outcome import outcome
from ccdiff_env.view.sources import play_scene
from ccdiff_env_cli import parse
from tools import gallery
from tools.pages import DATA, rendered
from tools.results import USED_FOR

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *ROOT.glob("[A-Z]*[A-Z].md"), *sorted((ROOT / "docs").glob("*.md"))]
PAGES = list(dict.fromkeys(PAGES))
TOOLS = sorted((ROOT / "tools").glob("*.py"))
BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
#: What is made smaller here than on the page.
SMALLER = {
    r"(make_vec|AgentVectorEnv)\(\s*\d+": r"\1(2",
    r"\*\*PPO_SETTINGS": "**PPO_SETTINGS | {'n_steps': 8, 'batch_size': 16}",
    r"\bn_steps=\d+": "n_steps=8, batch_size=16",
    r"learn\([\d_]+": "learn(400",
    r"(demonstrations\(.*?)[\d_]{6,}": r"\g<1>200",
    r"DECISIONS = [\d_]+": "DECISIONS = 400",
    r"range\(\d+\)": "range(3)",
}


def blocks(page: Path) -> Iterator[tuple[str, str, int]]:
    """Language, text and first line of every fenced block."""
    text = page.read_text(encoding="utf-8")
    for found in BLOCK.finditer(text):
        yield found[1], found[2], text.count("\n", 0, found.start(2))


def commands(page: Path) -> Iterator[str]:
    """Command lines of a page, without comments; figures drawn with characters are left out."""
    for language, text, _ in blocks(page):
        if language in ("", "bash") and "──" not in text:
            for line in re.sub(r"\\\n", " ", text).splitlines():
                if line.strip():
                    yield line


def ids(pages: list[Path]) -> list[str]:
    return [page.stem for page in pages]


WITH_COMMANDS = [page for page in PAGES if any(commands(page))]


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A folder with the files that pages name; nuScenes stands for the embedded scenes."""
    monkeypatch.chdir(tmp_path)
    unpack(tmp_path / "DIR")
    rollout = play_scene(ccdiff_env.embedded_scenes("val")[0], traffic="replay", driver="replay")
    rollout.save(tmp_path / "run.npz")
    rollout.to_scenarionet(tmp_path / "scenario.pkl")
    save_policy(PPO("MlpPolicy", SB3VecEnv(ccdiff_env.make_vec(1))), "my_ego.zip")
    monkeypatch.setattr(
        ccdiff_env, "load_nuscenes", lambda *_, **__: ccdiff_env.embedded_scenes("val")
    )


INDEX = (ROOT / "docs/index.md").read_text(encoding="utf-8")
TUTORIALS = re.search(r":caption: Tutorials\n:hidden:\n\n([^`]+)", INDEX)[1].split()
PYTHON = {
    f"{page.stem}-{line}": (page, "\n" * line + text)
    for page in PAGES
    for language, text, line in blocks(page)
    if language == "python" and page.stem not in TUTORIALS
}


def smaller(text: str) -> str:
    """A block in the size that runs here."""
    for large, small in SMALLER.items():
        text = re.sub(large, small, text)
    return text


@pytest.mark.parametrize("block", PYTHON)
def test_every_block_of_python_runs_by_itself(block, desk):
    page, text = PYTHON[block]
    exec(compile(smaller(text), str(page), "exec"), {"__name__": page.stem})


#: What is made smaller in the commands of tutorials.
FEWER = {
    r" --open": "",
    r"bench planners": r"bench planners --seeds 0",
    r"--protocol \S+": "--traffic idm",
    r"bench realism": r"bench realism --samples 2",
    r"(bench (planners|traffic|realism))": r"\1 --limit 1 --quiet",
}


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_leads_from_its_first_line_to_its_last(name, desk, monkeypatch):
    assert len(TUTORIALS) == 3
    monkeypatch.syspath_prepend(Path.cwd())
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    for language, text, _ in blocks(ROOT / f"docs/{name}.md"):
        if language == "python" and (file := re.match(r"# (\w+\.py)\n", text)):
            Path(file[1]).write_text(text, encoding="utf-8")
        elif language == "python":
            exec(compile(smaller(text), name, "exec"), {"__name__": name})
        else:
            for large, small in FEWER.items():
                text = re.sub(large, small, text)
            for line in text.splitlines():
                assert ccdiff_env_cli.main(shlex.split(line)[1:]) == 0, line


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=ids(WITH_COMMANDS))
def test_the_command_lines_of_a_page_are_understood(page):
    for line in commands(page):
        understood(line)


def understood(line: str) -> None:
    """Fail where a command line names a verb, an option or a file that is not there."""
    words = shlex.split(line.replace("<nuscenes>", "/nuscenes"), comments=True)
    while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
        words.pop(0)
    match words:
        case ["ccdiff-env", *rest]:
            parse(rest)
        case ["python", "-m", module, *_]:
            assert importlib.util.find_spec(module), line
        case ["python", "-c", code]:
            compile(code, line, "exec")
        case ["python", script, *rest]:
            text = (ROOT / script).read_text(encoding="utf-8")
            if "add_scene_arguments" in text:
                text += (ROOT / "ccdiff_env/scenes/arguments.py").read_text(encoding="utf-8")
            missing = [w for w in rest if w.startswith("--") and f'"{w}"' not in text]
            assert not missing, line
        case ["make", verb, *_]:
            text = (ROOT / "Makefile").read_text(encoding="utf-8")
            assert re.search(rf"^{verb}( .*)?:", text, re.MULTILINE), line
        case ["pip", "install", *what]:
            project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
            extras = set(re.findall(r"^(\w+) = \[", project, re.MULTILINE))
            for names in re.findall(r"\[([\w,]+)\]", " ".join(what)):
                assert set(names.split(",")) <= extras, line
        case [] | ["cargo" | "cd" | "export", *_]:
            pass
        case _:
            pytest.fail(f"not known: {line}")


def modules() -> list[str]:
    """Modules whose docstrings have examples."""
    files = (ROOT / "ccdiff_env").rglob("*.py")
    return sorted(
        ".".join(file.relative_to(ROOT).with_suffix("").parts)
        for file in files
        if ">>> " in file.read_text(encoding="utf-8")
    )


@pytest.mark.parametrize("name", modules())
def test_examples_of_docstrings_hold(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = doctest.testmod(
        importlib.import_module(name.removesuffix(".__init__")),
        optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS,
    )
    assert found.attempted
    assert not found.failed


def parsers(parser: argparse.ArgumentParser, name: str = "") -> Iterator[tuple[str, Any]]:
    """A parser and all below it, by their words."""
    below = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not below:
        yield name, parser
    for action in below:
        for word, found in action.choices.items():
            yield from parsers(found, f"{name} {word}")


VERBS = {
    name.strip(): parser
    for verb in ccdiff_env_cli.VERBS
    for name, parser in parsers(ccdiff_env_cli.parser_for([verb]))
    if name.split()[0] == verb
}


def test_commands_within_sentences_are_known():
    for page in PAGES:
        for line in re.findall(r"`(ccdiff-env [^`\n]+)`", page.read_text(encoding="utf-8")):
            _, *words = shlex.split(line.replace("<nuscenes>", "/nuscenes"))
            verb = " ".join(words[: 2 if words[0] == "bench" else 1])
            options = {word for word in words if word.startswith("-")}
            assert options <= {*VERBS[verb]._option_string_actions}, f"{page.name}: {line}"


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_every_option_says_what_it_does_and_its_default(verb):
    parser = VERBS[verb]
    one_of = {a for group in parser._mutually_exclusive_groups for a in group._group_actions}
    for action in parser._actions:
        text = parser._get_formatter()._expand_help(action)
        words = text.partition("(default")[0]
        assert len(words.split()) > 1, (verb, action.option_strings)
        is_flag = action.nargs == 0
        if action.option_strings and not (is_flag or action.required or action in one_of):
            assert "default: " in text, (verb, action.option_strings, text)


@pytest.mark.parametrize("page", PAGES, ids=ids(PAGES))
def test_tables_are_those_of_results_and_schemas(page):
    text = page.read_text(encoding="utf-8")
    assert rendered(text) == text, "python -m tools.pages"
    typed = re.sub(r"(?s)<!-- (results|table): .*?<!-- end -->", "", text)
    assert not re.findall(r"^\|.*\d \[[-+]?\d.*", typed, re.MULTILINE), "figures of no result"


@pytest.mark.parametrize(("width", "boxes"), [(390, True), (1280, False)])
def test_a_wide_table_of_the_site_is_read_without_scrolling_sideways(browser, width, boxes):
    static = ROOT / "docs" / "_static"
    heads = ["planner", *(f"figure {i}" for i in range(8))]
    rows = (heads, ["PDM-Closed", *["12.3 [11.1, 13.5], p 0.04"] * 8])
    table = "".join(f"<tr>{''.join(f'<td><p>{c}</p></td>' for c in row)}</tr>" for row in rows)
    table = table.replace("<tr>", "<thead><tr>", 1).replace("</tr>", "</tr></thead><tbody>", 1)
    page = browser.new_page(viewport={"width": width, "height": 800})
    page.set_content(
        f"<style>{(static / 'site.css').read_text('utf-8')}.table-wrapper {{ overflow: auto }}"
        f"</style><div class=table-wrapper><table>{table}</table></div>"
        f"<script>{(static / 'copy.js').read_text('utf-8')}</script>"
    )
    scrolls = "(e) => e.scrollWidth - e.clientWidth"
    assert [page.eval_on_selector(e, scrolls) for e in ("html", ".table-wrapper")] == [0, 0]
    above = "(cells) => cells.map((c) => getComputedStyle(c, '::before').content)"
    named = [f'"{head} "' for head in heads] if boxes else ["none"] * len(heads)
    assert page.eval_on_selector_all("tbody td", above) == named
    assert page.inner_text("tbody td:last-child").split("\n")[:2] == ["12.3", "[11.1, 13.5]"]
    page.close()


@pytest.mark.parametrize("name", ["realism", "learning", "dial"])
def test_charts_are_those_of_the_results_that_were_kept(name):
    from tools.charts import CHARTS, MADE

    made = (CHARTS / f"{name}.svg").read_text(encoding="utf-8")
    said = re.compile('aria-label="[^"]*[0-9][^"]*"')
    assert said.findall(MADE[name]()) == said.findall(made) != [], "python -m tools.charts"
    assert "prefers-color-scheme:dark" in made


def test_pictures_of_the_front_page_are_copied_into_the_site():
    docs = ROOT / "docs"
    names = re.findall(r'<img src="([^"]+)"', INDEX)
    settings = (docs / "conf.py").read_text("utf-8")
    assert names
    for name in names:
        assert (docs / name).is_file(), name
        assert f'"{name}"' in re.search(r"html_extra_path = (.*)", settings)[1]


#: A page and perhaps a heading; names in quotes or backticks are files that the code writes.
CITATION = re.compile(r"(?<![\w\"`'/{*])((?:docs/)?[\w-]+\.md)(?:#([\w-]+))?(?! \d)\b")
LINK = re.compile(r"\]\(([\w./-]+\.\w+)?(?:#([\w-]+))?\)")


def headings(page: Path) -> set[str]:
    """Anchors of a page, as GitHub makes them."""
    titles = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def lost(page: Path, heading: str | None) -> bool:
    """Whether a citation leads nowhere."""
    return not page.exists() or (heading is not None and heading not in headings(page))


def code() -> list[Path]:
    """Every file of code that may cite a page."""
    folders = [("rust", "*.rs"), ("ccdiff_env", "*.py"), ("tests", "*.py"), ("examples", "*.py")]
    files = [file for folder, ending in folders for file in (ROOT / folder).rglob(ending)]
    return [file for file in files if file != Path(__file__).resolve()]


def test_citations_in_code_resolve():
    dead, found = [], 0
    for file in code():
        text = file.read_text(encoding="utf-8")
        for line in re.findall(r"^.*\.md.*$", text, re.MULTILINE):
            assert not re.search(r"\.md \d", line), f"{file}: cite a heading, not a number: {line}"
            for name, heading in CITATION.findall(line):
                found += 1
                folders = (ROOT / "docs", ROOT, file.parent)
                if all(lost(folder / name, heading or None) for folder in folders):
                    dead.append(f"{file.relative_to(ROOT)}: {name}#{heading}")
    assert dead == []
    assert found > 60, "the pattern no longer finds the citations"


@functools.cache
def texts() -> dict[str, str]:
    """Text of every file of code, by its path without ``src``."""
    folders = ("rust", "ccdiff_env", "tests", "tools", "examples", "benchmarks")
    files = [file for folder in folders for file in (ROOT / folder).rglob("*.*")]
    return {
        f"/{file.relative_to(ROOT)}".replace("/src/", "/"): file.read_text(encoding="utf-8")
        for file in files
        if file.suffix in (".rs", ".py", ".js")
    }


def named_in(text: str) -> list[str]:
    """Texts of the files of code that a page names, leading folders and ``src`` left out."""
    found = []
    for name in re.findall(r"`([\w/.{},-]+\.(?:rs|py|js))`", re.sub(r"(?s)```.*?```", "", text)):
        before, _, rest = name.partition("{")
        inner, _, after = rest.partition("}")
        for one in inner.split(","):
            end = f"/{before}{one}{after}".replace("/src/", "/")
            here = [whole for file, whole in texts().items() if file.endswith(end)]
            assert here or name == "mine.py", name  # the reader's
            found += here
    return found


@pytest.mark.parametrize("page", PAGES, ids=ids(PAGES))
def test_files_that_a_page_names_exist(page):
    if page.name != "CHANGELOG.md":
        named_in(page.read_text(encoding="utf-8"))


def test_the_architecture_says_where_to_look():
    text = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    rows = re.search(r"## Where to look\n\n.*\n.*\n((?:\|.*\n)+)", text)[1].splitlines()
    assert len(rows) >= 12
    for row in rows:
        files = named_in(row)
        assert files, row
        for name in re.findall(r"`(\w+)`", row):
            assert name in files[0], row


def test_links_between_pages_resolve():
    dead = []
    for page in [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]:
        for name, heading in LINK.findall(page.read_text(encoding="utf-8")):
            if (name or heading) and lost(page.parent / name if name else page, heading or None):
                dead.append(f"{page.name}: {name}#{heading}")
    assert dead == []


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


@pytest.mark.parametrize("driver", ["idm", "ego"])
def test_the_demo_ends_in_a_scene_in_which_criticality_decides(driver):
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (shown,) = re.findall(r"view (\S+) --traffic (\S+) --criticality (\S+) (\S+)", makefile)
    scene, traffic = ccdiff_env.embedded_scenes()[shown[0]], shown[1]
    levels = ({"criticality": float(level)} for level in shown[2:])
    runs = [play_scene(scene, traffic=traffic, driver=driver, ccdiff=level) for level in levels]
    assert [outcome(run).tone for run in runs] == ["good", "bad"]
    assert runs[1].collisions("ego")[0].partner_id in guided_agents(runs[1])


def test_the_gallery_shows_where_criticality_decides_and_who_is_hit_first(tmp_path, monkeypatch):
    scenes, drivers = [*ccdiff_env.embedded_scenes("val")], ("idm", "pdm")
    names = [scene.name for scene in scenes]
    monkeypatch.setattr(gallery, "DRIVERS", drivers)
    played = {
        (driver, traffic): drive(SceneSet(scenes), driver, TRAFFIC[traffic], record=names)
        for driver in drivers
        for traffic in ("ccdiff-1", "ccdiff")
    }
    fates = {key: {n: outcome(run) for n, run in of.items()} for key, (_, of) in played.items()}
    decided = {
        name: [
            fates[driver, "ccdiff-1"][name].mishap == "is hit"
            for driver in drivers
            if fates[driver, "ccdiff-1"][name].tone == "bad"
            and (fates[driver, "ccdiff"][name].tone, fates[driver, "ccdiff"][name].others)
            == ("good", 0)
        ]
        for name in names
    }
    shown = {name: any(hits) for name, hits in decided.items() if hits}
    index = gallery.write_gallery(tmp_path / "all", scenes).read_text(encoding="utf-8")
    assert {page.stem for page in (tmp_path / "all").glob("*-*.html")} == {*shown}
    order = sorted(shown, key=lambda name: index.index(f'href="{name}.html'))
    assert [shown[name] for name in order] == sorted(shown.values(), reverse=True)
    # each shows both worlds; menus choose what happened, who drove, which scenes
    assert index.count("<img") == 2 * len(shown)
    assert (
        index.count("criticality 1: ego ") == index.count("realistic: ego reached ") == len(shown)
    )
    score = {key: {row["scene"]: row["score"] for row in rows} for key, (rows, _) in played.items()}
    less = {n: score["pdm", "ccdiff-1"][n] - score["idm", "ccdiff-1"][n] for n in names}
    index = gallery.write_duel(tmp_path / "duel", scenes, "pdm", "idm").read_text(encoding="utf-8")
    pages = (page.stem for page in (tmp_path / "duel").glob("*-*.html"))
    order = sorted(pages, key=lambda name: index.index(f'href="{name}.html'))
    ranked = sorted(less.values())
    wins = [value for value in ranked[::-1][: gallery.EACH] if value > 0.0]
    losses = [value for value in ranked[: gallery.EACH] if value < 0.0]
    assert [less[name] for name in order] == [*wins, *losses]


@pytest.mark.parametrize("tool", [p.stem for p in TOOLS if "__main__" in p.read_text("utf-8")])
def test_a_tool_that_helps_or_lacks_data_writes_nothing(tool, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [tool, "--help"])
    monkeypatch.delitem(sys.modules, f"tools.{tool}", raising=False)
    with pytest.raises(SystemExit, match="0"):
        runpy.run_module(f"tools.{tool}", run_name="__main__")
    assert capsys.readouterr().out.startswith("usage:")
    if tool == "gallery":
        monkeypatch.setenv("CCDIFF_DATA", str(tmp_path))
        monkeypatch.setattr(sys, "argv", [tool, "pages"])
        with pytest.raises(SystemExit, match="2"):
            runpy.run_module("tools.gallery", run_name="__main__")
        missing = f"CCDIFF_DATA: data set is missing: {tmp_path / 'nuscenes'}\n"
        assert capsys.readouterr().err == missing
    assert not [*tmp_path.iterdir()]
