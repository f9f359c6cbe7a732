"""The page of the tasks says what the schemas say, and its images exist."""

from __future__ import annotations

import re
from pathlib import Path

from tools.task_tables import TABLES, filled

PAGE = Path(__file__).resolve().parents[1] / "docs" / "tasks.md"


def test_tables_are_those_of_the_schemas():
    text = PAGE.read_text(encoding="utf-8")
    assert filled(text) == text, "python -m tools.task_tables docs/tasks.md"
    assert set(re.findall(r"<!-- table: (\w+) -->", text)) == set(TABLES)


def test_images_and_pages_that_are_named_exist():
    text = PAGE.read_text(encoding="utf-8")
    for name in re.findall(r"\]\(([\w./]+)\)", text):
        assert (PAGE.parent / name).exists(), name


def test_pictures_of_the_front_page_are_copied_into_the_site():
    names = re.findall(r'<img src="([^"]+)"', PAGE.with_name("index.md").read_text("utf-8"))
    settings = PAGE.with_name("conf.py").read_text("utf-8")
    assert names
    for name in names:
        assert PAGE.with_name(name).is_file(), name
        assert f'html_extra_path = ["{name}"]' in settings
