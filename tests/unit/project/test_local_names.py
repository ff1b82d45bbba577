"""Local names are nouns. Where they are not yet, their number may only fall."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "tools"))
from local_names import find_local_names, is_no_noun, measure_folders  # noqa: E402

# Local names that are no nouns, per 1,000 lines: the most that a folder may have. A folder that is not here may have 0.
MOST: dict[str, float] = {}
CLEARLY = 1.0  # so far below its figure, a folder gets a lower one


def list_wrong_figures(folders: dict[str, float], most: dict[str, float]) -> list[str]:
    """What is wrong with the table of figures."""
    gone = sorted(most.keys() - folders.keys())
    lines = [f"{folder} is no folder of the product: take it out of the table" for folder in gone]
    for folder, figure in folders.items():
        limit = most.get(folder, 0.0)
        if figure > limit:
            lines.append(f"{folder} has {figure:.1f}, and {limit} is the most: name what the new names are, with nouns")
        elif figure < limit - CLEARLY:
            lines.append(f"{folder} has only {figure:.1f} now: lower its {limit} to that")
    return lines


@pytest.mark.structure
def test_no_folder_has_more_local_names_that_are_no_nouns_than_its_figure_and_each_figure_is_lowered() -> None:
    lines = list_wrong_figures(measure_folders(ROOT), MOST)
    assert not lines, "\n".join(lines)


def test_a_figure_that_is_exceeded_or_out_of_date_is_told() -> None:
    assert not list_wrong_figures({"a": 2.9, "b": 0.0}, {"a": 3.0})
    assert list_wrong_figures({"a": 3.1}, {"a": 3.0})[0].startswith("a has 3.1, and 3.0 is the most")
    assert list_wrong_figures({"b": 0.1}, {})[0].startswith("b has 0.1, and 0.0 is the most")
    assert list_wrong_figures({"a": 1.9}, {"a": 3.0}) == ["a has only 1.9 now: lower its 3.0 to that"]
    assert list_wrong_figures({}, {"a": 3.0})[0].startswith("a is no folder")


@pytest.mark.parametrize("name", ["each", "found", "before", "place", "rest", "wanted", "ended", "why", "_here"])
def test_adverbs_participles_and_pronouns_are_no_nouns(name: str) -> None:
    assert is_no_noun(name)


@pytest.mark.parametrize(
    "name", ["axis", "i", "speed", "feed", "first", "run", "reading", "before_ns", "is_moved", "a2"]
)
def test_nouns_loop_names_and_names_of_several_words_are_counted_as_nouns(name: str) -> None:
    assert not is_no_noun(name)


def test_local_names_are_those_of_each_scope_but_not_parameters_of_functions() -> None:
    source = """
GLOBAL = 1
def move(target, *, speed=1):
    global GLOBAL
    target = GLOBAL = 2
    for axis in [name for name in target]:
        with open(axis) as file, closing(file) as (reader, writer):
            count, total = 1, lambda part, key=lambda inner: inner: part
    try:
        pass
    except OSError as error:
        pass
    match total:
        case {"a": first, **others}:
            pass
        case [head, *tail] as pair:
            pass
    def stop():
        nonlocal count
        count = depth = 2
"""
    scopes = list(find_local_names(ast.parse(source)))
    names = {"axis", "file", "reader", "writer", "count", "total", "error", "first", "others", "head", "tail", "pair"}
    assert scopes[0] == names
    assert sorted(map(sorted, scopes[1:])) == [["depth"], ["inner"], ["key", "part"], ["name"]]
