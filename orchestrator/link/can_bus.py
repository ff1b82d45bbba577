"""A CAN bus in memory, for virtual time and for live simulators: bit times with stuffing, arbitration, errors, bus-off.

Every node is a CAN controller of its own with its error counters (ISO 11898-1). Frames that are ready when the bus
becomes free arbitrate by their identifiers; the winner takes as long as its own bits do, stuff bits included.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from random import Random
from typing import Literal

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.link.can import (
    ERROR_BUS_OFF,
    ERROR_NO_ACKNOWLEDGE,
    ERROR_ON_BUS,
    ERROR_PASSIVE,
    ERROR_RESTARTED,
    FIXED_BITS,
    INTERMISSION_BITS,
    STUFFED_BITS,
    STUFFED_BITS_EXTENDED,
    CanFrame,
)

NodeState = Literal["active", "passive", "off"]

PASSIVE_FROM = 128
OFF_FROM = 256
SUSPENDED_BITS = 8
"""An error-passive node leaves the bus to others for this long after it has sent."""
ERROR_FRAME_BITS = 6 + 6 + 8
"""Error flag, its echo by the others, delimiter."""
RECOVERY_BITS = 128 * 11
_POLYNOMIAL = 0x4599


def _crc_table() -> list[int]:
    table: list[int] = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = crc << 1 ^ (_POLYNOMIAL if crc & 0x4000 else 0)
        table.append(crc & 0x7FFF)
    return table


_CRC = _crc_table()
_RUN = re.compile("0+|1+")


@lru_cache(maxsize=8192)
def exact_bits(frame: CanFrame) -> int:
    """Bits of `frame` on the bus with its actual stuff bits, and the intermission after it."""
    bits = stuffable_bits(frame)
    stuff_bits = carry = 0
    for run in _RUN.findall(bits):
        # The bit that is stuffed after five equal ones is the first of the next run.
        length = len(run) + carry
        stuff_bits += length // 5
        carry = length % 5 == 0
    return len(bits) + stuff_bits + FIXED_BITS


def stuffable_bits(frame: CanFrame) -> str:
    """Start of frame to the end of the CRC, as zeros and ones."""
    length = len(frame.data)
    if frame.extended:
        word = (frame.id >> 18) << 20 | 0b11 << 18 | frame.id & 0x3FFFF
        word, width = (word << 1 | frame.rtr) << 6 | length, STUFFED_BITS_EXTENDED - 15
    else:
        word, width = (frame.id << 1 | frame.rtr) << 6 | length, STUFFED_BITS - 15
    if not frame.rtr:
        word, width = word << 8 * length | int.from_bytes(frame.data, "big"), width + 8 * length
    crc = 0
    # Leading zeros change nothing: the CRC begins with 0.
    for byte in word.to_bytes((width + 7) // 8, "big"):
        crc = crc << 8 & 0x7FFF ^ _CRC[crc >> 7 ^ byte]
    return f"{word << 15 | crc:0{width + 15}b}"


def _arbitration_rank(frame: CanFrame) -> int:
    """The bits that arbitrate, as a number: the lowest wins."""
    if frame.extended:
        return (frame.id >> 18) << 21 | 0b11 << 19 | (frame.id & 0x3FFFF) << 1 | frame.rtr
    return frame.id << 21 | frame.rtr << 20


@dataclass(slots=True, eq=False)
class CanNode:
    """One CAN controller on the bus. Made by `MemoryCanBus.attach_node`.

    by_identifier: the waiting frame with the lowest identifier is sent first, not the oldest. accepts: identifiers
    that pass its acceptance filter; None: all.
    """

    _bus: "MemoryCanBus"
    receive: Callable[[CanFrame], None]
    on_error: Callable[[int], None]
    bitrate: int
    by_identifier: bool
    connected: bool = True
    transmit_errors: int = 0
    receive_errors: int = 0
    off: bool = False
    waiting: list[CanFrame] = field(default_factory=list[CanFrame])
    silent_until_ns: int = 0
    parked: bool = False
    accepts: frozenset[int] | None = None

    @property
    def node_state(self) -> NodeState:
        if self.off:
            return "off"
        return "passive" if max(self.transmit_errors, self.receive_errors) >= PASSIVE_FROM else "active"

    @property
    def is_active(self) -> bool:
        """Whether it takes part in the traffic on the bus."""
        return self.connected and not self.off and self.bitrate == self._bus.bitrate

    def queue_frames(self, *frames: CanFrame) -> None:
        """Queue frames. A node that is switched off, or in bus-off, sends nothing, now or later."""
        if self.connected and not self.off:
            self.waiting.extend(frames)
            self._bus.schedule_start()

    def next_frame(self) -> CanFrame:
        """The waiting frame that is sent next."""
        return min(self.waiting, key=_arbitration_rank) if self.by_identifier else self.waiting[0]

    def set_connected(self, *, connected: bool) -> None:
        """Switch the node on, with its counters at 0 and nothing to send, or off. A frame that it sends just then is
        destroyed."""
        self.connected, self.off = connected, False
        self.discard_frames()
        if connected:
            self._bus.retry_frames()

    def leave_bus_off(self) -> None:
        """Leave bus-off, after as many idle bits as the standard demands. Waiting frames have been discarded."""
        if self.off:
            self.waiting.clear()
            bus = self._bus
            bus.schedule_call(RECOVERY_BITS * bus.bit_ns, self._rejoin_bus)

    def _rejoin_bus(self) -> None:
        if self.off and self.connected:
            self.off = False
            self.discard_frames()
            self._bus.retry_frames()
            self.on_error(ERROR_RESTARTED)

    def discard_frames(self) -> None:
        self.transmit_errors = self.receive_errors = 0
        self.waiting.clear()
        self.parked = False

    # Notifications from the bus

    def count_errors(self, transmit: int = 0, receive: int = 0) -> None:
        """Add to the error counters; report a change of the node's state."""
        state_before = self.node_state
        self.transmit_errors = max(0, self.transmit_errors + transmit)
        # A receiver that has been passive is nearly so after its first good frame.
        most = PASSIVE_FROM - 1 if receive < 0 else OFF_FROM
        self.receive_errors = max(0, min(self.receive_errors, most) + receive)
        if self.transmit_errors >= OFF_FROM:
            self.off = True
            self.waiting.clear()
            self.on_error(ERROR_BUS_OFF)
        elif self.node_state != state_before:
            self.on_error(ERROR_PASSIVE)


