"""`tutti status`, `stop`, `estop`, `reset`: the whole fleet."""

import asyncio
import uuid
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED, UNREACHABLE
from orchestrator.cli.base.common import actor_name, console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.base.errors import exit_with_error, run_main
from orchestrator.cli.base.systems import require_unix

if TYPE_CHECKING:
    from orchestrator.bus.base import Bus
    from orchestrator.client import Tutti
    from orchestrator.model.operation.alarms import AlarmRecord
    from orchestrator.model.operation.virtual_state import VirtualState

_MODES = ("offline", "idle", "armed", "committed", "moving", "jogging", "homing", "stopping", "fault")


@click.command(
    epilog="""\b
Examples:
  tutti status --json | jq '.gantry.axes.x.position'
  tutti status --mode fault
  tutti status 'hall-1*' stage.z"""
)
@click.argument("names", metavar="[NAME]...", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="Every axis, however many controllers there are.")
@click.option("--mode", "modes", type=click.Choice(_MODES), multiple=True, help="Only controllers in this mode.")
@fleet_options
@json_option
def status(
    names: tuple[str, ...], modes: tuple[str, ...], connect: str, fleet: str | None, *, everything: bool, as_json: bool
) -> None:
    """Show the current state of every controller and axis.

    More than 20 controllers are summed up: those that are at rest and sound are counted, all others are named. NAME
    shows the axes of some of them: a controller, an axis or a group; * in a name stands for any signs.
    """
    from orchestrator.cli.base.alarms import print_open_alarms
    from orchestrator.cli.base.names import require_states
    from orchestrator.cli.jobs.queue import load_queue, print_queue_stop
    from orchestrator.cli.view.selection import select_states
    from orchestrator.model.errors import Refusal
    from orchestrator.monitor.fleet_summary import MANY, make_fleet_summary
    from orchestrator.monitor.fleet_view import make_state_table, name_missing_permits
    from orchestrator.monitor.open_bus import find_openness
    from orchestrator.monitor.virtual_view import make_virtual_table

    async def show_status(tutti: "Tutti") -> None:
        states = await select_states(tutti, await require_states(tutti), names, modes)
        virtual: dict[str, VirtualState] = {}
        if not names and not modes:
            with suppress(Refusal):  # without a coordinator
                virtual = await tutti.virtual_states()
        if as_json:
            print_json({name: state.to_plain() for name, state in (*states.items(), *virtual.items())})
        else:
            alarms: list[AlarmRecord] = []
            with suppress(Refusal):  # without a coordinator
                alarms = await tutti.list_alarms()
            if openness := find_openness(connect, alarms):
                console.print(openness, style="bold red", highlight=False, markup=False)
            leases = {lease.holder: lease for lease in await tutti.list_leases() if lease.holder is not None}
            queue = await load_queue(tutti)
            permits = name_missing_permits(queue)
            if len(states) > MANY and not (everything or names or modes):
                console.print(make_fleet_summary(states, permits=permits), highlight=False)
                console.print("→ `tutti status --all`, `--mode MODE`, or names: `tutti status 'a*'`", style="dim")
            elif states:
                console.print(make_state_table(states, leases, permits=permits))
            else:
                console.print(f"no controller is in the mode {' or '.join(modes)}", highlight=False)
            if virtual:
                console.print(make_virtual_table(virtual))
            print_queue_stop(queue)
            print_open_alarms(alarms)

    with_fleet(connect, fleet, show_status)


@click.command(epilog="Example: tutti stop")
@fleet_options
@json_option
@click.option("--abort", is_flag=True, help="As fast as the controllers can, instead of by the planned ramps.")
def stop(connect: str, fleet: str | None, *, as_json: bool, abort: bool) -> None:
    """Stop all axes of the fleet and end the running job. Works without a coordinator."""
    from orchestrator.client import Tutti

    async def stop_axes(tutti: Tutti) -> None:
        answers = await tutti.stop("abort" if abort else "decelerate")
        if not answers:
            raise await tutti.find_absence()
        _print_answers(answers, "stopped", as_json=as_json)

    with_fleet(connect, fleet, stop_axes)


@click.command(
    epilog="""\b
Examples:
  tutti estop --reason "hand in the machine"
  tutti estop --armed
  tutti estop --armed --port /dev/ttyUSB9"""
)
@fleet_options
@json_option
@click.option("--reason", default="", help="Shown to all users until it is reset.")
@click.option("--armed", is_flag=True, help="Keep a session open, and stop at a key, or a line on standard input.")
@click.option("--port", default="", help="With --armed: also at a line of text on this serial port (9600 baud, 8N1).")
def estop(connect: str, fleet: str | None, reason: str, port: str, *, armed: bool, as_json: bool) -> None:
    """Stop everything as fast as the controllers can, and latch until `tutti reset`.

    Without --fleet every fleet on the bus is stopped. This is software: it is no substitute for a wired emergency
    stop.

    With --armed it waits for a press, and says loudly when it is not connected. A press is repeated until every
    controller that was seen reports the latch. Ctrl-C disarms it.
    """
    if port and not armed:
        raise click.UsageError("--port needs --armed")
    if port:
        require_unix("a button at a serial port", "leave out --port: a key here presses the button, too")
    if armed:
        _run_armed(connect, fleet, reason, port, as_json=as_json)
        return
    latches = run_main(_send_estop(connect, fleet, reason))
    remedy = "use the wired e-stop; then see `tutti status`"
    if not as_json:
        for controller, is_latched in latches.items():
            console.print(f"{controller}: {'latched' if is_latched else '[bold red]NOT LATCHED[/]'}")
    if not latches:
        exit_with_error(f"no controller on {connect} confirms the e-stop", UNREACHABLE, remedy, code="no-answer")
    if not all(latches.values()):
        text = "not every controller confirms the e-stop"
        exit_with_error(text, FAILED, remedy, code="not-latched", latched=latches)
    if as_json:
        print_json(latches)


