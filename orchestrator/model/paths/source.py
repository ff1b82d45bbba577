"""What the pieces of a path were made of: a file of another program, and the line of each piece."""

import hashlib
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, NamedTuple, Self

from pydantic import Field

from orchestrator.model.base import Model
from orchestrator.model.paths.pieces import MAX_PIECES
from orchestrator.model.text.text_fields import SHOW_TEXT

MAX_LINE = 100_000_000

FileName = Annotated[str, SHOW_TEXT, Field(max_length=300)]
_Line = Annotated[int, Field(ge=0, le=MAX_LINE)]
_Count = Annotated[int, Field(ge=1, le=MAX_PIECES)]
_Growth = Annotated[int, Field(ge=-MAX_LINE, le=MAX_LINE)]


def digest_text(text: str) -> str:
    """What tells a file of text from another one."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:32]


class LineRun(NamedTuple):
    """Pieces in a row: the line of the first one, how many, and by how much the line grows from each to the next."""

    line: _Line
    pieces: _Count
    growth: _Growth


class PathSource(Model):
    """The files that a path was made of. A job keeps it, so that it can be told where in them it stood, and whether
    they have changed since."""

    file: FileName = Field(description="The file of the pieces.")
    digests: dict[FileName, str] = Field(
        default={}, max_length=4, description="By file, that one and what it needs: what tells its text from another."
    )
    lines: list[LineRun] = Field(
        default=[],
        max_length=MAX_PIECES,
        description="The lines of the pieces: `[line, pieces, growth]` for pieces whose line grows evenly.",
    )

    @classmethod
    def of_lines(cls, file: str, lines: Sequence[int], digests: dict[str, str]) -> Self:
        """The source of pieces with these lines."""
        return cls(file=file, digests=digests, lines=_join_lines(lines))

    def find_line(self, piece: int) -> int | None:
        """The line of a piece, which has a number from 0; None: it is not known."""
        for run in self.lines:
            if piece < run.pieces:
                return run.line + piece * run.growth
            piece -= run.pieces
        return None

    def list_lines(self) -> list[int]:
        """The lines of all pieces."""
        return [run.line + number * run.growth for run in self.lines for number in range(run.pieces)]

    def cut(self, first: int, count: int) -> Self:
        """The source of `count` pieces from `first` on."""
        lines = self.list_lines()
        return self.model_copy(update={"lines": _join_lines(lines[first : first + count])})


def _join_lines(lines: Sequence[int]) -> list[LineRun]:
    """Lines as few runs."""
    runs: list[LineRun] = []
    begin = 0
    growths = [later_line - line for line, later_line in pairwise(lines)]
    while begin < len(lines):
        end = begin + 1
        while end < len(lines) and growths[end - 1] == growths[begin]:
            end += 1
        runs.append(LineRun(lines[begin], end - begin, growths[begin] if end > begin + 1 else 0))
        begin = end
    return runs
