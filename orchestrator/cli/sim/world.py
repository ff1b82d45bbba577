"""`tutti sim input|analog|limit|power|push|contact|stall`: the environment of the controllers of `tutti up --sim`."""

import json
import os
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orchestrator.cli.base.codes import UNREACHABLE
from orchestrator.cli.base.common import check_fleet_option, json_option, print_result
from orchestrator.cli.base.completion import complete_controllers, complete_inputs, complete_single_axes
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.names import unknown_name
from orchestrator.cli.base.systems import require_unix

if TYPE_CHECKING:
    from orchestrator.model.fleet import Axis, Controller, Fleet

MOST_VOLTS = 1000

_state = click.option(
    "--state", type=click.Path(path_type=Path), default=None, help="The folder given to `tutti up` as --state."
)
_fleet = click.option(
    "--fleet",
    envvar="TUTTI_FLEET",
    default=None,
    callback=check_fleet_option,
    help="The fleet, if several are simulated.",
)
_PRESSED = {"none": "no limit switch is", "both": "both limit switches are"}


@click.command("input", epilog="Example: tutti sim input gantry.door active")
@click.argument("name", metavar="CONTROLLER.INPUT", shell_complete=complete_inputs)
@click.argument("to", type=click.Choice(["active", "inactive"]))
@_fleet
@_state
@json_option
def set_input(name: str, to: str, fleet: str | None, state: Path | None, *, as_json: bool) -> None:
    """Make a named input of a simulated controller active or inactive, whatever its polarity."""
    folder, controllers = _find_simulation(fleet, state)
    controller, point = _split_name(name, {c: unit.inputs for c, unit in controllers.items()}, "input")
    wired_input = controllers[controller].inputs[point]
    change = {"input": [wired_input.number, (to == "active") == (wired_input.active == "high")]}
    _write_change(folder, controller, change, f"{name} is {to}", as_json=as_json)


@click.command("analog", epilog="Example: tutti sim analog gantry 1 -- -2.5")
@click.argument("controller", shell_complete=complete_controllers)
@click.argument("number", type=click.IntRange(min=1))
@click.argument("volts", type=float)
@_fleet
@_state
@json_option
def set_analog(
    controller: str, number: int, volts: float, fleet: str | None, state: Path | None, *, as_json: bool
) -> None:
    """Set the voltage at an analogue input of a simulated controller, by its number there.

    A negative voltage needs `--` before it.
    """
    if not abs(volts) <= MOST_VOLTS:  # also not a number
        raise click.BadParameter(f"{volts:g} V is not from -{MOST_VOLTS} to {MOST_VOLTS} V", param_hint="VOLTS")
    folder, controllers = _find_simulation(fleet, state)
    if controller not in controllers:
        raise unknown_name("controller", controller, controllers)
    change = f"analogue input {number} of {controller} is at {volts:g} V"
    _write_change(folder, controller, {"analog": [number, volts]}, change, as_json=as_json)


@click.command(epilog="Example: tutti sim limit gantry.x forward")
@click.argument("name", metavar="CONTROLLER.AXIS", shell_complete=complete_single_axes)
@click.argument("which", type=click.Choice(["forward", "reverse", "both", "none"]))
@_fleet
@_state
@json_option
def limit(name: str, which: str, fleet: str | None, state: Path | None, *, as_json: bool) -> None:
    """Press the limit switches of a simulated axis, or release them (`none`)."""
    folder, controller, axis = _find_axis(name, fleet, state)
    words = f"{name}: {_PRESSED.get(which, f'the {which} limit switch is')} pressed"
    _write_change(folder, controller, {"limit": [axis.motors[0], which]}, words, as_json=as_json)


@click.command(epilog="Example: tutti sim power stage off")
@click.argument("controller", shell_complete=complete_controllers)
@click.argument("to", type=click.Choice(["on", "off"]))
@_fleet
@_state
@json_option
def power(controller: str, to: str, fleet: str | None, state: Path | None, *, as_json: bool) -> None:
    """Switch a simulated controller off or on."""
    folder, controllers = _find_simulation(fleet, state)
    if controller not in controllers:
        raise unknown_name("controller", controller, controllers)
    _write_change(folder, controller, {"power": to == "on"}, f"{controller} is switched {to}", as_json=as_json)


@click.command(epilog="Example: tutti sim push gantry.x 2.5")
@click.argument("name", metavar="CONTROLLER.AXIS", shell_complete=complete_single_axes)
@click.argument("distance", type=float)
@_fleet
@_state
@json_option
def push(name: str, distance: float, fleet: str | None, state: Path | None, *, as_json: bool) -> None:
    """Push a simulated axis with a disabled motor by DISTANCE in its unit."""
    folder, controller, axis = _find_axis(name, fleet, state)
    if not isfinite(distance):
        raise click.BadParameter(f"{distance} is not a distance", param_hint="DISTANCE")
    change = {"push": [axis.motors[0], round(distance * axis.counts_per_unit)]}
    _write_change(folder, controller, change, f"{name} is pushed by {distance:g} {axis.unit}", as_json=as_json)


