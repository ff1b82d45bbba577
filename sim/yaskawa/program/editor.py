"""The edit subsystem on a port: `ED` and its control keys (L4512-L4560)."""

from typing import TYPE_CHECKING

from sim.yaskawa.base.errors import CommandError

if TYPE_CHECKING:
    from sim.yaskawa.ports.ports import Port

DELETE, INSERT, PREVIOUS, QUIT = "\x04", "\t", "\x10", "\x11"


class Editor:
    """Ctrl-D deletes a line, ctrl-I inserts one before it, ctrl-P shows the one before, ctrl-Q quits, return saves.

    A line is shown with its number when it is come to; the prompt comes again when the editor is left. An empty
    return keeps the line, and goes on.
    """

    def __init__(self, port: "Port", line: int) -> None:
        self._port = port
        self._program = port.machine.program
        self._line = line
        self._typed = ""
        self._inserting = False
        self._show()

    def take(self, character: str) -> bool:
        """A character has come; False when it was the last one of the editor."""
        lines = self._program.lines
        if character == QUIT:
            self._port.emit(":")
            return False
        if character == DELETE:
            if self._line < len(lines):
                self._replace(lines[: self._line] + lines[self._line + 1 :])
        elif character == INSERT:
            self._typed, self._inserting = "", True
            self._port.emit(f"{self._line:03d} \r\n")
            return True
        elif character == PREVIOUS:
            self._line = max(self._line - 1, 0)
        elif character == "\r":
            self._save()
        else:
            self._typed += character if character != "\n" else ""
            return True
        self._typed, self._inserting = "", False
        self._show()
        return True

    def _save(self) -> None:
        lines, line = self._program.lines, self._line
        if not self._typed:
            self._line = min(line + 1, len(lines))
            return
        kept = line if self._inserting else line + 1
        if self._replace([*lines[:line], self._typed, *lines[kept:]]):
            self._line = line + 1

    def _replace(self, lines: list[str]) -> bool:
        """Refused as a download would be; the program stays as it was."""
        try:
            self._program.replace(lines)
        except CommandError as error:
            self._port.refuse(error.code)
            return False
        return True

    def _show(self) -> None:
        lines = self._program.lines
        text = lines[self._line] if self._line < len(lines) else ""
        self._port.emit(f"{self._line:03d} {text}\r\n")
