"""The state of one axis, and its run: the operation that moves it, alone or with other axes."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto
from fractions import Fraction

from orchestrator.clock.base import ClockTimer
from sim.core.controller import CommandedMotion, LimitSwitch
from sim.shrc203.line import Reply
from sim.shrc203.path import AxisPath, SpeedTriple


class AxisPhase(Enum):
    """Activity of an axis; Busy is everything but IDLE."""

    IDLE = auto()
    MOVING = auto()
    SETTLING = auto()
    """The profile has ended; in-position and the W: time are awaited (L2566)."""
    STANDBY = auto()
    """WT: or WI: is being executed (Busy by decision 13)."""
    AWAITING = auto()
    """The next operation has migrated and is about to start, or waits for its other axes."""


class EndCause(Enum):
    """Reason for the end of a motion."""

    END = auto()
    STOPPED = auto()
    """By L: or BEC:."""
    LIMIT = auto()
    SOFT_LIMIT = auto()
    ERROR = auto()


class RunKind(Enum):
    """Kind of a run, as far as status bits and stops distinguish it."""

    MOVE = auto()
    JOG = auto()
    INTERPOLATION = auto()
    ORIGIN = auto()
    """Mechanical origin return."""
    ZERO = auto()
    """Logical origin return."""


@dataclass(slots=True, eq=False)
class StageAxis:
    """One axis: counters, settings, buffers and errors. Positions are pulses."""

    index: int
    name: str
    controllable: bool = True

    position: int = 0
    """Pulses from the position at the first power-up, where the last finished motion ended."""
    offset: int = 0
    """Coordinate minus position."""
    zeroed: int = 0
    """The amount that R: has subtracted from the coordinate, for RC: (L2918)."""
    origin: int = -1000
    """The mechanical origin, as `position`."""
    scale_deviation: int = 0
    """Position minus the position that the scale has followed."""
    stalled_at: int | None = None
    """Position where the stage is stuck, as `position`."""
    limits: LimitSwitch | None = None
    """Limit switches pressed from outside; None: by travel."""
    travel: tuple[int, int] | None = None
    """Limit switches by travel, as `position`."""
    home_sensor: bool | None = None
    """ORG sensor forced from outside; None: by position."""
    soft_limits: tuple[int, int] | None = None
    """Least and greatest coordinate."""

    base_rate: int = 200
    divide: int = 2000
    deg_per_pulse: Fraction | None = None
    stage_unit: str = "P"
    axis_name: str = "1"
    config: str = "off"
    triple: SpeedTriple = field(default_factory=lambda: SpeedTriple(100, 1000, 100))
    origin_triple: SpeedTriple = field(default_factory=lambda: SpeedTriple(100, 1000, 100))
    closed_loop: bool = False
    excited: bool = True

    errors: set[str] = field(default_factory=set[str])
    """Active device errors S1-S10."""
    command_error: bool = False
    limit_stop: bool = False
    """The last stop was by a limit sensor (decision 30)."""
    soft_stop: int = 0
    """Direction of the software limit that stopped the last motion, or 0."""

    phase: AxisPhase = AxisPhase.IDLE
    run: "PathRun | None" = None
    timer: ClockTimer | None = None
    """Timer of a timed standby or a hand-over."""
    reply: Reply | None = None
    """Destination of completion characters: the port that started the operation (decision 47)."""

    @property
    def is_busy(self) -> bool:
        return self.phase is not AxisPhase.IDLE

    @property
    def nm_per_pulse(self) -> Fraction:
        """BASE RATE x 10 / DIVIDE (L807)."""
        return Fraction(self.base_rate * 10, self.divide)

    def push_stage(self, pulses: int) -> None:
        """Move the stage by hand: its scale detects it, the counter of commanded pulses does not."""
        self.position += pulses
        self.offset -= pulses
        self.scale_deviation -= pulses

    def restore_torque(self) -> None:
        """Restore the motor's torque. A closed loop returns the stage to the command, as after sleep (L2313)."""
        if self.closed_loop:
            self.position += self.scale_deviation
            self.offset -= self.scale_deviation
            self.scale_deviation = 0

    def check_limits(self) -> None:
        """Both limit sensors on at once are a limit error S5 (decision 28)."""
        if self.limit_on(1, self.position) and self.limit_on(-1, self.position):
            self.errors.add("S5")

    def limit_on(self, sign: int, position: float) -> bool:
        """Return whether the limit switch at the `sign` end is on with the stage at `position`."""
        if self.limits is not None:
            return self.limits in ("both", "forward" if sign > 0 else "reverse")
        if self.travel is None:
            return False
        return position >= self.travel[1] if sign > 0 else position <= self.travel[0]


@dataclass(slots=True, eq=False)
class RunTrack:
    """The share of one axis in a run."""

    axis: StageAxis
    path: AxisPath
    start: int
    """Position at the start, pls."""
    motion: CommandedMotion | None


@dataclass(slots=True, eq=False)
class PathRun:
    """One operation: one axis, or the axes of an interpolation together."""

    tracks: list[RunTrack]
    kind: RunKind
    triple: SpeedTriple
    """Defines the slope of a stop."""
    t0_ns: int
    """Device instant of the paths' origin."""
    ready: "Ready"
    """Called with the device instant at which the axes are positioned, settled and the W: time is over."""
    end_cause: EndCause = EndCause.END
    end_sign: int = 0
    """Direction of the software limit at which the run is planned to end."""
    timer: ClockTimer | None = None
    cause: EndCause = EndCause.END
    stopping: bool = False
    held: bool = False
    """Closed loop, and the stage does not reach its position."""


Ready = Callable[[PathRun, int, EndCause], None]
"""Called with the device instant at which the axes are positioned, settled and the W: time is over."""


@dataclass(frozen=True, slots=True)
class RunOrder:
    """Order for a run. `at_ns`: device instant of its start."""

    triple: SpeedTriple
    kind: RunKind
    at_ns: int
    ready: Ready
