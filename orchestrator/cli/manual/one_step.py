"""Manual actions as jobs of one step, so that they are leased, checked, recorded and stopped like any other job.

They end with the command: see `orchestrator.cli.jobs.foreground`.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import console, print_result, with_fleet
from orchestrator.cli.base.errors import exit_with_error

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.jobs.service import FleetNames
    from orchestrator.model.report import JobReport
    from orchestrator.model.steps.base import Step
    from orchestrator.model.units import Unit

F = TypeVar("F", bound=Callable[..., Any])


def wait_option(command: F) -> F:
    """Add the option `--wait`."""
    return click.option(
        "--wait", is_flag=True, help="Wait for axes that are in use, instead of being refused; shows what it waits for."
    )(command)


def run_single_step(
    connect: str, fleet: str | None, step: dict[str, Any], done: str, *, wait: bool, as_json: bool
) -> None:
    """Submit a job of one step, wait for it, and print `done` with its axes and their positions, or its reason. Exit 1
    if it is not done, 2 if the fleet does not have its names.

    wait: let it wait for axes that are in use. An interrupt stops what the step moves.
    """
    from pydantic import ValidationError

    from orchestrator.cli.jobs.foreground import run_attended
    from orchestrator.model.jobs.job import Job
    from orchestrator.model.problems import first_error_text

    try:
        job = Job.model_validate({"schema": "tutti.job/1", "name": f"manual: {step['do']}", "steps": [step]})
    except ValidationError as error:
        exit_with_error(first_error_text(error).removeprefix("Value error, "), BAD_INPUT)

    async def submit_step(tutti: "Tutti") -> None:
        nonlocal job
        names = await tutti.list_names()
        job = job.model_copy(update={"steps": [_spread_groups(names, _spread_fleet(names, job.steps[0]))]})
        axes = _check_names(names, job.steps[0])
        report = await run_attended(tutti, job, wait=wait, quiet=as_json or not console.is_terminal)
        if report.state != "done":
            _exit_with_failure(report)
        await _print_outcome(tutti, report, axes, done, as_json=as_json)

    with_fleet(connect, fleet, submit_step)


def _spread_fleet(names: "FleetNames", step: "Step") -> "Step":
    """A step that switches motors, with all controllers of the fleet for the word `all`."""
    from orchestrator.model.fleet_names import WHOLE_FLEET
    from orchestrator.model.steps.motors import Disable, Enable

    if not isinstance(step, Enable | Disable) or step.axes != [WHOLE_FLEET]:
        return step
    return step.model_copy(update={"axes": list(names.controllers)})


def _spread_groups(names: "FleetNames", step: "Step") -> "Step":
    """A move to a position, with the axes of it that its groups and controllers stand for. Raises `Refusal`."""
    from orchestrator.model.errors import Refusal
    from orchestrator.model.names import controller_of, is_position_name
    from orchestrator.model.steps.move import Move

    if not isinstance(step, Move) or not any(map(is_position_name, step.to.values())):
        return step
    targets = dict[str, Any]()
    known_axes = names.axes | names.virtual
    for name, target in step.to.items():
        if name in known_axes or not is_position_name(target) or not names.expand_name(name):
            targets[name] = target
            continue
        axes = [axis for axis in known_axes if controller_of(axis) == name] or names.expand_name(name)
        axes_inside = [axis for axis in axes if axis in names.positions.get(str(target), ())]
        if not axes_inside and str(target) in names.positions:
            text = f"position {target} has no axis of {name}; it has: {', '.join(names.positions[str(target)])}"
            raise Refusal("not-in-position", text, "name axes of it, or none for all of them")
        targets |= dict.fromkeys(axes_inside or [name], target)
    return step.model_copy(update={"to": targets})


def _check_names(names: "FleetNames", step: "Step") -> list[str]:
    """Check names and quantities of a step; return its axes. Raises `Refusal`, which speaks of no job file."""
    from orchestrator.cli.base.names import require_axes, unknown_name
    from orchestrator.model.names import ALL_AXES, is_position_name
    from orchestrator.model.steps.move import Move
    from orchestrator.model.steps.set_position import SetPosition

    for output in step.switched_outputs:
        if output not in names.outputs:
            raise unknown_name("output", output, names.outputs)
    if step.switched_outputs:
        return []
    if not isinstance(step, Move | SetPosition):
        return require_axes(names, step.named_axes or names.controllers)
    values = step.to | step.by if isinstance(step, Move) else step.axes
    position_names = {str(target): None for target in values.values() if is_position_name(target)}
    for name in position_names:
        if name not in names.positions:
            raise unknown_name("position", name, names.positions, "see `tutti position ls`")
    if ALL_AXES in values:
        return list(names.positions[str(values[ALL_AXES])])
    _check_quantities(names.axes | names.virtual if isinstance(step, Move) else names.axes, values)
    return list(values)


def _check_quantities(units: "Mapping[str, Unit]", values: "Mapping[str, int | float | str | None]") -> None:
    """Check the axes and quantities of a step; names of positions are known. units: of all axes that it may name."""
    from orchestrator.cli.base.names import unknown_name
    from orchestrator.model.errors import Refusal
    from orchestrator.model.names import is_position_name
    from orchestrator.model.units import UnitError, parse_quantity

    for name, value in values.items():
        if name not in units:
            raise unknown_name("axis", name, units)
        if value is None or is_position_name(value):
            continue
        try:
            parse_quantity(value, units[name])
        except UnitError as error:
            raise Refusal("bad-unit", f"{name}: {error}") from None


def _exit_with_failure(report: "JobReport") -> None:
    last = report.steps[-1] if report.steps else None
    refused_details = None if last is None else last.refused
    exit_with_error(
        (last.reason if last is not None else "") or report.reason or report.state,
        FAILED,
        "" if refused_details is None else refused_details.remedy,
        code=report.state if refused_details is None else refused_details.code,
        job_id=report.job_id,
    )


async def _print_outcome(tutti: "Tutti", report: "JobReport", axes: list[str], done: str, *, as_json: bool) -> None:
    """Print what has been done, with the names of the axes and where they are now."""
    from orchestrator.cli.base.positions import (
        describe_positions,
        describe_virtual_positions,
        list_positions,
        list_virtual_positions,
    )
    from orchestrator.model.state import ControllerState

    states: dict[str, ControllerState] = await tutti.status() if axes else {}
    positions, position_text = list_positions(states, axes), describe_positions(states, axes)
    if len(positions) < len(axes) and (virtual := await tutti.virtual_states()):
        positions |= list_virtual_positions(virtual, axes)
        position_text = ", ".join(filter(None, (position_text, describe_virtual_positions(virtual, axes))))
    words = f"{done}: {position_text}" if done and position_text else done or position_text
    value = {"job_id": report.job_id, "state": report.state, "axes": positions}
    print_result(value, words, as_json=as_json)
