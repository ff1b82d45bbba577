"""A whole fleet file from the examples of makes: commented, checked, and ready for `--sim`."""

from collections.abc import Sequence
from typing import NamedTuple

from adapters.contract import ExamplePlace
from adapters.host.makes import apply_make_defaults, find_controller_problems, find_make
from orchestrator.model.fleet import Controller, Fleet
from orchestrator.model.jobs.files import FileError, parse_document
from orchestrator.model.plugins import PluginError

_HEAD = """\
# {makes}.
# Change links and numbers to those of the machine, and check it:  tutti fleet check {file}
# Run it without hardware:  tutti up {file} --sim
# Its schema for an editor:  tutti schema fleet
schema: tutti.fleet/1
fleet: {fleet}

controllers:
"""


class MakeCount(NamedTuple):
    """How many controllers of a make."""

    make: str
    number: int


def make_example_fleet(makes: Sequence[MakeCount], fleet: str, file: str) -> str:
    """The text of a fleet file. fleet: its name. file: the name of the file, for the comments.

    Raises `ValueError` for an unknown make.
    """
    blocks: list[str] = []
    names: list[str] = []
    port = 0
    for make, count in makes:
        example = find_make(make)
        for number in range(count):
            name = make if count == 1 else f"{make}-{number + 1}"
            names.append(name)
            text = example.fleet_example(ExamplePlace(number, port))
            blocks.append(f"  {name}:\n{_indent(text)}")
        port += count
    head = _HEAD.format(
        makes=" and ".join(f"{make_count.number} {make_count.make}" for make_count in makes), file=file, fleet=fleet
    )
    tail = f"\n# Without it, all axes are homed one after the other.\nhome_order: [{', '.join(names)}]\n"
    return head + "\n".join(blocks) + tail


def _indent(text: str) -> str:
    """Return the lines of an example below `controllers: NAME:`."""
    return "".join(f"    {line}\n" if line else "\n" for line in text.strip().splitlines())


def load_example(make: str) -> Controller:
    """Return the controller that the make's own example describes.

    Raises `UnknownPlugin`, and `PluginError` for an example that cannot be used.
    """
    source = f"the example of {make}"
    try:
        fleet = parse_document(make_example_fleet([MakeCount(make, 1)], "example", source), Fleet, source)
    except FileError as error:
        raise PluginError(f"fleet_example of {make} is no part of a fleet file: {error}", "correct it") from None
    config = apply_make_defaults(fleet).controllers[make]
    problems = find_controller_problems(make, config)
    if problems:
        text = "; ".join(problem.text for problem in problems)
        raise PluginError(f"fleet_example of {make} does not pass check_config: {text}", "correct one of them")
    return config
