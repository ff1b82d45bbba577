"""Process of one simulated controller, or of several that share a link: `python -m sim.link.process --model smc4000
--name gantry --listen …`; with `--next` between, of several links.

When all are reachable it prints a JSON line with the address of each link. It ends with SIGTERM, SIGINT, or when its
standard input closes, so that it never outlives its parent. Lines on standard input, and on the named pipe `--world`,
change the physical environment; those on standard input concern its first controller.
"""

import argparse
import asyncio
import contextlib
import errno
import json
import os
import selectors
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from pydantic import ValidationError

from orchestrator.clock.input_thread import read_in_thread
from orchestrator.clock.live import LiveClock, prepare_live_process
from orchestrator.clock.realtime import RealtimePriority, set_realtime_priority
from orchestrator.clock.signals import call_at_signals
from orchestrator.model.errors import TuttiError
from orchestrator.model.files.private_files import FILE_MODE, make_private_folder, open_for_append, open_private_file
from orchestrator.model.problems import describe_first_error
from sim.core.contact import ContactBench
from sim.core.controller import (
    DeviceSpec,
    FirmwareTiming,
    LineEndpoint,
    PortRefused,
    SimulatedController,
    SimulatedLine,
    build_line,
)
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator
from sim.link.arguments import DeviceFields, PtyAddress, UdpAddress, parse_arguments, requested_devices
from sim.link.bridge import BridgeServer, listen_bridge
from sim.link.can_card import CanDevice
from sim.link.can_pty import CanPtyServer
from sim.link.pty import PtyServer
from sim.link.tcp import PORT as TCP_PORT
from sim.link.tcp import TcpServer, listen_tcp
from sim.link.truth import GroundTruthLog
from sim.link.udp import UdpServer, listen_udp
from sim.link.wires import follow_outputs
from sim.link.world import EnvironmentRefused, change_environment

Server = TcpServer | UdpServer | PtyServer | BridgeServer


class CannotStart(TuttiError):
    """The simulator cannot be served as requested; the message states the reason."""


