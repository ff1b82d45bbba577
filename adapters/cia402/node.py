"""One drive on the bus as the adapter knows it: its state as it says by itself, and the orders that it was given."""

import asyncio
from collections.abc import Callable
from typing import NamedTuple

from adapters.cia402 import states
from adapters.cia402.bus import EMCY, HEARTBEAT, RPDO, SDO_ANSWER, TPDO, Bus
from adapters.cia402.objects import (
    ACCELERATION,
    ACTUAL,
    CONTROLWORD,
    DECELERATION,
    DEMAND,
    INPUTS,
    MODE,
    MODE_DISPLAY,
    OUTPUTS,
    PROFILE_VELOCITY,
    STATUSWORD,
    TARGET,
    VELOCITY,
    Obj,
)
from adapters.cia402.sdo import SdoClient, bus_off
from adapters.cia402.states import State, state_of
from adapters.cia402.words import emergency_text
from adapters.contract import CannotDo
from orchestrator.clock.base import Clock
from orchestrator.link.base import LinkClosed
from orchestrator.link.can import CanFrame

_BOOT_UP = 0x00


class Answer(NamedTuple):
    """What a drive has said to a SYNC: its statusword, and its demanded position when the SYNC came."""

    at_ns: int
    status: int
    demand: int


class Node:
    """State and orders of one drive, while a connection lasts. Positions in counts."""

    def __init__(self, bus: Bus, number: int, name: str, answer_ns: int, *, outputs: bool) -> None:
        self.bus = bus
        self.number = number
        self.name = name
        self.answer_ns = answer_ns
        self.sdo = SdoClient(bus, number, name, answer_ns)
        self.has_outputs = outputs
        self.followed: Obj | None = None
        """The object of the positions that are streamed to it; None: none are, so RPDO 4 carries its ramps."""
        self.answer = Answer(0, 0, 0)
        """To the last SYNC, of a drive that follows positions."""
        self.status = self.mode = 0
        self.demand = self.actual = self.velocity = self.inputs = 0
        self.control = self.wanted_mode = self.outputs = 0
        self.mapped = False
        """Its PDOs are as the adapter wants them."""
        self.loaded = False
        """A controlword waits in it for a SYNC."""
        self.stops = 0
        self.drops = 0
        """How often it has left operation enabled, by its own word."""
        self.boots = 0
        self.left_bus = 0
        """How often this computer has left the bus."""
        self.emergencies: dict[int, str] = {}
        self.heard_ns = self.state_ns = self.moved_ns = self.acknowledged_ns = 0
        self.nmt = _BOOT_UP
        """Its NMT state, as its last heartbeat told."""
        self.beat_ns = 0
        self._watchers: list[asyncio.Future[None]] = []
        self._closed: LinkClosed | None = None

    @property
    def clock(self) -> Clock:
        return self.bus.clock

    @property
    def state(self) -> State:
        return state_of(self.status)

    @property
    def enabled(self) -> bool:
        return self.state is State.ENABLED

    # What it says

    def hear(self, function: int, frame: CanFrame, at_ns: int) -> None:
        data = frame.data
        self.heard_ns = at_ns
        if function == SDO_ANSWER:
            self.sdo.hear(data, at_ns)
        elif function == TPDO[0] and len(data) == STATUSWORD.size + MODE_DISPLAY.size:
            self.take_status(STATUSWORD.decode(data), at_ns)
            self.mode = MODE_DISPLAY.decode(data[2:])
        elif function == TPDO[1] and len(data) == DEMAND.size + ACTUAL.size:
            demand = DEMAND.decode(data)
            if demand != self.demand:
                self.moved_ns = at_ns
            self.demand, self.actual, self.state_ns = demand, ACTUAL.decode(data[4:]), at_ns
        elif function == TPDO[2] and len(data) == INPUTS.size + VELOCITY.size:
            self.inputs, self.velocity = INPUTS.decode(data), VELOCITY.decode(data[4:])
        elif function == TPDO[3] and len(data) == STATUSWORD.size + DEMAND.size:
            # It may have waited for the bus longer than what the others say: it is no news of the present state.
            self.answer = Answer(at_ns, STATUSWORD.decode(data), DEMAND.decode(data[2:]))
        elif function == EMCY and len(data) == 8:
            self._emergency(int.from_bytes(data[:2], "little"))
        elif function == HEARTBEAT and len(data) == 1:
            self._beat(data[0], at_ns)
        self._wake()

    def take_status(self, status: int, at_ns: int) -> None:
        """A statusword, from wherever it comes."""
        if status & states.ACKNOWLEDGED and not self.status & states.ACKNOWLEDGED:
            self.acknowledged_ns = at_ns
        enabled = self.enabled
        self.status = status
        self.drops += enabled and not self.enabled

    def _emergency(self, code: int) -> None:
        if code == 0:
            self.emergencies.clear()
        else:
            self.emergencies[code] = emergency_text(code)

    def _beat(self, state: int, at_ns: int) -> None:
        if state == _BOOT_UP:
            self._booted()
        self.nmt, self.beat_ns = state, at_ns

    def _booted(self) -> None:
        """It was switched off and on: it has forgotten everything, its PDOs first."""
        self.boots += 1
        self.drops += self.enabled
        self.mapped = self.loaded = False
        self.control = self.wanted_mode = self.outputs = self.status = 0
        self.emergencies.clear()

    def bus_off(self, off: bool) -> None:
        if off:
            self.left_bus += 1
            self.sdo.fail(bus_off(self.name))
        self._wake()

    def lost(self, error: LinkClosed) -> None:
        self._closed = error
        self.sdo.fail(error)
        self._wake()

    def _wake(self) -> None:
        for watcher in self._watchers:
            if not watcher.done():
                watcher.set_result(None)

    def wake(self) -> None:
        """Whoever waits looks again."""
        self._wake()

    async def until(self, condition: Callable[[], bool], until_ns: int) -> bool:
        """Wait until `condition` holds, at most until that instant; whether it does. Raises `LinkClosed`."""
        while True:
            if self._closed is not None:
                raise self._closed
            if condition():
                return True
            if self.clock.now_ns() >= until_ns:
                return False
            watcher: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._watchers.append(watcher)

            def late(watcher: "asyncio.Future[None]" = watcher) -> None:
                if not watcher.done():
                    watcher.set_result(None)

            timer = self.clock.call_at_ns(until_ns, late)
            try:
                await watcher
            finally:
                timer.cancel()
                self._watchers.remove(watcher)

    async def look(self) -> None:
        """Ask for its statusword. Raises `DriverFault` when it does not answer."""
        self.take_status(await self.sdo.read(STATUSWORD), self.clock.now_ns())
        self._wake()

    async def soon(self, condition: Callable[[], bool]) -> bool:
        """`until` for what a drive does at once."""
        return await self.until(condition, self.clock.now_ns() + self.answer_ns)

    # What it is told

    def order(self, control: int, mode: int | None = None) -> None:
        """Give it a controlword, taken at once. Raises `LinkClosed`."""
        self.bus.send(*self.orders(control, mode))

    def orders(self, control: int, mode: int | None = None) -> list[CanFrame]:
        """The frames of `order`. What waits for a SYNC is overwritten, too, so that it asks for nothing else."""
        self.control = control
        if mode is not None:
            self.wanted_mode = mode
        now = CONTROLWORD.encode(control) + MODE.encode(self.wanted_mode) + self._switched()
        frames = [CanFrame(RPDO[1] + self.number, now)]
        return [self.at_sync(control), *frames] if self.loaded else frames

    def at_sync(self, control: int, outputs: int | None = None) -> CanFrame:
        """A controlword that is taken with the next SYNC; with outputs, where some are named."""
        return CanFrame(RPDO[0] + self.number, CONTROLWORD.encode(control) + self._switched(outputs))

    async def set_point(self, target: int, velocity: int, acceleration: int, deceleration: int) -> None:
        """Give it a target with its profile, all in the drive's units; it is gone to when a controlword says so.

        Raises as `SdoClient.write`.
        """
        number = self.number
        goal = CanFrame(RPDO[2] + number, TARGET.encode(target) + PROFILE_VELOCITY.encode(velocity))
        if self.followed is None:
            ramps = CanFrame(RPDO[3] + number, ACCELERATION.encode(acceleration) + DECELERATION.encode(deceleration))
            self.bus.send(goal, ramps)
        else:
            await self.sdo.write(ACCELERATION, acceleration)
            await self.sdo.write(DECELERATION, deceleration)
            self.bus.send(goal)

    def position(self, counts: int) -> CanFrame:
        """A position of a stream, taken with the next SYNC."""
        assert self.followed is not None
        return CanFrame(RPDO[3] + self.number, self.followed.encode(counts))

    def _switched(self, outputs: int | None = None) -> bytes:
        if not self.has_outputs:
            return b""
        return OUTPUTS.encode(self.outputs if outputs is None else outputs)

    # Judging it

    def require_well(self) -> None:
        """Raises `CannotDo` when it has a fault, or can not be reached."""
        if self.bus.off:
            fault = bus_off(self.name).fault
            raise CannotDo(fault.code, fault.text, fault.remedy)
        if self.state in (State.FAULT, State.REACTION):
            raise CannotDo("fault", f"{self.name} has a fault: {self.why()}", "clear it with `tutti reset`")

    def why(self) -> str:
        """What is wrong, by its emergency messages."""
        return "; ".join(self.emergencies.values()) or "it has not said which"
