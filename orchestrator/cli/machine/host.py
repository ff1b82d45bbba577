"""`tutti host`: the adapter host of one computer, for a fleet whose coordinator is on another."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import connect_option, console, fleet_option, json_option, print_result
from orchestrator.cli.base.errors import errors, exit_with_error, run_main
from orchestrator.cli.base.systems import require_linux
from orchestrator.cli.machine.following import follow_file
from orchestrator.clock.owner import running
from orchestrator.clock.signals import call_at_signals

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.fleet import Fleet
    from orchestrator.runtime.live.fleet import LiveFleet

RETRY_S = 1.0


@click.command(
    epilog="""\b
Example, on the computer `lab2` whose controllers have `host: lab2`:
  tutti --identity ~/host-lab2 host lab2 --fleet lab --connect tls/192.168.1.5:7447

\b
Exit codes: 0 ended by Ctrl-C or SIGTERM; 1 a part could not be started, or
ended for good, or the host runs elsewhere; 2 bad input; 3 no router."""
)
@click.argument("name")
@connect_option
@fleet_option("The fleet.", required=True)
@click.option("--sim", "simulated", is_flag=True, help="Replace every link of this host by a simulated controller.")
@click.option("--truth", is_flag=True, help="Simulators record true motions, with times, in STATE/truth.")
@click.option("--state", type=click.Path(path_type=Path), default=None, help="Folder for latches and logs.")
@json_option
def host(
    name: str, connect: str, fleet: str, state: Path | None, *, simulated: bool, truth: bool, as_json: bool
) -> None:
    """Drive the controllers of adapter host NAME from this computer; Ctrl-C stops them and ends it.

    The fleet file comes from the coordinator, and is stored: a host that starts while the coordinator is away uses the
    last one. It follows a reload. On the coordinator's computer run `tutti up FILE --host local`, with the hosts that
    are there.
    """
    require_linux("an adapter host")
    from orchestrator.client import Tutti
    from orchestrator.runtime.live.fleet import LiveFleet
    from orchestrator.runtime.live.run import FleetRun
    from orchestrator.runtime.state.folder import default_state

    def print_line(line: str) -> None:
        (errors if as_json else console).print(line, highlight=False, markup=False, soft_wrap=True)

    async def run_host() -> None:
        folder = state or default_state(f"{fleet}@{name}")
        async with Tutti(connect, fleet, actor="host") as tutti:
            found_fleet = await _find_fleet(tutti, connect, folder, print_line)
            names = await _find_served(tutti, found_fleet, name)
        if name not in found_fleet.hosts:
            hosts = ", ".join(found_fleet.hosts)
            exit_with_error(
                f"fleet {fleet} has no controller with `host: {name}`; its hosts: {hosts}", BAD_INPUT, code="no-host"
            )
        _require_absence(names, name)
        run = FleetRun(connect=connect, simulated=simulated, truth=truth, hosts=frozenset((name,)))
        live = LiveFleet(found_fleet, folder, print_line, run)
        await _run_until_ended(live, name, as_json=as_json)

    run_main(run_host())


async def _find_fleet(tutti: "Tutti", connect: str, folder: Path, print_line: Callable[[str], None]) -> "Fleet":
    """The fleet file of the coordinator; without one, that which was stored last. Without either it is waited for.
    Raises `Refusal`."""
    from orchestrator.model.errors import Refusal
    from orchestrator.model.fleet import Fleet
    from orchestrator.model.jobs.files import FileError, parse_file, read_file
    from orchestrator.runtime.state.folder import FLEET_FILE

    has_said = False
    while True:
        try:
            return await tutti.load_fleet()
        except Refusal as refusal:
            if refusal.code != "no-coordinator":
                raise
        stored_folder = folder / FLEET_FILE
        if stored_folder.exists():
            try:
                fleet = parse_file(read_file(stored_folder), Fleet)
            except FileError as error:
                print_line(f"the stored fleet file cannot be used: {error}")
            else:
                print_line(f"no coordinator answers; with the fleet file that was stored last (digest {fleet.digest})")
                return fleet
        if not has_said:
            print_line(f"waiting for a coordinator of fleet {tutti.keys.fleet} on {connect}")
            has_said = True
        await asyncio.sleep(RETRY_S)


async def _find_served(tutti: "Tutti", fleet: "Fleet", name: str) -> list[str]:
    """The controllers of this host that another process serves already."""
    own_names = {controller for controller, config in fleet.controllers.items() if config.host == name}
    return [status for status in await tutti.status(1.0) if status in own_names]


def _require_absence(served: list[str], name: str) -> None:
    """End the command if another process serves a controller of this host: two drivers would send it commands."""
    if served:
        exit_with_error(
            f"{', '.join(served)} is served already: adapter host {name} runs elsewhere, or `tutti up` runs all hosts",
            FAILED,
            f"end that one, or start `tutti up` with --host for the hosts of its own computer; this one runs {name}",
            code="host-runs",
        )


async def _run_until_ended(live: "LiveFleet", name: str, *, as_json: bool) -> None:
    """Run the host until it is to end, or a part of it has ended for good."""
    end = asyncio.Event()
    call_at_signals(end.set)
    await live.start_hosts()
    own_names = [controller for controller, config in live.fleet.controllers.items() if config.host == name]
    value = {"host": name, "fleet": live.fleet.fleet, "controllers": own_names, "digest": live.fleet.digest}
    words = (
        f"host {name} of fleet {live.fleet.fleet} drives {', '.join(own_names)}; state in {live.state}; Ctrl-C ends it"
    )
    print_result({**value, "connect": live.connect, "state": str(live.state)}, words, as_json=as_json)
    assert live.failed is not None
    async with running(follow_file(live, "host")), running(end.wait()) as ended_task:
        await asyncio.wait([ended_task, live.failed], return_when=asyncio.FIRST_COMPLETED)
        live.say("stopping")
    await live.close()
    if live.failed.done():
        raise SystemExit(FAILED)