async def _send_estop(connect: str, fleet: str | None, reason: str) -> dict[str, bool]:
    """Send the e-stop, and return which controllers confirmed it; names begin with the fleet if there are several
    fleets."""
    from orchestrator.bus.estop import put_estop
    from orchestrator.bus.zenoh.bus import open_bus
    from orchestrator.clock.realtime import RealtimePriority, set_realtime_priority

    set_realtime_priority(RealtimePriority.BUS)
    bus = await open_bus(connect)
    try:
        put_estop(bus, fleet, *_new_event(), reason)
        # Everything else is imported only now that the e-stop is sent.
        latches = await _find_latched(bus, fleet)
    finally:
        await bus.close()
    if len({name.partition("/")[0] for name in latches}) > 1:
        return latches
    return {name.partition("/")[2]: is_latched for name, is_latched in latches.items()}


def _new_event() -> tuple[str, str]:
    """A unique name for an e-stop, and its originator."""
    actor = actor_name()
    return f"{actor}-{uuid.uuid4().hex[:8]}", actor


async def _find_latched(bus: "Bus", fleet: str | None) -> dict[str, bool]:
    """Which controllers report an e-stop latch, by `fleet/controller`; waits a little for it."""
    from orchestrator.bus.fleets import find_fleets
    from orchestrator.client import Tutti

    fleets = await find_fleets(bus) if fleet is None else [fleet]
    results = await asyncio.gather(*(Tutti(bus, name).wait_for_latch() for name in fleets))
    return {
        f"{name}/{controller}": is_latched
        for name, latches in zip(fleets, results, strict=True)
        for controller, is_latched in latches.items()
    }


def _run_armed(connect: str, fleet: str | None, reason: str, port: str, *, as_json: bool) -> None:
    # All modules are loaded before the button is armed.
    from orchestrator.cli.estop.arm import ArmedOptions, run_armed

    options = ArmedOptions(connect, fleet, reason, port, as_json)
    run_main(run_armed(options, _new_event, lambda bus: _find_latched(bus, fleet)))


@click.command(epilog="Example: tutti reset && tutti status")
@click.argument("event", required=False)
@fleet_options
@json_option
def reset(event: str | None, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Release the e-stop named EVENT on every controller, and clear the faults that can be cleared.

    Without EVENT, the one that is latched; if there are several, they are listed and none is released. First every
    controller is checked for safety: if one refuses, none is released.
    """
    from orchestrator.cli.base.names import require_states
    from orchestrator.cli.jobs.queue import load_queue, print_queue_stop
    from orchestrator.client import Tutti

    async def reset_estop(tutti: Tutti) -> None:
        states = await require_states(tutti)
        latched_estops = {state.estop.event: state.estop for state in states.values() if state.estop}
        if event is not None and event not in latched_estops:
            text = f"no e-stop {event} is latched; latched: {', '.join(latched_estops) or 'none'}"
            exit_with_error(text, BAD_INPUT, code="unknown-name")
        if event is None and len(latched_estops) > 1:
            event_list = "; ".join(f"{name} by {latch.actor}: {latch.reason}" for name, latch in latched_estops.items())
            text = f"several e-stops are latched: {event_list}"
            exit_with_error(text, BAD_INPUT, "name one: `tutti reset EVENT`", code="ambiguous")
        for name in latched_estops if event is None else [event]:
            if not as_json:
                console.print(f"releasing e-stop {name} by {latched_estops[name].actor}", markup=False)
        answers = await tutti.reset(event)
        is_refused = any(answers.values())
        if not as_json:
            print_queue_stop(await load_queue(tutti))
        _print_answers(
            answers, "still latched by another e-stop" if is_refused and latched_estops else "reset", as_json=as_json
        )

    with_fleet(connect, fleet, reset_estop)


def _print_answers(answers: dict[str, Any], done: str, *, as_json: bool) -> None:
    """Print the answer of each controller; a refusal makes the exit code 1."""
    if as_json:
        print_json({name: refusal.to_plain() if refusal else None for name, refusal in answers.items()})
    else:
        for name, refusal in answers.items():
            console.print(f"{name}: {done}" if refusal is None else f"{name}: [red]{refusal.text}[/] {refusal.remedy}")
    if any(answers.values()):
        raise SystemExit(FAILED)
