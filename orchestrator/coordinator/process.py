"""The coordinator as a process of its own: `python -m orchestrator.coordinator.process --help`.

Prints `ready` when it leads, or stands by to lead as soon as there is no leader. Ends with SIGTERM or SIGINT
(running jobs are stopped first), with its parent, and when it loses the leadership. Exit codes: 2 bad input, 3 the
bus cannot be reached, 4 another coordinator leads, 5 the journal cannot be used, 6 the leadership was lost, 7 a defect,
8 the leadership was handed over to a standby.
"""

import argparse
import asyncio
import shutil
import sys
import uuid
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from orchestrator.bus.base import Bus
from orchestrator.bus.expiry import find_session_certificate
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.latch import FileLatchStore, LatchKeeper
from orchestrator.bus.limits import MAX_COORDINATOR_MESSAGE_BYTES
from orchestrator.bus.log import ProcessLog
from orchestrator.bus.logfile import make_file_sink
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.own_alarms import report_own_alarms
from orchestrator.bus.zenoh.service_process import BAD_INPUT, run_service
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.executor import CHECKING, PLANNING, ProcessExecutor, ThreadExecutor
from orchestrator.clock.live import LiveClock, prepare_live_process
from orchestrator.clock.owner import running, wait_for_first
from orchestrator.clock.parent import die_with_parent
from orchestrator.clock.realtime import RealtimePriority, set_realtime_priority, yield_priority
from orchestrator.clock.service_manager import ServiceManager
from orchestrator.clock.signals import call_at_signals
from orchestrator.coordinator.alarms.command_process import run_command_process
from orchestrator.coordinator.alarms.lost_history import LostHistoryAlarm
from orchestrator.coordinator.coordinator import Coordinator
from orchestrator.coordinator.journal.records import HistoryLost, JournalError
from orchestrator.coordinator.leadership.environment import CoordinatorEnvironment
from orchestrator.coordinator.leadership.leadership import AnotherLeader
from orchestrator.coordinator.leadership.lease import LeaseWatch
from orchestrator.coordinator.leadership.standby import LeaderFile, stand_by
from orchestrator.coordinator.opening import JournalWish, is_address, open_journal_of, open_lease_of
from orchestrator.model.files.private_files import replace_private_file
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, load_fleet

ANOTHER, BAD_JOURNAL, LEADERSHIP_LOST, BROKEN, HANDED_OVER = 4, 5, 6, 7, 8
CLOSE_S = 2.0  # of what may not work any more
RETRY_NS = NS_PER_S  # between two tries to open the journal


@dataclass(slots=True)
class ProcessLife:
    """What this process has from its begin to its end. end: set when it is to end. urgent: it has real-time
    priority."""

    bus: Bus
    log: ProcessLog
    end: asyncio.Event
    urgent: bool
    is_ready: bool = False

    def report_ready(self) -> None:
        """Print, once, that it works."""
        if not self.is_ready:
            self.is_ready = True
            sys.stdout.write("ready\n")
            sys.stdout.flush()


async def run_coordinator(options: argparse.Namespace, *, urgent: bool) -> int:
    """Lead until the process is to end; return the exit code. urgent: whether it has real-time priority."""
    fleet = load_fleet(options.fleet)
    bus = await open_bus(options.connect, max_message_bytes=MAX_COORDINATOR_MESSAGE_BYTES)
    end = asyncio.Event()
    call_at_signals(end.set)
    log = ProcessLog("coordinator", "standby", LiveClock(), make_file_sink(options.log), (bus, FleetKeys(fleet.fleet)))
    life = ProcessLife(bus, log, end, urgent)
    if options.standby and options.existing_journal:
        life.report_ready()  # it has stood by before; its journal may be away at present
    obstacle = ""
    try:
        while True:
            try:
                if options.standby and not await _stand_by(options, fleet, life):
                    return 0
                # The fleet may have been reloaded meanwhile.
                fleet = load_fleet(options.fleet)
                return await _lead(options, fleet, life)
            except JournalError as error:
                if isinstance(error, HistoryLost):
                    await _report_lost_history(error, options, fleet, life)
                    raise
                # While a database fails over, it does not answer. One that never did may have a wrong address.
                if not (options.standby and is_address(options.journal) and life.is_ready):
                    raise
                if str(error) != obstacle:
                    obstacle = str(error)
                    log.warning(f"cannot lead, and tries again: {obstacle}")
                await wait_for_first(sleep_ns(LiveClock(), RETRY_NS), end.wait())
    finally:
        await bus.close()


