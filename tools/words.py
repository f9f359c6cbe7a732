"""Words per sentence and numbers per bullet in README and docs: ``python -m tools.words``.

Code, tables and headings do not count. ``make lint`` fails where a page is above a limit.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MAX_WORDS = 25
MAX_NUMBERS = 3  #: In a sentence; a bullet may not have more, either.
GENERATED = {"configuration.md"}  #: Its sentences are those of the options.

_NOT_PROSE = re.compile(
    r"^```[\s\S]*?^```$|<!--[\s\S]*?-->|^#+ .*$|^ *\|.*$|</?[a-z][^>\n]*>", re.M
)
_LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
_BULLET = re.compile(r"^ *(?:[*-]|\d+\.) ", re.M)
_END = re.compile(r"(?<=[.!?])[)\"*]*\s+")
_NUMBER = re.compile(r"(?<![\w.-])\d[\d,]*(?:\.\d+)?(?![\w-])")


def blocks(text: str) -> Iterator[tuple[bool, str]]:
    """Paragraphs and bullets of a page, with whether each is a bullet; code is one word."""
    text = _LINK.sub(r"\1", _NOT_PROSE.sub("\n\n", text))
    text = re.sub(r"(`+).+?\1", "code", text, flags=re.S)
    for paragraph in re.split(r"\n\s*\n", _BULLET.sub("\n\n* ", text)):
        words = paragraph.strip()
        if words:
            yield words.startswith("* "), words.removeprefix("* ")


def sentences(block: str) -> list[str]:
    """Sentences of a paragraph."""
    return [" ".join(part.split()) for part in _END.split(block) if part.strip()]


def problems(text: str) -> Iterator[str]:
    """What is above a limit in a page."""
    for is_bullet, block in blocks(text):
        for sentence in sentences(block):
            count = sum(any(c.isalnum() for c in word) for word in sentence.split())
            if count > MAX_WORDS:
                yield f"{count} words: {sentence}"
        for part in [block] if is_bullet else sentences(block):
            count = len(_NUMBER.findall(part))
            if count > MAX_NUMBERS:
                yield f"{count} numbers: {' '.join(part.split())}"


def main() -> int:
    """Check all pages; return the exit status."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    pages += sorted((ROOT / "docs/api").glob("*.md"))
    found = 0
    for page in pages:
        if page.name in GENERATED and page.parent.name == "docs":
            continue
        for problem in problems(page.read_text(encoding="utf-8")):
            found += 1
            print(f"{page.relative_to(ROOT)}: {problem}")
    words = sum(len(page.read_text(encoding="utf-8").split()) for page in pages)
    print(f"{len(pages)} pages, {words:,} words, {found} above a limit")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