def _needs_exact_time(model: str) -> bool:
    """Return whether a simulator asks for a loop that wakes exactly, for delays of less than a millisecond. One that
    cannot be used is reported later."""
    try:
        return bool(getattr(find_simulator(model), "needs_exact_time", False))
    except ValueError:
        return False


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until ended. Return 0, or 2 with one line on stderr when it cannot start."""
    links = parse_arguments(arguments)
    set_realtime_priority(RealtimePriority.BUS)
    try:
        is_exact = all(_needs_exact_time(link.model) and not isinstance(link.listen, PtyAddress) for link in links)
        with asyncio.Runner(loop_factory=_exact_loop if is_exact else None) as runner:
            runner.run(_run_links(links))
    except CannotStart as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


def _exact_loop() -> asyncio.AbstractEventLoop:
    """Create a loop that wakes up to the microsecond, as firmware does: the default one rounds up to the next
    millisecond.

    Not for serial lines: a process that wakes for each character has no time left for anything else.
    """
    return asyncio.SelectorEventLoop(selectors.SelectSelector())


async def _run_links(links: Sequence[argparse.Namespace]) -> None:
    task = asyncio.current_task()
    assert task is not None
    # Set before the ready line is printed: its reader may end this process at once.
    call_at_signals(task.cancel)
    clock = LiveClock()
    with contextlib.suppress(asyncio.CancelledError), contextlib.ExitStack() as cleanup:
        lines = await _standard_input()
        followers = [await _open_link(link, clock, cleanup) for link in links]
        prepare_live_process()
        for chosen_link, (server, *_) in zip(links, followers, strict=True):
            sys.stdout.write(json.dumps({"name": chosen_link.name, **server.ready_fields}) + "\n")
        sys.stdout.flush()
        await _follow_changes(lines, *followers[0])


async def _open_link(
    chosen: argparse.Namespace, clock: LiveClock, cleanup: contextlib.ExitStack
) -> tuple[Server, SimulatedController, str]:
    """Open one link. Return its server, and the first controller on it with its name. Raises `CannotStart` with that
    name."""
    requested_fields = requested_devices(chosen)
    try:
        line = _build_devices(chosen.model, requested_fields, clock)
        server = await _serve_endpoint(chosen, line.endpoint, clock)
        cleanup.callback(server.close)
        for unit in requested_fields:
            controller = line.devices[unit.name]
            if unit.truth is not None:
                GroundTruthLog(controller, clock, cleanup.enter_context(_open_append(unit.truth)))
            follow_outputs(controller, unit.wires, clock)
            if unit.world is not None:
                more = await _named_pipe(unit.world)
                listening = asyncio.get_running_loop().create_task(_follow_changes(more, server, controller, unit.name))
                cleanup.callback(listening.cancel)
    except CannotStart as error:
        raise CannotStart(f"{chosen.name}: {error}") from None
    return server, line.devices[requested_fields[0].name], requested_fields[0].name


async def _standard_input() -> asyncio.StreamReader:
    """Open standard input as lines."""
    reader = asyncio.StreamReader()
    try:
        if sys.platform == "win32":
            read_in_thread(sys.stdin.fileno(), lambda data: reader.feed_data(data) if data else reader.feed_eof())
            return reader
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    except (OSError, ValueError):
        raise CannotStart("standard input must be a pipe or a terminal: the simulator ends when it is closed") from None
    return reader


async def _named_pipe(path: Path) -> asyncio.StreamReader:
    """Open a named pipe as lines. It is opened for writing too, so that it does not end with its first writer."""
    reader = asyncio.StreamReader()
    if sys.platform == "win32":
        raise CannotStart("--world: there are no named pipes in folders of Windows")
    try:
        make_private_folder(path.parent)
        path.unlink(missing_ok=True)
        os.mkfifo(path, FILE_MODE)
        file = os.fdopen(open_private_file(path, os.O_RDWR | os.O_NONBLOCK), "rb", buffering=0)
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), file)
    except OSError as error:
        raise CannotStart(f"--world: {path}: {error.strerror}") from None
    return reader


def _build_devices(model: str, requested: Sequence[DeviceFields], clock: LiveClock) -> SimulatedLine:
    branches = {
        unit.name: DeviceSpec(
            unit.address,
            unit.options,
            Oscillator(**unit.oscillator.model_dump()),
            FirmwareTiming(**unit.timing.model_dump()),
            unit.seed,
        )
        for unit in requested
    }
    try:
        return build_line(find_simulator(model), clock, branches)
    except ValidationError as error:
        raise CannotStart(f"--options: {describe_first_error(error)}") from None
    except ValueError as error:
        raise CannotStart(str(error)) from None


async def _serve_endpoint(chosen: argparse.Namespace, controller: LineEndpoint, clock: LiveClock) -> Server:
    address = chosen.listen
    if isinstance(address, PtyAddress) and sys.platform == "win32":
        raise CannotStart("--listen: there are no pseudo-terminals on Windows")
    try:
        if isinstance(controller, CanDevice):
            if not isinstance(address, PtyAddress):
                raise CannotStart("--listen: a CAN bus can only be served at an slcan pseudo-terminal: pty:PATH")
            return CanPtyServer(controller.segment, clock, address.link)
        if isinstance(address, PtyAddress):
            return PtyServer(controller, clock, address.link, chosen.baud, chosen.frame)
        if isinstance(address, UdpAddress):
            return await listen_udp(controller, address.host, address.port)
        if TCP_PORT in controller.port_names:
            return await listen_tcp(controller, address.host, address.port)
        return await listen_bridge(controller, clock, address, chosen.baud, chosen.frame)
    except (PortRefused, OSError) as error:
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE and not isinstance(address, PtyAddress):
            raise CannotStart(f"port {address.port} of {address.host} is in use; choose another one") from None
        raise CannotStart(f"--listen: {error}") from None


def _open_append(path: Path) -> TextIO:
    try:
        return os.fdopen(open_for_append(path), "a", encoding="utf-8")
    except OSError as error:
        raise CannotStart(f"--truth: {path}: {error.strerror}") from None


async def _follow_changes(
    lines: asyncio.StreamReader, server: Server, controller: SimulatedController, name: str
) -> None:
    """Change the environment line by line, until the stream ends."""
    contacts = ContactBench(LiveClock())
    while line := await lines.readline():
        try:
            change_environment(controller, line.decode("utf-8", "replace"), contacts)
        except EnvironmentRefused as error:
            sys.stderr.write(f"{name}: {error}\n")
        server.restore_link()


if __name__ == "__main__":
    raise SystemExit(main())
