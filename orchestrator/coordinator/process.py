"""The coordinator as a process of its own: `python -m orchestrator.coordinator.process --help`.

Prints `ready` when it leads, or stands by to lead as soon as there is no leader. Ends with SIGTERM or SIGINT
(running jobs are stopped first), with its parent, and when it loses the leadership. Exit codes: 2 bad input, 3 the
bus cannot be reached, 4 another coordinator leads, 5 the journal cannot be used, 6 the leadership was lost, 7 a defect,
8 the leadership was handed over to a standby.
"""

import argparse
import asyncio
import contextlib
import shutil
import sys
import uuid
from pathlib import Path

from orchestrator.bus.base import Bus
from orchestrator.bus.expiry import find_session_certificate
from orchestrator.bus.keys import STANDBY, FleetKeys
from orchestrator.bus.latch import FileLatchStore, LatchKeeper
from orchestrator.bus.limits import MAX_COORDINATOR_MESSAGE_BYTES
from orchestrator.bus.log import ProcessLog
from orchestrator.bus.logfile import make_file_sink
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.own_alarms import report_own_alarms
from orchestrator.bus.zenoh.service_process import BAD_INPUT, run_service
from orchestrator.clock.executor import CHECKING, PLANNING, ProcessExecutor, ThreadExecutor
from orchestrator.clock.live import LiveClock, prepare_live_process
from orchestrator.clock.owner import running, wait_for_first
from orchestrator.clock.parent import die_with_parent
from orchestrator.clock.realtime import RealtimePriority, set_realtime_priority, yield_priority
from orchestrator.clock.service_manager import ServiceManager
from orchestrator.clock.signals import call_at_signals
from orchestrator.coordinator.alarms.command_process import run_command_process
from orchestrator.coordinator.coordinator import Coordinator
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal, require_journal
from orchestrator.coordinator.leadership.environment import CoordinatorEnvironment
from orchestrator.coordinator.leadership.leadership import AnotherLeader
from orchestrator.coordinator.leadership.standby import LeaderFile, wait_for_vacancy
from orchestrator.model.files.private_files import replace_private_file
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, load_fleet

ANOTHER, BAD_JOURNAL, LEADERSHIP_LOST, BROKEN, HANDED_OVER = 4, 5, 6, 7, 8
CLOSE_S = 2.0  # after a defect


async def run_coordinator(options: argparse.Namespace, *, urgent: bool) -> int:
    """Lead until the process is to end; return the exit code. urgent: whether it has real-time priority."""
    fleet = load_fleet(options.fleet)
    bus = await open_bus(options.connect, max_message_bytes=MAX_COORDINATOR_MESSAGE_BYTES)
    end = asyncio.Event()
    call_at_signals(end.set)
    try:
        if options.standby:
            _print_ready()
            if not await _stand_by(options, bus, FleetKeys(fleet.fleet), end):
                return 0
            # The fleet may have been reloaded meanwhile.
            fleet = load_fleet(options.fleet)
        return await _lead(options, fleet, bus, end, urgent=urgent)
    finally:
        await bus.close()


async def _stand_by(options: argparse.Namespace, bus: Bus, keys: FleetKeys, end: asyncio.Event) -> bool:
    """Wait until there is no leader, and make sure that the last one is gone; False when this process is to end."""
    # Kept meanwhile: the leader may be away when an e-stop comes.
    keeper, name = LatchKeeper(bus, keys, LiveClock().utc, _latch_store(options.journal)), uuid.uuid4().hex
    await keeper.start(f"standby-{name}")
    token = await bus.announce(keys.live("coordinator", name[:8], STANDBY))
    await wait_for_first(wait_for_vacancy(bus, keys, LiveClock()), end.wait())
    await token.undeclare()
    await keeper.close()
    if end.is_set():
        return False
    killed_process = LeaderFile(options.journal).kill_other_process()
    if killed_process:
        log = ProcessLog("coordinator", "standby", LiveClock(), make_file_sink(options.log), (bus, keys))
        log.warning(f"the coordinator in process {killed_process} was silent and has been killed; taking over")
    return True


