"""Tables of reports: one value, written as Markdown, LaTeX and CSV; pages and terminals read the
first.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from ccdiff_env.system.files import write_aside

#: A value, and the ends of its interval; NaN where there is none.
Figure = tuple[float, float, float]
#: Words and counts are shown as they are; of a float or a figure NaN is ``n/a``, ``None`` nothing.
Cell = str | int | float | Figure | None
TableRows = list[list[Cell]]
#: Letters that mean something in Markdown, and where.
_MEANING = re.compile(r"[\\`*\[\]<|~$]|&(?=#?\w+;)|^[#>]|(?<![^\W_])_|_(?![^\W_])")
#: A letter that is escaped by Markdown is shielded as one of the area for private use.
_ESCAPED, _SHIELD = re.compile(r"\\([!-/:-@\[-`{-~])"), 0xE000


class Markdown(str):
    """A cell of Markdown, as a :func:`link`; other words are escaped where they enter a table."""

    __slots__ = ()


def escaped(text: str) -> Markdown:
    """Return the Markdown that shows a text, such as a name, as it is, on one line."""
    return Markdown(_MEANING.sub(r"\\\g<0>", " ".join(text.splitlines())))


def link(words: str, address: str) -> Markdown:
    """Return a link of Markdown."""
    return Markdown(f"[{escaped(words)}]({quote(address, safe='/:?#&=%+,;@!')})")


def shielded(markdown: str) -> str:
    """Return Markdown in which letters that are escaped mean nothing, for its readers."""
    return _ESCAPED.sub(lambda found: chr(_SHIELD + ord(found[1])), markdown)


def unshielded(text: str, letter: Callable[[str], str] = str) -> str:
    """Return what :func:`shielded` letters stand for, as ``letter`` writes each."""
    return text.translate({_SHIELD + i: letter(chr(i)) for i in range(128)})


@dataclass(frozen=True)
class Column:
    """How a column shows its numbers; a column of words alone is a text, its head.

    ``name`` is the head in files. Readers see ``head``, by default the name with blanks, with the
    ``unit``; numbers times ``factor`` with so many ``digits`` and, if ``sign`` is ``"+"``, with
    signs; and the ``interval``. ``best`` emphasises the highest of the numbers that they see.
    """

    name: str
    head: str | None = None
    unit: str = ""
    digits: int = 2
    sign: str = ""
    factor: float = 1.0
    interval: bool = True
    best: bool = False

    @property
    def title(self) -> str:
        """Head for readers, with the unit."""
        head = self.name.replace("_", " ") if self.head is None else self.head
        return f"{head} {self.unit}".rstrip()

    def text(self, cell: Cell) -> str:
        """Return a cell in Markdown."""
        if cell is None or isinstance(cell, Markdown):
            return cell or ""
        if isinstance(cell, str | int):
            return escaped(str(cell))
        figure = [self.factor * x for x in (cell if isinstance(cell, tuple) else (cell,))]
        if not math.isfinite(figure[0]):
            return "n/a"
        shown, *ends = (f"{x:{self.sign}.{self.digits}f}" for x in figure)
        known = self.interval and ends and all(map(math.isfinite, figure))
        return f"{shown} [{', '.join(ends)}]" if known else shown

    def texts(self, cells: Sequence[Cell]) -> list[str]:
        """Return all cells in Markdown."""
        texts = [self.text(cell) for cell in cells]
        if not self.best:
            return texts
        # a number alone, with an interval, or as a link
        numbers = [text.split(" ")[0].strip("[").split("]")[0] for text in texts]
        values = [float(n) if n not in ("", "n/a") else -math.inf for n in numbers]
        most = max([v for v in values if v > -math.inf], default=math.nan)
        return [f"**{t}**" if v == most else t for t, v in zip(texts, values, strict=True)]


@dataclass(frozen=True)
class Table:
    """Rows of cells under columns, with a heading; true if there are any."""

    heads: Sequence[Column | str]
    rows: Sequence[Sequence[Cell]]
    title: str = ""

    @property
    def columns(self) -> list[Column]:
        """Columns, those of words as well."""
        return [Column(c, head=c) if isinstance(c, str) else c for c in self.heads]

    def __len__(self) -> int:
        return len(self.rows)

    def __str__(self) -> str:
        shown = [c.texts([row[i] for row in self.rows]) for i, c in enumerate(self.columns)]
        lines = [[escaped(c.title) for c in self.columns], *zip(*shown, strict=True)]
        drawn = ["".join(f"| {cell} " if cell else "| " for cell in line) + "|" for line in lines]
        text = "\n".join([drawn[0], "|" + "---|" * len(shown), *drawn[1:]])
        return f"### {escaped(self.title)}\n\n{text}" if self.title else text

    def latex(self, caption: str = "", label: str = "", notes: Sequence[str] = ()) -> str:
        """Return the table for LaTeX with booktabs and graphicx, no wider than a line; the best of
        a column is bold.

        The title, by default ``caption``, stands above it, and ``notes``, texts of Markdown, below.
        """
        shown = [c.texts([row[i] for row in self.rows]) for i, c in enumerate(self.columns)]
        lines = [" & ".join(map(_latex, line)) + r" \\" for line in zip(*shown, strict=True)]
        head = " & ".join(_latex(escaped(c.title)) for c in self.columns) + r" \\"
        columns = "l" + "c" * (len(self.columns) - 1)
        parts = [r"\toprule", head, r"\midrule", *lines, r"\bottomrule"]
        parts = [rf"{_FIT}\begin{{tabular}}{{{columns}}}", *parts, r"\end{tabular}}"]
        title = self.title or caption
        above = [rf"\caption{{{_latex(escaped(title))}}}"] if title else []
        above += [rf"\label{{{label}}}"] if label else []
        marked = any(r"\dagger" in line for line in lines)
        told = [note for note in notes if marked or not note.startswith("†")]
        below = [rf"\par\footnotesize {_latex(note)}" for note in told]
        return "\n".join(
            [r"\begin{table}", r"\centering", *above, *parts, *below, r"\end{table}", ""]
        )

    def write_csv(self, path: Path) -> None:
        """Write names and cells; figures in three columns, empty where nothing is known."""
        ends = [
            ("", "_low", "_high") if any(isinstance(cell, tuple) for cell in column) else ("",)
            for column in zip(*self.rows, strict=True)
        ] or [("",)] * len(self.columns)
        heads = [c.name + end for c, of in zip(self.columns, ends, strict=True) for end in of]
        file = io.StringIO(newline="")
        writer = csv.writer(file)
        writer.writerow(heads)
        for row in self.rows:
            cells = [cell if isinstance(cell, tuple) else (cell, None, None) for cell in row]
            flat = [x for cell, of in zip(cells, ends, strict=True) for x in cell[: len(of)]]
            writer.writerow(["" if x is None or x != x else x for x in flat])
        write_aside(path, file.getvalue())


_FIT = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{"
_LATEX = {
    **{letter: rf"\{letter}" for letter in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{
        "†": r"$\dagger$",
        "±": r"$\pm$",
        "²": r"\textsuperscript{2}",
        "³": r"\textsuperscript{3}",
    },
    **{
        "−": "--",
        "σ": r"$\sigma$",
        "τ": r"$\tau$",
        "°": r"$^\circ$",
        "·": r"$\cdot$",
    },
}


def _latex(text: str) -> str:
    """A text of Markdown for LaTeX: links are their words, ``**bold**`` is bold."""
    words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", shielded(text))
    plain = "".join(_LATEX.get(letter, letter) for letter in words)
    bold = re.sub(r"\*\*(.+?)\*\*", r"\\textbf{\1}", plain)
    return unshielded(bold, lambda letter: _LATEX.get(letter, letter))


Block = Table | str  #: A part of a document.


def latex_tables(parts: Mapping[str, Sequence[Block]], prefix: str) -> str:
    """Return the tables of a report's parts, by heading, for LaTeX: each with a caption, a label
    ``tab:prefix-...``, and the texts of its part that follow its first table, else all of them.
    They need booktabs and graphicx.
    """
    found: list[str] = []
    for head, blocks in parts.items():
        first = next((i for i, block in enumerate(blocks) if isinstance(block, Table)), len(blocks))
        after = [block for block in blocks[first:] if isinstance(block, str) and block]
        notes = after or [block for block in blocks if isinstance(block, str) and block]
        for table in (block for block in blocks if isinstance(block, Table) and block):
            label = re.sub(r"\W+", "-", f"{prefix}-{head}-{table.title}".lower()).strip("-")
            found.append(table.latex(head, f"tab:{label}", notes))
    return "\n".join(found)


def document(*blocks: Block) -> str:
    """Return the Markdown of paragraphs and tables; those without text or rows are left out."""
    return "\n\n".join(str(block) for block in blocks if block) + "\n"
