"""Differences of JSON objects: what a reader makes of them is the object itself."""

import random
from typing import Any

import pytest

from orchestrator.gateway.stream.merge_patch import apply_patch, drop_nulls, make_patch


def draw_value(draw: random.Random, depth: int) -> Any:
    kind = draw.randrange(6 if depth else 4)
    if kind >= 4:
        return {draw.choice("abcde"): draw_value(draw, depth - 1) for _ in range(draw.randrange(4))}
    return [draw.randrange(3), draw.choice("xy"), [draw.randrange(2), None], draw.random() < 0.5][kind]


def draw_object(draw: random.Random) -> dict[str, Any]:
    return {draw.choice("abcdefgh"): draw_value(draw, 3) for _ in range(6)}


@pytest.mark.parametrize("seed", range(300))
def test_a_patch_leads_from_one_object_to_the_other(seed: int) -> None:
    draw = random.Random(seed)
    before, after = draw_object(draw), draw_object(draw)
    patch = make_patch(before, after)
    assert apply_patch(before, patch) == after
    assert bool(patch) == (before != after)


def test_a_patch_has_what_differs_and_nothing_else() -> None:
    before = {"a": {"x": 1, "y": {"z": 2}}, "b": [1, 2], "c": 3}
    after = {"a": {"x": 1, "y": {"z": 4}}, "b": [1, 2, 3]}
    assert make_patch(before, after) == {"a": {"y": {"z": 4}}, "b": [1, 2, 3], "c": None}


def test_nulls_are_dropped_from_objects_only() -> None:
    assert drop_nulls({"a": None, "b": {"c": None, "d": 1}, "e": [None]}) == {"b": {"d": 1}, "e": [None]}
