"""The computer's own CAN controller on a simulated bus, the far end of a link of kind `can`.

Its bytes are frames as `orchestrator.link.can` writes them. Error frames report its state; after bus-off it restarts by
itself, as SocketCAN does with `restart-ms`.
"""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.can import ERROR_BUS_OFF, CanFrame, FrameReader, encode_frames
from orchestrator.link.can_bus import PASSIVE_FROM, MemoryCanBus
from orchestrator.link.supply import PowerSupply
from sim.core.controller import PortConnection, PortRefused, SendBytes

PORT = "can"
RESTART_NS = 100 * NS_PER_MS

# Values of data[1] of an error frame, from linux/can/error.h.
_NOW_PASSIVE = 0x30
_NOW_ACTIVE = 0x40


class CanCard:
    """One open connection from the computer to the bus; implements `PortConnection`. The computer has power."""

    supply = PowerSupply()

    def __init__(self, bus: MemoryCanBus, send: Callable[[bytes], None]) -> None:
        self._bus = bus
        self._send = send
        self._reader = FrameReader()
        self.node = bus.attach_node(lambda frame: send(encode_frames(frame)), self._report_bus_error)

    def receive_bytes(self, data: bytes) -> None:
        self.node.queue_frames(*(frame for frame in self._reader.add_bytes(data) if not frame.error))

    def close(self) -> None:
        """Close the connection; frames not yet sent are lost."""
        self._bus.detach_node(self.node)

    def _report_bus_error(self, what: int) -> None:
        passive = max(self.node.transmit_errors, self.node.receive_errors) >= PASSIVE_FROM
        state = _NOW_PASSIVE if passive else _NOW_ACTIVE
        counters = [min(255, self.node.transmit_errors), min(255, self.node.receive_errors)]
        self._send(encode_frames(CanFrame(what, bytes([0, state, 0, 0, 0, 0, *counters]), error=True)))
        if what == ERROR_BUS_OFF:
            self._bus.schedule_call(RESTART_NS, self.node.leave_bus_off)


class CanSegment:
    """A bus as the end point of a cable: each connection is one more node on it, a computer's."""

    def __init__(self, bus: MemoryCanBus) -> None:
        self.bus = bus

    @property
    def port_names(self) -> tuple[str, ...]:
        return (PORT,)

    @property
    def segment(self) -> "CanSegment":
        return self

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> PortConnection:
        """Open a node. Raises `PortRefused`. A bus never disconnects."""
        del closed
        if port != PORT:
            raise PortRefused(f"no port {port!r}; a CAN bus has {PORT}")
        return CanCard(self.bus, send)


@runtime_checkable
class CanDevice(Protocol):
    """A device that is reached over a CAN bus."""

    @property
    def segment(self) -> CanSegment: ...
