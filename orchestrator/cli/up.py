"""`tutti up`: a complete fleet on this machine."""

import asyncio
import os
import signal
from pathlib import Path

import click

from orchestrator.cli.base.codes import FAILED, INTERRUPTED
from orchestrator.cli.base.common import check_endpoint_option, console, json_option, print_result
from orchestrator.cli.base.errors import errors, run_main

NO_REALTIME_WARNING = (
    "this user has no permission for real-time processes, so stops and starts may be late when the "
    "machine is busy; grant CAP_SYS_NICE, or an rtprio limit of 4 (`LimitRTPRIO=4` in a systemd unit)"
)


@click.command(
    epilog="""\b
Examples:
  tutti up deploy/examples/demo.fleet.yaml --sim
  tutti up lab.fleet.yaml --connect tcp/192.168.1.5:7447

\b
Exit codes: 0 ended by Ctrl-C or SIGTERM; 130 the same before the fleet was up;
1 a part could not be started, or ended for good; 2 bad input;
3 no router at --connect."""
)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--sim", "simulated", is_flag=True, help="Replace every link by a simulated controller; print which.")
@click.option(
    "--connect",
    default="",
    callback=check_endpoint_option,
    help="Use the router (zenohd) at `tcp/HOST:PORT` instead of starting one.",
)
@click.option(
    "--port",
    default=7447,
    show_default=True,
    type=click.IntRange(1, 65_535),
    help="Port of the router that is started, on 127.0.0.1.",
)
@click.option("--state", type=click.Path(path_type=Path), default=None, help="Folder for journal, latches and logs.")
@click.option("--take-over", is_flag=True, help="Lead the fleet although another coordinator does.")
@click.option("--standby", is_flag=True, help="A second coordinator takes over within 2 s when one dies or hangs.")
@click.option("--truth", is_flag=True, help="Simulators record true motions, with times, in STATE/truth.")
@json_option
def up(
    file: Path,
    connect: str,
    port: int,
    state: Path | None,
    *,
    simulated: bool,
    take_over: bool,
    standby: bool,
    truth: bool,
    as_json: bool,
) -> None:
    """Start router, adapter hosts, coordinator (and simulators) for the fleet in FILE. Ctrl-C ends them all.

    Ctrl-C stops the running job first; a process that dies is restarted.
    """
    from orchestrator.clock.realtime import RealtimePriority, set_realtime_priority
    from orchestrator.runtime.checked import load_checked_fleet
    from orchestrator.runtime.live import LiveFleet

    def print_line(line: str) -> None:
        (errors if as_json else console).print(line, highlight=False, markup=False, soft_wrap=True)

    async def run_fleet() -> None:
        fleet = load_checked_fleet(file)
        folder = state or default_state(fleet.fleet)
        live = LiveFleet(fleet, folder, print_line, connect, port, simulated, take_over, truth, standby)
        end = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, end.set)
        if not set_realtime_priority(RealtimePriority.SERVICE, children=False):
            print_line(NO_REALTIME_WARNING)
        starting = loop.create_task(live.start())
        ended = loop.create_task(end.wait())
        await asyncio.wait([starting, ended], return_when=asyncio.FIRST_COMPLETED)
        if not starting.done():
            print_line("interrupted while starting; ending the started processes")
            starting.cancel()
            await asyncio.wait([starting])
            raise SystemExit(INTERRUPTED)
        await starting
        words = f"fleet {fleet.fleet} is up; state in {folder}; Ctrl-C ends it"
        print_result({"fleet": fleet.fleet, "connect": live.connect, "state": str(folder)}, words, as_json=as_json)
        assert live.failed is not None
        await asyncio.wait([ended, live.failed], return_when=asyncio.FIRST_COMPLETED)
        print_line("stopping")
        await live.close()
        if live.failed.done():
            raise SystemExit(FAILED)

    run_main(run_fleet())


def default_state(fleet: str) -> Path:
    """Return `$XDG_STATE_HOME/tutti/FLEET`, or below `~/.local/state`."""
    base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(base) / "tutti" / fleet
