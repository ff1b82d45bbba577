"""A program in G-code becomes the steps of a job. Meanings are those of LinuxCNC's G-code reference (RS274/NGC).

Each word of a line is taken for one meaning or refused, with line and column: a word that is left out could be the one
on which the machine depends.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from orchestrator.model.jobs.files import MAX_PROBLEMS, FileError, FileProblem
from orchestrator.model.paths.files.base.imported import ImportedSteps
from orchestrator.model.paths.files.base.problems import ImportProblems
from orchestrator.model.paths.files.gcode.blocks import ProgramLine, match_blocks
from orchestrator.model.paths.files.gcode.codes import DIALECTS
from orchestrator.model.paths.files.gcode.errors import LineError, ProgramLimit
from orchestrator.model.paths.files.gcode.expressions import Calculator
from orchestrator.model.paths.files.gcode.flow import ProgramFlow
from orchestrator.model.paths.files.gcode.line import CodeLine
from orchestrator.model.paths.files.gcode.offsets import read_tools
from orchestrator.model.paths.files.gcode.program import read_program
from orchestrator.model.paths.files.gcode.runner import LineRunner
from orchestrator.model.paths.files.gcode.words import read_words
from orchestrator.model.paths.gcode_settings import GcodeSettings

NOTHING = "the program moves nothing"


class GcodeReader:
    """Reads one program. axes: by letter, the axis of the fleet, e.g. `{"X": "gantry.x"}`; linear ones in mm.

    start: where the axes stand, mm, by letter; those that are not named stand at 0. settings: what stands for the
    machine that the program was written for. folder: of its tool table.
    """

    def __init__(
        self,
        name: str,
        axes: Mapping[str, str],
        start: Mapping[str, float] | None = None,
        settings: GcodeSettings | None = None,
        folder: Path | None = None,
    ) -> None:
        self._name = name
        self._settings = settings or GcodeSettings()
        self._dialect = DIALECTS[self._settings.dialect]
        self._problems = ImportProblems(name)
        self._lines = set[int]()  # with a mistake
        tools = None
        if self._settings.tool_table is not None:
            tools = read_tools((folder or Path()) / self._settings.tool_table)
        named_axes = {letter.upper(): axis for letter, axis in axes.items()}
        try:
            self._runner = LineRunner(named_axes, start or {}, self._settings, tools)
        except LineError as error:
            raise FileError([FileProblem(name, 1, "", error.text)]) from None
        self._calculator = Calculator(self._runner.find_state)

    def read_steps(self, lines: Sequence[str]) -> list[dict[str, Any]]:
        """The steps of a job: paths, and what stands between them. Raises `FileError` with every mistake."""
        return self.read_all(lines).steps

    def read_all(self, lines: Sequence[str], from_line: int = 1) -> ImportedSteps:
        """The same, with places and notes. from_line: the steps begin there, with a move to where the program stands
        then, and with the modes of the lines before. Raises `FileError` with every mistake."""
        program, problems = read_program(lines, self._settings, has_flow=self._dialect.has_flow)
        blocks, more = match_blocks(program)
        for number, error in (*problems, *more):
            self._note(number, error)
        runner = self._runner
        flow = ProgramFlow(program, blocks, self._calculator)
        modes: list[str] = []
        has_begun = from_line <= 1
        try:
            for line in flow.run() if not more else program:
                if not has_begun and line.number >= from_line and not flow.is_called:
                    has_begun, modes = True, runner.begin_here()
                if not self._read_line(line):
                    break
        except LineError as error:
            self._note(flow.line.number, error)
        if not has_begun:
            self._problems.add(from_line, 0, f"the program ends at line {flow.line.number}, before it")
        runner.finish()
        if not runner.writer.has_moved and not self._problems.found:
            self._problems.add(max(1, len(lines)), 0, NOTHING)
        self._problems.raise_any()
        notes = runner.notes.describe()
        return ImportedSteps(
            self._name, runner.writer.steps, runner.writer.places, notes, modes, lines=runner.writer.lines
        )

    def _read_line(self, line: ProgramLine) -> bool:
        """Run a line without an O word; False: the program ends here, or is too wrong to go on."""
        if line.control is not None:
            return True
        try:
            words = read_words(line.text, self._calculator if self._dialect.has_flow else None)
            if line.has_checksum:
                self._runner.notes.skip("*")
            return self._runner.run(CodeLine(words, self._dialect), line.number)
        except ProgramLimit:
            raise
        except LineError as error:
            self._note(line.number, error)
            return len(self._problems.found) < MAX_PROBLEMS

    def _note(self, number: int, error: LineError) -> None:
        """Note the first mistake of a line: what runs several times is wrong once."""
        if number not in self._lines:
            self._lines.add(number)
            self._problems.add(number, error.column, error.text)
