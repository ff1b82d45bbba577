"""Pieces of a long path: the same pieces, in a fraction of the memory."""

import pickle
import tracemalloc
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import pytest

from orchestrator.model.paths.packed import PART_ITEMS, PackedPieces, pack_pieces
from orchestrator.model.paths.pieces import MAX_PIECES, LinePiece, Piece
from orchestrator.model.script import WrongValue
from orchestrator.model.steps.path import FollowPath

COUNT = 2 * PART_ITEMS + 7


def make_pieces(count: int) -> list[Piece]:
    return [LinePiece(to=[f"{number % 7} mm", number]) for number in range(count)]


def make_path(pieces: Sequence[Any]) -> FollowPath:
    return FollowPath(axes=["gantry.x", "gantry.y"], start=[0, 0], tolerance="10 um", pieces=pieces)


def test_packed_pieces_are_those_of_the_list() -> None:
    pieces = make_pieces(COUNT)
    packed = pack_pieces(pieces)
    assert isinstance(packed, PackedPieces) and len(packed) == COUNT
    assert list(packed) == pieces
    for number in (0, PART_ITEMS - 1, PART_ITEMS, COUNT - 1, -1, -COUNT):
        assert packed[number] == pieces[number]
    for span in (slice(3), slice(PART_ITEMS - 2, PART_ITEMS + 2), slice(None, None, -300)):
        assert packed[span] == pieces[span]
    for number in (COUNT, -COUNT - 1):
        with pytest.raises(IndexError, match=f"piece {number} of {COUNT}"):
            packed[number]
    assert packed == pack_pieces(pieces) != pack_pieces(pieces[1:])
    assert pickle.loads(pickle.dumps(packed)) == packed


def test_a_path_packs_its_pieces_when_there_are_many() -> None:
    assert isinstance(make_path(make_pieces(PART_ITEMS)).pieces, list)
    path = make_path(make_pieces(COUNT))
    assert isinstance(path.pieces, PackedPieces)
    assert FollowPath.model_validate_json(path.to_json()) == path
    assert make_path(path.to_plain()["pieces"]) == path
    assert make_path(path.pieces).pieces is path.pieces


def test_a_mistake_in_a_long_path_has_its_place() -> None:
    pieces = [piece.to_plain() for piece in make_pieces(COUNT)]
    pieces[PART_ITEMS + 3]["to"] = [1]
    with pytest.raises(WrongValue, match=rf"pieces\.{PART_ITEMS + 3}\.to has 1 values for 2 axes"):
        make_path(pieces)
    pieces[PART_ITEMS + 3]["to"] = None
    with pytest.raises(WrongValue, match=rf"pieces\.{PART_ITEMS + 3}\.line\.to"):
        make_path(pieces)


def test_too_many_pieces_are_refused() -> None:
    with pytest.raises(WrongValue, match=f"at most {MAX_PIECES}"):
        make_path([{"piece": "line", "to": [0, 0]}] * (MAX_PIECES + 1))


def test_the_memory_of_a_long_path_is_that_of_its_text() -> None:
    text = make_path(make_pieces(10 * PART_ITEMS)).to_json()
    tracemalloc.start()
    path = FollowPath.model_validate_json(text)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 3 * len(text)
    assert all(a.to != b.to for a, b in pairwise(path.pieces))
