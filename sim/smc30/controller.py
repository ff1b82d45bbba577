"""One SMC30, or a bus of up to seven, on one serial line, and their environment."""

import random
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_S, Clock, ClockTimer
from orchestrator.link.supply import PowerSupply
from sim.core.controller import CommandedMotion, FirmwareTiming, LimitSwitch, PortRefused, SendBytes, refuse_analog
from sim.core.devicetime import DeviceTime
from sim.core.oscillator import Oscillator
from sim.smc30.drive import StepGenerator
from sim.smc30.framing import ReceivedString, StringReader, compute_checksum, odd_parity
from sim.smc30.inputs import ANALOGUE_INPUTS, USER_INPUTS
from sim.smc30.options import IndexerOptions, Smc30Options
from sim.smc30.outputs import USER_OUTPUTS
from sim.smc30.unit import StepIndexer

STOP_INPUT = 4
"""Number of the Stop input for `set_input`; true: pulled to ground."""
_PORT = "serial"
_BITS_PER_CHARACTER = 10
_PLACE = 10


@dataclass(frozen=True, slots=True)
class _PendingString:
    """A received string being decoded."""

    received: ReceivedString
    timer: ClockTimer


@dataclass(frozen=True, slots=True)
class _SentReply:
    """A reply on the shared line, in true time."""

    begin_ns: int
    end_ns: int
    station: "BusStation"
    data: bytes


@dataclass(frozen=True, slots=True)
class DeviceSetup:
    """One device of a line, with its individual setup.

    axis: its name.
    record: list that receives its motions."""

    options: IndexerOptions
    oscillator: Oscillator
    timing: FirmwareTiming
    generator: random.Random
    axis: str
    record: list[CommandedMotion]


class BusStation:
    """A device on the line: receives strings, applies the firmware's delay, sends replies."""

    def __init__(self, clock: Clock, place: DeviceSetup, bus: "Smc30Controller") -> None:
        options = place.options
        self._clock = clock
        self._bus = bus
        self._timing = place.timing
        self._generator = place.generator
        self._checksum = options.checksum
        self.address = options.address
        self._reader = StringReader(options.address, options.checksum, options.line_limit, bus.options.parity)
        self._pending: deque[_PendingString] = deque()
        self._busy_until_ns = 0
        self._supply = PowerSupply()
        self.record = place.record
        time = DeviceTime(clock, place.oscillator)
        poll_phase = self._generator.random() if options.input_poll_ms else 0.0
        drive = StepGenerator(time, place.axis, place.record, options.travel_steps)
        self.unit = StepIndexer(time, options, drive, self._send_reply, poll_phase)

    @property
    def is_decoding(self) -> bool:
        return bool(self._pending)

    def receive_bytes(self, data: bytes) -> None:
        """Receive bytes from the line; without power they are ignored."""
        if not self.unit.on:
            return
        for received_string in self._reader.read_strings(
            self._supply.cut_received(data, self._clock.now_ns(), self._bus.character_ns)
        ):
            delay_ns = self._timing.decode_ns
            if self._timing.spread_ns:
                delay_ns += self._generator.randint(0, self._timing.spread_ns)
            if not delay_ns and not self._pending:
                self.unit.handle_string(received_string)
            else:
                self._busy_until_ns = max(self._clock.now_ns(), self._busy_until_ns) + delay_ns
                timer = self._clock.call_at_ns(self._busy_until_ns, self._handle_decoded)
                self._pending.append(_PendingString(received_string, timer))

    def _handle_decoded(self) -> None:
        self.unit.handle_string(self._pending.popleft().received)

    def _send_reply(self, text: str) -> None:
        data = text.encode("ascii")
        if self._checksum:
            data += bytes((compute_checksum(data),))
        self._bus.transmit_reply(self, data + b"\r")

    def set_power(self, *, on: bool) -> None:
        if on == self.unit.on:
            return
        if on:
            self._supply.set_power(on=on, at_ns=self._clock.now_ns())
            self.unit.power_up()
            return
        for pending in self._pending:
            pending.timer.cancel()
        self._pending.clear()
        self._busy_until_ns = 0
        self._reader.discard_partial()
        self.unit.power_down()
        self._bus.stop_transmission(self)


