"""One connection: its command buffer, the pace at which commands are executed, and its replies."""

from collections import deque
from collections.abc import Callable
from typing import Protocol

from orchestrator.clock.base import Timer
from orchestrator.link.supply import Supply
from sim.core.controller import Send
from sim.core.devicetime import DeviceTime
from sim.ppsmc.line import CommandLine, LineReader


class Firmware(Protocol):
    """What a connection needs of the unit behind it."""

    @property
    def time(self) -> DeviceTime: ...

    @property
    def supply(self) -> Supply: ...

    @property
    def listening(self) -> bool:
        """Whether anybody reads the line."""
        ...

    def delay_ns(self) -> int:
        """Decoding time of the next command."""
        ...

    def execute(self, port: "Port", line: CommandLine) -> None: ...

    def framed(self, text: str, serial: bool) -> bytes: ...

    def left(self, port: "Port") -> None:
        """The other side has gone, and perhaps commands of it still wait."""
        ...


class Port:
    """One open connection. Commands of one connection are executed in order, one at a time."""

    def __init__(self, firmware: Firmware, send: Send, closed: Callable[[], None], serial: bool, limit: int) -> None:
        self._firmware = firmware
        self._send = send
        self._closed = closed
        self._serial = serial
        self._reader = LineReader(limit)
        self._buffer: deque[CommandLine] = deque()
        self._open = True
        self._timer: Timer | None = None
        self._asleep_ns = 0
        """Device time until which a sleep holds the next command back."""
        self._working = False

    # From outside

    def receive(self, data: bytes) -> None:
        if not self._open or not self._firmware.listening:
            return
        self._buffer += self._reader.lines(data)
        self._work()

    def close(self) -> None:
        """The other side has gone; what it has sent completely is still carried out."""
        if self._open:
            self._open = False
            self._firmware.left(self)

    # From the unit

    @property
    def serial(self) -> bool:
        return self._serial

    @property
    def supply(self) -> Supply:
        return self._firmware.supply

    @property
    def open(self) -> bool:
        return self._open

    @property
    def empty(self) -> bool:
        """Whether no command waits."""
        return not self._buffer and self._timer is None

    def say(self, text: str) -> None:
        """Send one reply."""
        if self._open:
            self._send(self._firmware.framed(text, self._serial))

    def sleep(self, duration_ns: int) -> None:
        self._asleep_ns = self._firmware.time.now_ns() + duration_ns

    def drop_waiting(self) -> None:
        """The command buffer is cleared (L1409)."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._buffer.clear()
        self._asleep_ns = 0

    def drop_commands(self) -> None:
        """Whatever has been heard is gone."""
        self.drop_waiting()
        self._reader.clear()

    def hang_up(self) -> None:
        """The unit ends the connection."""
        self.drop_commands()
        if self._open:
            self._open = False
            self._closed()

    # Command by command

    def _work(self) -> None:
        """Execute what is due; the rest waits for its time."""
        if self._working or self._timer is not None:
            return
        self._working = True
        while self._buffer and self._timer is None:
            time = self._firmware.time
            now_ns = time.now_ns()
            due_ns = max(now_ns, self._asleep_ns) + self._firmware.delay_ns()
            if due_ns > now_ns:
                self._timer = time.call_at(due_ns, self._due)
            else:
                self._firmware.execute(self, self._buffer.popleft())
        self._working = False
        if not self._open and self.empty:
            self._firmware.left(self)

    def _due(self) -> None:
        self._timer = None
        self._working = True
        self._firmware.execute(self, self._buffer.popleft())
        self._working = False
        self._work()
