"""The recorder as a process of its own: `python -m orchestrator.monitor.recording.process --help`.

Prints a line when it records: the address of the metrics, or why there is none. Ends with SIGTERM or SIGINT, and with
its parent. Exit codes: 2 bad input, or another recorder uses the folder; 3 the bus cannot be reached.
"""

import argparse
import asyncio
import contextlib
import sys
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from orchestrator.bus.base import Bus
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.log import ProcessLog
from orchestrator.bus.logfile import make_file_sink
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.own_alarms import report_own_alarms
from orchestrator.bus.zenoh.service_process import BAD_INPUT, run_service
from orchestrator.clock.executor import ThreadExecutor
from orchestrator.clock.live import LiveClock, prepare_live_process
from orchestrator.clock.owner import TaskOwner, running
from orchestrator.clock.parent import die_with_parent
from orchestrator.clock.service_manager import ServiceManager
from orchestrator.clock.signals import call_at_signals
from orchestrator.monitor.metrics.fleet_metrics import FleetMetrics
from orchestrator.monitor.metrics.server import NoPort, serve_metrics
from orchestrator.monitor.recording.folder import RecorderLimits, RecordingFolder
from orchestrator.monitor.recording.lock import FolderInUse, FolderLock
from orchestrator.monitor.recording.recorder import FleetRecorder
from orchestrator.monitor.recording.unfinished import list_unfinished, repair_left
from orchestrator.monitor.recording.writer import RecordingWriter


@dataclass(frozen=True, slots=True)
class RecorderOptions:
    """quota: bytes that all recordings of `folder` may take. fleet_file: attached to every recording.
    metrics_port: None: the first free one; 0: metrics are not served. service: it is a service of its own.
    """

    fleet: str
    connect: str
    folder: Path
    quota: int
    log: Path
    fleet_file: Path | None = None
    metrics_port: int | None = 0
    service: bool = False


async def record_fleet(options: RecorderOptions, on_ready: Callable[[str], None]) -> int:
    """Record until the process is to end; return the exit code.

    on_ready: called with the address of the metrics, or why there is none.

    Raises `FolderInUse`, `UnsafePath`, `OSError` for the folder, and `RouterUnreachable`.
    """
    lock = FolderLock(options.folder)
    try:
        log = ProcessLog("recorder", options.fleet, LiveClock(), make_file_sink(options.log))
        bus = await open_bus(options.connect)
        try:
            await _record(options, bus, log, on_ready)
        finally:
            await bus.close()
    finally:
        lock.release()
    return 0


async def _record(options: RecorderOptions, bus: Bus, log: ProcessLog, on_ready: Callable[[str], None]) -> None:
    clock, keys = LiveClock(), FleetKeys(options.fleet)
    end = asyncio.Event()
    call_at_signals(end.set)
    paths_left = list_unfinished(options.folder)  # before this recorder begins its own
    folder = RecordingFolder(options.folder, options.fleet, clock, RecorderLimits(quota=options.quota))
    writer = RecordingWriter(folder, options.fleet, clock, options.fleet_file)
    metrics = FleetMetrics(clock, lambda: (writer.written, writer.dropped, writer.invalid))
    writer.on_message = lambda channel, message: metrics.take_message(message)
    recorder = FleetRecorder(bus, keys, clock, writer, ThreadExecutor("recordings"))

    def note_alarm(kind: str, text: str, active: bool) -> None:  # noqa: FBT001 - a callback
        recorder.alarms.note_alarm(kind, text, active=active)
        (log.warning if active else log.info)(text)

    folder.on_alarm = note_alarm
    await recorder.start()
    prepare_live_process()
    await bus.announce(keys.live("recorder", uuid.uuid4().hex[:8], "1"))
    log.info(f"records fleet {options.fleet} in {options.folder}")
    on_ready(_serve_metrics(metrics, options.metrics_port, log))
    tasks_beside = TaskOwner()
    tasks_beside.spawn(repair_left(paths_left, log, ThreadExecutor("repair")))
    async with running(recorder.run()) as running_task, running(end.wait()) as ended_task:
        if options.service:
            tasks_beside.spawn(ServiceManager().run_alone())
        async with report_own_alarms(bus, keys, ("recorder", "own"), options.connect):
            await asyncio.wait([running_task, ended_task], return_when=asyncio.FIRST_COMPLETED)
    tasks_beside.cancel_all()
    with contextlib.suppress(asyncio.CancelledError):
        await running_task  # raises a defect: then the process ends with it, and is started again
    await recorder.close()
    log.info(f"{writer.written} messages recorded, {writer.dropped} left out, {writer.invalid} not valid")


def _serve_metrics(metrics: FleetMetrics, port: int | None, log: ProcessLog) -> str:
    """Serve metrics; return their address, or why there is none."""
    if port == 0:
        return ""
    try:
        return f"metrics on {serve_metrics(metrics.registry, port)}"
    except NoPort as error:
        log.warning(str(error))
        return str(error)


def _print_ready(metrics: str) -> None:
    sys.stdout.write(f"{metrics}\n")
    sys.stdout.flush()


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m orchestrator.monitor.recording.process", description=__doc__)
    parser.add_argument("--fleet", required=True, help="the fleet's name")
    parser.add_argument("--fleet-file", type=Path, default=None, help="attached to every recording")
    parser.add_argument("--connect", required=True, help="the router, e.g. tcp/127.0.0.1:7447")
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--quota", type=int, required=True, help="bytes that all recordings may take")
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--metrics-port", type=int, default=None, help="0: no metrics; default: the first free one")
    parser.add_argument("--service", action="store_true", help="a service of its own: announce that it is ready")
    parser.add_argument("--parent", type=int, default=0, help="end when this process ends")
    options = parser.parse_args()
    chosen_options = RecorderOptions(
        fleet=options.fleet,
        connect=options.connect,
        folder=options.folder,
        quota=options.quota,
        log=options.log,
        fleet_file=options.fleet_file,
        metrics_port=options.metrics_port,
        service=options.service,
    )
    if options.parent:
        die_with_parent(options.parent)
    return run_service(record_fleet(chosen_options, _print_ready), options.folder, {FolderInUse: BAD_INPUT})


if __name__ == "__main__":
    raise SystemExit(main())
