"""The process of an adapter host:
`python -m adapters.host.host_process --fleet FILE --host NAME --connect … --state DIR`.

Under a guardian it writes a byte to `--beat-fd` every 50 ms from its event loop, so that a hung loop stops beating.
When nobody reads that pipe any more the guardian is dead, and nobody would take over from this process: it stops its
controllers and ends. That is preferred to being killed with it, which would leave them moving.

Prints `ready` when all its controllers are on the bus. Exit codes: 2 bad input, 3 no router.
"""

import argparse
import asyncio
import contextlib
import logging
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn
from uuid import uuid4

from adapters.controller.store import FileStore
from adapters.host.firing_process import ProcessFirer
from adapters.host.host import AdapterHost, Surroundings, check_controller
from adapters.link.open import open_link
from orchestrator.bus.keys import Keys
from orchestrator.bus.log import Log, Sink
from orchestrator.bus.logfile import file_sink
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.sessions import RouterUnreachable
from orchestrator.clock.executor import Threaded
from orchestrator.clock.live import LiveClock, begin_live
from orchestrator.clock.realtime import Urgency, hurry
from orchestrator.model.files import FileError, load_fleet
from orchestrator.model.fleet import Controller, Fleet

BEAT_S = 0.05
STOP_S = 1.0  # for the stop orders to leave when it ends
CLOSE_S = 2.0  # for links and bus to be left in order

BAD_INPUT = 2
NO_BUS = 3


class BadInput(Exception):
    """The arguments or the fleet file can not be used. Says why."""


class OneLineParser(argparse.ArgumentParser):
    """Says what is wrong in one line, and ends with code 2."""

    def error(self, message: str) -> NoReturn:
        sys.stderr.write(f"{self.prog}: {message}\n")
        raise SystemExit(BAD_INPUT)


def host_parser(program: str, description: str) -> argparse.ArgumentParser:
    """The arguments that the guardian shares with its child."""
    parser = OneLineParser(prog=program, description=description)
    parser.add_argument("--fleet", type=Path, required=True, help="the fleet file")
    parser.add_argument("--host", required=True, help="run the controllers whose `host` is this")
    parser.add_argument("--connect", required=True, help="the router, e.g. tcp/127.0.0.1:7447")
    parser.add_argument("--state", type=Path, required=True, help="directory for what must outlive the process")
    parser.add_argument("--log", type=Path, help="append JSON lines here; without it to stderr")
    return parser


def load_host(path: Path, host: str) -> tuple[Fleet, dict[str, Controller]]:
    """The fleet, and those of its controllers that are the host's, checked with their makes. Raises `BadInput`."""
    try:
        fleet = load_fleet(path)
        mine = {name: config for name, config in fleet.controllers.items() if config.host == host}
        for name, config in mine.items():
            check_controller(name, config)
    except FileError as error:
        raise BadInput(str(error)) from None
    except ValueError as error:
        raise BadInput(f"{path}: {error}") from None
    if not mine:
        hosts = ", ".join(sorted({config.host for config in fleet.controllers.values()}))
        raise BadInput(f"{path}: no controller has `host: {host}`; the hosts there are: {hosts}")
    return fleet, mine


def open_sink(path: Path | None) -> Sink:
    """Where log lines go: the file, or stderr. Raises `BadInput`."""
    try:
        write = file_sink(path) if path is not None else _to_stderr
    except OSError as error:
        raise BadInput(f"--log {path}: {error.strerror}") from None

    def sink(line: str) -> None:
        # A full disk or a closed terminal must not stop what drives machines.
        with contextlib.suppress(OSError):
            write(line)

    return sink


def _to_stderr(line: str) -> None:
    sys.stderr.write(line + "\n")


class _Forward(logging.Handler):
    """What libraries log goes to our own log."""

    def __init__(self, log: Log) -> None:
        super().__init__(logging.WARNING)
        self._log = log

    def emit(self, record: logging.LogRecord) -> None:
        self._log.info(record.getMessage(), logger=record.name)


