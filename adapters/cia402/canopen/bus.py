"""One CAN bus with its drives: opened once; received frames are dispatched to their nodes.

The networks of python-can and canopen read in threads, which cannot run in virtual time; this module implements the
part of CANopen that a master needs, over the project's own links.
"""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from typing import Protocol

from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import LinkClosed, OpenLink
from orchestrator.link.can import ERROR_BUS_OFF, ERROR_RESTARTED, CanFrame, CanLink

SHARED = "cia402 bus"
"""The key of the bus in `DriverSetup.shared`."""

# Function codes of the predefined connection set (CiA 301), to be added to the node number.
EMCY = 0x080
TPDO = (0x180, 0x280, 0x380, 0x480)
RPDO = (0x200, 0x300, 0x400, 0x500)
SDO_ANSWER = 0x580
SDO_REQUEST = 0x600
HEARTBEAT = 0x700
_NODE = 0x7F

SYNC = CanFrame(0x080)
OPERATIONAL = 0x05
"""The NMT state in a heartbeat."""
_BEATS = 4  # within the watchdog time
NMT_START, NMT_STOP, NMT_PRE_OPERATIONAL, NMT_RESET = 0x01, 0x02, 0x80, 0x81


class BusNode(Protocol):
    """A node as the bus sees it."""

    def handle_frame(self, function: int, frame: CanFrame, at_ns: int) -> None:
        """Handle a frame of the node. function: its identifier without the node number."""
        ...

    def handle_bus_off(self, *, off: bool) -> None:
        """Handle that this computer has left the bus, or has returned to it."""
        ...

    def handle_link_loss(self, error: LinkClosed) -> None:
        """Handle a closed link."""
        ...


class Cia402Bus:
    """One bus. Created before any loop runs; every drive of it joins when its driver is created."""

    def __init__(self, clock: Clock, bitrate: int) -> None:
        self.bitrate = bitrate
        self.is_off = False
        self.clock = clock
        self.units: dict[int, int] = {}
        self.periods_ms: dict[int, int] = {}
        """SYNC periods that drives following positions require, by node: all equal, because one SYNC serves all."""
        self.switching: set[int] = set()
        """Drives whose outputs travel with the positions that are streamed to them."""
        self.watchdogs_ms: dict[int, int] = {}
        """Watchdog times of drives that monitor this computer's heartbeat, by node."""
        self.host_node = 0
        self._can: CanLink | None = None
        self._opening = asyncio.Lock()
        self._reading: asyncio.Task[None] | None = None
        self._beating: asyncio.Task[None] | None = None
        self._nodes: dict[int, BusNode] = {}
        self._pending_stops: dict[int, tuple[CanFrame, ...]] = {}

    def register_drive(self, node: int, start_ns: int) -> None:
        """Register a drive of the bus. start_ns: its usual time from SYNC to motion."""
        self.units[node] = start_ns

    @property
    def start_ns(self) -> int:
        """The common time from SYNC to motion of the bus: the median of its drives."""
        return (min(self.units.values()) + max(self.units.values())) // 2

    # Link

    async def attach_node(self, node: int, bus_node: BusNode, open_link: OpenLink) -> None:
        """Open the link if necessary, and dispatch frames to `node` from now on. Raises `LinkRefused`."""
        async with self._opening:
            if self._can is None:
                self._can = CanLink(await open_link(), self.bitrate)
                self.is_off = False
                # Stops of an earlier link would stop a later motion.
                self._pending_stops.clear()
                self._reading = asyncio.get_running_loop().create_task(self._read_frames(self._can))
                if self.watchdogs_ms:
                    self._beating = asyncio.get_running_loop().create_task(self._send_heartbeats(self._can))
            self._nodes[node] = bus_node

    async def detach_node(self, node: int, bus_node: BusNode) -> None:
        """Detach a drive; the link is closed after the last one."""
        async with self._opening:
            if self._nodes.get(node) is bus_node:
                del self._nodes[node]
                self._pending_stops.pop(node, None)
            can = self._can
            if not self._nodes and can is not None:
                self._can = None
                for task in (self._reading, self._beating):
                    if task is not None:
                        task.cancel()
                await can.close()

    @property
    def can_link(self) -> CanLink:
        """The open link; raises `LinkClosed`."""
        if self._can is None:
            raise LinkClosed("the CAN link is closed")
        return self._can

    # Transmission

    def send_frames(self, *frames: CanFrame) -> int:
        """Pass frames to the CAN controller; return the host time. Raises `LinkClosed`."""
        return self.can_link.send_frames(*frames)

    def send_stop(self, node: int, frames: Sequence[CanFrame]) -> int:
        """Like `send_frames`; frames that a CAN controller discards while it is off the bus are repeated when it
        returns."""
        if self.is_off:
            self._pending_stops[node] = tuple(frames)
        return self.can_link.send_frames(*frames)

    async def _send_heartbeats(self, can: CanLink) -> None:
        """Send the heartbeat of this computer, often enough for the shortest watchdog of a drive to tolerate losses."""
        every_ns = min(self.watchdogs_ms.values()) * NS_PER_MS // _BEATS
        with suppress(LinkClosed):
            while True:
                can.send_frames(CanFrame(HEARTBEAT + self.host_node, bytes([OPERATIONAL])))
                await sleep_ns(self.clock, every_ns)

    # Reception

    async def _read_frames(self, can: CanLink) -> None:
        try:
            while True:
                arrival = await can.read_frame()
                if arrival.frame.error:
                    self._handle_bus_state(arrival.frame.id)
                elif not arrival.frame.extended and not arrival.frame.rtr:
                    self._dispatch_frame(arrival.frame, arrival.at_ns)
        except LinkClosed as error:
            self._handle_link_loss(can, error)
        except ValueError as error:
            # The frame boundaries are lost.
            self._handle_link_loss(can, LinkClosed(f"{can.endpoint}: the received data are not CAN frames: {error}"))
            await can.close()

    def _handle_link_loss(self, can: CanLink, error: LinkClosed) -> None:
        if self._can is can:
            self._can = None
            hearers, self._nodes = self._nodes, {}
            for hearer in hearers.values():
                hearer.handle_link_loss(error)

    def _dispatch_frame(self, frame: CanFrame, at_ns: int) -> None:
        hearer = self._nodes.get(frame.id & _NODE)
        if hearer is not None:
            hearer.handle_frame(frame.id & ~_NODE, frame, at_ns)

    def _handle_bus_state(self, what: int) -> None:
        if what & ERROR_BUS_OFF:
            self.is_off = True
        elif what & ERROR_RESTARTED:
            self.is_off = False
            pending, self._pending_stops = self._pending_stops, {}
            for frames in pending.values():
                self.can_link.send_frames(*frames)
        else:
            return
        for hearer in list(self._nodes.values()):
            hearer.handle_bus_off(off=self.is_off)
