"""Saved positions as the journal has them, read one by one: a damaged one moves nothing, and the others are kept."""

from collections.abc import Iterable
from zlib import crc32

from pydantic import ValidationError

from orchestrator.model.positions.entries import SavedPosition


def read_positions(rows: Iterable[tuple[str, str, int]]) -> tuple[list[SavedPosition], list[str]]:
    """The positions of rows of name, body and checksum; and the names of those that cannot be read."""
    positions: list[SavedPosition] = []
    damaged_names: list[str] = []
    for name, body, crc in rows:
        try:
            position = SavedPosition.read_stored(body)
        except ValidationError:
            damaged_names.append(name)
            continue
        if crc32(body.encode()) == crc and position.name == name:
            positions.append(position)
        else:
            damaged_names.append(name)
    return positions, damaged_names
