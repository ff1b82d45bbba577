"""The process of one simulated controller, or of several that share a link:
`python -m sim.link.process --model smc4000 --name gantry --listen …`; with `--next` between, of several links.

When all can be reached it prints a JSON line for each link, with its place. It ends with SIGTERM, SIGINT, or when its
standard input is closed, so that it never outlives the one who started it. Lines on standard input, and on the named
pipe `--world`, change the physical world; those on standard input that of its first controller.
"""

import argparse
import asyncio
import contextlib
import json
import os
import selectors
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from pydantic import ValidationError

from orchestrator.clock.live import LiveClock, begin_live
from orchestrator.clock.realtime import Urgency, hurry
from sim.core.controller import Branch, Port, PortRefused, SimulatedController, SimulatedLine, Timing, build_line
from sim.core.oscillator import Oscillator
from sim.core.vectors import simulator
from sim.link.arguments import PtyPlace, UdpPlace, UnitFields, first_problem, parse_arguments, units
from sim.link.bridge import BridgeServer, listen_bridge
from sim.link.can_card import OnCanBus
from sim.link.can_pty import CanPtyServer
from sim.link.pty import PtyServer
from sim.link.tcp import PORT as TCP_PORT
from sim.link.tcp import TcpServer, listen_tcp
from sim.link.truth import TruthLog
from sim.link.udp import UdpServer, listen_udp
from sim.link.wires import follow_outputs
from sim.link.world import WorldRefused, change_world

Server = TcpServer | UdpServer | PtyServer | BridgeServer


class CannotStart(Exception):
    """The simulator can not be reached as it was asked to. Says why."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until ended. Gives 0, or 2 with one line on stderr when it can not start."""
    links = parse_arguments(arguments)
    hurry(Urgency.BUS)
    try:
        on_ethernet = all(each.model == "smc4000" and not isinstance(each.listen, PtyPlace) for each in links)
        with asyncio.Runner(loop_factory=_exact_loop if on_ethernet else None) as runner:
            runner.run(_run(links))
    except CannotStart as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


def _exact_loop() -> asyncio.AbstractEventLoop:
    """A loop that wakes up to the microsecond, as firmware does: the usual one rounds up to the next millisecond.

    Not for serial lines: whoever is woken for each character has no time left for anything else.
    """
    return asyncio.SelectorEventLoop(selectors.SelectSelector())


async def _run(links: Sequence[argparse.Namespace]) -> None:
    task = asyncio.current_task()
    assert task is not None
    # From the first moment: whoever reads the ready line may end this process at once.
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    clock = LiveClock()
    with contextlib.suppress(asyncio.CancelledError), contextlib.ExitStack() as cleanup:
        lines = await _standard_input()
        told = [await _open_link(chosen, clock, cleanup) for chosen in links]
        begin_live()
        for chosen, (server, *_) in zip(links, told, strict=True):
            sys.stdout.write(json.dumps({"name": chosen.name, **server.ready}) + "\n")
        sys.stdout.flush()
        await _follow(lines, *told[0])


async def _open_link(
    chosen: argparse.Namespace, clock: LiveClock, cleanup: contextlib.ExitStack
) -> tuple[Server, SimulatedController, str]:
    """What serves the link, and the first controller on it with its name. Raises `CannotStart` naming it."""
    asked = units(chosen)
    try:
        line = _build(chosen.model, asked, clock)
        server = await _serve(chosen, line.far, clock)
        cleanup.callback(server.close)
        for unit in asked:
            controller = line.units[unit.name]
            if unit.truth is not None:
                TruthLog(controller, clock, cleanup.enter_context(_opened(unit.truth)))
            follow_outputs(controller, unit.wires, clock)
            if unit.world is not None:
                more = await _named_pipe(unit.world)
                listening = asyncio.get_running_loop().create_task(_follow(more, server, controller, unit.name))
                cleanup.callback(listening.cancel)
    except CannotStart as error:
        raise CannotStart(f"{chosen.name}: {error}") from None
    return server, line.units[asked[0].name], asked[0].name


async def _standard_input() -> asyncio.StreamReader:
    """Standard input as lines."""
    reader = asyncio.StreamReader()
    try:
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    except (OSError, ValueError):
        raise CannotStart("standard input must be a pipe or a terminal: the simulator ends when it is closed") from None
    return reader


async def _named_pipe(path: Path) -> asyncio.StreamReader:
    """Lines of whoever opens the pipe. Opened for writing too, so that it does not end with its first writer."""
    reader = asyncio.StreamReader()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        os.mkfifo(path, 0o600)
        opened = os.fdopen(os.open(path, os.O_RDWR | os.O_NONBLOCK), "rb", buffering=0)
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), opened)
    except OSError as error:
        raise CannotStart(f"--world: {path}: {error.strerror}") from None
    return reader


def _build(model: str, asked: Sequence[UnitFields], clock: LiveClock) -> SimulatedLine:
    branches = {
        unit.name: Branch(
            unit.address,
            unit.options,
            Oscillator(**unit.oscillator.model_dump()),
            Timing(**unit.timing.model_dump()),
            unit.seed,
        )
        for unit in asked
    }
    try:
        return build_line(simulator(model), clock, branches)
    except ValidationError as error:
        raise CannotStart(f"--options: {first_problem(error)}") from None
    except ValueError as error:
        raise CannotStart(str(error)) from None


async def _serve(chosen: argparse.Namespace, controller: Port, clock: LiveClock) -> Server:
    place = chosen.listen
    try:
        if isinstance(controller, OnCanBus):
            if not isinstance(place, PtyPlace):
                raise CannotStart("--listen: a CAN bus stands behind an slcan pseudo-terminal only: pty:PATH")
            return CanPtyServer(controller.segment, clock, place.link)
        if isinstance(place, PtyPlace):
            return PtyServer(controller, clock, place.link, chosen.baud, chosen.frame)
        if isinstance(place, UdpPlace):
            return await listen_udp(controller, place.host, place.port)
        if TCP_PORT in controller.ports:
            return await listen_tcp(controller, place.host, place.port)
        return await listen_bridge(controller, clock, place.host, place.port, chosen.baud, chosen.frame)
    except (PortRefused, OSError) as error:
        raise CannotStart(f"--listen: {error}") from None


def _opened(path: Path) -> TextIO:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("a", encoding="utf-8")
    except OSError as error:
        raise CannotStart(f"--truth: {path}: {error.strerror}") from None


async def _follow(lines: asyncio.StreamReader, server: Server, controller: SimulatedController, name: str) -> None:
    """Change the world line by line, until there are no more."""
    while line := await lines.readline():
        try:
            change_world(controller, line.decode("utf-8", "replace"))
        except WorldRefused as error:
            sys.stderr.write(f"{name}: {error}\n")
        server.reconnect()


if __name__ == "__main__":
    raise SystemExit(main())
