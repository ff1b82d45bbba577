"""`tutti down`: end a fleet that `tutti up` runs on this machine."""

import os
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED, UNREACHABLE
from orchestrator.cli.base.common import actor_name, fleet_option, json_option, print_result, state_option
from orchestrator.cli.base.errors import exit_with_error, run_main
from orchestrator.cli.base.systems import require_linux

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.runtime.state.folder import RunningFleet

REST_S = 10.0  # for axes to come to rest
END_S = 30.0  # for all processes of the fleet
POLL_S = 0.1


@click.command(epilog="Example: tutti down --fleet demo")
@state_option
@fleet_option("The fleet, if several run.")
@click.option("--host", default="", metavar="NAME", help="End the `tutti host NAME` of the fleet on this machine.")
@json_option
def down(state: Path | None, fleet: str | None, host: str, *, as_json: bool) -> None:
    """End a fleet that `tutti up` runs on this machine: first its axes come to rest, then its processes end in order.

    Only the processes of that `tutti up` are ended. Exit 1, and nothing is ended, while an axis does not come to rest.
    """
    require_linux("a fleet")
    running_fleet = _choose_fleet(state, fleet, host)
    # From here on it is this process, whatever takes its id later.
    try:
        process = os.pidfd_open(running_fleet.pid)
    except ProcessLookupError:
        exit_with_error(f"fleet {running_fleet.fleet} has just ended", UNREACHABLE)
    try:
        if _has_ended(running_fleet):
            exit_with_error(f"fleet {running_fleet.fleet} has just ended", UNREACHABLE)
        run_main(_bring_to_rest(running_fleet))
        signal.pidfd_send_signal(process, signal.SIGTERM)
    except PermissionError:
        exit_with_error(f"fleet {running_fleet.fleet} is run by another user (process {running_fleet.pid})", FAILED)
    finally:
        os.close(process)
    _wait_for_end(running_fleet)
    value = {"fleet": running_fleet.fleet, "state": str(running_fleet.folder)}
    noun = f"adapter host {running_fleet.adapter_host} of fleet" if running_fleet.adapter_host else "fleet"
    print_result(value, f"{noun} {running_fleet.fleet} is down", as_json=as_json)


def _choose_fleet(state: Path | None, fleet: str | None, host: str) -> "RunningFleet":
    """The fleet to end; a choice that is not unique ends the command."""
    from orchestrator.runtime.state.folder import default_state, find_running_fleet, find_running_fleets

    if state is not None:
        found_fleet = find_running_fleet(state)
        if found_fleet is None:
            exit_with_error(f"no fleet runs with the state folder {state}", UNREACHABLE)
        return found_fleet
    running_fleets = find_running_fleets(host)
    chosen_fleets = [candidate for candidate in running_fleets if fleet in (None, candidate.fleet)]
    names = ", ".join(candidate.fleet for candidate in running_fleets)
    if not chosen_fleets:
        folder_text = f"below {default_state('any').parent}"
        text = (
            f"no fleet {fleet} runs {folder_text}; there run: {names}"
            if fleet and names
            else f"no fleet runs {folder_text}"
        )
        exit_with_error(
            text, UNREACHABLE, "name its folder, if it was started with --state: `tutti down --state FOLDER`"
        )
    if len(chosen_fleets) > 1:
        exit_with_error(
            f"several fleets run: {names}", BAD_INPUT, "choose one with --fleet or --state", code="which-fleet"
        )
    return chosen_fleets[0]


async def _bring_to_rest(running: "RunningFleet") -> None:
    """Stop what moves, and wait until it is at rest. A fleet that does not answer is ended without."""
    import asyncio

    from orchestrator.bus.zenoh.sessions import RouterUnreachable
    from orchestrator.client import Tutti

    try:
        async with Tutti(running.connect, running.fleet, actor=actor_name()) as tutti:
            moving_axes = await _find_moving(tutti)
            if moving_axes:
                await tutti.stop()
            until_s = time.monotonic() + REST_S
            while moving_axes and time.monotonic() < until_s:
                await asyncio.sleep(POLL_S)
                moving_axes = await _find_moving(tutti)
    except RouterUnreachable:
        return
    if moving_axes:
        text = f"{', '.join(moving_axes)} still moves {REST_S:g} s after a stop; nothing was ended"
        exit_with_error(text, FAILED, "stop it: `tutti estop`, or the wired e-stop; then repeat", code="moving")


async def _find_moving(tutti: "Tutti") -> list[str]:
    """The axes that move, of controllers that are reached."""
    return [
        f"{name}.{axis}"
        for name, state in (await tutti.status(1.0)).items()
        if state.mode != "offline"
        for axis, axis_now in state.axes.items()
        if axis_now.moving or axis_now.homing
    ]


def _has_ended(running: "RunningFleet") -> bool:
    from orchestrator.runtime.state.folder import find_start_ticks

    return find_start_ticks(running.pid) != running.started


def _wait_for_end(running: "RunningFleet") -> None:
    until_s = time.monotonic() + END_S
    while not _has_ended(running):
        if time.monotonic() > until_s:
            text = f"process {running.pid} of fleet {running.fleet} has not ended within {END_S:g} s"
            exit_with_error(text, FAILED, f"see {running.folder / 'log'}")
        time.sleep(POLL_S)
