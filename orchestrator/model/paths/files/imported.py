"""What an importer makes: the steps of a job, and mistakes with their places."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from orchestrator.model.jobs.files import FileError, FileProblem

DIGITS = 10  # of a number: more than any controller counts


def format_number(value: float) -> str:
    """A number as it stands in a job file."""
    text = f"{value:.{DIGITS}g}"
    return "0" if text == "-0" else text


@dataclass(slots=True)
class ImportProblems:
    """The mistakes of a file, gathered: nothing is half-imported."""

    file: str
    found: list[FileProblem] = field(default_factory=list[FileProblem])

    def add(self, line: int, column: int, text: str) -> None:
        """Add a mistake. column: from 1; 0: the whole line."""
        self.found.append(FileProblem(self.file, line, f"column {column}" if column else "", text))

    def raise_any(self) -> None:
        """Raises `FileError` with every mistake, if there is one."""
        if self.found:
            raise FileError(self.found)


def make_job(name: str, steps: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """A job file of steps, in plain values."""
    return {"schema": "tutti.job/1", "name": name, "steps": list(steps)}
