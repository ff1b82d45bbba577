"""A drive in its physical environment, and the bus that drives share."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from orchestrator.clock.base import Clock
from orchestrator.link.can_bus import MemoryCanBus
from sim.cia402.options import DriveOptions, read_options
from sim.cia402.servo import AXIS
from sim.cia402.states import POWERED
from sim.cia402.station import OFF, DriveNode
from sim.core.controller import (
    CommandedMotion,
    DeviceSpec,
    FirmwareTiming,
    LimitSwitch,
    PortConnection,
    SendBytes,
    refuse_analog,
)
from sim.core.devicetime import DeviceTime
from sim.core.oscillator import Oscillator
from sim.link.can_card import CanSegment


class SimulatedDrive:
    """One drive; implements `SimulatedController`. Its axis is `1`, its inputs and outputs are 1-8."""

    def __init__(self, segment: CanSegment, station: DriveNode, time: DeviceTime) -> None:
        self._time = time
        self.segment = segment
        self.station = station

    @property
    def port_names(self) -> tuple[str, ...]:
        return self.segment.port_names

    @property
    def axis_names(self) -> tuple[str, ...]:
        return (AXIS,)

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> PortConnection:
        """Connect to its bus; raises `PortRefused`."""
        return self.segment.connect(port, send, closed)

    # Environment

    def set_power(self, *, on: bool) -> None:
        self.station.set_power(on=on)

    def set_input(self, number: int, *, level: bool) -> None:
        self.station.drive.set_input(number, level=level)

    def set_analog(self, number: int, volts: float) -> None:
        """Raise `ValueError`: there are no analogue inputs."""
        refuse_analog(number)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        _require_axis(axis)
        self.station.drive.set_limit(which)

    def set_stalled(self, axis: str, *, stalled: bool) -> None:
        _require_axis(axis)
        self.station.drive.servo.set_stalled(stalled=stalled)

    def push_axis(self, axis: str, counts: int) -> None:
        """Push the axis. Raises `ValueError` while the motor keeps torque."""
        _require_axis(axis)
        if self.station.drive.states.state in POWERED:
            raise ValueError(
                f"the motor of drive {self.station.node} is on and keeps torque; switch it off before pushing the axis"
            )
        self.station.drive.servo.push_motor(counts)

    def output_level(self, number: int) -> bool:
        return self.station.drive.servo.terminals.output_level(number)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        self.station.drive.servo.terminals.on_output(listener)

    # Ground truth

    def position(self, axis: str) -> float:
        _require_axis(axis)
        return self.station.drive.servo.demand_position

    def physical_position(self, axis: str) -> float:
        _require_axis(axis)
        return self.station.drive.servo.mechanical_position

    def velocity(self, axis: str) -> float:
        _require_axis(axis)
        return self.station.drive.servo.demand_speed * self._time.clock_rate()

    def is_moving(self, axis: str) -> bool:
        _require_axis(axis)
        return self.station.drive.servo.mover.is_moving

    def at_rest(self) -> bool:
        servo = self.station.drive.servo
        return self.station.state == OFF or not (servo.is_busy or servo.mover.is_running)

    @property
    def commanded_motions(self) -> Sequence[CommandedMotion]:
        return self.station.drive.servo.mover.motions


def _require_axis(axis: str) -> None:
    if axis != AXIS:
        raise ValueError(f"no axis {axis!r}; a drive has {AXIS}")


def build_drive(
    clock: Clock, options: Mapping[str, object], oscillator: Oscillator | None, timing: FirmwareTiming | None, seed: int
) -> SimulatedDrive:
    """Build one drive on a bus of its own, node 1."""
    branch = DeviceSpec(1, options, oscillator or Oscillator(), timing or FirmwareTiming(), seed)
    return build_bus(clock, [branch])[1][0]


def build_bus(clock: Clock, branches: Sequence[DeviceSpec]) -> tuple[CanSegment, list[SimulatedDrive]]:
    """Build drives on one bus. Its bit rate is the most frequent one among them. `ValueError` for a wrong option."""
    options = [read_options(branch.options) for branch in branches]
    (bitrate, _), *_ = Counter(option.bitrate for option in options).most_common()
    segment = CanSegment(MemoryCanBus(clock, bitrate, seed=branches[0].seed))
    return segment, [
        _build_on_segment(clock, segment, branch, option) for branch, option in zip(branches, options, strict=True)
    ]


def _build_on_segment(clock: Clock, segment: CanSegment, branch: DeviceSpec, options: DriveOptions) -> SimulatedDrive:
    time = DeviceTime(clock, branch.oscillator)
    station = DriveNode(time, segment.bus, options, branch)
    return SimulatedDrive(segment, station, time)