@click.command("contact", epilog="Example: tutti sim contact gantry.touch gantry.y -- -2.5")
@click.argument("name", metavar="CONTROLLER.INPUT", shell_complete=complete_inputs)
@click.argument("axis_name", metavar="CONTROLLER.AXIS", shell_complete=complete_single_axes)
@click.argument("distance", type=float)
@_fleet
@_state
@json_option
def put_contact(
    name: str, axis_name: str, distance: float, fleet: str | None, state: Path | None, *, as_json: bool
) -> None:
    """Make an input active where a simulated axis is DISTANCE from where it stands, in its unit, and beyond.

    0 removes the contact. A negative distance needs `--` before it.
    """
    folder, controller, axis = _find_axis(axis_name, fleet, state)
    _, controllers = _find_simulation(fleet, state)
    _, point = _split_name(name, {controller: controllers[controller].inputs}, "input")
    if not isfinite(distance):
        raise click.BadParameter(f"{distance} is not a distance", param_hint="DISTANCE")
    wired_input = controllers[controller].inputs[point]
    counts = float(distance * float(axis.counts_per_unit))
    change = {"contact": [axis.motors[0], counts, wired_input.number, wired_input.active == "high"]}
    state_words = f"active {distance:g} {axis.unit} from where {axis_name} stands" if distance else "free"
    _write_change(folder, controller, change, f"{name} is {state_words}", as_json=as_json)


@click.command(epilog="Example: tutti sim stall gantry.x on")
@click.argument("name", metavar="CONTROLLER.AXIS", shell_complete=complete_single_axes)
@click.argument("to", type=click.Choice(["on", "off"]))
@_fleet
@_state
@json_option
def stall(name: str, to: str, fleet: str | None, state: Path | None, *, as_json: bool) -> None:
    """Stall a simulated axis, so that it does not follow its command (`on`); or free it (`off`)."""
    folder, controller, axis = _find_axis(name, fleet, state)
    words = f"{name} {'does not follow its command' if to == 'on' else 'is free'}"
    _write_change(folder, controller, {"stall": [axis.motors[0], to == "on"]}, words, as_json=as_json)


def _find_simulation(fleet: str | None, state: Path | None) -> "tuple[Path, dict[str, Controller]]":
    """Return state folder and controllers of the selected simulated fleet."""
    require_unix("a change of what surrounds a simulated controller", "run it on the computer of the simulated fleet")
    from orchestrator.model.jobs.files import FileError, load_fleet
    from orchestrator.runtime.state.folder import default_state, find_running_fleets

    if state is None:
        base = default_state(fleet or "x").parent
        simulated_folders = [
            running_fleet.folder for running_fleet in find_running_fleets() if (running_fleet.folder / "world").is_dir()
        ]
        folders = [base / fleet] if fleet else simulated_folders
        if len(folders) != 1:
            found_text = ", ".join(folder.name for folder in folders)
            text = (
                f"several simulated fleets run: {found_text}" if found_text else f"no simulated fleet runs below {base}"
            )
            exit_with_error(
                text, UNREACHABLE, "choose one with --fleet or --state, or start one: `tutti up FILE --sim`"
            )
        state = folders[0]
    try:
        loaded_fleet: Fleet = load_fleet(state / "fleet.json")
    except FileError as error:
        exit_with_error(str(error), UNREACHABLE, "is this the --state of a `tutti up … --sim`?")
    return state, dict(loaded_fleet.controllers)


def _find_axis(name: str, fleet: str | None, state: Path | None) -> "tuple[Path, str, Axis]":
    folder, controllers = _find_simulation(fleet, state)
    controller, axis = _split_name(name, {c: unit.axes for c, unit in controllers.items()}, "axis")
    return folder, controller, controllers[controller].axes[axis]


def _split_name(name: str, known: dict[str, Any], what: str) -> tuple[str, str]:
    controller, _, point = name.partition(".")
    if controller not in known or point not in known[controller]:
        raise unknown_name(what, name, [f"{c}.{point_name}" for c, names in known.items() for point_name in names])
    return controller, point


def _write_change(state: Path, controller: str, change: dict[str, Any], words: str, *, as_json: bool) -> None:
    """Write one line to the simulator's pipe, and print what is so now, in `words`."""
    from orchestrator.model.files.private_files import open_private_file
    from orchestrator.runtime.live.fleet import simulation_pipe

    path = simulation_pipe(state, controller)
    try:
        pipe = open_private_file(path, os.O_WRONLY | os.O_NONBLOCK)
    except OSError:
        exit_with_error(f"no simulator listens at {path}", UNREACHABLE, "start the fleet: `tutti up FILE --sim`")
    with os.fdopen(pipe, "wb") as line:
        line.write(json.dumps(change).encode() + b"\n")
    print_result({controller: change}, words, as_json=as_json)