class _Beat:
    """Beats from the event loop until nobody listens; then calls `orphaned`."""

    def __init__(self, fd: int, orphaned: asyncio.Event) -> None:
        self._fd = fd
        self._orphaned = orphaned
        os.set_inheritable(fd, False)
        os.set_blocking(fd, False)
        self._beat()

    def _beat(self) -> None:
        try:
            os.write(self._fd, b".")
        except BlockingIOError:
            pass  # The guardian is behind with reading; there are beats enough in the pipe.
        except OSError:
            self._orphaned.set()
            return
        asyncio.get_running_loop().call_later(BEAT_S, self._beat)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until ended. Gives 0, or 2 (bad input) or 3 (no router) with one line on stderr."""
    parser = host_parser("python -m adapters.host.host_process", "Drives the controllers of one host.")
    parser.add_argument("--beat-fd", type=int, help="pipe to the guardian, set by it")
    chosen = parser.parse_args(arguments)
    try:
        fleet, _ = load_host(chosen.fleet, chosen.host)
        hurry(Urgency.SERVICE)
        asyncio.run(_run(chosen, fleet, open_sink(chosen.log)))
    except BadInput as error:
        sys.stderr.write(f"{error}\n")
        return BAD_INPUT
    except RouterUnreachable as error:
        sys.stderr.write(f"{error}\n")
        return NO_BUS
    return 0


async def _run(chosen: argparse.Namespace, fleet: Fleet, sink: Sink) -> None:
    loop, clock, ended, orphaned = asyncio.get_running_loop(), LiveClock(), asyncio.Event(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    log = Log("host", chosen.host, clock, sink)
    loop.set_exception_handler(lambda _, context: _defect(log, context))
    logging.getLogger().addHandler(_Forward(log))
    bus = await open_bus(chosen.connect)
    try:
        firer = ProcessFirer()
        around = Surroundings(
            bus,
            Keys(fleet.fleet),
            clock,
            firer,
            lambda _, config: open_link(config.reached_by, clock),
            lambda controller: FileStore(chosen.state / f"{controller}.json"),
            Threaded("memory"),
            sink,
            uuid4().hex,
        )
        try:
            host = AdapterHost(chosen.host, fleet, around)
            if chosen.beat_fd is not None:
                _Beat(chosen.beat_fd, orphaned)
            await host.start()
            begin_live()
            log.info("the adapter host runs", instance=around.instance, pid=os.getpid())
            _say_ready()
            await _first(ended, orphaned)
            reason = "the guardian is gone" if orphaned.is_set() else "the adapter host is ended"
            await _leave(host, log, reason)
        finally:
            firer.close()
    finally:
        await bus.close()


def _say_ready() -> None:
    """One line for those who have started it. A restarted one may find that nobody listens any more."""
    with contextlib.suppress(OSError):
        sys.stdout.write("ready\n")
        sys.stdout.flush()


async def _first(*events: asyncio.Event) -> None:
    """Wait for any of `events`."""
    waits = [asyncio.ensure_future(event.wait()) for event in events]
    await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
    for wait in waits:
        wait.cancel()


async def _leave(host: AdapterHost, log: Log, reason: str) -> None:
    """Stop everything, for nobody watches it any more, and leave links and bus."""
    log.info(reason)
    stops = await asyncio.gather(
        *(asyncio.wait_for(unit.stop(False, reason), STOP_S) for unit in host.units.values()), return_exceptions=True
    )
    for unit, outcome in zip(host.units.values(), stops, strict=True):
        if isinstance(outcome, Exception):
            log.info(f"not stopped: {outcome or type(outcome).__name__}", controller=unit.controller)
    try:
        await asyncio.wait_for(host.close(), CLOSE_S)
    except TimeoutError:
        log.info(f"links and bus could not be left within {CLOSE_S:g} s")


def _defect(log: Log, context: dict[str, Any]) -> None:
    """A task or callback failed: that is a defect of this program, and the others go on."""
    log.info(f"a defect: {context['message']}: {context.get('exception')!r}", level="error")


if __name__ == "__main__":
    raise SystemExit(main())
