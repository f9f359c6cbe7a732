"""``tools.words`` counts sentences and numbers, and the pages hold to its limits."""

from __future__ import annotations

import pytest

from tools import words

LONG = " ".join(["word"] * 26) + "."


def test_sentences_end_at_marks_and_not_in_numbers():
    text = "It took 0.5 s. Did it? (Yes!) Good."
    assert words.sentences(text) == ["It took 0.5 s.", "Did it?", "(Yes!", "Good."]


@pytest.mark.parametrize(
    "text",
    [
        LONG,
        f"* A bullet. {LONG}",
        f"Lines of\n a paragraph: {LONG}",
        "One 1, two 2, three 3, four 4.",
        "* One 1 and 2.\n  Three 3 and 4.",
        "1. A list of 1 and 2. Also 3 and 4.",
    ],
)
def test_what_is_above_a_limit_is_found(text):
    assert len(list(words.problems(text))) == 1


@pytest.mark.parametrize(
    "text",
    [
        LONG.replace("word ", "", 1),
        f"# {LONG}",
        f"| a | {LONG} |\n|---|---|",
        f"```\n{LONG}\n```",
        f"`{LONG}` is one word.",
        f"<!-- {LONG} -->",
        "[one](https://example.org/1-2-3-4) of v1.0, B2 and x86-64, 5, 6, 7",
        "One 1, two 2, three 3. Four 4.",
        "* Of 1 and 2.\n* Of 3 and 4.",
    ],
)
def test_what_is_within_them_is_not(text):
    assert list(words.problems(text)) == []


def test_pages_are_within_the_limits(capsys):
    assert words.main() == 0, capsys.readouterr().out
