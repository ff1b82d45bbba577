"""The documents agree with the tree: the files and names that they mention exist."""

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PACKAGES = ("orchestrator", "adapters", "sim", "integrations", "benches", "tests", "tools")
PAGES = sorted(path.relative_to(ROOT) for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
FILE = re.compile(r"(?<![\w/.])(?:orchestrator|adapters|sim|benches|tests|deploy|tools)/[\w/.*-]*[\w*]")
MEMBER = re.compile(r"`(_?[A-Z][a-z]{2,}\w*)\.([a-z_]\w{2,})`")


@cache
def names_in_code() -> tuple[set[str], set[str]]:
    """The classes, and what may be a member of one: functions, and first words of lines that are indented once."""
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    source = "\n".join(path.read_text(encoding="utf-8") for path in files)
    indented = re.findall(r"^    (\w+)", source, re.MULTILINE)
    return set(re.findall(r"class (\w+)", source)), {*re.findall(r"def (\w+)", source), *indented}


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_files_that_a_page_mentions_exist(page: Path) -> None:
    mentioned = set(FILE.findall((ROOT / page).read_text(encoding="utf-8")))
    missing = [each for each in mentioned if not [*ROOT.glob(each)] and not (ROOT / f"{each}.py").exists()]
    assert not missing, f"{page}: no such file: {', '.join(sorted(missing))}"


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_classes_and_methods_that_a_page_mentions_exist(page: Path) -> None:
    unknown: list[str] = []
    classes, members = names_in_code()
    for name, member in sorted(set(MEMBER.findall((ROOT / page).read_text(encoding="utf-8")))):
        if name not in classes:
            unknown.append(name)
        elif member not in members:
            unknown.append(f"{name}.{member}")
    assert not unknown, f"{page}: not in the code: {', '.join(unknown)}"
