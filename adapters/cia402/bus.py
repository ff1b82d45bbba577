"""One CAN bus with the drives on it: opened once, frames handed to the node that they are from.

python-can's and canopen's own networks read in threads, which have no place in virtual time; this is the little of
CANopen that a master needs, over the project's own links.
"""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from typing import Protocol

from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import LinkClosed, OpenLink
from orchestrator.link.can import ERROR_BUS_OFF, ERROR_RESTARTED, CanFrame, CanLink

SHARED = "cia402 bus"
"""Where the drivers of one bus find it in `Setup.shared`."""

# Function codes of the predefined connection set (CiA 301), to be added to the node's number.
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
_BEATS = 4  # within the time of a watchdog
NMT_START, NMT_STOP, NMT_PRE_OPERATIONAL, NMT_RESET = 0x01, 0x02, 0x80, 0x81


class Hearer(Protocol):
    """A node as the bus knows it."""

    def hear(self, function: int, frame: CanFrame, at_ns: int) -> None:
        """A frame of the node. function: its identifier without the node's number."""
        ...

    def bus_off(self, off: bool) -> None:
        """This computer has left the bus, or is back on it."""
        ...

    def lost(self, error: LinkClosed) -> None:
        """The link is closed."""
        ...


class Bus:
    """One bus. Made before any loop runs; every drive of it joins when its driver is built."""

    def __init__(self, clock: Clock, bitrate: int) -> None:
        self.bitrate = bitrate
        self.off = False
        self.clock = clock
        self.units: dict[int, int] = {}
        self.periods_ms: dict[int, int] = {}
        """Of SYNC, as its drives that follow positions want it, by node: all the same, because one SYNC is for all."""
        self.watchdogs_ms: dict[int, int] = {}
        """Of drives that watch this computer's heartbeat, by node."""
        self.host_node = 0
        self._can: CanLink | None = None
        self._opening = asyncio.Lock()
        self._reading: asyncio.Task[None] | None = None
        self._beating: asyncio.Task[None] | None = None
        self._hearers: dict[int, Hearer] = {}
        self._owed: dict[int, tuple[CanFrame, ...]] = {}

    def join(self, node: int, start_ns: int) -> None:
        """A drive of the bus is known. start_ns: its usual time from SYNC to motion."""
        self.units[node] = start_ns

    @property
    def start_ns(self) -> int:
        """The usual time from SYNC to motion that the drives of the bus agree on: the middle of theirs."""
        return (min(self.units.values()) + max(self.units.values())) // 2

    # The link

    async def attach(self, node: int, hearer: Hearer, open_link: OpenLink) -> None:
        """See to it that the link is open, and hear `node` from now on. Raises `LinkRefused`."""
        async with self._opening:
            if self._can is None:
                self._can = CanLink(await open_link(), self.bitrate)
                self.off = False
                self._reading = asyncio.get_running_loop().create_task(self._read(self._can))
                if self.watchdogs_ms:
                    self._beating = asyncio.get_running_loop().create_task(self._beat(self._can))
            self._hearers[node] = hearer

    async def detach(self, node: int, hearer: Hearer) -> None:
        """A drive is left; the link is closed after the last one."""
        async with self._opening:
            if self._hearers.get(node) is hearer:
                del self._hearers[node]
            can = self._can
            if not self._hearers and can is not None:
                self._can = None
                for task in (self._reading, self._beating):
                    if task is not None:
                        task.cancel()
                await can.close()

    @property
    def can(self) -> CanLink:
        """The open link; raises `LinkClosed`."""
        if self._can is None:
            raise LinkClosed("the CAN link is closed")
        return self._can

    # Speaking

    def send(self, *frames: CanFrame) -> int:
        """Hand frames to the CAN controller; host time. Raises `LinkClosed`."""
        return self.can.send(*frames)

    def send_stop(self, node: int, frames: Sequence[CanFrame]) -> int:
        """Like `send`; what a CAN controller that is off the bus throws away is said again when it is back."""
        if self.off:
            self._owed[node] = tuple(frames)
        return self.can.send(*frames)

    async def _beat(self, can: CanLink) -> None:
        """The heartbeat of this computer, often enough for the least patient drive to miss some."""
        every_ns = min(self.watchdogs_ms.values()) * NS_PER_MS // _BEATS
        with suppress(LinkClosed):
            while True:
                can.send(CanFrame(HEARTBEAT + self.host_node, bytes([OPERATIONAL])))
                await sleep_ns(self.clock, every_ns)

    # Hearing

    async def _read(self, can: CanLink) -> None:
        try:
            while True:
                received = await can.read()
                if received.frame.error:
                    self._trouble(received.frame.id)
                elif not received.frame.extended and not received.frame.rtr:
                    self._take(received.frame, received.at_ns)
        except LinkClosed as error:
            self._lost(can, error)
        except ValueError as error:
            # Frames can not be told from each other any more.
            self._lost(can, LinkClosed(f"{can.place}: what comes is no CAN frames: {error}"))
            await can.close()

    def _lost(self, can: CanLink, error: LinkClosed) -> None:
        if self._can is can:
            self._can = None
            hearers, self._hearers = self._hearers, {}
            for hearer in hearers.values():
                hearer.lost(error)

    def _take(self, frame: CanFrame, at_ns: int) -> None:
        hearer = self._hearers.get(frame.id & _NODE)
        if hearer is not None:
            hearer.hear(frame.id & ~_NODE, frame, at_ns)

    def _trouble(self, what: int) -> None:
        if what & ERROR_BUS_OFF:
            self.off = True
        elif what & ERROR_RESTARTED:
            self.off = False
            owed, self._owed = self._owed, {}
            for frames in owed.values():
                self.can.send(*frames)
        else:
            return
        for hearer in list(self._hearers.values()):
            hearer.bus_off(self.off)
