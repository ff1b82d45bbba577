"""One axis: its registers, its commanded motion, and its encoder."""

from collections.abc import Callable
from math import inf
from typing import Protocol

from sim.core.controller import CommandedMotion
from sim.yaskawa.base import fixed
from sim.yaskawa.motion.gear import ElectronicGear
from sim.yaskawa.motion.profile import ACCELERATION_UNIT, SPEED_UNIT, VelocityProfile

NO_ABSOLUTE = -2147483648


class CommandedPath(Protocol):
    """A commanded position (counts) and velocity (counts/sample) at a time in samples, in closed form."""

    def position(self, at: float) -> float: ...

    def velocity(self, at: float) -> float: ...


class ServoAxis:
    """Axis X, Y, Z, W or the virtual N. All instants are in samples, all positions in counts."""

    def __init__(self, name: str, index: int, lag: int) -> None:
        self.name = name
        self.lag = lag
        """Samples from a command to its effect on the encoder reading."""
        self.index = index
        self.virtual = name == "N"
        self.registers: dict[str, int] = {}
        self.path: CommandedPath = VelocityProfile(0, 0.0)
        self.profile: VelocityProfile | None = None
        """The path when it is an independent profile."""
        self.mode = ""
        """Running mode: `move`, `jog`, `home`, `edge`, `index`, `sequence`, `contour`, `cam`, or none."""
        self.armed = "PR"
        """Mode that `BG` starts: PR, PA, JG, HM, FE or FI."""
        self.stage = 0
        self.direction = 1
        self.target = 0.0
        self.move_start = 0
        self.mark = 0.0
        """Position that AR counts from."""
        self.end: float = inf
        self.watch: float = inf
        """Sample at which the profile reaches a limit, an edge or an index."""
        self.watch_code = 0
        self.ending_code = 0
        """Stop code at the end of the present motion."""
        self.stop_code = 1
        self.stopping = False
        self.motor_off = True
        self.stalled = False
        self.frozen: int | None = 0
        """The encoder's reading while the motor does not follow."""
        self.physical_zero = 0
        """Encoder reading at physical position 0; changed by `DP` and homing."""
        self.gear = ElectronicGear()
        self.modulus = 0
        """Cycle in which positions are reported under ECAM, 0 for none (L13736)."""
        self.turned: Callable[[], int] | None = None
        """For a slave that counts by the master's turns: its displacement by the turns up to now (SMC-2000: L8449)."""
        self.auxiliary = 0
        self.shift = 0
        """Sum of all redefinitions of the position, which followers must not see."""
        self.latch_armed = self.latch_used = False
        self.latched = 0
        self.home_stage = 0
        self.off_on_error = False
        self.absolute = NO_ABSOLUTE
        """Last reading of AE (SMC-2000: L12250), counts."""
        self.turns = 0
        """The revolutions in it."""
        self.motion: CommandedMotion | None = None

    @property
    def is_moving(self) -> bool:
        """Whether `_BG` is 1."""
        return self.mode not in ("", "cam")

    @property
    def is_stepper(self) -> bool:
        """Return whether it drives a step motor (L7683)."""
        return abs(self.registers["MT"]) > fixed.ONE

    @property
    def pulse_delay(self) -> int:
        """Return the samples by which the smoothing of steps delays the last pulse: 3 KS (L6662)."""
        return -(-3 * self.registers["KS"] // fixed.ONE)

    def speed_register(self, name: str) -> float:
        """Return a speed register in counts/sample."""
        return self.registers[name] / fixed.ONE * SPEED_UNIT

    def acceleration_register(self, name: str) -> float:
        """Return an acceleration register in counts/sample^2."""
        return self.registers[name] / fixed.ONE * ACCELERATION_UNIT

    def command_at(self, at: float) -> float:
        """Return the commanded position, not rounded, not modularised."""
        return self.path.position(at) + self.gear.position(at) if self.gear.on else self.path.position(at)

    def command_velocity(self, at: float) -> float:
        """Return the commanded velocity, counts/sample."""
        return self.path.velocity(at) + (self.gear.velocity(at) if self.gear.on else 0.0)

    def reference_at(self, sample: int) -> int:
        """Return the commanded position in whole counts, 32 bits."""
        return fixed.wrap_counts(fixed.round_half_up(self.command_at(sample)))

    def actual_at(self, sample: int) -> int:
        """Return the encoder position: that of the command `lag` samples before, or the frozen one (D63)."""
        return self.frozen if self.frozen is not None else self.reference_at(sample - self.lag)

    def actual_between(self, instant: float) -> int:
        """Return the encoder position at an instant, which may lie between samples."""
        if self.frozen is not None:
            return self.frozen
        return fixed.wrap_counts(fixed.round_half_up(self.command_at(instant - self.lag)))

    def report_counts(self, counts: int) -> int:
        """Return `counts` in the cycle of a cam."""
        if self.turned is not None:
            return counts - self.turned()
        return counts % self.modulus if self.modulus else counts

    def follower_travel(self, at: float, *, commanded: bool) -> float:
        """Return the position that a follower sees: it does not jump when the position is redefined."""
        if commanded or self.virtual:
            return self.command_at(at) - self.shift
        return (self.frozen if self.frozen is not None else self.command_at(at - self.lag)) - self.shift

    def physical_at(self, sample: int) -> int:
        """Return the physical position: 0 at power-up, not changed by redefinitions."""
        return self.actual_at(sample) - self.physical_zero

    def physical_between(self, instant: float) -> float:
        """Return the physical position at an instant between samples: on the profile while it follows its command."""
        if self.frozen is None and self.command_velocity(instant - self.lag) != 0.0:
            return self.command_at(instant - self.lag) - self.physical_zero
        return float(self.actual_between(instant) - self.physical_zero)

    def stand_at(self, sample: int, position: float) -> None:
        """Stand at `position` (before gearing) from `sample` on."""
        self.profile = VelocityProfile(sample, position)
        self.path = self.profile
        self.mode = ""
        self.stopping = False
        self.end = self.watch = inf

    def take_gear_share(self, at: int) -> float:
        """Return the commanded position and count what gearing has added to it as the axis's own, so that targets are
        absolute (L8210). The gear continues from 0."""
        position = self.command_at(at)
        self.gear.restart_count(at)
        return position

    def define_position(self, sample: int, counts: int) -> None:
        """`DP`: set command and encoder to `counts` (L4227)."""
        self.shift += counts - self.reference_at(sample)
        self.physical_zero += counts - (self.frozen if self.frozen is not None else self.reference_at(sample))
        self.gear.restart_count(sample)
        self.stand_at(sample, counts)
        if self.frozen is not None:
            self.frozen = counts

    def freeze_motor(self, sample: int) -> None:
        """Stop following the command."""
        if self.frozen is None:
            self.frozen = self.reference_at(sample)

    def thaw_motor(self) -> None:
        if not self.stalled and (not self.motor_off or self.virtual):
            self.frozen = None

    def position_error(self, sample: int) -> int:
        """Return the position error: commanded minus actual (L10487)."""
        return self.reference_at(sample) - self.actual_at(sample)

    @property
    def only_follows(self) -> bool:
        """Return whether it is moved by gearing alone, which a limit ends (L5543)."""
        return self.gear.is_engaged and not self.gear.gantry and not self.is_moving

    @property
    def error_limit(self) -> int:
        """Return the largest position error without a reaction, `ER`; 0 for none."""
        return fixed.to_integer(self.registers["ER"])

    def exceeds_error_limit(self, error: int) -> bool:
        """Return whether a position error is beyond ER, for a servo that is on (L4962)."""
        limit = self.error_limit
        return bool(limit) and not self.virtual and not self.motor_off and abs(error) > limit
