"""The coordinator as a process of its own: `python -m orchestrator.coordinator.process --help`.

Prints `ready` when it reigns. Ends with SIGTERM or SIGINT (a running job is stopped first), with its parent, and
when it is deposed. Exit codes: 2 bad input, 3 the bus can not be reached, 4 another coordinator reigns, 5 the
journal can not be used, 6 deposed.
"""

import argparse
import asyncio
import signal
import sys
import uuid
from pathlib import Path

from orchestrator.bus.keys import Keys
from orchestrator.bus.logfile import file_sink
from orchestrator.bus.zenoh_bus import open_bus
from orchestrator.bus.zenoh_sessions import RouterUnreachable
from orchestrator.clock.live import LiveClock
from orchestrator.clock.parent import die_with_parent
from orchestrator.coordinator.coordinator import Coordinator, Court
from orchestrator.coordinator.journal import Journal, JournalError, Threaded
from orchestrator.coordinator.reign import AnotherReigns
from orchestrator.model.files import FileError, load_fleet
from orchestrator.model.fleet import Fleet

BAD_INPUT, NO_BUS, ANOTHER, BAD_JOURNAL, DEPOSED = 2, 3, 4, 5, 6


async def run(options: argparse.Namespace) -> int:
    """Reign until told to end; the exit code."""
    fleet = load_fleet(options.fleet)
    journal = Journal(options.journal)
    bus = await open_bus(options.connect)
    loop, end = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, end.set)
    court = Court(
        bus=bus,
        keys=Keys(fleet.fleet),
        clock=LiveClock(),
        journal=journal,
        runs=Threaded(),
        new_id=lambda: uuid.uuid4().hex,
        sink=file_sink(options.log),
        save_fleet=lambda taken: save_fleet(options.fleet, taken),
    )
    coordinator = Coordinator(fleet, court)
    try:
        await coordinator.start(options.take_over)
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        waits = [loop.create_task(end.wait()), loop.create_task(coordinator.deposed.wait())]
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        for wait in waits:
            wait.cancel()
        deposed = coordinator.deposed.is_set()
        if not deposed:
            await coordinator.close()
        return DEPOSED if deposed else 0
    finally:
        await bus.close()
        journal.close()


def save_fleet(path: Path, fleet: Fleet) -> None:
    """Replace the file as a whole: who is started with it again must find what the fleet runs with."""
    fresh = path.with_suffix(".new")
    fresh.write_text(fleet.model_dump_json(), encoding="utf-8")
    fresh.replace(path)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m orchestrator.coordinator.process", description=__doc__)
    parser.add_argument("--fleet", type=Path, required=True, help="the fleet file; replaced when it is reloaded")
    parser.add_argument("--connect", required=True, help="the router, e.g. tcp/127.0.0.1:7447")
    parser.add_argument("--journal", type=Path, required=True)
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--take-over", action="store_true", help="reign although another coordinator does")
    parser.add_argument("--parent", type=int, default=0, help="end when this process does")
    options = parser.parse_args()
    if options.parent:
        die_with_parent(options.parent)
    try:
        return asyncio.run(run(options))
    except (FileError, RouterUnreachable, AnotherReigns, JournalError) as error:
        sys.stderr.write(f"{error}\n")
        codes = {FileError: BAD_INPUT, RouterUnreachable: NO_BUS, AnotherReigns: ANOTHER, JournalError: BAD_JOURNAL}
        return codes[type(error)]


if __name__ == "__main__":
    raise SystemExit(main())
