"""The state of one axis."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from sim.ppsmc.encoder import Encoder
from sim.ppsmc.grammar import rounded
from sim.ppsmc.sensors import Switches
from sim.ppsmc.settings import Settings

if TYPE_CHECKING:
    from sim.ppsmc.drive import Run
    from sim.ppsmc.task import Task

MOST_STEPS = 2**23 - 1
"""No target lies further from zero (L2022)."""

LIMIT_ERROR = (1500, "limit switch error")
POSITIONING_ERROR = (1501, "positioning error")
NO_ERROR = (0, "")


@dataclass(slots=True, eq=False)
class Axis:
    """One axis: step counter, configuration, status bits, and what it is doing."""

    number: int
    settings: Settings
    switches: Switches
    encoder: Encoder | None

    steps: int = 0
    """The step counter at rest, or where the running motion started."""
    origin: int = 0
    """The counter at mechanical position 0, the place of the first power-up."""
    referenced: bool = False
    index_found: bool = False
    homed: bool = False
    """Homed at least once since power-up (bit 4 of later firmware)."""
    oscillation_error: bool = False
    error: tuple[int, str] = NO_ERROR
    run: "Run | None" = None
    task: "Task | None" = None
    queued: Callable[[], None] | None = None
    """The one target that waits for the end of the motion (decision 13)."""
    target: tuple[bool, Fraction] | None = None
    """Target buffer: absolute?, distance; None is `r0.00`."""

    @property
    def name(self) -> str:
        return str(self.number)

    def count(self, distance: Fraction) -> int:
        """Motor steps of a distance in the axis's unit (L871)."""
        return rounded(distance * self.settings.gear)

    def distance(self, steps: int) -> Fraction:
        """The distance of `steps` in the axis's unit."""
        return steps / self.settings.gear

    def set_counter(self, steps: int) -> None:
        """Give the present place, at rest, another coordinate."""
        self.origin += steps - self.steps
        self.steps = steps

    def increments(self, steps: float) -> int:
        """Encoder counter content with the step counter at `steps`."""
        if self.encoder is None:
            return 0
        content = self.encoder.read(steps - self.origin, self.settings.esm)
        return -content if self.settings.edir else content

    def encoder_distance(self, steps: float) -> Fraction:
        """Encoder position in the axis's unit, of this axis's encoder alone.

        The calibration factor is indicated / true position and needs closed loop (L4531-L4564).
        """
        factor = self.settings.cf if self.settings.ecl else Fraction(1)
        return self.increments(steps) * self.settings.eres / factor

    def load_encoder(self, position: Fraction) -> None:
        """Make the encoder position, at rest, `position` (L2946)."""
        if self.encoder is None:
            return
        factor = self.settings.cf if self.settings.ecl else Fraction(1)
        content = rounded(position * factor / self.settings.eres)
        self.encoder.load(-content if self.settings.edir else content, self.steps - self.origin)
