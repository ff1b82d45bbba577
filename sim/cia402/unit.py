"""A drive in its physical world, and the bus that drives share."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from orchestrator.clock.base import Clock
from orchestrator.link.can_bus import MemoryCanBus
from sim.cia402.options import Options, read_options
from sim.cia402.servo import AXIS
from sim.cia402.states import POWERED
from sim.cia402.station import OFF, Station
from sim.core.controller import Branch, Connection, LimitSwitch, Motion, Send, Timing
from sim.core.devicetime import DeviceTime
from sim.core.oscillator import Oscillator
from sim.link.can_card import CanSegment


class DriveUnit:
    """One drive; fulfils `SimulatedController`. Its axis is `1`, its inputs and outputs are 1-8."""

    def __init__(self, segment: CanSegment, station: Station, time: DeviceTime) -> None:
        self._time = time
        self.segment = segment
        self.station = station

    @property
    def ports(self) -> tuple[str, ...]:
        return self.segment.ports

    @property
    def axes(self) -> tuple[str, ...]:
        return (AXIS,)

    def connect(self, port: str, send: Send, closed: Callable[[], None]) -> Connection:
        """The bus that it is on; raises `PortRefused`."""
        return self.segment.connect(port, send, closed)

    # The world

    def set_power(self, on: bool) -> None:
        self.station.set_power(on)

    def set_input(self, number: int, level: bool) -> None:
        self.station.drive.set_input(number, level)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        _require(axis)
        self.station.drive.set_limit(which)

    def set_stalled(self, axis: str, stalled: bool) -> None:
        _require(axis)
        self.station.drive.servo.set_stalled(stalled)

    def push(self, axis: str, counts: int) -> None:
        """Raises `ValueError` while the motor holds the axis."""
        _require(axis)
        if self.station.drive.states.state in POWERED:
            raise ValueError(f"the motor of drive {self.station.node} is on and holds the axis; it can not be pushed")
        self.station.drive.servo.push(counts)

    def output(self, number: int) -> bool:
        return self.station.drive.servo.terminals.output(number)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        self.station.drive.servo.terminals.on_output(listener)

    # The truth

    def position(self, axis: str) -> float:
        _require(axis)
        return self.station.drive.servo.demand

    def place(self, axis: str) -> float:
        _require(axis)
        return self.station.drive.servo.mechanical

    def velocity(self, axis: str) -> float:
        _require(axis)
        return self.station.drive.servo.speed * self._time.rate()

    def moving(self, axis: str) -> bool:
        _require(axis)
        return self.station.drive.servo.mover.moving

    def at_rest(self) -> bool:
        servo = self.station.drive.servo
        return self.station.state == OFF or not (servo.busy or servo.mover.running)

    @property
    def motions(self) -> Sequence[Motion]:
        return self.station.drive.servo.mover.motions


def _require(axis: str) -> None:
    if axis != AXIS:
        raise ValueError(f"no axis {axis!r}; a drive has {AXIS}")


def build_drive(
    clock: Clock, options: Mapping[str, object], oscillator: Oscillator | None, timing: Timing | None, seed: int
) -> DriveUnit:
    """One drive on a bus of its own, node 1."""
    branch = Branch(1, options, oscillator or Oscillator(), timing or Timing(), seed)
    return build_bus(clock, [branch])[1][0]


def build_bus(clock: Clock, branches: Sequence[Branch]) -> tuple[CanSegment, list[DriveUnit]]:
    """Drives on one bus. Its bit rate is that of most of them. `ValueError` for a wrong option."""
    options = [read_options(branch.options) for branch in branches]
    (bitrate, _), *_ = Counter(each.bitrate for each in options).most_common()
    segment = CanSegment(MemoryCanBus(clock, bitrate, seed=branches[0].seed))
    return segment, [_build(clock, segment, branch, each) for branch, each in zip(branches, options, strict=True)]


def _build(clock: Clock, segment: CanSegment, branch: Branch, options: Options) -> DriveUnit:
    time = DeviceTime(clock, branch.oscillator)
    node = 1 if branch.address is None else branch.address
    station = Station(clock, time, segment.bus, node, options, branch.timing, branch.seed)
    return DriveUnit(segment, station, time)
