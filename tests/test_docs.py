"""What README, docs and docstrings show runs: Python in order, command lines at least parsed."""

from __future__ import annotations

import argparse
import contextlib
import doctest
import importlib
import io
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import ccdiff_env
import ccdiff_env_cli
from ccdiff_env.scenes.embedded import unpack
from ccdiff_env.view.sources import play_scene
from ccdiff_env_cli import parse

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *ROOT.glob("[A-Z]*[A-Z].md"), *sorted((ROOT / "docs").glob("*.md"))]
PAGES = list(dict.fromkeys(PAGES))
BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
#: What is made smaller here than on the page.
SMALLER = {
    "make_vec(64": "make_vec(2",
    "make_vec(\n    128": "make_vec(\n    2",
    "AgentVectorEnv(16": "AgentVectorEnv(2",
    "**PPO_SETTINGS)": "**PPO_SETTINGS | {'n_steps': 8, 'batch_size': 16})",
    "learn(1_000_000)": "learn(1)",
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


WITH_PYTHON = [page for page in PAGES if any(kind == "python" for kind, *_ in blocks(page))]
WITH_COMMANDS = [page for page in PAGES if any(commands(page))]


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A folder with the files that pages name; nuScenes stands for the embedded scenes."""
    monkeypatch.chdir(tmp_path)
    unpack(tmp_path / "DIR")
    rollout = play_scene(ccdiff_env.embedded_scenes("val")[0], traffic="replay", driver="replay")
    rollout.save(tmp_path / "run.npz")
    rollout.to_scenarionet(tmp_path / "scenario.pkl")
    monkeypatch.setattr(
        ccdiff_env, "load_nuscenes", lambda *_, **__: ccdiff_env.embedded_scenes("val")
    )


@pytest.mark.parametrize("page", WITH_PYTHON, ids=ids(WITH_PYTHON))
def test_the_python_of_a_page_runs_from_top_to_bottom(page, desk):
    names: dict = {"__name__": page.stem}
    for language, text, line in blocks(page):
        if language != "python":
            continue
        for large, small in SMALLER.items():
            text = text.replace(large, small)
        exec(compile("\n" * line + text, str(page), "exec"), names)


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
            assert re.search(rf"^{verb}( .*)?:", (ROOT / "Makefile").read_text(), re.MULTILINE), (
                line
            )
        case ["pip", "install", *what]:
            project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
            extras = set(re.findall(r"^(\w+) = \[", project, re.MULTILINE))
            for names in re.findall(r"\[([\w,]+)\]", " ".join(what)):
                assert set(names.split(",")) <= extras, line
        case [] | ["cargo" | "cd" | "export", *_]:
            pass
        case _:
            pytest.fail(f"not known: {line}")


def test_commands_within_sentences_are_known():
    for page in PAGES:
        for line in re.findall(r"`(ccdiff-env [^`\n]+)`", page.read_text(encoding="utf-8")):
            words = shlex.split(line.replace("<nuscenes>", "/nuscenes"))
            options = [word for word in words if word.startswith("-")]
            verb = words[1 : 3 if words[1] == "bench" else 2]
            shown = help_of(verb)
            for option in options:
                assert re.search(rf"(?<![\w-]){option}\b", shown), f"{page.name}: {line}"


def help_of(verb: list[str]) -> str:
    """What ``--help`` of a verb prints."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text), pytest.raises(SystemExit):
        parse([*(word for word in verb if not word.startswith("-")), "--help"])
    return text.getvalue()


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


def test_every_verb_has_a_parser_with_arguments():
    assert set(ccdiff_env_cli.VERBS) == {name.split()[0] for name in VERBS}
    assert len(VERBS) == len(ccdiff_env_cli.VERBS) - 1 + 7  # bench has seven kinds


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


@pytest.mark.parametrize("verb", VERBS)
def test_help_lists_the_names_that_an_option_takes(verb):
    parser = VERBS[verb]
    listed = {
        "--methods": "ccdiff_unguided",
        "--planners": "pdm",
        "--traffic": {
            "view": "constant_velocity",
            "train-ego": "bank",
        }.get(verb, "ccdiff-1"),
        "--driver": "ego_replay",
        "--ego": "ego_replay",
        "--split": "mini_val",
        "--train-split": "train_val",
        "--model": "trafficsim",
        "--dynamics": "assisted" if verb == "train-ego" else "delta_pose",
    }
    for option in listed.keys() & parser._option_string_actions.keys():
        text = parser._get_formatter()._expand_help(parser._option_string_actions[option])
        assert listed[option] in text.partition("default: ")[0].partition(" of: ")[2], option


@pytest.mark.parametrize("page", PAGES, ids=ids(PAGES))
def test_tables_of_results_are_those_that_were_kept(page):
    from tools.results import rendered

    text = page.read_text(encoding="utf-8")
    assert rendered(text) == text, "python -m tools.results --render"


@pytest.mark.parametrize("name", ["realism", "speed", "learning", "dial"])
def test_charts_are_those_of_the_results_that_were_kept(name):
    from tools.charts import CHARTS, MADE

    made = (CHARTS / f"{name}.svg").read_text(encoding="utf-8")
    said = re.compile('aria-label="[^"]*[0-9][^"]*"')
    assert said.findall(MADE[name]()) == said.findall(made) != [], "python -m tools.charts"
    assert "prefers-color-scheme:dark" in made
