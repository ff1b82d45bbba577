"""A daisy chain of SMC-2000: each unit's port 2 wired to port 1 of the next, the host on port 1 of the first (L937)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from orchestrator.clock.base import Clock
from orchestrator.link.supply import Supply
from sim.core.controller import Connection, LimitSwitch, Motion, PortRefused, Send
from sim.yaskawa.base.options import MAIN_BAUD
from sim.yaskawa.controller import Controller, refused

PORT = "serial"
UNIT = 100
"""Inputs and outputs of the unit with address A are numbered from A*100 + 1 on."""


class Chain:
    """Units behind one byte port; fulfils `SimulatedController`.

    Axes are named by the unit's address and the make's letter (`0X`, `1Y`). Each unit hands on what comes from the
    host while it is switched on and `CC` has made its port 2 part of the chain; both directions cost `hop_ns` a unit.
    """

    def __init__(self, clock: Clock, units: Sequence[Controller], hop_ns: int) -> None:
        self._clock = clock
        self.units = tuple(units)
        self._hop_ns = hop_ns
        self._by_address = {unit.machine.address: unit for unit in units}
        if len(self._by_address) < len(self.units):
            raise ValueError("chain: two units have the same address")
        self._open = False

    def share_clock(self) -> None:
        """Wire the first unit's sample clock to all others; it counts in those whose `TM` is negative (L975)."""
        for unit in self.units[1:]:
            unit.machine.wire_clock(self.units[0].machine)

    @property
    def ports(self) -> tuple[str, ...]:
        return (PORT,)

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(f"{unit.machine.address}{axis}" for unit in self.units for axis in unit.axes)

    def connect(self, port: str, send: Send, closed: Callable[[], None]) -> Connection:
        """Port 1 of the first unit; raises `PortRefused`."""
        if port != PORT:
            raise PortRefused(f"no port {port!r}; a daisy chain has {PORT}")
        if self._open:
            raise PortRefused("the serial port is in use")
        if not self.units[0].machine.powered:
            raise PortRefused("the first controller of the chain is switched off")
        self._open = True

        def hung_up() -> None:
            self._open = False
            closed()

        return ChainConnection(self, send, hung_up)

    def released(self) -> None:
        """The host's connection has ended."""
        self._open = False

    def passes(self, place: int) -> bool:
        """Whether the unit at `place` hands on bytes: both ways, at the baud rate of the next unit's port 1."""
        machine = self.units[place].machine
        baud, _, chained, _ = machine.second_line
        return machine.powered and chained == 1 and baud == MAIN_BAUD

    def after_hops(self, hops: int, deliver: Callable[[], None]) -> None:
        """Call `deliver` when bytes have come through so many units."""
        if hops and self._hop_ns:
            self._clock.call_at_ns(self._clock.now_ns() + hops * self._hop_ns, deliver)
        else:
            deliver()

    def now_ns(self) -> int:
        return self._clock.now_ns()

    # The physical world

    def set_power(self, on: bool) -> None:
        """All units at once; `units` has each of them."""
        for unit in self.units:
            unit.set_power(on)

    def set_input(self, number: int, level: bool) -> None:
        """Input of one unit: A*100 + its number there."""
        unit, local = self._point(number)
        unit.set_input(local, level)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        unit, letter = self._axis(axis)
        unit.set_limit(letter, which)

    def set_stalled(self, axis: str, stalled: bool) -> None:
        unit, letter = self._axis(axis)
        unit.set_stalled(letter, stalled)

    def push(self, axis: str, counts: int) -> None:
        unit, letter = self._axis(axis)
        unit.push(letter, counts)

    def output(self, number: int) -> bool:
        unit, local = self._point(number)
        return unit.output(local)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        for unit in self.units:
            base = unit.machine.address * UNIT
            unit.on_output(lambda number, level, base=base: listener(base + number, level))

    # The truth

    def position(self, axis: str) -> float:
        unit, letter = self._axis(axis)
        return unit.position(letter)

    def place(self, axis: str) -> float:
        unit, letter = self._axis(axis)
        return unit.place(letter)

    def velocity(self, axis: str) -> float:
        unit, letter = self._axis(axis)
        return unit.velocity(letter)

    def moving(self, axis: str) -> bool:
        unit, letter = self._axis(axis)
        return unit.moving(letter)

    def at_rest(self) -> bool:
        return all(unit.at_rest() for unit in self.units)

    @property
    def motions(self) -> Sequence[Motion]:
        """All units' motions in order of start, axes by their names in the chain."""
        found = [
            replace(motion, axis=f"{unit.machine.address}{motion.axis}")
            for unit in self.units
            for motion in unit.motions
        ]
        return sorted(found, key=lambda motion: motion.start_ns)

    def _axis(self, name: str) -> tuple[Controller, str]:
        return self._by_address[int(name[:1])], name[1:]

    def _point(self, number: int) -> tuple[Controller, int]:
        address, local = divmod(number, UNIT)
        unit = self._by_address.get(address)
        if unit is None:
            raise ValueError(f"{number}: no unit of the chain has the address {address}")
        return unit, local


