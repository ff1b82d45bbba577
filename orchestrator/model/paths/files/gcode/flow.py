"""The order in which the lines of a program run: subroutines, branches and loops, bounded in number."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from orchestrator.model.paths.files.gcode.blocks import Block, Blocks, ControlLine, ProgramLine
from orchestrator.model.paths.files.gcode.errors import LineError, ProgramLimit
from orchestrator.model.paths.files.gcode.expressions import PASSED, Calculator, ExpressionReader, Scope

MOST_LINES = 1_000_000  # that run
MOST_CALLS = 10  # subroutines inside each other, as in LinuxCNC


@dataclass(slots=True)
class _Frame:
    """A subroutine that runs. back: the index of the line behind its call; counts: passes to come of its loops."""

    back: int
    label: str
    counts: dict[int, int] = field(default_factory=dict[int, int])


class ProgramFlow:
    """Runs the O words of a program. line: the one that runs; is_called: whether that is in a subroutine."""

    def __init__(self, lines: Sequence[ProgramLine], blocks: Blocks, calculator: Calculator) -> None:
        self.line: ProgramLine = ProgramLine(1, "", None)
        self._lines = lines
        self._blocks = blocks
        self._calculator = calculator
        self._frames = [_Frame(0, "")]
        self._branches = set[int]()  # that are looked at because those before them did not run
        self._runners = {
            "sub": self._skip_sub,
            "if": self._run_if,
            "elseif": self._run_if,
            "else": self._run_if,
            "endif": self._end_block,
            "do": self._end_block,
            "while": self._run_while,
            "endwhile": self._repeat_while,
            "repeat": self._run_repeat,
            "endrepeat": self._end_repeat,
            "break": self._break,
            "continue": self._continue,
        }

    @property
    def is_called(self) -> bool:
        """Whether a subroutine runs."""
        return len(self._frames) > 1

    def run(self) -> Iterator[ProgramLine]:
        """The lines without O words, in the order in which they run. Raises `LineError`, of `line`."""
        index, count = 0, 0
        while index < len(self._lines):
            self.line = line = self._lines[index]
            count += 1
            if count > MOST_LINES:
                raise ProgramLimit(0, f"more than {MOST_LINES} lines have run: a loop that does not end, or too long")
            if line.control is None:
                yield line
                index += 1
            else:
                index = self._run_control(index, line.control)

    def _run_control(self, index: int, control: ControlLine) -> int:
        """Run a line with an O word; the index of the next one."""
        reader = ExpressionReader(control.text, self._calculator, control.at)
        block = self._blocks.of.get(index)
        if control.kind == "call":
            following = self._call(index, control, reader)
        elif control.kind in ("return", "endsub"):
            following = self._return(reader)
        else:
            assert block is not None
            following = self._runners[control.kind](index, block, reader)
        if not reader.is_at_end:
            raise LineError(reader.at + 1, f"{control.text[reader.at :][:20]!r} stands behind o{control.label}")
        return following

    def _call(self, index: int, control: ControlLine, reader: ExpressionReader) -> int:
        block = self._blocks.subs.get(control.label)
        if block is None:
            raise ProgramLimit(control.column, f"o{control.label} is no subroutine of this file")
        if len(self._frames) > MOST_CALLS:
            raise ProgramLimit(control.column, f"subroutines call each other more than {MOST_CALLS} deep")
        values: list[float] = []
        while not reader.is_at_end:
            values.append(reader.read_bracket())
        if len(values) > PASSED:
            raise LineError(control.column, f"o{control.label} has {len(values)} values; the maximum is {PASSED}")
        self._frames.append(_Frame(index + 1, control.label))
        self._calculator.scopes.append(Scope(dict(enumerate(values, 1))))
        return block.lines[0] + 1

    def _return(self, reader: ExpressionReader) -> int:
        is_value = not reader.is_at_end
        self._calculator.common["_value"] = reader.read_bracket() if is_value else 0.0
        self._calculator.common["_value_returned"] = float(is_value)
        self._calculator.scopes.pop()
        return self._frames.pop().back

    def _skip_sub(self, _: int, block: Block, reader: ExpressionReader) -> int:
        reader.at = len(reader.text)
        return block.lines[-1] + 1

    def _run_if(self, index: int, block: Block, reader: ExpressionReader) -> int:
        number = block.lines.index(index)
        kind = self._find_kind(index)
        if kind in ("elseif", "else") and number and index not in self._branches:
            reader.at = len(reader.text)  # a branch before it has run
            return block.lines[-1] + 1
        self._branches.discard(index)
        if kind == "else" or reader.read_bracket() != 0:
            return index + 1
        following = block.lines[number + 1]
        if following == block.lines[-1]:
            return following + 1
        self._branches.add(following)
        return following

    def _find_kind(self, index: int) -> str:
        control = self._lines[index].control
        return "" if control is None else control.kind

    def _end_block(self, index: int, _: Block, __: ExpressionReader) -> int:
        return index + 1

    def _run_while(self, index: int, block: Block, reader: ExpressionReader) -> int:
        is_true = reader.read_bracket() != 0
        if block.kind == "do":
            return block.lines[0] + 1 if is_true else index + 1
        return index + 1 if is_true else block.lines[-1] + 1

    def _repeat_while(self, _: int, block: Block, __: ExpressionReader) -> int:
        return block.lines[0]

    def _run_repeat(self, index: int, block: Block, reader: ExpressionReader) -> int:
        times = round(reader.read_bracket())
        self._frames[-1].counts[index] = times
        return index + 1 if times > 0 else block.lines[-1] + 1

    def _end_repeat(self, index: int, block: Block, _: ExpressionReader) -> int:
        counts, begin = self._frames[-1].counts, block.lines[0]
        counts[begin] = counts.get(begin, 0) - 1
        return begin + 1 if counts[begin] > 0 else index + 1

    def _break(self, _: int, block: Block, __: ExpressionReader) -> int:
        return block.lines[-1] + 1

    def _continue(self, _: int, block: Block, __: ExpressionReader) -> int:
        return block.lines[0] if block.kind == "while" else block.lines[-1]
