"""Fleet files that have passed every check that needs no hardware."""

from collections.abc import Callable
from pathlib import Path

from adapters.host.makes import apply_make_defaults, find_controller_problems
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, FileProblem, LoadedFile, parse_file, read_file
from orchestrator.model.problems import Problem
from orchestrator.runtime.simulated import find_simulation_problems


def load_checked_fleet(file: Path, *, tolerant: bool = False) -> Fleet:
    """Load the fleet in `file`, each controller's part checked by its make, and with the defaults of its make.

    tolerant: accept controllers whose make is installed and cannot be used; they never connect.

    Raises `FileError` with every problem.
    """
    return check_loaded_fleet(read_file(file), tolerant=tolerant)


def check_loaded_fleet(source: LoadedFile, *, tolerant: bool = False) -> Fleet:
    """The same for a fleet file that was read already, or arrived as text. Raises `FileError` with every problem."""
    fleet = parse_file(source, Fleet)
    return _complete_fleet(fleet, lambda problem: source.problem(problem.place, problem.text), tolerant=tolerant)


def check_fleet(fleet: Fleet) -> Fleet:
    """The same for a fleet that a program has made. Raises `FileError` with every problem."""
    name = f"fleet {fleet.fleet}"
    return _complete_fleet(
        fleet, lambda problem: FileProblem(name, 0, ".".join(map(str, problem.place)), problem.text), tolerant=False
    )


def _complete_fleet(fleet: Fleet, locate: Callable[[Problem], FileProblem], *, tolerant: bool) -> Fleet:
    fleet = apply_make_defaults(fleet)
    problems = [
        locate(problem)
        for name, config in fleet.controllers.items()
        for problem in [
            *find_controller_problems(name, config, tolerant=tolerant),
            *find_simulation_problems(name, config),
        ]
    ]
    if problems:
        raise FileError(problems)
    return fleet