class HostLineEnd:
    """The host's end of the serial line."""

    def __init__(self, bus: "Smc30Controller", send: SendBytes) -> None:
        self._bus = bus
        self.send = send
        self.supply = PowerSupply()

    def receive_bytes(self, data: bytes) -> None:
        self._bus.handle_bytes(self, data)

    def close(self) -> None:
        self._bus.handle_close(self)


class Smc30Controller:
    """The devices by place on the bus, 1-7; a single device has place 1.

    Axes are named by place. User inputs and outputs are numbered 10 * place + 1-3, and those of place 1 also 1-3; the
    Stop input is 10 * place + 4, true when pulled to ground.
    """

    def __init__(self, clock: Clock, options: Smc30Options, places: Sequence[DeviceSetup]) -> None:
        self._clock = clock
        self.options = options
        self._port: HostLineEnd | None = None
        self._arrived: deque[bytes] = deque()
        """Bytes being delivered, followed by those that arrived meanwhile."""
        self._last: _SentReply | None = None
        self._spoke: BusStation | None = None
        """The replies sent last."""
        self.character_ns = _BITS_PER_CHARACTER * NS_PER_S // options.baud
        self._numbers_by_place = len(places) > 1
        self._listeners: list[Callable[[int, bool], None]] = []
        self._stations = [BusStation(clock, address, self) for address in places]
        for number, station in enumerate(self._stations, start=1):
            station.unit.outputs.listeners.append(self._output_relay(number))

    # Serial line

    @property
    def port_names(self) -> tuple[str, ...]:
        return (_PORT,)

    @property
    def axis_names(self) -> tuple[str, ...]:
        return tuple(station.unit.axis for station in self._stations)

    @property
    def bus_stations(self) -> Sequence[BusStation]:
        """The devices in the order of their places."""
        return self._stations

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> HostLineEnd:
        """Connect the host's end of the line, replacing an earlier connection. The line never disconnects: `closed` is
        not called."""
        del closed
        if port != _PORT:
            raise PortRefused(f"no port {port!r}; there is {_PORT!r}")
        self._port = HostLineEnd(self, send)
        return self._port

    def handle_close(self, port: HostLineEnd) -> None:
        if self._port is port:
            self._port = None

    def handle_bytes(self, port: HostLineEnd, data: bytes) -> None:
        """Deliver every byte to every device, in order even if an answer makes the host send more at once."""
        if port is not self._port:
            return
        self._arrived.append(data)
        if len(self._arrived) > 1:
            return
        while self._arrived:
            for station in self._stations:
                station.receive_bytes(self._arrived[0])
            self._arrived.popleft()

    def transmit_reply(self, station: BusStation, data: bytes) -> None:
        """Begin to send a reply. Two devices with one address drive the line together and garble each other.

        The earlier one's bytes cannot be taken back: the later one's characters come out mixed with them. Devices with
        different addresses collide only with the option, because that needs cables that take time like real ones.
        """
        if len(self._stations) > 1:
            data = self._mix_colliding(station, data)
        self._spoke = station
        if self._port is not None:
            self._port.send(odd_parity(data) if self.options.parity == "wire" else data)

    def stop_transmission(self, station: BusStation) -> None:
        """Handle a power loss of a device, possibly while it was sending."""
        if self._port is not None and self._spoke is station:
            self._port.supply.set_power(on=False, at_ns=self._clock.now_ns())

    def _mix_colliding(self, station: BusStation, data: bytes) -> bytes:
        now_ns, last = self._clock.now_ns(), self._last
        end_ns = now_ns + len(data) * self.character_ns
        self._last = _SentReply(now_ns, end_ns, station, data)
        if last is None or last.station is station or now_ns >= last.end_ns:
            return data
        if last.station.address != station.address and self.options.collisions == "same_address":
            return data
        under = last.data[(now_ns - last.begin_ns) // self.character_ns :].ljust(len(data), b"\x7f")
        return bytes(byte & mask for byte, mask in zip(data, under, strict=False))

    # Environment

    def set_power(self, *, on: bool) -> None:
        """Switch the power of all devices; the line stays connected."""
        for station in self._stations:
            station.set_power(on=on)

    def set_unit_power(self, axis: str, *, on: bool) -> None:
        """Switch the power of one device of the bus."""
        self._find_station(axis).set_power(on=on)

    def set_input(self, number: int, *, level: bool) -> None:
        address, own = self._split_number(number)
        unit = self._stations[address - 1].unit
        if own == STOP_INPUT:
            unit.set_stop_input(held=level)
        elif 1 <= own <= USER_INPUTS:
            unit.inputs.set_user(own, level=level)
        else:
            raise ValueError(
                f"no input {number}; a device has user inputs 1-{USER_INPUTS} and the Stop input {STOP_INPUT}"
            )

    def set_analog(self, number: int, volts: float) -> None:
        """Set the voltage at an analogue input, numbered like the user inputs, 1-6 of a place."""
        address, own = self._split_number(number)
        if not 1 <= own <= ANALOGUE_INPUTS:
            refuse_analog(number, f"1 to {ANALOGUE_INPUTS}")
        self._stations[address - 1].unit.inputs.set_volts(own, volts)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        self._find_station(axis).unit.drive.set_limits(which)

    def set_stalled(self, axis: str, *, stalled: bool) -> None:
        """Ignored by the device: it is open loop and counts the steps it commands."""
        del stalled
        self._find_station(axis)

    def push_axis(self, axis: str, counts: int) -> None:
        """Push a motor at rest: the manual does not state when the device lowers or switches off its current."""
        self._find_station(axis).unit.drive.push_axis(counts)

    def output_level(self, number: int) -> bool:
        address, own = self._split_number(number)
        if not 1 <= own <= USER_OUTPUTS:
            raise ValueError(f"no output {number}; a device has 1-{USER_OUTPUTS}")
        return self._stations[address - 1].unit.outputs.output_level(own)

    def set_output(self, number: int, *, level: bool) -> None:
        """Set an output to a level, as a test's initial state."""
        address, own = self._split_number(number)
        self._stations[address - 1].unit.outputs.set_output(own, on=level)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        """Subscribe to output changes. Outputs of a bus are reported as 10 * place + 1-3, of a single device as 1-3."""
        self._listeners.append(listener)

    # Ground truth

    def find_indexer(self, axis: str) -> StepIndexer:
        """Return one device, for state that only it can report."""
        return self._find_station(axis).unit

    def position(self, axis: str) -> float:
        """Position counter, with the fraction of the step in progress."""
        return self._find_station(axis).unit.drive.exact_state()[0]

    def physical_position(self, axis: str) -> float:
        return self._find_station(axis).unit.drive.physical_steps

    def velocity(self, axis: str) -> float:
        station = self._find_station(axis)
        return station.unit.drive.exact_state()[1] * station.unit.time.clock_rate()

    def is_moving(self, axis: str) -> bool:
        return self._find_station(axis).unit.drive.is_moving

    def at_rest(self) -> bool:
        return not any(station.unit.is_busy or station.is_decoding for station in self._stations)

    @property
    def commanded_motions(self) -> Sequence[CommandedMotion]:
        return self._stations[0].record

    # Names

    def _find_station(self, axis: str) -> BusStation:
        for station in self._stations:
            if station.unit.axis == axis:
                return station
        raise ValueError(f"no axis {axis!r}; there are {', '.join(self.axis_names)}")

    def _split_number(self, number: int) -> tuple[int, int]:
        address, own = divmod(number, _PLACE)
        if address > len(self._stations):
            raise ValueError(f"no device at place {address}; there are {len(self._stations)}")
        return max(address, 1), own

    def _output_relay(self, place: int) -> Callable[[int, bool], None]:
        base = place * _PLACE if self._numbers_by_place else 0

        def relay_output(number: int, *, level: bool) -> None:
            for listener in self._listeners:
                listener(base + number, level)

        return lambda number, level: relay_output(number, level=level)


def _build_oscillator(options: IndexerOptions, seed: int) -> Oscillator:
    return Oscillator(drift_ppm=options.drift_ppm, wander_ppm=options.wander_ppm, seed=seed)


def build_controller(
    clock: Clock, options: Smc30Options, oscillator: Oscillator | None, timing: FirmwareTiming | None, seed: int
) -> Smc30Controller:
    """Build powered-up devices. The fleet's oscillator is that of place 1; the others have the one of their options."""
    record: list[CommandedMotion] = []
    places = [
        DeviceSetup(
            options=unit,
            oscillator=oscillator if number == 1 and oscillator is not None else _build_oscillator(unit, seed + number),
            timing=timing or FirmwareTiming(),
            generator=random.Random(seed * _PLACE + number),
            axis=str(number),
            record=record,
        )
        for number, unit in enumerate(options.device_options(), start=1)
    ]
    return Smc30Controller(clock, options, places)
