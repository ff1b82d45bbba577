"""Each state that an adapter infers has a row in the page of its make, with what ends it, and tests that exist."""

import re
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[2]
PAGES = Path(__file__).parents[3] / "docs" / "reference" / "controllers"
WITHOUT_TABLE = ("vectors",)
WITH_TABLE = sorted(page.stem for page in PAGES.glob("*.md") if page.stem not in WITHOUT_TABLE)
COLUMNS = 4  # state, beginning, end, tests
_NAMED_TEST = re.compile(r"`([\w/]+\.py)::(\w+)`")


def list_rows(page: str) -> list[list[str]]:
    """The rows of the table of a page, without its head."""
    _, _, section = (PAGES / f"{page}.md").read_text(encoding="utf-8").partition("Inferred states\n")
    section = section.partition("\n## ")[0]
    rows = [line.strip("|").split(" | ") for line in section.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in row] for row in rows[1:]]


@cache
def list_tests(path: str) -> frozenset[str]:
    """The names of the tests in a file."""
    return frozenset(re.findall(r"^def (test_\w+)", (TESTS / path).read_text(encoding="utf-8"), re.MULTILINE))


@pytest.mark.parametrize("page", WITH_TABLE)
def test_each_inferred_state_has_an_end_and_a_test_that_exists(page: str) -> None:
    rows = list_rows(page)
    assert rows
    for row in rows:
        assert len(row) == COLUMNS and all(row), row
        named = _NAMED_TEST.findall(row[-1])
        assert named, row
        missing_tests = [name for path, name in named if name not in list_tests(path)]
        assert not missing_tests, row
