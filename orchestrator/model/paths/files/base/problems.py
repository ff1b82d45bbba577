"""Mistakes of a file with their places."""

from dataclasses import dataclass, field

from orchestrator.model.jobs.files import FileError, FileProblem


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
