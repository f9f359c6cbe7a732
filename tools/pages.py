"""Tables of README and docs: ``python -m tools.pages`` writes them between the marks of the pages.

``<!-- results: NAME -->`` and ``<!-- end -->`` hold what a run of ``tools.results`` kept in
docs/results; ``<!-- results: NAME; A, B -->`` has the columns A and B alone, ``<!-- results: NAME;
A, B; X, Y -->`` their rows of X and Y. ``<!-- table: NAME -->`` holds a table of
``tools.task_tables`` or ``tools.expectations``, or a file of docs/results that has ``heads``.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ccdiff_env.system.table import Markdown, Table, document

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "docs" / "results"
_BLOCK = re.compile(
    r"(<!-- (results|table): (\w+)(?:; ([^>;]+))?(?:; ([^>]+))? -->\n).*?<!-- end -->", re.DOTALL
)


def kept(name: str) -> Any:
    """Return what the run of a table kept."""
    return json.loads((DATA / f"{name}.json").read_text(encoding="utf-8"))


def keep(name: str, head: Mapping[str, Any], rows: Iterable[Mapping[str, Any]]) -> None:
    """Keep the rows of a table, each on a line, below what is said of its run."""
    lines = ",\n  ".join(json.dumps(row) for row in rows)
    text = json.dumps(head, indent=1)[:-2] + f',\n "rows": [\n  {lines}\n ]\n}}\n'
    (DATA / f"{name}.json").write_text(text, encoding="utf-8")


def _with_heads(run: Mapping[str, Any]) -> str:
    """The rows of a run under ``heads``, which name keys of the rows."""
    cells = [[row.get(key, "–") for key in run["heads"]] for row in run["rows"]]
    written = [[f"{c:,}" if isinstance(c, int) else Markdown(c) for c in row] for row in cells]
    machine = f"{run['machine']}, {run['date']}." if "machine" in run else ""
    return document(Table([*run["heads"].values()], written), machine).rstrip()


def rendered(page: str) -> str:
    """Return a page with its tables."""
    # imported here: these keep their rows by this module
    from tools import expectations, results, task_tables

    def block(found: re.Match[str]) -> str:
        mark, kind, name, columns, rows = found.groups()
        if kind == "results":
            return f"{mark}{results.render(name, columns, rows)}\n<!-- end -->"
        if made := task_tables.TABLES.get(name):
            return f"{mark}\n{made()}\n\n<!-- end -->"
        run = kept(name)
        table = _with_heads(run) if "heads" in run else expectations.table(run["rows"])
        return f"{mark}\n{table}\n\n<!-- end -->"

    return _BLOCK.sub(block, page)


def write() -> None:
    """Write the tables of all pages."""
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        old = page.read_text(encoding="utf-8")
        if (new := rendered(old)) != old:
            page.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    write()