async def _stand_by(options: argparse.Namespace, fleet: Fleet, life: ProcessLife) -> bool:
    """Wait until there is no leader, and make sure that the last one is gone; False when this process is to end. Raises
    `JournalError` if the journal cannot be used from the first."""
    bus, end = life.bus, life.end
    keys, clock, name = FleetKeys(fleet.fleet), LiveClock(), uuid.uuid4().hex
    # Kept meanwhile: the leader may be away when an e-stop comes.
    keeper = LatchKeeper(bus, keys, clock.utc, _latch_store(options))
    await keeper.start(f"standby-{name}")
    try:
        async with _watch_lease(options, fleet, name) as is_lease_over:
            life.report_ready()
            await wait_for_first(stand_by(bus, keys, clock, name[:8], is_lease_over), end.wait())
    finally:
        await keeper.close()
    if end.is_set():
        return False
    killed_process = 0 if is_address(options.journal) else LeaderFile(Path(options.journal)).kill_other_process()
    if killed_process:
        life.log.warning(f"the coordinator in process {killed_process} was silent and has been killed; taking over")
    return True


@asynccontextmanager
async def _watch_lease(options: argparse.Namespace, fleet: Fleet, name: str) -> AsyncGenerator[Callable[[], bool]]:
    """Says whether no leader holds the lease; a journal in a file has none. Raises `JournalError`."""
    run = ThreadExecutor("standby")
    opened_lease = await run(open_lease_of, _make_wish(options, fleet, name), run)
    if opened_lease is None:
        yield lambda: True
        return
    terms, close = opened_lease
    watch = LeaseWatch(terms, LiveClock(), terms.duration_ns if options.patient else 0)
    try:
        async with running(watch.keep_looking()):
            yield lambda: watch.is_over
    finally:
        await run(close)


def _make_history_alarm(options: argparse.Namespace, fleet: Fleet, life: ProcessLife) -> LostHistoryAlarm:
    return LostHistoryAlarm(_find_state(options), life.bus, FleetKeys(fleet.fleet), run_command_process)


async def _report_lost_history(
    error: HistoryLost, options: argparse.Namespace, fleet: Fleet, life: ProcessLife
) -> None:
    failure = await _make_history_alarm(options, fleet, life).raise_alarm(error, fleet.notify, LiveClock().utc())
    life.log.warning(f"cannot lead: {error}")
    if failure:
        life.log.warning(f"the command for this alarm has failed, and runs again with the next start: {failure}")


def _make_wish(options: argparse.Namespace, fleet: Fleet, name: str) -> JournalWish:
    return JournalWish(options.journal, fleet.fleet, fleet.journal, options.existing_journal, name)


