"""The edit subsystem on a port: `ED` and its control keys (L4512-L4560)."""

from typing import Protocol

from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.program.program import StoredProgram

DELETE, INSERT, PREVIOUS, QUIT = "\x04", "\t", "\x10", "\x11"


class EditorPort(Protocol):
    """The port that the editor writes to."""

    def emit_text(self, text: str) -> None:
        """Send text as it is."""
        ...

    def refuse_command(self, code: int) -> None:
        """Answer an invalid command."""
        ...


class ProgramEditor:
    """Ctrl-D deletes a line, ctrl-I inserts one before it, ctrl-P shows the one before, ctrl-Q quits, return saves.

    A line is shown with its number when it is reached; the prompt returns when the editor is left. An empty return
    keeps the line, and continues.
    """

    def __init__(self, port: EditorPort, program: StoredProgram, line: int) -> None:
        self._port = port
        self._program = program
        self._line = line
        self._typed = ""
        self._inserting = False
        self._show_line()

    def take_character(self, character: str) -> bool:
        """Process a character; return False when it was the last one of the editor."""
        lines = self._program.lines
        if character == QUIT:
            self._port.emit_text(":")
            return False
        if character == DELETE:
            if self._line < len(lines):
                self._replace_program(lines[: self._line] + lines[self._line + 1 :])
        elif character == INSERT:
            self._typed, self._inserting = "", True
            self._port.emit_text(f"{self._line:03d} \r\n")
            return True
        elif character == PREVIOUS:
            self._line = max(self._line - 1, 0)
        elif character == "\r":
            self._save_line()
        else:
            self._typed += character if character != "\n" else ""
            return True
        self._typed, self._inserting = "", False
        self._show_line()
        return True

    def _save_line(self) -> None:
        lines, line = self._program.lines, self._line
        if not self._typed:
            self._line = min(line + 1, len(lines))
            return
        next_line = line if self._inserting else line + 1
        if self._replace_program([*lines[:line], self._typed, *lines[next_line:]]):
            self._line = line + 1

    def _replace_program(self, lines: list[str]) -> bool:
        """Replace the program, with the refusals of a download; after a refusal the program stays unchanged."""
        try:
            self._program.replace_lines(lines)
        except CommandError as error:
            self._port.refuse_command(error.code)
            return False
        return True

    def _show_line(self) -> None:
        lines = self._program.lines
        text = lines[self._line] if self._line < len(lines) else ""
        self._port.emit_text(f"{self._line:03d} {text}\r\n")
