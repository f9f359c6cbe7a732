"""What the front pages promise has tests (promises.md); their figures are those that were kept."""

import ast
import re
from pathlib import Path

from tools.pages import kept

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text("utf-8")
ROW = re.compile(r"^\| (.+) \| `([\w/.]+)::(\w+|\*)` \|$", re.MULTILINE)
PROMISES = ROW.findall((ROOT / "tests/promises.md").read_text("utf-8"))


def plain(text: str) -> str:
    """A text without its links, emphasis and line breaks."""
    return " ".join(re.sub(r"\]\([^)]*\)|[\[*]", "", text).split())


def test_every_promise_of_the_front_page_names_a_test_that_is_there():
    said = plain(README + (ROOT / "docs/index.md").read_text("utf-8"))
    for promise, file, name in PROMISES:
        assert plain(promise) in said, promise
        tree = ast.parse((ROOT / file).read_text("utf-8"))
        functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        assert name == "*" or name in functions, f"{file}::{name}"
        assert name == "main" or any(function.startswith("test_") for function in functions)
    promised = README.partition("## When to use something else")[0]
    bullets = re.findall(r"^\* (.+)$", promised, re.MULTILINE)
    assert len(bullets) > 8
    for bullet in bullets:
        assert any(plain(promise) in plain(bullet) for promise, *_ in PROMISES), bullet


def test_figures_of_the_front_page_are_those_that_were_kept():
    speed = {row["what"]: row for row in kept("speed")["rows"]}
    assert speed["IDM"]["1"] > 50 * speed["highway-env's highway-fast-v0"]["1"]
    assert all(2 * speed["swift"][size] > speed["IDM"][size] for size in ("1", "64", "1024"))

    ppo, _, idm, pdm = kept("expectations")["rows"]
    percent = [f"{100 * share:.0f}" for share in (min(ppo["seeds"]), max(ppo["seeds"]))]
    assert f"{ppo['success']:.0f} % of held-out episodes" in README
    assert f"(three seeds: {percent[0]} to {percent[1]} %)" in README
    assert f"PDM-Closed arrive in {idm['success']:.0f} and {pdm['success']:.0f} %" in README

    realism = {row["method"]: row["realism"] for row in kept("realism")["rows"]}
    driven = sorted(realism.keys() - {"replay"}, key=lambda name: -realism[name][0])
    assert driven[0] == "swift"
    assert all("_routes_" in name for name in driven[1:5])
    assert realism["idm"][1] < realism["ccdiff_careful"][0] < realism["idm"][2]

    rivals = {row["method"]: row["fde"] for row in kept("matched_less")["rows"]}
    assert all(rivals[name][1] < 0 < rivals[name][2] for name in ("trafficsim", "ctg", "ctgpp"))

    in_idm, in_critical = (row["shares"] for row in kept("learning_matrix")["rows"][:2])
    less = []
    for traffic in ("ccdiff-1-one-step", "ccdiff-2-one-step"):
        assert in_critical[traffic][2] < in_idm[traffic][0]
        less.append(f"{100 * (1 - in_critical[traffic][0] / in_idm[traffic][0]):.0f}")
    assert f"collides {' and '.join(less)} % less" in README

    less_pdm = next(
        r for r in kept("ego_pairs")["rows"] if (r["against"], r["traffic"]) == ("pdm", "mean")
    )
    assert less_pdm["difference"][1] > 0
    assert f"scores above PDM-Closed (three seeds, p {less_pdm['p'][0]:.2f})" in README
