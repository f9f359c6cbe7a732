"""Lines per room against ``tools/budget.txt``: ``python -m tools.budget``.

A room that has grown fails, so that a change which adds lines says so in the table, which
``--update`` writes.
"""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "tools" / "budget.txt"
CODE = {".rs", ".py", ".pyi", ".js", ".css", ".html"}


def room(file: Path) -> str | None:
    """Return the room of a file: a crate or its tests, a package in ccdiff_env, or a folder."""
    first, *rest = file.parts
    if file.suffix == ".md" and (first == "docs" or file.name == "README.md"):
        return "words of README and docs"
    if file.suffix not in CODE:
        return None
    if first in ("rust", "ccdiff_env") and len(rest) > 1:
        tests = first == "rust" and ("tests" in rest or file.stem == "tests")
        return f"{first}/{rest[0]}{' tests' if tests else ''}"
    return first if rest else "."


def counted() -> Counter[str]:
    """Return lines by room; of pages their words."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True).stdout
    found: Counter[str] = Counter()
    for name in listed.split("\n")[:-1]:
        if (place := room(Path(name))) is not None and (ROOT / name).is_file():
            text = (ROOT / name).read_text(encoding="utf-8")
            found[place] += len(text.split() if name.endswith(".md") else text.splitlines())
    return found


def main(words: list[str]) -> int:
    """Print the rooms; return 1 if one has grown."""
    found = counted()
    if "--update" in words:
        rows = [f"{found[place]:6d} {place}\n" for place in sorted(found)]
        TABLE.write_text("".join(rows), encoding="utf-8")
    lines = TABLE.read_text(encoding="utf-8").splitlines()
    budget = {place: int(most) for most, place in (line.split(maxsplit=1) for line in lines)}
    grown = [place for place in sorted(found) if found[place] > budget.get(place, 0)]
    for place in sorted({*found, *budget}):
        mark = "  has grown" if place in grown else ""
        print(f"{found[place]:6d} of {budget.get(place, 0):6d}  {place}{mark}")
    if grown:
        print("remove as much as you add, or run python -m tools.budget --update and say why")
    return int(bool(grown))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
