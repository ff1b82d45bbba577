"""Daisy chain of SMC-2000: each controller's port 2 wired to port 1 of the next, the host on port 1 of the first
(L937)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from orchestrator.clock.base import Clock
from orchestrator.link.supply import PowerSupply
from sim.core.controller import CommandedMotion, LimitSwitch, PortConnection, PortRefused, SendBytes
from sim.yaskawa.base.options import MAIN_BAUD
from sim.yaskawa.machine.controller import YaskawaController, is_refusal

PORT = "serial"
ADDRESS_STRIDE = 100
"""Inputs and outputs of the controller with address A are numbered from A*100 + 1 on."""


class DaisyChain:
    """Controllers on one byte port; implements `SimulatedController`.

    Axes are named by the controller's address and the make's letter (`0X`, `1Y`). Each controller forwards the
    host's bytes while it is switched on and `CC` has made its port 2 part of the chain; both directions cost
    `hop_ns` per controller.
    """

    def __init__(self, clock: Clock, units: Sequence[YaskawaController], hop_ns: int) -> None:
        self._clock = clock
        self.units = tuple(units)
        self._hop_ns = hop_ns
        self._by_address = {unit.machine.address: unit for unit in units}
        if len(self._by_address) < len(self.units):
            raise ValueError("chain: two controllers have the same address; give each its own")
        self._open = False

    def share_clock(self) -> None:
        """Wire the first controller's sample clock to all others; it counts in those whose `TM` is negative (L975)."""
        for unit in self.units[1:]:
            unit.machine.wire_clock(self.units[0].machine)

    @property
    def port_names(self) -> tuple[str, ...]:
        return (PORT,)

    @property
    def axis_names(self) -> tuple[str, ...]:
        return tuple(f"{unit.machine.address}{axis}" for unit in self.units for axis in unit.axis_names)

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> PortConnection:
        """Open port 1 of the first controller; raises `PortRefused`."""
        if port != PORT:
            raise PortRefused(f"no port {port!r}; a daisy chain has {PORT}")
        if self._open:
            raise PortRefused("the serial port is in use; close the other connection first")
        if not self.units[0].machine.powered:
            raise PortRefused("the first controller of the chain is switched off")
        self._open = True

        def hung_up() -> None:
            self._open = False
            closed()

        return ChainConnection(self, send, hung_up)

    def handle_disconnect(self) -> None:
        """Handle the end of the host's connection."""
        self._open = False

    def is_forwarding(self, place: int) -> bool:
        """Return whether the controller at `place` forwards bytes: both ways, at the baud rate of the next one's
        port 1."""
        machine = self.units[place].machine
        baud, _, is_chained, _ = machine.second_line
        return machine.powered and is_chained == 1 and baud == MAIN_BAUD

    def call_after_hops(self, hops: int, deliver: Callable[[], None]) -> None:
        """Call `deliver` when bytes have passed this number of controllers."""
        if hops and self._hop_ns:
            self._clock.call_at_ns(self._clock.now_ns() + hops * self._hop_ns, deliver)
        else:
            deliver()

    def now_ns(self) -> int:
        return self._clock.now_ns()

    # Environment

    def set_power(self, *, on: bool) -> None:
        """Switch all controllers at once; `units` has each of them."""
        for unit in self.units:
            unit.set_power(on=on)

    def set_input(self, number: int, *, level: bool) -> None:
        """Set an input of one controller: A*100 + its number there."""
        unit, local = self._find_point(number)
        unit.set_input(local, level=level)

    def set_analog(self, number: int, volts: float) -> None:
        """Set an analogue input of one controller: A*100 + its number there."""
        unit, local = self._find_point(number)
        unit.set_analog(local, volts)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        unit, letter = self._find_axis(axis)
        unit.set_limit(letter, which)

    def set_stalled(self, axis: str, *, stalled: bool) -> None:
        unit, letter = self._find_axis(axis)
        unit.set_stalled(letter, stalled=stalled)

    def push_axis(self, axis: str, counts: int) -> None:
        unit, letter = self._find_axis(axis)
        unit.push_axis(letter, counts)

    def output_level(self, number: int) -> bool:
        unit, local = self._find_point(number)
        return unit.output_level(local)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        for unit in self.units:
            base = unit.machine.address * ADDRESS_STRIDE
            unit.on_output(lambda number, level, base=base: listener(base + number, level))

    # Ground truth

    def position(self, axis: str) -> float:
        unit, letter = self._find_axis(axis)
        return unit.position(letter)

    def physical_position(self, axis: str) -> float:
        unit, letter = self._find_axis(axis)
        return unit.physical_position(letter)

    def velocity(self, axis: str) -> float:
        unit, letter = self._find_axis(axis)
        return unit.velocity(letter)

    def is_moving(self, axis: str) -> bool:
        unit, letter = self._find_axis(axis)
        return unit.is_moving(letter)

    def at_rest(self) -> bool:
        return all(unit.at_rest() for unit in self.units)

    @property
    def commanded_motions(self) -> Sequence[CommandedMotion]:
        """Motions of all controllers in order of start, axes by their names in the chain."""
        texts = [
            replace(motion, axis=f"{unit.machine.address}{motion.axis}")
            for unit in self.units
            for motion in unit.commanded_motions
        ]
        return sorted(texts, key=lambda motion: motion.start_ns)

    def _find_axis(self, name: str) -> tuple[YaskawaController, str]:
        return self._by_address[int(name[:1])], name[1:]

    def _find_point(self, number: int) -> tuple[YaskawaController, int]:
        address, local = divmod(number, ADDRESS_STRIDE)
        unit = self._by_address.get(address)
        if unit is None:
            raise ValueError(f"{number}: no controller of the chain has the address {address}")
        return unit, local


