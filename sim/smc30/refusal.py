"""Reasons for which a command is refused (L1534-L1562)."""

from typing import Literal

from orchestrator.model.errors import TuttiError

Code = Literal["E1", "E2", "E3", "E4", "E5", "E6"]


class StatementRefused(TuttiError):
    """A command, or a program line at run time, that fails with `code`."""

    def __init__(self, code: Code) -> None:
        super().__init__(code)
        self.code: Code = code