def _ignore_error(trouble: int) -> None:
    del trouble


class MemoryCanBus:
    """One bus. bitrate: bits/s. error_rate: probability that a frame is destroyed. seed: of the random errors."""

    def __init__(self, clock: Clock, bitrate: int, seed: int = 0, error_rate: float = 0.0) -> None:
        self.clock = clock
        self.bitrate = bitrate
        self.error_rate = error_rate
        self.cut = False
        """The wire is broken next to every node: no node receives another."""
        self.busy_ns = 0
        """Total time of frames and error frames on the bus since it was made, intermissions included."""
        self.frames = 0
        """Number of frames sent since it was made."""
        self._nodes: list[CanNode] = []
        self._listeners: list[Callable[[CanFrame, int, int], None]] = []
        self._draw = Random(seed)
        self._disturbed = 0
        self._free_ns = 0
        self._sending = False
        self._starts_ns: int | None = None

    @property
    def bit_ns(self) -> float:
        return NS_PER_S / self.bitrate

    def attach_node(
        self,
        receive: Callable[[CanFrame], None],
        on_error: Callable[[int], None] = _ignore_error,
        *,
        bitrate: int | None = None,
        by_identifier: bool = False,
    ) -> CanNode:
        """Attach a further node. receive: called with frames of others, at their end. trouble: called with `ERROR_…`
        of this node."""
        node = CanNode(self, receive, on_error, bitrate or self.bitrate, by_identifier)
        self._nodes.append(node)
        self.retry_frames()
        return node

    def detach_node(self, node: CanNode) -> None:
        """Unplug it for good."""
        node.set_connected(connected=False)
        self._nodes.remove(node)

    def add_listener(self, listener: Callable[[CanFrame, int, int], None]) -> None:
        """Call `listener(frame, begin_ns, end_ns)` for every frame that was sent."""
        self._listeners.append(listener)

    def disturb_frames(self, frames: int) -> None:
        """Destroy the next `frames` frames, repetitions included."""
        self._disturbed += frames

    def schedule_call(self, duration_ns: float, callback: Callable[[], None]) -> None:
        self.clock.call_at_ns(self.clock.now_ns() + round(duration_ns), callback)

    def retry_frames(self) -> None:
        """A node has appeared that may acknowledge: retry frames that were given up."""
        for node in self._nodes:
            node.parked = False
        self.schedule_start()

    def schedule_start(self) -> None:
        """Make sure that the next frame starts when it can."""
        if self._sending:
            return
        ready = [node for node in self._nodes if node.waiting and not node.parked]
        if not ready:
            return
        at_ns = max(self.clock.now_ns(), self._free_ns, min(node.silent_until_ns for node in ready))
        if self._starts_ns is None or at_ns < self._starts_ns:
            self._starts_ns = at_ns
            self.clock.call_at_ns(at_ns, lambda: self._start_frame(at_ns))

    def _start_frame(self, planned_ns: int) -> None:
        if self._sending or self._starts_ns != planned_ns:
            return
        self._starts_ns = None
        now_ns = self.clock.now_ns()
        ready = [n for n in self._nodes if n.waiting and not n.parked and n.silent_until_ns <= now_ns]
        if not ready:
            self.schedule_start()
            return
        heads = [(_arbitration_rank(frame), node, frame) for node in ready for frame in (node.next_frame(),)]
        least, _, frame = heads[0] if len(heads) == 1 else min(heads, key=lambda head: head[0])
        same_nodes = [(node, head) for rank, node, head in heads if rank == least]
        senders = [node for node, _ in same_nodes]
        begin_ns = planned_ns
        self._sending = True
        is_acknowledged = self._is_acknowledged(senders)
        spoilt = any(head != frame or not node.is_active for node, head in same_nodes) or self._is_disturbed()
        bits = exact_bits(frame)
        if spoilt:
            bits = self._draw.randint(1, bits - INTERMISSION_BITS) + ERROR_FRAME_BITS + INTERMISSION_BITS
        elif not is_acknowledged:
            bits += ERROR_FRAME_BITS
        self._free_ns = begin_ns + round(bits * self.bit_ns)
        self.busy_ns += self._free_ns - begin_ns
        # Receivers take a frame at its end, before the intermission.
        end_ns = self._free_ns - round(INTERMISSION_BITS * self.bit_ns)

        def end_frame() -> None:
            self._sending = False
            if spoilt or any(frame not in node.waiting for node in senders):
                self._handle_destroyed(senders)
            elif not is_acknowledged:
                self._handle_unacknowledged(senders)
            else:
                self._deliver_frame(senders, frame, begin_ns, end_ns)
            self.schedule_start()

        self.clock.call_at_ns(end_ns, end_frame)

    def _is_acknowledged(self, senders: list[CanNode]) -> bool:
        return not self.cut and any(node.is_active for node in self._nodes if node not in senders)

    def _is_disturbed(self) -> bool:
        if self._disturbed:
            self._disturbed -= 1
            return True
        return bool(self.error_rate) and self._draw.random() < self.error_rate

    def _deliver_frame(self, senders: list[CanNode], frame: CanFrame, begin_ns: int, end_ns: int) -> None:
        self.frames += 1
        for node in senders:
            node.waiting.remove(frame)
            if node.transmit_errors:
                node.count_errors(transmit=-1)
            self._suspend_node(node)
        for listener in self._listeners:
            listener(frame, begin_ns, end_ns)
        for node in [listener for listener in self._nodes if listener.is_active and listener not in senders]:
            if node.receive_errors:
                node.count_errors(receive=-1)
            if node.accepts is None or frame.id in node.accepts:
                node.receive(frame)

    def _handle_destroyed(self, senders: list[CanNode]) -> None:
        for node in list(self._nodes):
            if node in senders:
                node.on_error(ERROR_ON_BUS)
                node.count_errors(transmit=8)
                self._suspend_node(node)
            elif node.is_active:
                node.count_errors(receive=1)

    def _handle_unacknowledged(self, senders: list[CanNode]) -> None:
        for node in senders:
            if node.node_state == "active":
                node.count_errors(transmit=8)
            elif not self._is_acknowledged(senders):
                # A passive node retries for ever without counting, and nothing on the bus changes by it. A node that
                # has appeared during this frame acknowledges the next one.
                node.parked = True
                node.on_error(ERROR_NO_ACKNOWLEDGE)
            self._suspend_node(node)

    def _suspend_node(self, node: CanNode) -> None:
        if node.node_state == "passive":
            node.silent_until_ns = self._free_ns + round(SUSPENDED_BITS * self.bit_ns)
