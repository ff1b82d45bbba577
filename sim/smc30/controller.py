"""One SMC30, or a bus of up to seven, behind one serial line, and the world around them."""

import random
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_S, Clock, Timer
from orchestrator.link.supply import Supply
from sim.core.controller import LimitSwitch, Motion, PortRefused, Send, Timing
from sim.core.devicetime import DeviceTime
from sim.core.oscillator import Oscillator
from sim.smc30.framing import Received, StringReader, checksum, odd_parity
from sim.smc30.inputs import ANALOGUE_INPUTS, USER_INPUTS
from sim.smc30.options import Options, UnitOptions
from sim.smc30.outputs import USER_OUTPUTS
from sim.smc30.unit import Unit

STOP_INPUT = 4
"""Number of the Stop input for `set_input`; true: pulled to ground."""
_PORT = "serial"
_BITS_PER_CHARACTER = 10
_PLACE = 10


@dataclass(frozen=True, slots=True)
class _Pending:
    """A string being decoded."""

    received: Received
    timer: Timer


@dataclass(frozen=True, slots=True)
class _Sent:
    """A reply on the shared line, in true time."""

    begin_ns: int
    end_ns: int
    station: "Station"
    data: bytes


@dataclass(frozen=True, slots=True)
class Place:
    """One unit of a line, and what is its own. axis: its name. record: where its motions are kept."""

    options: UnitOptions
    oscillator: Oscillator
    timing: Timing
    generator: random.Random
    axis: str
    record: list[Motion]


class Station:
    """A unit on the line: what it hears, how long its firmware takes, what it says."""

    def __init__(self, clock: Clock, place: Place, bus: "Smc30Controller") -> None:
        options = place.options
        self._clock = clock
        self._bus = bus
        self._timing = place.timing
        self._generator = place.generator
        self._checksum = options.checksum
        self.address = options.address
        self._reader = StringReader(options.address, options.checksum, options.line_limit, bus.options.parity)
        self._pending: deque[_Pending] = deque()
        self._busy_until_ns = 0
        self._supply = Supply()
        self.record = place.record
        time = DeviceTime(clock, place.oscillator)
        poll_phase = self._generator.random() if options.input_poll_ms else 0.0
        self.unit = Unit(time, options, place.axis, place.record, self._say, poll_phase)

    @property
    def decoding(self) -> bool:
        return bool(self._pending)

    def hear(self, data: bytes) -> None:
        """Bytes on the line; a unit without power hears nothing."""
        if not self.unit.on:
            return
        for received in self._reader.feed(self._supply.heard(data, self._clock.now_ns(), self._bus.character_ns)):
            delay_ns = self._timing.decode_ns
            if self._timing.spread_ns:
                delay_ns += self._generator.randint(0, self._timing.spread_ns)
            if not delay_ns and not self._pending:
                self.unit.take(received)
            else:
                self._busy_until_ns = max(self._clock.now_ns(), self._busy_until_ns) + delay_ns
                timer = self._clock.call_at_ns(self._busy_until_ns, self._decoded)
                self._pending.append(_Pending(received, timer))

    def _decoded(self) -> None:
        self.unit.take(self._pending.popleft().received)

    def _say(self, text: str) -> None:
        data = text.encode("ascii")
        if self._checksum:
            data += bytes((checksum(data),))
        self._bus.transmit(self, data + b"\r")

    def set_power(self, on: bool) -> None:
        if on == self.unit.on:
            return
        if on:
            self._supply.switched(on, self._clock.now_ns())
            self.unit.power_up()
            return
        for pending in self._pending:
            pending.timer.cancel()
        self._pending.clear()
        self._busy_until_ns = 0
        self._reader.clear()
        self.unit.power_down()
        self._bus.fell_silent(self)


class Port:
    """The other end of the serial line."""

    def __init__(self, bus: "Smc30Controller", send: Send) -> None:
        self._bus = bus
        self.send = send
        self.supply = Supply()

    def receive(self, data: bytes) -> None:
        self._bus.received(self, data)

    def close(self) -> None:
        self._bus.closed(self)