async def _lead(options: argparse.Namespace, fleet: Fleet, bus: Bus, end: asyncio.Event, *, urgent: bool) -> int:
    latches = _latch_store(options.journal)
    if options.existing_journal:
        require_journal(options.journal)
    journal, runs, decode = SqliteJournal(options.journal), ThreadExecutor("journal"), ProcessExecutor()
    check, plan_long = ProcessExecutor(CHECKING), ProcessExecutor(PLANNING)
    court = CoordinatorEnvironment(
        bus=bus,
        keys=FleetKeys(fleet.fleet),
        clock=LiveClock(),
        journal=journal,
        execute=runs,
        plan=ThreadExecutor("planning", many_objects=True),
        plan_long=plan_long,
        decode=decode,
        check=check,
        new_id=lambda: uuid.uuid4().hex,
        sink=make_file_sink(options.log),
        save_fleet=lambda taken_fleet: save_fleet(options.fleet, taken_fleet),
        latches=latches,
        run_command=run_command_process,
        find_free=lambda: runs(_find_free_bytes, options.journal.parent),
        certificate=find_session_certificate(options.connect),
    )
    coordinator = Coordinator(fleet, court)
    try:
        if urgent:
            # The adapters stop without the leader: the ends of its jobs must not delay that.
            await bus.subscribe(court.keys.estop, lambda _: yield_priority(RealtimePriority.SERVICE))
        await coordinator.start(take_over=options.take_over, vacant=options.standby)
        LeaderFile(options.journal).write_own_process()
        prepare_live_process()
        if not options.standby:
            _print_ready()
        events = (end, coordinator.leadership_lost, coordinator.broken, coordinator.handed_over)
        async with (
            running(_feed_watchdog(options, coordinator)),
            report_own_alarms(bus, court.keys, ("coordinator", "own"), options.connect),
        ):
            await wait_for_first(*(event.wait() for event in events))
        if coordinator.leadership_lost.is_set():
            return LEADERSHIP_LOST
        if coordinator.broken.is_set():
            # Whatever does not work any more may not keep it from being restarted.
            with contextlib.suppress(Exception):
                async with asyncio.timeout(CLOSE_S):
                    await coordinator.close("a defect of the coordinator, which is restarted")
            return BROKEN
        await coordinator.close()
        return HANDED_OVER if coordinator.handed_over.is_set() else 0
    finally:
        for executor in (decode, check, plan_long):
            executor.close()
        # In the journal's own thread, after its pending writes: SQLite crashes the process if closed during a call.
        await runs(journal.close)


async def _feed_watchdog(options: argparse.Namespace, coordinator: Coordinator) -> None:
    """Feed the watchdog of the service manager by heartbeats, if this process is to."""
    if options.feed_watchdog:
        await ServiceManager().feed_watchdog(lambda: coordinator.leadership.make_heartbeat().seq)


def _find_free_bytes(folder: Path) -> int | None:
    """The free bytes on the disk of a folder; None if that is not known."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


def _latch_store(journal: Path) -> FileLatchStore:
    """The e-stop latch beside the journal."""
    return FileLatchStore(journal.with_name("estop.json"))


def _print_ready() -> None:
    sys.stdout.write("ready\n")
    sys.stdout.flush()


def save_fleet(path: Path, fleet: Fleet) -> None:
    """Replace the file as a whole: a restart must find the configuration that the fleet runs with."""
    replace_private_file(path, fleet.to_json())


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m orchestrator.coordinator.process", description=__doc__)
    parser.add_argument("--fleet", type=Path, required=True, help="the fleet file; replaced when it is reloaded")
    parser.add_argument("--connect", required=True, help="the router, e.g. tcp/127.0.0.1:7447")
    parser.add_argument("--journal", type=Path, required=True)
    parser.add_argument("--existing-journal", action="store_true", help="refuse a missing journal; else it is begun")
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--take-over", action="store_true", help="lead even if another coordinator does")
    parser.add_argument("--standby", action="store_true", help="lead as soon as there is no leader on this journal")
    parser.add_argument("--feed-watchdog", action="store_true", help="feed the watchdog of the service manager")
    parser.add_argument("--parent", type=int, default=0, help="end when this process ends")
    options = parser.parse_args()
    if options.parent:
        die_with_parent(options.parent)
    urgent = set_realtime_priority(RealtimePriority.SERVICE)
    codes: dict[type[Exception], int] = {FileError: BAD_INPUT, AnotherLeader: ANOTHER, JournalError: BAD_JOURNAL}
    return run_service(run_coordinator(options, urgent=urgent), options.log, codes)


if __name__ == "__main__":
    raise SystemExit(main())
