"""The sources of the operators' page: its words, and what must never be in it."""

import json
import re
from pathlib import Path

from unit.project.test_rules import OLD_WORDS

PAGE = Path(__file__).parents[3] / "orchestrator" / "gateway" / "page"
SOURCES = sorted(path for path in (PAGE / "src").rglob("*") if path.suffix in (".ts", ".tsx", ".css"))


def find_lines(pattern: str) -> list[str]:
    found = re.compile(pattern, re.IGNORECASE)
    return [
        f"{path.relative_to(PAGE)}:{number}: {line.strip()}"
        for path in SOURCES
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if found.search(line)
    ]


def test_the_page_is_in_the_words_of_the_field() -> None:
    assert len(SOURCES) > 30
    assert find_lines(rf"\b({'|'.join(OLD_WORDS)})\b") == []


def test_nothing_is_inserted_as_html_and_nothing_is_loaded_from_elsewhere() -> None:
    assert find_lines(r"innerHTML|outerHTML|insertAdjacentHTML|dangerouslySetInnerHTML|document\.write|\beval\(") == []
    assert [line for line in find_lines(r"https?://") if "www.w3.org" not in line] == []


def test_no_text_of_the_screen_is_outside_the_catalogue() -> None:
    """A literal of several words between tags, or in a label."""
    pattern = r">\s*[A-Z][a-z]+ [a-z]+[^<>{}=]*</|(aria-label|title|label|placeholder)=\"[A-Za-z]+ "
    assert [line for line in find_lines(pattern) if "texts.ts" not in line] == []


def test_the_lock_names_no_address_of_a_registry() -> None:
    lock = json.loads((PAGE / "package-lock.json").read_text(encoding="utf-8"))
    assert not [name for name, each in lock["packages"].items() if "resolved" in each]
    assert all("integrity" in each for name, each in lock["packages"].items() if name)
