"""`tutti coordinator`: a coordinator by itself, on one of several computers that share a journal in a database."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import FAILED, UNREACHABLE
from orchestrator.cli.base.common import (
    check_endpoint_option,
    console,
    fleet_options,
    json_option,
    keys_folder_option,
    print_result,
    with_fleet,
)
from orchestrator.cli.base.default_group import DefaultGroup
from orchestrator.cli.base.errors import errors, exit_with_error, run_main
from orchestrator.cli.base.systems import require_linux
from orchestrator.cli.machine.following import follow_file
from orchestrator.cli.machine.journal_places import read_database_address
from orchestrator.clock.owner import running
from orchestrator.clock.signals import call_at_signals

if TYPE_CHECKING:
    from orchestrator.runtime.live.fleet import LiveFleet


@click.group(
    cls=DefaultGroup,
    default="run",
    epilog="""\b
Examples, on two computers with a router each:
  tutti coordinator lab.fleet.yaml --journal postgresql://tutti@a,b/tutti --connect tls/a:7447,tls/b:7447
  tutti coordinator lab.fleet.yaml --journal postgresql://tutti@a,b/tutti --connect tls/a:7447,tls/b:7447 --standby
  tutti coordinator hand-over""",
)
def coordinator() -> None:
    """Run a coordinator by itself: of several on one journal in PostgreSQL, one leads. `tutti coordinator FILE …` is
    `tutti coordinator run FILE …`."""


@coordinator.command(
    epilog="""\b
Example:
  tutti coordinator lab.fleet.yaml --journal postgresql://tutti@a,b/tutti --connect tls/a:7447,tls/b:7447

\b
Exit codes: 0 ended by Ctrl-C or SIGTERM; 1 it could not be started, or ended
for good; 2 bad input; 3 no router."""
)
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--journal",
    required=True,
    metavar="ADDRESS",
    help="The journal: postgresql://USER@HOST,HOST/DATABASE, with each host that may be the primary.",
)
@click.option(
    "--connect",
    required=True,
    callback=check_endpoint_option,
    help="The routers, e.g. tls/a:7447,tls/b:7447; another one is used when one goes away.",
)
@click.option("--standby", is_flag=True, help="Let the other coordinators lead first: this one waits a lease longer.")
@keys_folder_option("With --connect tls/…: the folder of the fleet's keys.")
@click.option("--state", type=click.Path(path_type=Path), default=None, help="Folder for latches and logs.")
@json_option
def run(
    file: Path, journal: str, connect: str, keys: Path | None, state: Path | None, *, standby: bool, as_json: bool
) -> None:
    """Coordinate the fleet in FILE as soon as no other coordinator does; Ctrl-C ends it.

    Hosts, routers and the page run by themselves: `tutti host`, `tutti router`, `tutti up --no-hosts` of another fleet
    state. The leader holds a lease in the database. If its computer dies, the next one leads once the lease is over;
    what moves stops meanwhile, and the job that ran is interrupted.
    """
    require_linux("a coordinator")
    from orchestrator.coordinator.opening import is_address
    from orchestrator.runtime.checked import load_checked_fleet
    from orchestrator.runtime.live.fleet import LiveFleet
    from orchestrator.runtime.live.run import FleetRun
    from orchestrator.runtime.state.folder import default_state

    if not is_address(journal):
        raise click.UsageError(
            f"--journal {journal}: write postgresql://USER@HOST,HOST/DATABASE; a file is for `tutti up`"
        )
    read_database_address(journal)

    def print_line(line: str) -> None:
        (errors if as_json else console).print(line, highlight=False, markup=False, soft_wrap=True)

    async def run_coordinator() -> None:
        fleet = load_checked_fleet(file, tolerant=True)
        folder = state or default_state(f"{fleet.fleet}@coordinator")
        plan = FleetRun(connect=connect, journal=journal, patient=standby, keys=keys if "tls/" in connect else None)
        await _run_until_ended(LiveFleet(fleet, folder, print_line, plan), as_json=as_json)

    run_main(run_coordinator())


async def _run_until_ended(live: "LiveFleet", *, as_json: bool) -> None:
    """Run the coordinator until it is to end, or has ended for good."""
    from orchestrator.runtime.state.folder import UpFailed

    end = asyncio.Event()
    call_at_signals(end.set)
    try:
        await live.start_coordinator()
    except UpFailed as error:
        child = live.children.get("coordinator")
        if child is None or child.exit_code != UNREACHABLE:
            raise
        # The process has the same code for it.
        exit_with_error(str(error), UNREACHABLE, code="no-router")
    value = {"fleet": live.fleet.fleet, "connect": live.connect, "state": str(live.state), "digest": live.fleet.digest}
    words = f"a coordinator of fleet {live.fleet.fleet} leads, or stands by; state in {live.state}; Ctrl-C ends it"
    print_result(value, words, as_json=as_json)
    assert live.failed is not None
    async with running(follow_file(live, "coordinator")), running(end.wait()) as ended_task:
        await asyncio.wait([ended_task, live.failed], return_when=asyncio.FIRST_COMPLETED)
        live.say("stopping")
    await live.close()
    if live.failed.done():
        raise SystemExit(FAILED)


@coordinator.command("hand-over", epilog="Example: tutti coordinator hand-over --fleet lab")
@fleet_options
@json_option
def hand_over(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Let a standby lead, before this computer is maintained. The fleet must be at rest; the queue goes on."""
    from orchestrator.client import Tutti

    async def leave(tutti: Tutti) -> None:
        standbys = await tutti.hand_over()
        words = f"handed over; a standby leads next ({', '.join(standbys)}). `tutti status` shows when it does"
        print_result({"standbys": standbys}, words, as_json=as_json)

    with_fleet(connect, fleet, leave)
