"""Citations of pages in code and docs lead somewhere: the page exists, and has the heading."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: A page and perhaps a heading; names in quotes or backticks are files that the code writes.
CITATION = re.compile(r"(?<![\w\"`'/{*])((?:docs/)?[\w-]+\.md)(?:#([\w-]+))?(?! \d)\b")
LINK = re.compile(r"\]\(([\w./-]+\.md)?(?:#([\w-]+))?\)")


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


def test_files_that_the_architecture_names_exist():
    """Paths may leave out leading folders and ``src``; braces hold several names."""
    text = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    found = []
    for name in re.findall(r"`([\w/.{},-]+\.(?:rs|py|js))`", text):
        before, _, rest = name.partition("{")
        inner, _, after = rest.partition("}")
        found += [f"{before}{one}{after}" for one in inner.split(",")]
    folders = ("rust", "ccdiff_env", "tests", "tools", "examples", "benchmarks")
    files = [
        f"/{file.relative_to(ROOT)}" for folder in folders for file in (ROOT / folder).rglob("*.*")
    ]
    files = [file.replace("/src/", "/") for file in files]
    named = {name: f"/{name.replace('/src/', '/')}" for name in found}
    assert [name for name, end in named.items() if not any(f.endswith(end) for f in files)] == []
    assert len(found) > 30


def test_links_between_pages_resolve():
    dead = []
    for page in [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]:
        for name, heading in LINK.findall(page.read_text(encoding="utf-8")):
            if (name or heading) and lost(page.parent / name if name else page, heading or None):
                dead.append(f"{page.name}: {name}#{heading}")
    assert dead == []
