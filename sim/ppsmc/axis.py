"""The state of one axis, its running motion, and its activity."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

from orchestrator.clock.base import NS_PER_S, ClockTimer
from sim.core.controller import CommandedMotion
from sim.ppsmc.encoder import IncrementalEncoder
from sim.ppsmc.grammar import round_nearest
from sim.ppsmc.legs import MotionEnd, TaskKind
from sim.ppsmc.path import SpeedProfile, StepPath
from sim.ppsmc.sensors import TravelSwitches, UntilSwitch
from sim.ppsmc.settings import AxisSettings

STEP_LIMIT = 2**23 - 1
"""Largest distance of a target from zero (L2022)."""

LIMIT_ERROR = (1500, "limit switch error")
POSITIONING_ERROR = (1501, "positioning error")
NO_ERROR = (0, "")


class AxisActivity(Protocol):
    """A sequence of motions and pauses that keeps an axis busy."""

    @property
    def kind(self) -> TaskKind: ...

    def stop_task(self) -> None:
        """Stop as by q: decelerate, and discard the rest."""
        ...

    def abort_task(self) -> None:
        """Stop dead without notification."""
        ...


@dataclass(slots=True, eq=False)
class StepperAxis:
    """One axis: step counter, configuration, status bits, and present activity."""

    number: int
    settings: AxisSettings
    switches: TravelSwitches
    encoder: IncrementalEncoder | None

    steps: int = 0
    """The step counter at rest, or at the start of the running motion."""
    origin: int = 0
    """The counter at mechanical position 0, the position at the first power-up."""
    referenced: bool = False
    index_found: bool = False
    homed: bool = False
    """Homed at least once since power-up (bit 4 of later firmware)."""
    oscillation_error: bool = False
    error: tuple[int, str] = NO_ERROR
    run: "MotionRun | None" = None
    task: AxisActivity | None = None
    queued: Callable[[], None] | None = None
    """The one target that waits for the end of the motion (decision 13)."""
    target: tuple[bool, Fraction] | None = None
    """Target buffer: absolute?, distance; None is `r0.00`."""

    @property
    def name(self) -> str:
        return str(self.number)

    def count_steps(self, distance: Fraction) -> int:
        """Return the motor steps of a distance in the axis's unit (L871)."""
        return round_nearest(distance * self.settings.steps_per_unit)

    def steps_to_distance(self, steps: int) -> Fraction:
        """Return the distance of `steps` in the axis's unit."""
        return steps / self.settings.steps_per_unit

    def set_counter(self, steps: int) -> None:
        """Assign another coordinate to the present position, at rest."""
        self.origin += steps - self.steps
        self.steps = steps

    def encoder_increments(self, steps: float) -> int:
        """Return the encoder counter content with the step counter at `steps`."""
        if self.encoder is None:
            return 0
        content = self.encoder.read_counter(steps - self.origin, self.settings.esm)
        return -content if self.settings.edir else content

    def encoder_distance(self, steps: float) -> Fraction:
        """Return the encoder position in the axis's unit, of this axis's encoder alone.

        The calibration factor is indicated / true position and needs closed loop (L4531-L4564).
        """
        factor = self.settings.cf if self.settings.ecl else Fraction(1)
        return self.encoder_increments(steps) * self.settings.eres / factor

    def load_encoder(self, position: Fraction) -> None:
        """Set the encoder position, at rest, to `position` (L2946)."""
        if self.encoder is None:
            return
        factor = self.settings.cf if self.settings.ecl else Fraction(1)
        content = round_nearest(position * factor / self.settings.eres)
        self.encoder.load_counter(-content if self.settings.edir else content, self.steps - self.origin)


Ended = Callable[[MotionEnd], None]


@dataclass(slots=True, eq=False)
class MotionRun:
    """A running motion of one axis. Path displacements count from `base`."""

    axis: StepperAxis
    path: StepPath
    profile: SpeedProfile
    start_ns: int
    """Device time at the path's time 0; slightly ahead of now at a skewed start."""
    base: int
    until: UntilSwitch | None
    ended: Ended
    motion: CommandedMotion
    soft: bool = False
    """At its `UntilSwitch` it decelerates instead of stopping dead."""
    found: bool = False
    stopping: bool = False
    quit: bool = False
    timer: ClockTimer | None = None

    def path_seconds(self, now_ns: int) -> float:
        return (now_ns - self.start_ns) / NS_PER_S
