"""The lines of a program, from its text: where it begins and ends, and what does not belong to it."""

from collections.abc import Sequence

from orchestrator.model.paths.files.gcode.blocks import ProgramLine, read_control
from orchestrator.model.paths.files.gcode.errors import LineError
from orchestrator.model.paths.files.gcode.words import strip_line
from orchestrator.model.paths.gcode_settings import GcodeSettings


def read_program(
    lines: Sequence[str], settings: GcodeSettings, *, has_flow: bool
) -> tuple[list[ProgramLine], list[tuple[int, LineError]]]:
    """The lines that are not empty, and mistakes with their lines. The second % ends the program."""
    program: list[ProgramLine] = []
    problems: list[tuple[int, LineError]] = []
    is_begun = False
    for number, text in enumerate(lines, 1):
        try:
            bare = strip_line(text)
            if not bare.text.strip():
                continue
            if bare.text.strip() == "%":
                if is_begun:
                    break
                is_begun = True
                continue
            is_begun = True
            if bare.is_deleted and settings.block_delete is None:
                example = "write `gcode: {block_delete: skip}` or `run`"
                raise LineError(text.index("/") + 1, f"a line that begins with / runs or not: {example}")
            if bare.is_deleted and settings.block_delete == "skip":
                continue
            # An O stands at the start of a line, or behind its number.
            is_control = has_flow and bare.text.lstrip()[:1] in "OoNn"
            control = read_control(bare.text) if is_control else None
            program.append(ProgramLine(number, bare.text, control, bare.has_checksum))
        except LineError as error:
            problems.append((number, error))
    return program, problems
