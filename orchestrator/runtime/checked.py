"""Fleet files that have passed every check that needs no hardware."""

from pathlib import Path

from adapters.host.host import apply_make_defaults, find_controller_problems
from orchestrator.model.files import FileError, parse_file, read_file
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.simulated import find_simulation_problems


def load_checked_fleet(file: Path) -> Fleet:
    """Load the fleet in `file`, each controller's part checked by its make, and with the defaults of its make.

    Raises `FileError` with every problem.
    """
    source = read_file(file)
    fleet = apply_make_defaults(parse_file(source, Fleet))
    problems = [
        source.problem(each.place, each.text)
        for name, config in fleet.controllers.items()
        for each in [*find_controller_problems(name, config), *find_simulation_problems(name, config)]
    ]
    if problems:
        raise FileError(problems)
    return fleet
