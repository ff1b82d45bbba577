"""Errors of fleets in tests, and names and times that a test gives."""

from collections.abc import Iterable

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.base import UnknownName
from orchestrator.model.errors import TuttiError
from orchestrator.model.fleet import Axis, Controller, DigitalInput, Fleet
from orchestrator.model.fleet_names import list_names, suggest_name
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.numbers import parse_duration


class BadTest(TuttiError):
    """A test that cannot be run as it is written: a name, a time, or a call at a place where it is not possible."""


class FleetViolation(TuttiError, AssertionError):
    """An invariant of the fleet was violated. The text has all violations, and the seed."""


class CallbackFailed(TuttiError):
    """A function that a test has scheduled has raised; its error is the cause."""


def find_controller(fleet: Fleet, name: str) -> Controller:
    """The controller `name`. Raises `UnknownName` with those that there are."""
    if name not in fleet.controllers:
        names = list(fleet.controllers)
        raise UnknownName(
            name,
            f"the fleet has no controller {name[:80]}; {suggest_name(name, names)}{list_names(names, 'controller')}",
        )
    return fleet.controllers[name]


def find_axis(fleet: Fleet, name: str) -> tuple[str, Axis]:
    """The controller of the axis `controller.axis`, and the axis. Raises `UnknownName` with those that there are."""
    return controller_of(name), fleet.axis(name)


def find_input(fleet: Fleet, name: str) -> tuple[str, DigitalInput]:
    """The controller of the input `controller.input`, and the input. Raises `UnknownName` with those that there are."""
    unknown = fleet.names.explain_unknown(name, "input")
    if unknown is not None:
        raise UnknownName(name, unknown)
    controller, own = split_name(name)
    return controller, fleet.controllers[controller].inputs[own]


def find_choice(kind: str, name: str, known: Iterable[str]) -> str:
    """`name`, if it is one of `known`. Raises `UnknownName` with the near ones, and all."""
    choices = list(known)
    if name in choices:
        return name
    text = f"there is no {kind} {name[:80]!r}; {suggest_name(name, choices)}choose one of: {', '.join(choices)}"
    raise UnknownName(name, text)


def parse_delay_ns(what: str, delay: str | float | None) -> int | None:
    """A time from now, as text with a unit or in seconds, in ns. Raises `BadTest`, which names `what` it is."""
    if delay is None:
        return None
    try:
        return parse_duration(delay if isinstance(delay, str) else f"{delay:.9f} s")
    except ValueError as error:
        raise BadTest(f"{what}: {error}") from None


def format_s(at_ns: int) -> str:
    """An instant or duration in seconds, for texts."""
    return f"{at_ns / NS_PER_S:.3f} s"
