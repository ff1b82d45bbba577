"""Ethernet beyond the hosts: devices that a controller itself connects to, and what it has under way with them.

L1789-L1898, L5851-L5946, L9738-L9783. A network joins simulated controllers, and anything else with the same face,
by IP address; without one nobody answers, and a handle stays in the state of connecting.
"""

import re
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Protocol

from orchestrator.clock.base import Timer
from sim.core.controller import Connection, PortRefused, Send
from sim.yaskawa.base import fixed

if TYPE_CHECKING:
    from sim.yaskawa.machine import Machine

UDP, TCP = 1, 2
CONNECTING, MASTER = {UDP: -5, TCP: -6}, {UDP: -1, TCP: -2}
"""What `_IHh2` tells (L5884-L5890)."""
WAITING, ACCEPTED, REFUSED, TIMED_OUT = 1, 2, 3, 4
"""What `_IHh4` tells (L5918-L5924)."""
RETRIES = 4
"""Retry times of `IA<t` after which an answer is given up."""
FIELDS = 8
_NUMBER = re.compile(r"\$[0-9A-F]+(?:\.[0-9A-F]+)?|-?\d+(?:\.\d+)?")


class Place(Protocol):
    """Something that can be connected to: a simulated controller, a host, an I/O device."""

    def connect(self, port: str, send: Send, closed: Callable[[], None]) -> Connection:
        """Raises `PortRefused`."""
        ...


class Network:
    """Who is at which IP address, as the signed 32-bit number of `_IA0`. latency_ns: each way."""

    def __init__(self, latency_ns: int = 0) -> None:
        self.latency_ns = latency_ns
        self.places: dict[int, Place] = {}


class Peer:
    """A handle that the controller has opened itself."""

    def __init__(self, machine: "Machine", handle: str, address: int, number: int, kind: int) -> None:
        self.machine = machine
        self.handle = handle
        self.address = address
        self.number = number
        """Port of the other side."""
        self.kind = kind
        self.asked = 0
        """State of the last SA."""
        self.fields: list[int] = []
        """What it has brought."""
        self._line: Connection | None = None
        self._heard = b""
        self._timer: Timer | None = None
        self._taken: Callable[[bytes], bool] | None = None
        """Takes what has come in answer to a Modbus packet; whether that is all of it."""

    @property
    def state(self) -> int:
        """`_IHh2`."""
        return (CONNECTING if self._line is None else MASTER)[self.kind]

    @property
    def unresolved(self) -> int:
        """`_IHh3`: 1 while nobody has answered for the address."""
        return int(self._line is None)

    def open(self) -> None:
        """Look for the address, and connect (L5934)."""
        network = self.machine.network
        if network is not None:
            self._later(self._connect)

    def _connect(self) -> None:
        network = self.machine.network
        place = network.places.get(self.address) if network is not None else None
        if place is None or self.machine.ports.outgoing.get(self.handle) is not self:
            self.machine.fail(125)
            return
        try:
            self._line = place.connect(
                "tcp" if self.kind == TCP else "udp", partial(self._later, self._take), self.lost
            )
        except PortRefused:
            self.machine.fail(120)
        self.machine.go_on()

    def _later(self, call: Callable[..., None], *args: bytes) -> None:
        network = self.machine.network
        latency_ns = network.latency_ns if network is not None else 0
        if not latency_ns:
            call(*args)
            return
        clock = self.machine.timebase.clock
        clock.call_at_ns(clock.now_ns() + latency_ns, partial(call, *args))

    # What is said

    def send(self, data: bytes) -> None:
        """Lost while it is not connected."""
        if self._line is not None:
            self._later(self._line.receive, data)

    def ask(self, command: str) -> None:
        """`SA`: a command for another controller (L9743)."""
        self.asked, self.fields, self._heard, self._taken = WAITING, [], b"", None
        self._give_up_later()
        self.send(f"{command}\r".encode("latin-1"))

    def exchange(self, packet: bytes, taken: Callable[[bytes], bool]) -> None:
        """A Modbus packet; `taken` gets what has come so far."""
        self.asked, self._heard, self._taken = WAITING, b"", taken
        self._give_up_later()
        self.send(packet)

    def _give_up_later(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        timebase = self.machine.timebase
        due_ns = timebase.true_ns(timebase.sample() + RETRIES * self.machine.retry_time)
        self._timer = timebase.clock.call_at_ns(due_ns, self._give_up)

    def _give_up(self) -> None:
        self._timer = None
        self._done(TIMED_OUT)

    def _take(self, data: bytes) -> None:
        if self.asked != WAITING:
            return
        self._heard += data
        if self._taken is not None:
            if self._taken(self._heard):
                self._done(ACCEPTED)
        elif self._heard[-1:] in (b":", b"?"):
            told = _NUMBER.findall(self._heard[:-1].decode("latin-1"))
            self.fields = [_value(text) for text in told[:FIELDS]]
            self._done(ACCEPTED if self._heard.endswith(b":") else REFUSED)

    def _done(self, state: int) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self.asked == WAITING:
            self.asked = state
            self.machine.look()
            self.machine.go_on()

    # The end

    def close(self) -> None:
        """`IHh=>-1`, `IHh=>-2`, power off."""
        line, self._line = self._line, None
        self._done(TIMED_OUT)
        if line is not None:
            self._later(line.close)

    def lost(self) -> None:
        """The other side has ended the connection: the handle is free, and #TCPERR is called (L4774)."""
        machine = self.machine
        machine.look()
        self._line = None
        if machine.ports.outgoing.get(self.handle) is self:
            del machine.ports.outgoing[self.handle]
            machine.ports.connection_lost(self.handle)
        self._done(TIMED_OUT)
        machine.go_on()


def _value(text: str) -> int:
    negative = text.startswith("-")
    raw = fixed.literal(text.removeprefix("-"))
    return -raw if negative else raw
