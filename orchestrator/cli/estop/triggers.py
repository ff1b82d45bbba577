"""What presses the button: a key of the terminal, or a line of text on standard input or a serial port."""

import asyncio
import contextlib
import os
import sys
from collections.abc import Callable, Generator

from adapters.link.serial import open_serial
from orchestrator.cli.base.terminal import watch_input
from orchestrator.cli.estop.button import WIRED, Report
from orchestrator.clock.live import LiveClock
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import TuttiError
from orchestrator.model.links import SerialLink

REOPEN_S = 1.0
MAX_LINE_BYTES = 1000  # of a line that has not ended; what comes before is no text


class TriggerLost(TuttiError):
    """Nothing can press the button any more."""


class LineSplitter:
    """Finds complete lines in pieces of bytes."""

    def __init__(self) -> None:
        self._rest = b""

    def has_line(self, data: bytes) -> bool:
        """Whether a line that is not blank ends in `data`."""
        *lines, tail = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        self._rest = tail[-MAX_LINE_BYTES:]
        return any(line.strip(b" \t\0") for line in lines)


@contextlib.contextmanager
def watch_standard_input(press: Callable[[], None], lost: asyncio.Event) -> Generator[str]:
    """Press the button at a key, or at a line if standard input is no terminal; set `lost` when it ends. Gives what
    presses it, in words. Raises `TriggerLost`."""
    fd, lines = sys.stdin.fileno(), LineSplitter()
    terminal = os.isatty(fd)

    def take_input(data: bytes) -> None:
        if not data:
            lost.set()
        elif terminal or lines.has_line(data):
            press()

    with contextlib.ExitStack() as restore:
        try:
            restore.enter_context(watch_input(fd, take_input))
        except OSError:
            raise TriggerLost("standard input must be a terminal or a pipe, or give a serial port: --port") from None
        yield "any key" if terminal else "a line of text"


async def watch_port(device: str, press: Callable[[], None], report: Report) -> None:
    """Press the button at a line of text on a serial port, 9600 baud; open the port again when it is lost."""
    link = SerialLink(kind="serial", device=device, baud=9600)
    text = ""
    while True:
        try:
            port = open_serial(link, LiveClock())
            report("port", f"a line of text on {device} presses the button")
            text, lines = "", LineSplitter()
            try:
                while True:
                    if lines.has_line((await port.read()).data):
                        press()
            finally:
                await port.close()
        except (LinkRefused, LinkClosed) as error:
            if text != str(error):
                text = str(error)
                report("port-lost", f"NO BUTTON on {device}: {error}; {WIRED}")
            await asyncio.sleep(REOPEN_S)
