"""`tutti status`, `stop`, `estop`, `reset`: the whole fleet, at once."""

from typing import Any

import click

from orchestrator.cli.codes import FAILED
from orchestrator.cli.common import console, errors, fleet_options, json_option, print_json, with_fleet


@click.command(epilog="Example: tutti status --json | jq '.gantry.axes.x.position'")
@fleet_options
@json_option
def status(connect: str, fleet: str | None, as_json: bool) -> None:
    """Show every controller and axis as they are now."""
    from orchestrator.client import Tutti
    from orchestrator.monitor.fleet_view import state_table

    async def act(tutti: Tutti) -> None:
        states = await tutti.status()
        if as_json:
            print_json({name: state.to_plain() for name, state in states.items()})
        else:
            console.print(state_table(states))

    with_fleet(connect, fleet, act)


@click.command(epilog="Example: tutti stop")
@fleet_options
@json_option
@click.option("--abort", is_flag=True, help="As fast as the controllers can, instead of by the planned ramps.")
def stop(connect: str, fleet: str | None, as_json: bool, abort: bool) -> None:
    """Stop all axes of the fleet and end the running job. Needs no coordinator."""
    from orchestrator.client import Tutti

    async def act(tutti: Tutti) -> None:
        _tell(await tutti.stop("abort" if abort else "decelerate"), "stopped", as_json)

    with_fleet(connect, fleet, act)


@click.command(epilog='Example: tutti estop --reason "hand in the machine"')
@fleet_options
@json_option
@click.option("--reason", default="", help="Shown to everybody until it is reset.")
def estop(connect: str, fleet: str | None, as_json: bool, reason: str) -> None:
    """Stop everything as fast as the controllers can, and latch until `tutti reset`.

    This is software: it is no substitute for a wired emergency stop.
    """
    from orchestrator.client import Tutti

    async def act(tutti: Tutti) -> None:
        latched = await tutti.estop(reason)
        if as_json:
            print_json(latched)
        else:
            for controller, done in latched.items():
                console.print(f"{controller}: {'latched' if done else '[bold red]NOT LATCHED[/]'}")
        if not latched or not all(latched.values()):
            errors.print("[bold red]tutti:[/] not every controller shows the e-stop; use the wired one")
            raise SystemExit(FAILED)

    with_fleet(connect, fleet, act)


@click.command(epilog="Example: tutti reset && tutti status")
@fleet_options
@json_option
def reset(connect: str, fleet: str | None, as_json: bool) -> None:
    """Release the e-stop latch of every controller and clear the faults that can be cleared."""
    from orchestrator.client import Tutti

    async def act(tutti: Tutti) -> None:
        _tell(await tutti.reset(), "reset", as_json)

    with_fleet(connect, fleet, act)


def _tell(answers: dict[str, Any], done: str, as_json: bool) -> None:
    """What each controller answered; a refusal makes the exit code 1."""
    if as_json:
        print_json({name: refusal.to_plain() if refusal else None for name, refusal in answers.items()})
    else:
        for name, refusal in answers.items():
            console.print(f"{name}: {done}" if refusal is None else f"{name}: [red]{refusal.text}[/] {refusal.remedy}")
    if any(answers.values()):
        raise SystemExit(FAILED)
