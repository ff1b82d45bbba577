"""The process of an adapter host:
`python -m adapters.host.host_process --fleet FILE --host NAME --connect … --state DIR`.

Under a guardian it writes a byte to `--beat-fd` every 50 ms from its event loop, so that a hung loop stops these
heartbeats. When the other end of that pipe is closed, the guardian is dead and this process would have no successor: it
stops its controllers and ends. Being killed together with the guardian would leave them moving.

Prints `ready` when all its controllers are on the bus. Exit codes: 2 bad input, 3 no router.
"""

import argparse
import asyncio
import contextlib
import logging
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn
from uuid import uuid4

from adapters.controller.state.store import FileStore
from adapters.host.host import AdapterHost, HostEnvironment
from adapters.host.makes import apply_make_defaults, find_controller_problems
from adapters.host.timed_writer import ProcessTimedWriter
from adapters.link.open import make_controller_opener
from orchestrator.bus.expiry import find_session_certificate
from orchestrator.bus.identity import BadIdentity
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.limits import MAX_HOST_MESSAGE_BYTES
from orchestrator.bus.log import LogSink, ProcessLog
from orchestrator.bus.logfile import make_file_sink
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.own_alarms import report_own_alarms
from orchestrator.bus.zenoh.sessions import RouterUnreachable
from orchestrator.clock.executor import ThreadExecutor
from orchestrator.clock.live import LiveClock, prepare_live_process
from orchestrator.clock.owner import wait_for_first
from orchestrator.clock.realtime import RealtimePriority, set_realtime_priority
from orchestrator.clock.signals import call_at_signals
from orchestrator.model.errors import TuttiError
from orchestrator.model.fleet import Controller, Fleet
from orchestrator.model.jobs.files import FileError, parse_file, read_file

HEARTBEAT_S = 0.05
STOP_SEND_S = 1.0  # for the stops to be sent when the process ends
CLOSE_TIMEOUT_S = 2.0  # for links and bus to be closed in order

BAD_INPUT = 2
NO_BUS = 3


class InvalidInput(TuttiError):
    """The arguments or the fleet file are invalid; the text states why."""


class OneLineParser(argparse.ArgumentParser):
    """Report a usage error in one line, and exit with code 2."""

    def error(self, message: str) -> NoReturn:
        sys.stderr.write(f"{self.prog}: {message}\n")
        raise SystemExit(BAD_INPUT)


def host_parser(program: str, description: str) -> argparse.ArgumentParser:
    """Return a parser with the arguments that the guardian shares with its child."""
    parser = OneLineParser(prog=program, description=description)
    parser.add_argument("--fleet", type=Path, required=True, help="the fleet file")
    parser.add_argument("--host", required=True, help="run the controllers with this `host`")
    parser.add_argument("--connect", required=True, help="the router, e.g. tcp/127.0.0.1:7447")
    parser.add_argument("--state", type=Path, required=True, help="directory for data that must outlive the process")
    parser.add_argument("--log", type=Path, help="append JSON lines to this file; default: stderr")
    return parser


def load_host(path: Path, host: str) -> tuple[Fleet, dict[str, Controller]]:
    """Return the fleet, and those of its controllers that belong to the host, checked with their makes. Raises
    `InvalidInput`."""
    try:
        source = read_file(path)
        fleet = apply_make_defaults(parse_file(source, Fleet))
        own_controllers = {name: config for name, config in fleet.controllers.items() if config.host == host}
        problem_lists = [
            find_controller_problems(name, config, tolerant=True) for name, config in own_controllers.items()
        ]
        problems = [
            source.problem(problem.place, problem.text) for problem_list in problem_lists for problem in problem_list
        ]
        if problems:
            raise FileError(problems)
    except FileError as error:
        raise InvalidInput(str(error)) from None
    if not own_controllers:
        hosts = ", ".join(sorted(fleet.hosts))
        raise InvalidInput(f"{path}: no controller has `host: {host}`; existing hosts: {hosts}")
    return fleet, own_controllers


def open_sink(path: Path | None) -> LogSink:
    """Open the destination of log lines: the file, or stderr. Raises `InvalidInput`."""
    try:
        write = make_file_sink(path) if path is not None else _write_to_stderr
    except OSError as error:
        raise InvalidInput(f"--log {path}: {error.strerror}") from None

    def write_line(line: str) -> None:
        # A full disk or a closed terminal must not stop the process that drives machines.
        with contextlib.suppress(OSError):
            write(line)

    return write_line


def _write_to_stderr(line: str) -> None:
    sys.stderr.write(line + "\n")


class _LogForwarder(logging.Handler):
    """Forward log records of libraries to the project's own log."""

    def __init__(self, log: ProcessLog) -> None:
        super().__init__(logging.WARNING)
        self._log = log

    def emit(self, record: logging.LogRecord) -> None:
        self._log.info(record.getMessage(), logger=record.name)


