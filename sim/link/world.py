"""Physical environment of a live simulator, changed by JSON lines."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from orchestrator.model.errors import TuttiError
from orchestrator.model.problems import describe_first_error
from sim.core.contact import ContactBench, ContactPlace
from sim.core.controller import LimitSwitch, SimulatedController


class EnvironmentRefused(TuttiError, ValueError):
    """A line that cannot be carried out; the message states the reason."""


class EnvironmentChange(BaseModel):
    """One line: any of these, applied in this order.

    input: number and level.
    analog: number and volts.
    limit: axis and switches.
    stall: axis, on.
    push: axis, and the counts by which it is moved by hand.
    contact: axis, the counts from where it stands to the place where an input changes, the number of the input, and its
    level from there on; 0 counts remove it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    power: bool | None = None
    input: tuple[Annotated[int, Field(ge=0)], bool] | None = None
    analog: tuple[Annotated[int, Field(ge=1)], Annotated[float, Field(ge=-1000, le=1000)]] | None = None
    limit: tuple[str, LimitSwitch] | None = None
    stall: tuple[str, bool] | None = None
    push: tuple[str, int] | None = None
    contact: tuple[str, Annotated[float, Field(ge=-1e9, le=1e9)], Annotated[int, Field(ge=0)], bool] | None = None


def change_environment(controller: SimulatedController, line: str, contacts: ContactBench | None = None) -> None:
    """Carry out the JSON `line`. contacts: where a contact is put. Raises `EnvironmentRefused`."""
    try:
        change = EnvironmentChange.model_validate_json(line)
    except ValidationError as error:
        raise EnvironmentRefused(f'{describe_first_error(error, "line")}; e.g. {{"input": [1, true]}}') from None
    for axis in [pair[0] for pair in (change.limit, change.stall, change.push, change.contact) if pair is not None]:
        if axis not in controller.axis_names:
            raise EnvironmentRefused(f"no axis {axis!r}; available: {', '.join(controller.axis_names)}")
    try:
        _apply_change(controller, change)
        if change.contact is not None and contacts is not None:
            _put_contact(controller, contacts, change.contact)
    except ValueError as error:
        raise EnvironmentRefused(str(error)) from None


def _apply_change(controller: SimulatedController, change: EnvironmentChange) -> None:
    if change.power is not None:
        controller.set_power(on=change.power)
    if change.input is not None:
        number, level = change.input
        controller.set_input(number, level=level)
    if change.analog is not None:
        controller.set_analog(*change.analog)
    if change.limit is not None:
        controller.set_limit(*change.limit)
    if change.stall is not None:
        axis, is_stalled = change.stall
        controller.set_stalled(axis, stalled=is_stalled)
    if change.push is not None:
        controller.push_axis(*change.push)


def _put_contact(controller: SimulatedController, contacts: ContactBench, change: tuple[str, float, int, bool]) -> None:
    axis, distance, number, level = change
    if not distance:
        contacts.remove(controller, number)
        return
    at_counts = controller.physical_position(axis) + distance
    contacts.put(controller, ContactPlace(axis, at_counts, 1 if distance > 0 else -1, number, level=level))