@dataclass(slots=True)
class _Open:
    """Port 1 of one unit."""

    connection: Connection | None


class ChainConnection:
    """The host's end of the wire."""

    def __init__(self, chain: Chain, send: Send, closed: Callable[[], None]) -> None:
        self._chain = chain
        self._send = send
        self._closed = closed
        self._live = True
        self._spoke = 0
        """The place of the unit that has answered last."""
        self.supply = Supply()
        self._ends = [_Open(None) for _ in chain.units]
        for place in range(len(chain.units)):
            self._plug(place)

    def receive(self, data: bytes) -> None:
        """Bytes go through the chain command by command, so that units take them in the order of the wire."""
        start = 0
        for index, byte in enumerate(data):
            if byte in b"\r;":
                self._enter(0, data[start : index + 1])
                start = index + 1
        if start < len(data):
            self._enter(0, data[start:])

    def close(self) -> None:
        self._live = False
        self._chain.released()
        for end in self._ends:
            if end.connection is not None:
                end.connection.close()

    def _plug(self, place: int) -> None:
        unit = self._chain.units[place]

        def gone() -> None:
            self._ends[place].connection = None
            if place <= self._spoke:
                self.supply.switched(False, self._chain.now_ns())
            if place == 0 and self._live:
                self.close()
                self._closed()

        if unit.machine.powered:
            self._ends[place].connection = unit.connect(PORT, lambda data: self._leave(place, data), gone)

    def _enter(self, place: int, data: bytes) -> None:
        """Bytes reach port 1 of the unit at `place`; a unit switched on again is on the wire as before."""
        if not self._live:
            return
        if self._ends[place].connection is None:
            self._plug(place)
        connection = self._ends[place].connection
        handed_on = self._chain.passes(place)
        if connection is not None:
            connection.receive(data)
        if handed_on and place + 1 < len(self._ends):
            self._chain.after_hops(1, lambda: self._enter(place + 1, data))

    def _leave(self, place: int, data: bytes) -> None:
        """Bytes leave port 1 of the unit at `place` for the host."""
        if self._live and all(self._chain.passes(before) for before in range(place)):
            self._spoke = place
            self._chain.after_hops(place, lambda: self._deliver(data))

    def _deliver(self, data: bytes) -> None:
        if self._live:
            self._send(data)


class ChainBench:
    """Implements `VectorBench`."""

    def __init__(self, chain: Chain) -> None:
        self._chain = chain

    @property
    def controller(self) -> Chain:
        return self._chain

    @property
    def port(self) -> str:
        return PORT

    def refused(self, reply: bytes) -> bool:
        return refused(reply)

    def given(self, truth: Mapping[str, object]) -> None:
        """No vector of a chain has a physical truth."""
        if truth:
            raise ValueError(f"no truth can be given of a daisy chain, found {', '.join(truth)}")