class _HeartbeatWriter:
    """Write heartbeats from the event loop until the pipe is closed; then set `orphaned`. None while the host is not
    sound, or its firing process has died: the loop alone drives no controller."""

    def __init__(self, fd: int, orphaned: asyncio.Event, is_sound: Callable[[], bool]) -> None:
        self._fd = fd
        self._is_sound = is_sound
        self._orphaned = orphaned
        os.set_inheritable(fd, False)  # noqa: FBT003 - its parameters are positional-only
        os.set_blocking(fd, False)
        self._write_heartbeat()

    def _write_heartbeat(self) -> None:
        try:
            if self._is_sound():
                os.write(self._fd, b".")
        except BlockingIOError:
            pass  # The guardian reads slowly; the pipe already holds enough heartbeats.
        except OSError:
            self._orphaned.set()
            return
        asyncio.get_running_loop().call_later(HEARTBEAT_S, self._write_heartbeat)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until ended. Return 0, or 2 (bad input) or 3 (no router) with one line on stderr."""
    parser = host_parser("python -m adapters.host.host_process", "Drive the controllers of one host.")
    parser.add_argument("--beat-fd", type=int, help="pipe to the guardian, set by it")
    options = parser.parse_args(arguments)
    try:
        fleet, _ = load_host(options.fleet, options.host)
        set_realtime_priority(RealtimePriority.SERVICE)
        asyncio.run(_run_host(options, fleet, open_sink(options.log)))
    except (InvalidInput, BadIdentity) as error:
        sys.stderr.write(f"{error}\n")
        return BAD_INPUT
    except RouterUnreachable as error:
        sys.stderr.write(f"{error}\n")
        return NO_BUS
    return 0


async def _run_host(chosen: argparse.Namespace, fleet: Fleet, sink: LogSink) -> None:
    loop, clock, end, guardian_loss = asyncio.get_running_loop(), LiveClock(), asyncio.Event(), asyncio.Event()
    call_at_signals(end.set)
    log = ProcessLog("host", chosen.host, clock, sink)
    loop.set_exception_handler(lambda _, context: _log_defect(log, context))
    logging.getLogger().addHandler(_LogForwarder(log))
    bus = await open_bus(chosen.connect, max_message_bytes=MAX_HOST_MESSAGE_BYTES)
    try:
        firer = ProcessTimedWriter()
        around = HostEnvironment(
            bus=bus,
            keys=FleetKeys(fleet.fleet),
            clock=clock,
            timed_writer=firer,
            open_link=lambda _, config: make_controller_opener(config, clock),
            store=lambda controller: FileStore(chosen.state / f"{controller}.json"),
            runs=ThreadExecutor("memory"),
            sink=sink,
            instance=uuid4().hex,
            certificate=find_session_certificate(chosen.connect),
        )
        try:
            host = AdapterHost(chosen.host, fleet, around)
            if chosen.beat_fd is not None:
                _HeartbeatWriter(chosen.beat_fd, guardian_loss, lambda: host.is_sound and firer.is_alive)
            await host.start()
            prepare_live_process()
            log.info("the adapter host runs", instance=around.instance, pid=os.getpid())
            _print_ready()
            async with report_own_alarms(bus, around.keys, ("host", chosen.host), chosen.connect):
                await wait_for_first(end.wait(), guardian_loss.wait())
            reason = "the guardian is gone" if guardian_loss.is_set() else "the adapter host has ended"
            await _shut_down(host, log, reason)
        finally:
            firer.close()
    finally:
        await bus.close()


def _print_ready() -> None:
    """Print one line for the parent process. After a restart nothing may read it any more."""
    with contextlib.suppress(OSError):
        sys.stdout.write("ready\n")
        sys.stdout.flush()


async def _shut_down(host: AdapterHost, log: ProcessLog, reason: str) -> None:
    """Stop everything, because this process no longer supervises it, and close links and bus."""
    log.info(reason)
    stops = await asyncio.gather(
        *(
            asyncio.wait_for(unit.stops.stop(abort=False, reason=reason), STOP_SEND_S)
            for unit in host.supervisors.values()
        ),
        return_exceptions=True,
    )
    for unit, outcome in zip(host.supervisors.values(), stops, strict=True):
        if isinstance(outcome, Exception):
            log.info(f"not stopped: {outcome or type(outcome).__name__}", controller=unit.controller)
    try:
        await asyncio.wait_for(host.close(), CLOSE_TIMEOUT_S)
    except TimeoutError:
        log.info(f"links and bus could not be closed within {CLOSE_TIMEOUT_S:g} s")


def _log_defect(log: ProcessLog, context: dict[str, Any]) -> None:
    """Log the failure of a task or callback: a defect of this program; the other tasks continue."""
    log.info(f"a defect: {context['message']}: {context.get('exception')!r}", level="error")


if __name__ == "__main__":
    raise SystemExit(main())
