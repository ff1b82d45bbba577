"""What a line of a program is refused for."""

from orchestrator.model.errors import TuttiError


class LineError(TuttiError):
    """A mistake in a line. column: from 1; 0: the whole line. text: what is wrong, with what to write."""

    def __init__(self, column: int, text: str) -> None:
        super().__init__(text)
        self.column = column
        self.text = text


class ProgramLimit(LineError):
    """A program that is too long, or never ends: it is not read on."""
