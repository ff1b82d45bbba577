"""One connection: its command buffer, the timing of command execution, and its replies."""

from collections import deque
from collections.abc import Callable
from typing import Protocol

from orchestrator.clock.base import ClockTimer
from orchestrator.link.supply import PowerSupply
from sim.core.controller import SendBytes
from sim.core.devicetime import DeviceTime
from sim.ppsmc.line import ClientLine, ClientLineReader


class PortFirmware(Protocol):
    """Interface of the controller that a connection uses."""

    @property
    def time(self) -> DeviceTime: ...

    @property
    def supply(self) -> PowerSupply: ...

    @property
    def is_listening(self) -> bool:
        """Return whether the firmware reads the line."""
        ...

    def delay_ns(self) -> int:
        """Decoding time of the next command."""
        ...

    def execute_line(self, port: "ClientConnection", line: ClientLine) -> None: ...

    def frame_reply(self, text: str, *, serial: bool) -> bytes: ...

    def handle_disconnect(self, port: "ClientConnection") -> None:
        """Handle a disconnection; commands of the port may still wait."""
        ...


class ClientConnection:
    """One open connection. Commands of one connection are executed in order, one at a time."""

    def __init__(
        self, firmware: PortFirmware, send: SendBytes, closed: Callable[[], None], limit: int, *, serial: bool
    ) -> None:
        self._firmware = firmware
        self._send = send
        self._closed = closed
        self._serial = serial
        self._reader = ClientLineReader(limit)
        self._buffer: deque[ClientLine] = deque()
        self._open = True
        self._timer: ClockTimer | None = None
        self._asleep_ns = 0
        """Device time until which a sleep delays the next command."""
        self._working = False

    # From outside

    def receive_bytes(self, data: bytes) -> None:
        if not self._open or not self._firmware.is_listening:
            return
        self._buffer += self._reader.read_lines(data)
        self._execute_due()

    def close(self) -> None:
        """Handle a disconnection; completely received commands are still executed."""
        if self._open:
            self._open = False
            self._firmware.handle_disconnect(self)

    # From the controller

    @property
    def is_serial(self) -> bool:
        return self._serial

    @property
    def supply(self) -> PowerSupply:
        return self._firmware.supply

    @property
    def is_open(self) -> bool:
        return self._open

    @property
    def is_empty(self) -> bool:
        """Return whether no command waits."""
        return not self._buffer and self._timer is None

    def send_reply(self, text: str) -> None:
        """Send one reply."""
        if self._open:
            self._send(self._firmware.frame_reply(text, serial=self._serial))

    def delay_next(self, duration_ns: int) -> None:
        self._asleep_ns = self._firmware.time.now_ns() + duration_ns

    def discard_waiting(self) -> None:
        """Clear the command buffer (L1409)."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._buffer.clear()
        self._asleep_ns = 0

    def discard_commands(self) -> None:
        """Discard all received bytes."""
        self.discard_waiting()
        self._reader.discard_partial()

    def close_from_controller(self) -> None:
        """Close the connection from the controller's side."""
        self.discard_commands()
        if self._open:
            self._open = False
            self._closed()

    # Execution, command by command

    def _execute_due(self) -> None:
        """Execute the commands that are due; the others wait."""
        if self._working or self._timer is not None:
            return
        self._working = True
        while self._buffer and self._timer is None:
            time = self._firmware.time
            now_ns = time.now_ns()
            due_ns = max(now_ns, self._asleep_ns) + self._firmware.delay_ns()
            if due_ns > now_ns:
                self._timer = time.call_at(due_ns, self._handle_due)
            else:
                self._firmware.execute_line(self, self._buffer.popleft())
        self._working = False
        if not self._open and self.is_empty:
            self._firmware.handle_disconnect(self)

    def _handle_due(self) -> None:
        self._timer = None
        self._working = True
        self._firmware.execute_line(self, self._buffer.popleft())
        self._working = False
        self._execute_due()
