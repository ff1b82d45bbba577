"""Ethernet beyond the hosts: devices that a controller itself connects to, and its exchanges with them.

L1789-L1898, L5851-L5946, L9738-L9783. A network joins simulated controllers, and anything else with the same
interface, by IP address; without a network no device answers, and a handle stays in the state of connecting.
"""

import re
from collections.abc import Callable
from functools import partial
from typing import Protocol

from orchestrator.clock.base import ClockTimer
from sim.core.controller import PortConnection, PortRefused, SendBytes
from sim.yaskawa.base import fixed
from sim.yaskawa.base.timebase import ServoTimebase

UDP, TCP = 1, 2
CONNECTING, MASTER = {UDP: -5, TCP: -6}, {UDP: -1, TCP: -2}
"""Values of `_IHh2` (L5884-L5890)."""
WAITING, ACCEPTED, REFUSED, TIMED_OUT = 1, 2, 3, 4
"""Values of `_IHh4` (L5918-L5924)."""
RETRIES = 4
"""Retry times of `IA<t` after which the wait for an answer ends."""
FIELDS = 8
_NUMBER = re.compile(r"\$[0-9A-F]+(?:\.[0-9A-F]+)?|-?\d+(?:\.\d+)?")


class NetworkDevice(Protocol):
    """A connectable device: a simulated controller, a host, an I/O device."""

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> PortConnection:
        """Open a port. Raises `PortRefused`."""
        ...


class DeviceNetwork:
    """Devices by IP address, as the signed 32-bit number of `_IA0`.

    latency_ns: each way."""

    def __init__(self, latency_ns: int = 0) -> None:
        self.latency_ns = latency_ns
        self.places: dict[int, NetworkDevice] = {}


class HandleSet(Protocol):
    """Ethernet handles of the controller."""

    @property
    def outgoing(self) -> "dict[str, PeerHandle]":
        """Handles that the controller has opened itself."""
        ...

    def handle_connection_loss(self, handle: str) -> None:
        """Handle a TCP connection lost without action of the controller."""
        ...


class NetworkHost(Protocol):
    """The machine as its outgoing connections see it."""

    @property
    def network(self) -> DeviceNetwork | None:
        """Ethernet network that it is connected to."""
        ...

    @property
    def ports(self) -> HandleSet: ...

    @property
    def timebase(self) -> ServoTimebase: ...

    retry_time: int
    """`IA<t`, samples."""

    def refuse_command(self, code: int) -> None:
        """Store the code that `TC` reports."""
        ...

    def advance_to_now(self) -> None:
        """Advance to the present before an access from outside."""
        ...

    def run_ready(self) -> None:
        """Run all that is ready, then schedule the next sample with an event."""
        ...


class PeerHandle:
    """A handle that the controller has opened itself."""

    def __init__(self, machine: NetworkHost, handle: str, address: int, number: int, kind: int) -> None:
        self.machine = machine
        self.handle = handle
        self.address = address
        self.number = number
        """Port number of the remote end."""
        self.kind = kind
        self.send_state = 0
        """State of the last SA."""
        self.fields: list[int] = []
        """Values received in its reply."""
        self._line: PortConnection | None = None
        self._received = b""
        self._timer: ClockTimer | None = None
        self._taken: Callable[[bytes], bool] | None = None
        """Receives the answer to a Modbus packet; returns whether it is complete."""

    @property
    def handle_state(self) -> int:
        """`_IHh2`."""
        return (CONNECTING if self._line is None else MASTER)[self.kind]

    @property
    def is_unresolved(self) -> int:
        """`_IHh3`: 1 while no device has answered for the address."""
        return int(self._line is None)

    def open_handle(self) -> None:
        """Resolve the address, and connect (L5934)."""
        network = self.machine.network
        if network is not None:
            self._call_later(self._connect_port)

    def _connect_port(self) -> None:
        network = self.machine.network
        server = network.places.get(self.address) if network is not None else None
        if server is None or self.machine.ports.outgoing.get(self.handle) is not self:
            self.machine.refuse_command(125)
            return
        try:
            self._line = server.connect(
                "tcp" if self.kind == TCP else "udp",
                partial(self._call_later, self._receive_bytes),
                self.handle_disconnect,
            )
        except PortRefused:
            self.machine.refuse_command(120)
        self.machine.run_ready()

    def _call_later(self, call: Callable[..., None], *args: bytes) -> None:
        network = self.machine.network
        latency_ns = network.latency_ns if network is not None else 0
        if not latency_ns:
            call(*args)
            return
        clock = self.machine.timebase.clock
        clock.call_at_ns(clock.now_ns() + latency_ns, partial(call, *args))

    # Data exchange

    def send_bytes(self, data: bytes) -> None:
        """Send; the data is lost while it is not connected."""
        if self._line is not None:
            self._call_later(self._line.receive_bytes, data)

    def send_command(self, command: str) -> None:
        """`SA`: send a command to another controller (L9743)."""
        self.send_state, self.fields, self._received, self._taken = WAITING, [], b"", None
        self._schedule_timeout()
        self.send_bytes(f"{command}\r".encode("latin-1"))

    def send_packet(self, packet: bytes, taken: Callable[[bytes], bool]) -> None:
        """Send a Modbus packet; `taken` receives the data so far."""
        self.send_state, self._received, self._taken = WAITING, b"", taken
        self._schedule_timeout()
        self.send_bytes(packet)

    def _schedule_timeout(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        timebase = self.machine.timebase
        due_ns = timebase.true_ns(timebase.current_sample() + RETRIES * self.machine.retry_time)
        self._timer = timebase.clock.call_at_ns(due_ns, self._handle_timeout)

    def _handle_timeout(self) -> None:
        self._timer = None
        self._finish_exchange(TIMED_OUT)

    def _receive_bytes(self, data: bytes) -> None:
        if self.send_state != WAITING:
            return
        self._received += data
        if self._taken is not None:
            if self._taken(self._received):
                self._finish_exchange(ACCEPTED)
        elif self._received[-1:] in (b":", b"?"):
            values = _NUMBER.findall(self._received[:-1].decode("latin-1"))
            self.fields = [_parse_value(text) for text in values[:FIELDS]]
            self._finish_exchange(ACCEPTED if self._received.endswith(b":") else REFUSED)

    def _finish_exchange(self, state: int) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self.send_state == WAITING:
            self.send_state = state
            self.machine.advance_to_now()
            self.machine.run_ready()

    # End of the connection

    def close_handle(self) -> None:
        """`IHh=>-1`, `IHh=>-2`, power off."""
        line, self._line = self._line, None
        self._finish_exchange(TIMED_OUT)
        if line is not None:
            self._call_later(line.close)

    def handle_disconnect(self) -> None:
        """Handle a disconnection by the remote end: the handle is free, and #TCPERR is called (L4774)."""
        machine = self.machine
        machine.advance_to_now()
        self._line = None
        if machine.ports.outgoing.get(self.handle) is self:
            del machine.ports.outgoing[self.handle]
            machine.ports.handle_connection_loss(self.handle)
        self._finish_exchange(TIMED_OUT)
        machine.run_ready()


def _parse_value(text: str) -> int:
    negative = text.startswith("-")
    raw = fixed.parse_literal(text.removeprefix("-"))
    return -raw if negative else raw
