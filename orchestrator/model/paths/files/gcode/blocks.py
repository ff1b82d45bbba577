"""O words of a file: subroutines, branches and loops, matched before anything runs."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from orchestrator.model.paths.files.gcode.errors import LineError

_O_WORD = re.compile(r"\s*(?:N\s*\d+\s*)?O\s*(?:(\d{1,9})|<([^<>]{1,100})>)\s*([A-Za-z]+)?", re.IGNORECASE | re.ASCII)
_CLOSERS = {"endsub": "sub", "endif": "if", "endrepeat": "repeat"}
_OPENERS = ("sub", "if", "repeat", "do")
_LOOPS = ("while", "do", "repeat")
KINDS = (*_OPENERS, *_CLOSERS, "elseif", "else", "while", "endwhile", "break", "continue", "return", "call")


class ControlLine(NamedTuple):
    """A line with an O word. at: where its text goes on behind the keyword; column: of its O, from 1."""

    label: str
    kind: str
    text: str
    at: int
    column: int


class ProgramLine(NamedTuple):
    """A line without comments. control: its O word, if it has one."""

    number: int
    text: str
    control: ControlLine | None
    has_checksum: bool = False


@dataclass(slots=True)
class Block:
    """A block between O words. lines: the indices of its lines with O words, in order: if, elseif, else, endif."""

    kind: str
    label: str
    lines: list[int] = field(default_factory=list[int])


@dataclass(frozen=True, slots=True)
class Blocks:
    """The blocks of a program. of: the block of each index with an O word; subs: by label."""

    of: Mapping[int, Block]
    subs: Mapping[str, Block]


def read_control(text: str) -> ControlLine | None:
    """The O word of a line without comments; None: it has none. Raises `LineError`."""
    match = _O_WORD.match(text)
    if match is None:
        return None
    column = text.upper().index("O") + 1
    label = match[1] or re.sub(r"\s", "", match[2]).lower()
    kind = (match[3] or "").lower()
    if kind not in KINDS:
        raise LineError(
            column,
            f"o{label[:40]} {kind[:20]}: an O word is followed by one of: {', '.join(KINDS)}; alone it is of fanuc",
        )
    return ControlLine(label.lstrip("0") or "0" if match[1] else label, kind, text, match.end(), column)


class _Matcher:
    """Matches the O words of a program."""

    def __init__(self) -> None:
        self.of: dict[int, Block] = {}
        self.subs: dict[str, Block] = {}
        self._open: list[Block] = []

    def take(self, index: int, control: ControlLine) -> None:
        """Take the next line with an O word. Raises `LineError`."""
        kind, label = control.kind, control.label
        top = self._open[-1] if self._open and self._open[-1].label == label else None
        if kind == "while" and top is not None and top.kind == "do":
            self._close(index)
        elif kind in _OPENERS or kind == "while":
            self._begin(index, control)
        elif kind in ("elseif", "else", *_CLOSERS, "endwhile"):
            self._continue(index, control, top)
        elif kind in ("break", "continue"):
            self._leave(index, control)
        elif kind == "return" and not any(block.kind == "sub" for block in self._open):
            raise LineError(control.column, f"o{label} return stands outside of a subroutine")

    def finish(self, lines: Sequence[ProgramLine]) -> tuple[int, LineError] | None:
        """The line and the mistake of a block that is not closed."""
        if not self._open:
            return None
        block = self._open[-1]
        line = lines[block.lines[0]]
        assert line.control is not None
        end = {"do": "while"}.get(block.kind, f"end{block.kind}")
        return line.number, LineError(line.control.column, f"o{block.label} {block.kind} has no o{block.label} {end}")

    def _begin(self, index: int, control: ControlLine) -> None:
        block = Block(control.kind, control.label, [index])
        if control.kind == "sub":
            if self._open:
                raise LineError(control.column, f"o{control.label} sub stands inside o{self._open[-1].label}")
            if control.label in self.subs:
                raise LineError(control.column, f"o{control.label} sub is there twice")
            self.subs[control.label] = block
        self._open.append(block)
        self.of[index] = block

    def _continue(self, index: int, control: ControlLine, top: Block | None) -> None:
        opener = {"elseif": "if", "else": "if", "endwhile": "while"}.get(control.kind) or _CLOSERS[control.kind]
        if top is None or top.kind != opener:
            raise LineError(
                control.column, f"o{control.label} {control.kind} has no o{control.label} {opener} before it"
            )
        if control.kind in ("elseif", "else"):
            self.of[index] = top
            top.lines.append(index)
        else:
            self._close(index)

    def _close(self, index: int) -> None:
        block = self._open.pop()
        block.lines.append(index)
        self.of[index] = block

    def _leave(self, index: int, control: ControlLine) -> None:
        for block in reversed(self._open):
            if block.kind in _LOOPS and block.label == control.label:
                self.of[index] = block
                return
        raise LineError(control.column, f"o{control.label} {control.kind} stands outside of a loop o{control.label}")


def match_blocks(lines: Sequence[ProgramLine]) -> tuple[Blocks, list[tuple[int, LineError]]]:
    """The blocks of a program, and mistakes with their lines."""
    matcher = _Matcher()
    problems: list[tuple[int, LineError]] = []
    for index, line in enumerate(lines):
        if line.control is None:
            continue
        try:
            matcher.take(index, line.control)
        except LineError as error:
            problems.append((line.number, error))
    last_problem = matcher.finish(lines)
    if last_problem is not None and not problems:
        problems.append(last_problem)
    return Blocks(matcher.of, matcher.subs), problems