class Smc30Controller:
    """The units by place on the bus, 1-7; a unit alone has place 1.

    Axes are named by place. User inputs and outputs are numbered 10 * place + 1-3, and those of place 1 also 1-3;
    the Stop input is 10 * place + 4, true when pulled to ground.
    """

    def __init__(self, clock: Clock, options: Options, places: Sequence[Place]) -> None:
        self._clock = clock
        self.options = options
        self._port: Port | None = None
        self._arrived: deque[bytes] = deque()
        """Bytes being heard, and behind them those that came meanwhile."""
        self._last: _Sent | None = None
        self._spoke: Station | None = None
        """Who has begun to send last."""
        self.character_ns = _BITS_PER_CHARACTER * NS_PER_S // options.baud
        self._numbers_by_place = len(places) > 1
        self._listeners: list[Callable[[int, bool], None]] = []
        self._stations = [Station(clock, place, self) for place in places]
        for number, station in enumerate(self._stations, start=1):
            station.unit.outputs.listeners.append(self._relay(number))

    # The wire

    @property
    def ports(self) -> tuple[str, ...]:
        return (_PORT,)

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(station.unit.axis for station in self._stations)

    @property
    def stations(self) -> Sequence[Station]:
        """The units in the order of their places."""
        return self._stations

    def connect(self, port: str, send: Send, closed: Callable[[], None]) -> Port:
        """Take the other end of the line, in place of whoever had it. It does not hang up: `closed` is not called."""
        del closed
        if port != _PORT:
            raise PortRefused(f"no port {port!r}; there is {_PORT!r}")
        self._port = Port(self, send)
        return self._port

    def closed(self, port: Port) -> None:
        if self._port is port:
            self._port = None

    def received(self, port: Port, data: bytes) -> None:
        """Every unit sees every byte, in order even if an answer makes the other end send more at once."""
        if port is not self._port:
            return
        self._arrived.append(data)
        if len(self._arrived) > 1:
            return
        while self._arrived:
            for station in self._stations:
                station.hear(self._arrived[0])
            self._arrived.popleft()

    def transmit(self, station: Station, data: bytes) -> None:
        """A unit begins to send. Two units with one address drive the line together and garble each other.

        What the earlier one has sent can not be taken back: the later one's characters come out mixed with it. Units
        with different addresses do so only with the option, as it takes wires that need time like real ones.
        """
        if len(self._stations) > 1:
            data = self._mixed(station, data)
        self._spoke = station
        if self._port is not None:
            self._port.send(odd_parity(data) if self.options.parity == "wire" else data)

    def fell_silent(self, station: Station) -> None:
        """A unit has lost its power, perhaps while it was sending."""
        if self._port is not None and self._spoke is station:
            self._port.supply.switched(False, self._clock.now_ns())

    def _mixed(self, station: Station, data: bytes) -> bytes:
        now_ns, last = self._clock.now_ns(), self._last
        end_ns = now_ns + len(data) * self.character_ns
        self._last = _Sent(now_ns, end_ns, station, data)
        if last is None or last.station is station or now_ns >= last.end_ns:
            return data
        if last.station.address != station.address and self.options.collisions == "same_address":
            return data
        under = last.data[(now_ns - last.begin_ns) // self.character_ns :].ljust(len(data), b"\x7f")
        return bytes(one & other for one, other in zip(data, under, strict=False))

    # The world

    def set_power(self, on: bool) -> None:
        """All units; the wire stays."""
        for station in self._stations:
            station.set_power(on)

    def set_unit_power(self, axis: str, on: bool) -> None:
        """One unit of the bus."""
        self._station(axis).set_power(on)

    def set_input(self, number: int, level: bool) -> None:
        place, own = self._numbered(number)
        unit = self._stations[place - 1].unit
        if own == STOP_INPUT:
            unit.hold(level)
        elif 1 <= own <= USER_INPUTS:
            unit.inputs.set_user(own, level)
        else:
            raise ValueError(
                f"no input {number}; a unit has user inputs 1-{USER_INPUTS} and the Stop input {STOP_INPUT}"
            )

    def set_volts(self, number: int, volts: float) -> None:
        """Voltage at an analogue input, numbered like the user inputs, 1-6 of a place."""
        place, own = self._numbered(number)
        if not 1 <= own <= ANALOGUE_INPUTS:
            raise ValueError(f"no analogue input {number}; a unit has 1-{ANALOGUE_INPUTS}")
        self._stations[place - 1].unit.inputs.set_volts(own, volts)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        self._station(axis).unit.drive.set_limits(which)

    def set_stalled(self, axis: str, stalled: bool) -> None:
        """Without effect on anything that the unit knows: it is open loop and counts the steps it commands."""
        del stalled
        self._station(axis)

    def push(self, axis: str, counts: int) -> None:
        """Of a motor at rest: nothing says when the unit lowers or drops the current of one."""
        self._station(axis).unit.drive.push(counts)

    def output(self, number: int) -> bool:
        place, own = self._numbered(number)
        if not 1 <= own <= USER_OUTPUTS:
            raise ValueError(f"no output {number}; a unit has 1-{USER_OUTPUTS}")
        return self._stations[place - 1].unit.outputs.level(own)

    def set_output(self, number: int, level: bool) -> None:
        """Bring an output to a level, as a test's starting point."""
        place, own = self._numbered(number)
        self._stations[place - 1].unit.outputs.set(own, level)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        """Outputs of a bus are told as 10 * place + 1-3, of a unit alone as 1-3."""
        self._listeners.append(listener)

    # The truth

    def unit(self, axis: str) -> Unit:
        """One unit, for what only it can tell."""
        return self._station(axis).unit

    def position(self, axis: str) -> float:
        """The position counter, with the part of a step that is under way."""
        return self._station(axis).unit.drive.exact()[0]

    def place(self, axis: str) -> float:
        return self._station(axis).unit.drive.place

    def velocity(self, axis: str) -> float:
        station = self._station(axis)
        return station.unit.drive.exact()[1] * station.unit.time.rate()

    def moving(self, axis: str) -> bool:
        return self._station(axis).unit.drive.moving

    def at_rest(self) -> bool:
        return not any(station.unit.busy or station.decoding for station in self._stations)

    @property
    def motions(self) -> Sequence[Motion]:
        return self._stations[0].record

    # Names

    def _station(self, axis: str) -> Station:
        for station in self._stations:
            if station.unit.axis == axis:
                return station
        raise ValueError(f"no axis {axis!r}; there are {', '.join(self.axes)}")

    def _numbered(self, number: int) -> tuple[int, int]:
        place, own = divmod(number, _PLACE)
        if place > len(self._stations):
            raise ValueError(f"no unit at place {place}; there are {len(self._stations)}")
        return max(place, 1), own

    def _relay(self, place: int) -> Callable[[int, bool], None]:
        base = place * _PLACE if self._numbers_by_place else 0

        def relay(number: int, level: bool) -> None:
            for listener in self._listeners:
                listener(base + number, level)

        return relay


def _crystal(options: UnitOptions, seed: int) -> Oscillator:
    return Oscillator(drift_ppm=options.drift_ppm, wander_ppm=options.wander_ppm, seed=seed)


def build_controller(
    clock: Clock, options: Options, oscillator: Oscillator | None, timing: Timing | None, seed: int
) -> Smc30Controller:
    """Powered-up units. The fleet's crystal is that of place 1; the others have the one of their options."""
    record: list[Motion] = []
    places = [
        Place(
            unit,
            oscillator if number == 1 and oscillator is not None else _crystal(unit, seed + number),
            timing or Timing(),
            random.Random(seed * _PLACE + number),
            str(number),
            record,
        )
        for number, unit in enumerate(options.each(), start=1)
    ]
    return Smc30Controller(clock, options, places)
