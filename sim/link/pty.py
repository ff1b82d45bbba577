"""A simulated controller's serial port as a raw pseudo-terminal with a stable name.

Pseudo-terminals neither pace nor carry parity, so both directions are paced here. This process keeps the client's side
open too, so that clients may come and go; a new client flushes the bytes that it finds, as on any port.
"""

import asyncio
import contextlib
import os
from pathlib import Path

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.model.files.private_files import make_private_folder
from sim.core.controller import LineEndpoint, PortConnection, PortRefused
from sim.link.pacing import PacedLine

PORT = "serial"

# Unsent bytes that the operating system buffers for a real port.
UNSENT_BYTES = 4096


class PtyServer:
    """Serve `controller` on a pseudo-terminal that `link` points to.

    bits: of one character, with its frame.

    Raises `PortRefused` when the controller has no serial port, `OSError` when the link cannot be made.
    """

    def __init__(self, controller: LineEndpoint, clock: Clock, link: Path, baud: int, bits: int) -> None:
        self._controller = controller
        self._clock = clock
        self._link = link
        self._char_ns = bits * NS_PER_S // baud
        self._in = PacedLine(clock, self._char_ns, self._deliver_to_controller)
        self._out = PacedLine(clock, self._char_ns, self._send_to_client)
        self._far: PortConnection | None = controller.connect(PORT, self._out.queue_bytes, self._handle_disconnect)
        self._loop = asyncio.get_running_loop()
        self._reading = False
        import tty  # which Windows does not have, where simulators on Ethernet run too

        self._master, self._slave = os.openpty()
        try:
            tty.setraw(self._slave)
            self.device = os.ttyname(self._slave)
            self._create_link()
        except BaseException:
            os.close(self._master)
            os.close(self._slave)
            raise
        os.set_blocking(self._master, False)
        self._resume_reading()

    @property
    def ready_fields(self) -> dict[str, object]:
        """Address fields for the ready line."""
        return {"place": f"serial {self._link}", "kind": "serial", "device": str(self._link)}

    def close(self) -> None:
        """Remove the port."""
        if self._reading:
            self._loop.remove_reader(self._master)
        with contextlib.suppress(OSError):
            if str(self._link.readlink()) == self.device:
                self._link.unlink()
        os.close(self._master)
        os.close(self._slave)

    def restore_link(self) -> None:
        """Reconnect after a power cycle of the controller: the cable is still plugged in, but bytes in transmission are
        lost."""
        if self._far is not None:
            self._out.cut_transmission(self._far.supply.lost_ns)
        else:
            with contextlib.suppress(PortRefused):
                self._far = self._controller.connect(PORT, self._out.queue_bytes, self._handle_disconnect)

    def _create_link(self) -> None:
        """Point the stable name here; an old link of a simulator that was killed is replaced."""
        if self._link.exists() and not self._link.is_symlink():
            raise FileExistsError(f"{self._link} exists and is not a symbolic link; choose another name")
        make_private_folder(self._link.parent)
        fresh = self._link.with_name(f".{self._link.name}.{os.getpid()}")
        fresh.symlink_to(self.device)
        fresh.replace(self._link)

    # Input

    def _resume_reading(self) -> None:
        self._loop.add_reader(self._master, self._handle_readable)
        self._reading = True

    def _handle_readable(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._in.queue_lines(os.read(self._master, UNSENT_BYTES))
        if self._in.waiting >= UNSENT_BYTES:
            # A client that writes faster than the line is blocked, as by a real port.
            self._loop.remove_reader(self._master)
            self._reading = False

    def _deliver_to_controller(self, data: bytes) -> None:
        if not self._reading and self._in.waiting < UNSENT_BYTES:
            self._resume_reading()
        self.restore_link()
        if self._far is not None:
            data_left = self._far.supply.cut_received(data, self._clock.now_ns(), self._char_ns)
            if data_left:
                self._far.receive_bytes(data_left)

    # Output

    def _send_to_client(self, data: bytes) -> None:
        # The operating system keeps unread bytes, as it does for a real port; bytes beyond its buffer are lost.
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def _handle_disconnect(self) -> None:
        self._far = None
        self._out.cut_transmission(self._clock.now_ns())
