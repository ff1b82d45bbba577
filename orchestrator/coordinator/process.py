"""The coordinator as a process of its own: `python -m orchestrator.coordinator.process --help`.

Prints `ready` when it reigns, or stands by to reign as soon as nobody else does. Ends with SIGTERM or SIGINT (a running
job is stopped first), with its parent, and when it is deposed. Exit codes: 2 bad input, 3 the bus can not be reached,
4 another coordinator reigns, 5 the journal can not be used, 6 deposed.
"""

import argparse
import asyncio
import signal
import sys
import uuid
from pathlib import Path

from orchestrator.bus.base import Bus
from orchestrator.bus.keys import Keys
from orchestrator.bus.log import Log
from orchestrator.bus.logfile import file_sink
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.sessions import RouterUnreachable
from orchestrator.clock.executor import Threaded
from orchestrator.clock.live import LiveClock, begin_live
from orchestrator.clock.parent import die_with_parent
from orchestrator.clock.realtime import Urgency, hurry, step_back
from orchestrator.coordinator.coordinator import Coordinator, Court
from orchestrator.coordinator.journal.journal import Journal, JournalError
from orchestrator.coordinator.leadership.leadership import AnotherReigns
from orchestrator.coordinator.leadership.standby import Reigning, vacancy
from orchestrator.model.files import FileError, load_fleet
from orchestrator.model.fleet import Fleet

BAD_INPUT, NO_BUS, ANOTHER, BAD_JOURNAL, DEPOSED = 2, 3, 4, 5, 6


async def run(options: argparse.Namespace, urgent: bool) -> int:
    """Reign until told to end; the exit code. urgent: whether it runs in real time."""
    fleet = load_fleet(options.fleet)
    bus = await open_bus(options.connect)
    loop, end = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, end.set)
    try:
        if options.standby:
            _say_ready()
            if not await _stood_by(options, bus, Keys(fleet.fleet), end):
                return 0
            # It may have been reloaded meanwhile.
            fleet = load_fleet(options.fleet)
        return await _reign(options, fleet, bus, end, urgent)
    finally:
        await bus.close()


async def _stood_by(options: argparse.Namespace, bus: Bus, keys: Keys, end: asyncio.Event) -> bool:
    """Wait until nobody reigns, and see to it that who did is gone; False when this process is to end."""
    vacant = asyncio.ensure_future(vacancy(bus, keys, LiveClock()))
    ended = asyncio.ensure_future(end.wait())
    await asyncio.wait([vacant, ended], return_when=asyncio.FIRST_COMPLETED)
    for wait in (vacant, ended):
        wait.cancel()
    if end.is_set():
        return False
    killed = Reigning(options.journal).end_other()
    if killed:
        log = Log("coordinator", "standby", LiveClock(), file_sink(options.log), bus, keys)
        log.warning(f"the coordinator of process {killed} was silent and is ended; taking over")
    return True


async def _reign(options: argparse.Namespace, fleet: Fleet, bus: Bus, end: asyncio.Event, urgent: bool) -> int:
    loop = asyncio.get_running_loop()
    journal, runs = Journal(options.journal), Threaded("journal")
    court = Court(
        bus=bus,
        keys=Keys(fleet.fleet),
        clock=LiveClock(),
        journal=journal,
        runs=runs,
        new_id=lambda: uuid.uuid4().hex,
        sink=file_sink(options.log),
        save_fleet=lambda taken: save_fleet(options.fleet, taken),
    )
    coordinator = Coordinator(fleet, court)
    try:
        if urgent:
            # Adapters stop without it: what it does about its jobs must not keep them from that.
            await bus.subscribe(court.keys.estop, lambda _: step_back(Urgency.SERVICE))
        await coordinator.start(options.take_over, vacant=options.standby)
        Reigning(options.journal).write()
        begin_live()
        if not options.standby:
            _say_ready()
        waits = [loop.create_task(end.wait()), loop.create_task(coordinator.deposed.wait())]
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        for wait in waits:
            wait.cancel()
        deposed = coordinator.deposed.is_set()
        if not deposed:
            await coordinator.close()
        return DEPOSED if deposed else 0
    finally:
        # In its own thread, behind what still writes there: closed under a call, SQLite ends the whole process.
        await runs(journal.close)


def _say_ready() -> None:
    sys.stdout.write("ready\n")
    sys.stdout.flush()


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
    parser.add_argument("--standby", action="store_true", help="reign as soon as nobody else does on this journal")
    parser.add_argument("--parent", type=int, default=0, help="end when this process does")
    options = parser.parse_args()
    if options.parent:
        die_with_parent(options.parent)
    urgent = hurry(Urgency.SERVICE)
    try:
        return asyncio.run(run(options, urgent))
    except (FileError, RouterUnreachable, AnotherReigns, JournalError) as error:
        sys.stderr.write(f"{error}\n")
        codes = {FileError: BAD_INPUT, RouterUnreachable: NO_BUS, AnotherReigns: ANOTHER, JournalError: BAD_JOURNAL}
        return codes[type(error)]


if __name__ == "__main__":
    raise SystemExit(main())
