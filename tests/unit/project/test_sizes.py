"""Classes and functions that are too large stand in a list, `large.txt`, that may only shrink."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
LIST = Path(__file__).parent / "large.txt"
sys.path.insert(0, str(ROOT / "tools"))
import figures  # noqa: E402

GENERATED = "orchestrator/client/blocking.py "  # by tools/blocking_client.py: one method for each of `Tutti`


def read_list() -> dict[str, int]:
    """The list: a size and a name in each line, as `tools/figures.py --large` prints it."""
    rows = [line.split(maxsplit=1) for line in LIST.read_text(encoding="utf-8").splitlines()]
    return {name: int(size) for size, name in rows}


def list_wrong_sizes(sizes: dict[str, int], most: dict[str, int]) -> list[str]:
    """What differs from the list, each with what to do."""
    lines = [f"{name} is not too large any more: take it out of the list" for name in sorted(most.keys() - sizes)]
    for name, size in sizes.items():
        if name not in most:
            lines.append(f"{name} has {size}: cut it by responsibility")
        elif size > most[name]:
            lines.append(f"{name} has {size}, and {most[name]} is the most: cut it by responsibility")
        elif size < most[name]:
            lines.append(f"{name} has only {size} now: lower its {most[name]} to that")
    return lines


@pytest.mark.structure
def test_no_class_and_no_function_grows_beyond_its_size_in_the_list() -> None:
    sizes = {name: size for name, size in figures.list_large().items() if not name.startswith(GENERATED)}
    lines = list_wrong_sizes(sizes, read_list())
    assert not lines, "\n".join(lines)


def test_what_is_new_larger_smaller_or_gone_is_named() -> None:
    assert not list_wrong_sizes({"a": 16}, {"a": 16})
    assert list_wrong_sizes({"a": 16}, {}) == ["a has 16: cut it by responsibility"]
    assert list_wrong_sizes({"a": 17}, {"a": 16})[0].startswith("a has 17, and 16 is the most")
    assert list_wrong_sizes({"a": 16}, {"a": 17})[0].startswith("a has only 16 now")
    assert list_wrong_sizes({}, {"a": 17})[0].startswith("a is not too large any more")
