"""Fleet files that have passed every check that needs no hardware."""

from pathlib import Path

from adapters.host.host import check_controller
from orchestrator.model.files import FileError, FileProblem, load_fleet
from orchestrator.model.fleet import Fleet


def load_checked_fleet(file: Path) -> Fleet:
    """Load the fleet in `file`, each controller's part checked by its make. Raises `FileError` with every problem."""
    fleet = load_fleet(file)
    problems: list[FileProblem] = []
    for name, config in fleet.controllers.items():
        try:
            check_controller(name, config)
        except ValueError as error:
            problems.append(FileProblem(str(file), _find_line_number(file, name), "", str(error)))
    if problems:
        raise FileError(problems)
    return fleet


def _find_line_number(file: Path, controller: str) -> int:
    """Return the line number where a controller begins, for the message."""
    lines = file.read_text(encoding="utf-8").splitlines()
    return next((k for k, line in enumerate(lines, start=1) if line.strip().startswith(f"{controller}:")), 1)