async def _lead(options: argparse.Namespace, fleet: Fleet, life: ProcessLife) -> int:
    bus = life.bus
    latches, folder = _latch_store(options), _find_state(options)
    runs, decode = ThreadExecutor("journal"), ProcessExecutor()
    opened_journal = await runs(open_journal_of, _make_wish(options, fleet, uuid.uuid4().hex))
    check, plan_long = ProcessExecutor(CHECKING), ProcessExecutor(PLANNING)
    court = CoordinatorEnvironment(
        bus=bus,
        keys=FleetKeys(fleet.fleet),
        clock=LiveClock(),
        journal=opened_journal.journal,
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
        find_free=lambda: runs(_find_free_bytes, folder),
        certificate=find_session_certificate(options.connect),
        journal_server=opened_journal.server,
    )
    coordinator = Coordinator(fleet, court)
    try:
        try:
            await coordinator.start(take_over=options.take_over, vacant=options.standby)
        except JournalError:
            await _leave(coordinator, "it cannot lead")
            raise
        if life.urgent:
            # The adapters stop without the leader: the ends of its jobs must not delay that.
            await bus.subscribe(court.keys.estop, lambda _: yield_priority(RealtimePriority.SERVICE))
        if not is_address(options.journal):
            LeaderFile(Path(options.journal)).write_own_process()
        _make_history_alarm(options, fleet, life).clear()
        prepare_live_process()
        life.report_ready()
        events = (life.end, coordinator.leadership_lost, coordinator.broken, coordinator.handed_over)
        async with (
            running(_feed_watchdog(options, coordinator)),
            report_own_alarms(bus, court.keys, ("coordinator", "own"), options.connect),
        ):
            await wait_for_first(*(event.wait() for event in events))
        if coordinator.leadership_lost.is_set():
            await coordinator.abandon()
            return LEADERSHIP_LOST
        if coordinator.broken.is_set():
            await _leave(coordinator, "a defect of the coordinator, which is restarted")
            return BROKEN
        await coordinator.close()
        return HANDED_OVER if coordinator.handed_over.is_set() else 0
    finally:
        for executor in (decode, check, plan_long):
            executor.close()
        # In the journal's own thread, after its pending writes: SQLite crashes the process if closed during a call.
        await runs(opened_journal.close)


async def _leave(coordinator: Coordinator, reason: str) -> None:
    """Close what works: the rest may not keep it from being started again."""
    with suppress(Exception):
        async with asyncio.timeout(CLOSE_S):
            await coordinator.close(reason)


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


def _find_state(options: argparse.Namespace) -> Path:
    """The folder of what this computer keeps besides the journal."""
    return options.state or Path(options.journal).parent


def _latch_store(options: argparse.Namespace) -> FileLatchStore:
    """The e-stop latch of this computer."""
    return FileLatchStore(_find_state(options) / "estop.json")


def save_fleet(path: Path, fleet: Fleet) -> None:
    """Replace the file as a whole: a restart must find the configuration that the fleet runs with."""
    replace_private_file(path, fleet.to_json())


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m orchestrator.coordinator.process", description=__doc__)
    parser.add_argument("--fleet", type=Path, required=True, help="the fleet file; replaced when it is reloaded")
    parser.add_argument("--connect", required=True, help="the router, e.g. tcp/127.0.0.1:7447")
    parser.add_argument("--journal", required=True, help="a file, or postgresql://USER@HOST,HOST/DATABASE")
    parser.add_argument("--state", type=Path, help="folder of the latch, with a database; else that of the file")
    parser.add_argument("--existing-journal", action="store_true", help="refuse a missing journal; else it is begun")
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--take-over", action="store_true", help="lead even if another coordinator does")
    parser.add_argument("--standby", action="store_true", help="lead as soon as there is no leader on this journal")
    parser.add_argument("--patient", action="store_true", help="with a database: let another standby lead first")
    parser.add_argument("--feed-watchdog", action="store_true", help="feed the watchdog of the service manager")
    parser.add_argument("--parent", type=int, default=0, help="end when this process ends")
    options = parser.parse_args()
    if is_address(options.journal) and options.state is None:
        parser.error("--journal postgresql://… needs --state")
    if options.parent:
        die_with_parent(options.parent)
    urgent = set_realtime_priority(RealtimePriority.SERVICE)
    codes: dict[type[Exception], int] = {FileError: BAD_INPUT, AnotherLeader: ANOTHER, JournalError: BAD_JOURNAL}
    return run_service(run_coordinator(options, urgent=urgent), options.log, codes)


if __name__ == "__main__":
    raise SystemExit(main())
