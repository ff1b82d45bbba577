"""One axis: its registers, what it is commanded to do, and where its encoder is."""

from collections.abc import Callable
from math import inf
from typing import Protocol

from sim.core.controller import Motion
from sim.yaskawa.base import fixed
from sim.yaskawa.motion.gear import Gear
from sim.yaskawa.motion.profile import ACCELERATION_UNIT, SPEED_UNIT, Profile

NO_ABSOLUTE = -2147483648


class Path(Protocol):
    """A commanded position (counts) and velocity (counts/sample) at a time in samples, in closed form."""

    def position(self, at: float) -> float: ...

    def velocity(self, at: float) -> float: ...


class Axis:
    """Axis X, Y, Z, W or the virtual N. All instants are in samples, all positions in counts."""

    def __init__(self, name: str, index: int, lag: int) -> None:
        self.name = name
        self.lag = lag
        """Samples from a command to the encoder's reading of it."""
        self.index = index
        self.virtual = name == "N"
        self.registers: dict[str, int] = {}
        self.path: Path = Profile(0, 0.0)
        self.profile: Profile | None = None
        """The path when it is an independent profile."""
        self.mode = ""
        """What runs: `move`, `jog`, `home`, `edge`, `index`, `sequence`, `contour`, `cam`, or nothing."""
        self.armed = "PR"
        """What `BG` starts: PR, PA, JG, HM, FE or FI."""
        self.stage = 0
        self.direction = 1
        self.target = 0.0
        self.move_start = 0
        self.mark = 0.0
        """Where AR counts from."""
        self.end: float = inf
        self.watch: float = inf
        """When the profile meets a limit, an edge or an index."""
        self.watch_code = 0
        self.ending_code = 0
        """Stop code that the present motion will end with."""
        self.stop_code = 1
        self.stopping = False
        self.motor_off = True
        self.stalled = False
        self.frozen: int | None = 0
        """The encoder's reading while the motor does not follow."""
        self.physical_zero = 0
        """Encoder reading at physical position 0; `DP` and homing move it."""
        self.gear = Gear()
        self.modulus = 0
        """Cycle in which positions are reported under ECAM, 0 for none (L13736)."""
        self.turned: Callable[[], int] | None = None
        """For a slave that counts by the master's turns: what the turns up to now have moved it (SMC-2000: L8449)."""
        self.auxiliary = 0
        self.shift = 0
        """Sum of all redefinitions of the position, so that followers do not see them."""
        self.latch_armed = False
        self.latch_used = False
        self.latched = 0
        self.home_stage = 0
        self.off_on_error = False
        self.absolute = NO_ABSOLUTE
        """What AE has read (SMC-2000: L12250), counts."""
        self.turns = 0
        """The revolutions in it."""
        self.motion: Motion | None = None

    @property
    def moving(self) -> bool:
        """Whether `_BG` is 1."""
        return self.mode not in ("", "cam")

    @property
    def stepper(self) -> bool:
        """Whether it drives a step motor (L7683)."""
        return abs(self.registers["MT"]) > fixed.ONE

    @property
    def pulse_delay(self) -> int:
        """Samples by which the smoothing of steps holds back the last pulse: 3 KS (L6662)."""
        return -(-3 * self.registers["KS"] // fixed.ONE)

    def speed(self, name: str) -> float:
        """A speed register in counts/sample."""
        return self.registers[name] / fixed.ONE * SPEED_UNIT

    def acceleration(self, name: str) -> float:
        """An acceleration register in counts/sample^2."""
        return self.registers[name] / fixed.ONE * ACCELERATION_UNIT

    def command(self, at: float) -> float:
        """Commanded position, not rounded, not modularised."""
        return self.path.position(at) + self.gear.position(at) if self.gear.on else self.path.position(at)

    def command_velocity(self, at: float) -> float:
        """Commanded velocity, counts/sample."""
        return self.path.velocity(at) + (self.gear.velocity(at) if self.gear.on else 0.0)

    def reference(self, sample: int) -> int:
        """Commanded position in whole counts, 32 bits."""
        return fixed.wrapped(fixed.rounded(self.command(sample)))

    def actual(self, sample: int) -> int:
        """Encoder position: that of the command `lag` samples before, or where it froze (D63)."""
        return self.frozen if self.frozen is not None else self.reference(sample - self.lag)

    def reported(self, counts: int) -> int:
        """`counts` in the cycle of a cam."""
        if self.turned is not None:
            return counts - self.turned()
        return counts % self.modulus if self.modulus else counts

    def travel(self, at: float, commanded: bool) -> float:
        """Position that a follower sees: it does not jump when the position is redefined."""
        if commanded or self.virtual:
            return self.command(at) - self.shift
        return (self.frozen if self.frozen is not None else self.command(at - self.lag)) - self.shift

    def physical(self, sample: int) -> int:
        """Physical position: 0 at power-up, not changed by redefinitions."""
        return self.actual(sample) - self.physical_zero

    def rest(self, sample: int, position: float) -> None:
        """Stand at `position` (before gearing) from `sample` on."""
        self.profile = Profile(sample, position)
        self.path = self.profile
        self.mode = ""
        self.stopping = False
        self.end = self.watch = inf

    def define(self, sample: int, counts: int) -> None:
        """`DP`: command and encoder become `counts` (L4227)."""
        self.shift += counts - self.reference(sample)
        self.physical_zero += counts - (self.frozen if self.frozen is not None else self.reference(sample))
        self.gear.restart(sample)
        self.rest(sample, counts)
        if self.frozen is not None:
            self.frozen = counts

    def freeze(self, sample: int) -> None:
        """The motor no longer follows."""
        if self.frozen is None:
            self.frozen = self.reference(sample)

    def thaw(self) -> None:
        if not self.stalled and (not self.motor_off or self.virtual):
            self.frozen = None

    def error(self, sample: int) -> int:
        """Position error: commanded minus actual (L10487)."""
        return self.reference(sample) - self.actual(sample)
