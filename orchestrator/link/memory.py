"""Links in memory that model a wire, for virtual time: character times, latency and its tail, USB receive delay.

Bytes in flight belong to the wire: they arrive even if their sender has died meanwhile, and they are delivered in
the receiver's own context, so that a frozen receiver takes them only when it is resumed.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from contextvars import Context
from dataclasses import dataclass, field
from functools import partial
from random import Random
from typing import Protocol

from orchestrator.clock.base import Clock, sleep_until_ns
from orchestrator.clock.virtual import VirtualClock
from orchestrator.link.base import Link, LinkClosed, LinkRefused, ReceivedBytes
from orchestrator.link.supply import NEVER_NS, PowerSupply

PIECE_CHARACTERS = 62  # characters of a serial line that are received together, as many as a USB adapter's packet holds


class FarConnection(Protocol):
    """The controller's end of an open link."""

    @property
    def supply(self) -> PowerSupply: ...

    def receive_bytes(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class WireLink(Link, Protocol):
    """A link in memory."""

    def hang_up(self) -> None:
        """Close at once; the kernel does this for a process that died."""
        ...


class LinkAcceptor(Protocol):
    """A controller that accepts links."""

    def connect(self, port: str, send: Callable[[bytes], None], closed: Callable[[], None]) -> FarConnection: ...


@dataclass(frozen=True, slots=True)
class WireModel:
    """The timing of a wire, in ns.

    char_ns: one character, 10 bits at the baud rate (0: Ethernet). latency_ns + uniform jitter_ns each way; with
    probability tail_chance up to tail_ns more. hold_ns: a receive delay of 0 to this much (a USB adapter's
    free-running latency timer, controller to host only).
    """

    char_ns: int = 0
    latency_ns: int = 100_000
    jitter_ns: int = 100_000
    tail_chance: float = 0.001
    tail_ns: int = 5_000_000
    hold_ns: int = 0


LAN = WireModel()
DEFAULT_JITTER_NS = 1_000_000  # jitter that adapters assume for a line, unless configured (`wire_jitter_us`)
START_RELEVANT_NS = 300_000_000  # of the lines before a start, any may be what starts it, or delay the one that does


def serial_wire(baud: int, bits: int = 10, hold_ns: int = 0) -> WireModel:
    """A serial line: `bits` per character including start, parity and stop."""
    char_ns = bits * 1_000_000_000 // baud
    return WireModel(char_ns=char_ns, latency_ns=20_000, jitter_ns=80_000, tail_chance=0.0005, hold_ns=hold_ns)


def can_wire(hold_ns: int = 0) -> WireModel:
    """From a program to the CAN controller of its computer, and back; the bus itself is at the far end."""
    return WireModel(latency_ns=20_000, jitter_ns=40_000, tail_chance=0.0005, tail_ns=1_000_000, hold_ns=hold_ns)


def split_pieces(data: bytes) -> list[bytes]:
    """Split data into the pieces that a serial line delivers."""
    return [data[begin : begin + PIECE_CHARACTERS] for begin in range(0, len(data), PIECE_CHARACTERS)]


@dataclass(slots=True)
class MemoryWire:
    """The wire to one port of one simulated controller. Faults are injected here, from outside.

    lose_close: the close of a link does not reach the controller, as when a cable is pulled: a half-open connection.
    far_context: the context of the process that the controller lives in. closed_ns: when the close of the last link
    reaches, or has reached, the controller. late_ns: when lines to the controller were written that were delayed
    beyond latency and jitter, by the tail.
    """

    clock: VirtualClock
    model: WireModel
    far: LinkAcceptor
    port: str
    endpoint: str
    far_context: Context
    seed: int = 0
    cut: bool = False
    lose_close: bool = False
    refuse: bool = False
    to_far: Callable[[bytes], bytes] | None = None
    to_near: Callable[[bytes], bytes] | None = None
    links: "list[WireLink]" = field(default_factory=list["WireLink"])
    closed_ns: int = 0
    late_ns: list[int] = field(default_factory=list[int])
    draw: Random = field(init=False)
    _outside: Context = field(init=False, default_factory=Context)

    def __post_init__(self) -> None:
        self.draw = Random(self.seed)

    async def open_link(self, clock: Clock | None = None) -> "WireLink":
        """Open a link from the calling process. Raises `LinkRefused`. clock: that of its computer, for time stamps;
        None: virtual time."""
        if self.refuse:
            raise LinkRefused(f"{self.endpoint}: connection refused; is the controller switched on?")
        if self.closed_ns > self.clock.now_ns():
            # A port can be opened again at once; the last bytes of one connection arrive before the next one begins.
            await sleep_until_ns(self.clock, self.closed_ns)
        link = MemoryLink(self, clock or self.clock)
        opening: asyncio.Future[str | None] = asyncio.get_running_loop().create_future()

        def connect_far() -> None:
            if opening.done():
                return  # given up while the controller's process hung
            try:
                link.connect_far()
            except Exception as error:
                opening.set_result(str(error))
            else:
                opening.set_result(None)

        self.run_far(connect_far)
        reason = await opening
        if reason is not None:
            raise LinkRefused(f"{self.endpoint}: {reason}")
        self.links.append(link)
        return link

    def run_far(self, callback: Callable[[], None]) -> None:
        """Run `callback` in the controller's process, when it runs at all."""
        asyncio.get_running_loop().call_soon(callback, context=self.far_context)

    def schedule_call(self, at_ns: int, callback: Callable[[], None]) -> None:
        """Call `callback` at `at_ns` as an event of the wire, which a hung process does not delay."""
        self.clock.call_at_ns(at_ns, callback, context=self._outside)

    def delayed_start(self, start_ns: int) -> bool:
        """Whether a line that may have affected a start at that instant was late, which no process can detect."""
        return any(start_ns - START_RELEVANT_NS < instant_ns <= start_ns for instant_ns in self.late_ns)

    def delay_ns(self) -> int:
        """One draw of the latency."""
        model = self.model
        delay = model.latency_ns + self.draw.randrange(model.jitter_ns + 1)
        if model.tail_chance and self.draw.random() < model.tail_chance:
            delay += self.draw.randrange(model.tail_ns + 1)
        return delay


class MemoryLink:
    """One open connection over a `MemoryWire`. clock: of its time stamps."""

    def __init__(self, wire: MemoryWire, clock: Clock) -> None:
        self._wire = wire
        self._clock = clock
        self._far: FarConnection | None = None
        self._open = True
        self._received: deque[bytes] = deque()
        self._waiting: asyncio.Future[None] | None = None
        self._out_free_ns = 0
        self._in_free_ns = 0
        self._said_ns = 0
        self._last_far_ns = 0
        self._last_near_ns = 0

    def connect_far(self) -> None:
        """Runs in the controller's process. Raises what the controller raises."""
        self._far = self._wire.far.connect(self._wire.port, self._from_far, self._far_closed)

    @property
    def endpoint(self) -> str:
        return self._wire.endpoint

    @property
    def char_ns(self) -> int:
        return self._wire.model.char_ns

    def fileno(self) -> int:
        return -1

    def record_write(self, at_ns: int, data: bytes) -> None:
        """A link keeps no record of itself; `TracedLink` does."""

    def write(self, data: bytes) -> int:
        wire, now_ns = self._wire, self._wire.clock.now_ns()
        if not self._open:
            raise LinkClosed(f"{wire.endpoint} is closed")
        if wire.to_far is not None:
            data = wire.to_far(data)
        # A command takes effect when its own terminator has arrived, not when the last one of the write has.
        for line in data.splitlines(keepends=True):
            self._out_free_ns = max(self._out_free_ns, now_ns) + len(line) * wire.model.char_ns
            delay_ns = wire.delay_ns()
            if delay_ns > DEFAULT_JITTER_NS:
                wire.late_ns.append(now_ns)
            arrival_ns = max(self._out_free_ns + delay_ns, self._last_far_ns)
            self._last_far_ns = arrival_ns
            wire.schedule_call(arrival_ns, lambda line=line: self._arrive_far(line))
        return self._clock.now_ns()

    def _arrive_far(self, data: bytes) -> None:
        far_end = self._far
        if self._wire.cut or far_end is None:
            return
        arrival = far_end.supply.cut_received(data, self._wire.clock.now_ns(), self._wire.model.char_ns)
        if arrival:
            self._wire.run_far(lambda: far_end.receive_bytes(arrival))

    def _from_far(self, data: bytes) -> None:
        wire, now_ns = self._wire, self._wire.clock.now_ns()
        if wire.to_near is not None:
            data = wire.to_near(data)
        char_ns = wire.model.char_ns
        delay_ns = wire.delay_ns()
        if wire.model.hold_ns:
            delay_ns += wire.draw.randrange(wire.model.hold_ns + 1)
        lost_ns = NEVER_NS if self._far is None else self._far.supply.lost_ns
        if lost_ns >= self._said_ns:
            # Of what was sent before, nothing is still queued, and little is in flight.
            self._in_free_ns = now_ns
            self._last_near_ns = min(self._last_near_ns, lost_ns + PIECE_CHARACTERS * char_ns + delay_ns)
        self._said_ns = now_ns
        for piece in split_pieces(data) if char_ns else (data,):
            ends_ns = self._in_free_ns = max(self._in_free_ns, now_ns) + len(piece) * char_ns
            self._last_near_ns = max(ends_ns + delay_ns, self._last_near_ns)
            wire.schedule_call(self._last_near_ns, partial(self._arrive_near, piece, now_ns, ends_ns))

    def _arrive_near(self, data: bytes, sent_ns: int, ends_ns: int) -> None:
        if self._wire.cut or not self._open:
            return
        if self._far is not None:
            data = self._far.supply.cut_sent(data, sent_ns, ends_ns, self._wire.model.char_ns)
            if not data:
                return
        self._received.append(data)
        self._wake_reader()

    def _far_closed(self) -> None:
        self._wire.schedule_call(self._wire.clock.now_ns() + self._wire.delay_ns(), self._mark_closed)

    def _mark_closed(self) -> None:
        self._open = False
        if self in self._wire.links:
            self._wire.links.remove(self)
        self._wake_reader()

    def _wake_reader(self) -> None:
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)

    async def read(self) -> ReceivedBytes:
        while not self._received:
            if not self._open:
                raise LinkClosed(f"{self._wire.endpoint} is closed")
            self._waiting = asyncio.get_running_loop().create_future()
            try:
                await self._waiting
            finally:
                self._waiting = None
        # A process that was frozen meanwhile gets the bytes when it runs again, as from a socket.
        return ReceivedBytes(self._received.popleft(), self._clock.now_ns())

    async def close(self) -> None:
        self.hang_up()

    def hang_up(self) -> None:
        """Close at once; the kernel does this for a process that died."""
        if not self._open:
            return
        self._mark_closed()
        far_end = self._far
        if far_end is not None and not self._wire.lose_close:
            wire = self._wire
            closed_ns = wire.clock.now_ns() + wire.delay_ns()
            wire.closed_ns = max(wire.closed_ns, closed_ns)
            wire.schedule_call(closed_ns, lambda: wire.run_far(far_end.close))