@dataclass(slots=True)
class _OpenPort:
    """Port 1 of one controller."""

    connection: PortConnection | None


class ChainConnection:
    """The host's end of the serial line."""

    def __init__(self, chain: DaisyChain, send: SendBytes, closed: Callable[[], None]) -> None:
        self._chain = chain
        self._send = send
        self._closed = closed
        self._live = True
        self._spoke = 0
        """The place of the controller that has answered last."""
        self.supply = PowerSupply()
        self._ends = [_OpenPort(None) for _ in chain.units]
        for number in range(len(chain.units)):
            self._plug_in(number)

    def receive_bytes(self, data: bytes) -> None:
        """Send bytes through the chain command by command, so that the controllers take them in order."""
        start = 0
        for index, byte in enumerate(data):
            if byte in b"\r;":
                self._deliver_to_port(0, data[start : index + 1])
                start = index + 1
        if start < len(data):
            self._deliver_to_port(0, data[start:])

    def close(self) -> None:
        self._live = False
        self._chain.handle_disconnect()
        for end in self._ends:
            if end.connection is not None:
                end.connection.close()

    def _plug_in(self, place: int) -> None:
        unit = self._chain.units[place]

        def handle_disconnect() -> None:
            self._ends[place].connection = None
            if place <= self._spoke:
                self.supply.set_power(on=False, at_ns=self._chain.now_ns())
            if place == 0 and self._live:
                self.close()
                self._closed()

        if unit.machine.powered:
            self._ends[place].connection = unit.connect(
                PORT, lambda data: self._forward_to_host(place, data), handle_disconnect
            )

    def _deliver_to_port(self, place: int, data: bytes) -> None:
        """Deliver bytes to port 1 of the controller at `place`; a controller switched on again is connected as
        before."""
        if not self._live:
            return
        if self._ends[place].connection is None:
            self._plug_in(place)
        connection = self._ends[place].connection
        handed_on = self._chain.is_forwarding(place)
        if connection is not None:
            connection.receive_bytes(data)
        if handed_on and place + 1 < len(self._ends):
            self._chain.call_after_hops(1, lambda: self._deliver_to_port(place + 1, data))

    def _forward_to_host(self, place: int, data: bytes) -> None:
        """Send bytes from port 1 of the controller at `place` to the host."""
        if self._live and all(self._chain.is_forwarding(previous) for previous in range(place)):
            self._spoke = place
            self._chain.call_after_hops(place, lambda: self._send_to_host(data))

    def _send_to_host(self, data: bytes) -> None:
        if self._live:
            self._send(data)


class ChainBench:
    """Implements `VectorBench`."""

    def __init__(self, chain: DaisyChain) -> None:
        self._chain = chain

    @property
    def controller(self) -> DaisyChain:
        return self._chain

    @property
    def port_name(self) -> str:
        return PORT

    def is_refusal(self, reply: bytes) -> bool:
        return is_refusal(reply)

    def apply_given(self, state: Mapping[str, object]) -> None:
        """Raise `ValueError`: no vector of a chain has a ground truth."""
        if state:
            raise ValueError(f"a daisy chain accepts no ground truth, found {', '.join(state)}")
