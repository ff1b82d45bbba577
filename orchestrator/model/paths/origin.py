"""Where the pieces of a path stand in the file that it was made of."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple


class Place(NamedTuple):
    """A place in a file: line and column, from 1; column 0: the whole line."""

    line: int
    column: int = 0

    def __str__(self) -> str:
        return f"{self.line}: column {self.column}" if self.column else f"{self.line}"


@dataclass(frozen=True, slots=True)
class PathOrigin:
    """The places of the pieces of a path in its file. notes: what of the file was left out, in words."""

    file: str
    places: Sequence[Place]
    notes: Sequence[str] = field(default_factory=list[str])

    def describe(self, piece: int) -> str:
        """The file, line and column of a piece, which has a number from 1; empty: they are not known."""
        return f"{self.file}:{self.places[piece - 1]}" if 0 < piece <= len(self.places) else ""
