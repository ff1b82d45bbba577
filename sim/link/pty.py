"""A simulated controller's serial port as a raw pseudo-terminal with a stable name.

Pseudo-terminals neither pace nor carry parity, so both directions are paced here. This process keeps the client's
side open too, so that clients may come and go; who comes flushes what he finds, as on any port.
"""

import asyncio
import contextlib
import os
import tty
from pathlib import Path

from orchestrator.clock.base import NS_PER_S, Clock
from sim.core.controller import Connection, Port, PortRefused
from sim.link.pacing import PacedLine

PORT = "serial"

# As many unsent bytes as the operating system takes for a real port.
UNSENT_BYTES = 4096


class PtyServer:
    """Serves `controller` on a pseudo-terminal that `link` points to. `bits`: of one character, with its frame.

    Raises `PortRefused` when the controller has no serial port, `OSError` when the link can not be made.
    """

    def __init__(self, controller: Port, clock: Clock, link: Path, baud: int, bits: int) -> None:
        self._controller = controller
        self._clock = clock
        self._link = link
        self._char_ns = bits * NS_PER_S // baud
        self._in = PacedLine(clock, self._char_ns, self._arrive)
        self._out = PacedLine(clock, self._char_ns, self._leave)
        self._far: Connection | None = controller.connect(PORT, self._out.put, self._hung_up)
        self._loop = asyncio.get_running_loop()
        self._reading = False
        self._master, self._slave = os.openpty()
        try:
            tty.setraw(self._slave)
            self.device = os.ttyname(self._slave)
            self._point()
        except BaseException:
            os.close(self._master)
            os.close(self._slave)
            raise
        os.set_blocking(self._master, False)
        self._read_on()

    @property
    def ready(self) -> dict[str, object]:
        """Where it is, for the ready line."""
        return {"place": f"serial {self._link}", "kind": "serial", "device": str(self._link)}

    def close(self) -> None:
        """Take the port away."""
        if self._reading:
            self._loop.remove_reader(self._master)
        with contextlib.suppress(OSError):
            if str(self._link.readlink()) == self.device:
                self._link.unlink()
        os.close(self._master)
        os.close(self._slave)

    def reconnect(self) -> None:
        """A wire is still plugged in when the controller comes back from a power cycle, without what it was saying."""
        if self._far is not None:
            self._out.fell_silent(self._far.supply.lost_ns)
        else:
            with contextlib.suppress(PortRefused):
                self._far = self._controller.connect(PORT, self._out.put, self._hung_up)

    def _point(self) -> None:
        """Let the stable name point here; an old link of a simulator that was killed is replaced."""
        if self._link.exists() and not self._link.is_symlink():
            raise FileExistsError(f"{self._link} is there already and is no link; choose another name")
        self._link.parent.mkdir(parents=True, exist_ok=True)
        fresh = self._link.with_name(f".{self._link.name}.{os.getpid()}")
        fresh.symlink_to(self.device)
        fresh.replace(self._link)

    # In

    def _read_on(self) -> None:
        self._loop.add_reader(self._master, self._readable)
        self._reading = True

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._in.put_lines(os.read(self._master, UNSENT_BYTES))
        if self._in.waiting >= UNSENT_BYTES:
            # A client that writes faster than the line is held up, as by a real port.
            self._loop.remove_reader(self._master)
            self._reading = False

    def _arrive(self, data: bytes) -> None:
        if not self._reading and self._in.waiting < UNSENT_BYTES:
            self._read_on()
        self.reconnect()
        if self._far is not None:
            heard = self._far.supply.heard(data, self._clock.now_ns(), self._char_ns)
            if heard:
                self._far.receive(heard)

    # Out

    def _leave(self, data: bytes) -> None:
        # What nobody reads the operating system keeps, as it does of a real port; what it has no room for is lost.
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def _hung_up(self) -> None:
        self._far = None
        self._out.fell_silent(self._clock.now_ns())
