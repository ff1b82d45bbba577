"""Modes of operation: profile position, profile velocity, interpolated and cyclic synchronous position (CiA 402-2).

A mode acts only while the drive is in the state ENABLED.
"""

import math
from dataclasses import dataclass

from orchestrator.clock.base import ClockTimer
from sim.cia402.dictionary import DriveDictionary
from sim.cia402.profile import to_speed, to_target
from sim.cia402.servo import UNLIMITED, ServoMotor

PROFILE_POSITION, PROFILE_VELOCITY, HOMING, INTERPOLATED, CYCLIC = 1, 3, 6, 7, 8

HALT = 0x100
START = 0x10
_IMMEDIATELY = 0x20
_RELATIVE = 0x40

REACHED = 0x400
ACKNOWLEDGED = SPEED_ZERO = ACTIVE = FOLLOWS = 0x1000
FOLLOWING_ERROR = 0x2000


class OperationMode:
    """Interface from the drive to its mode of operation.

    bits: the bits of the statusword that the mode defines."""

    def __init__(self, dictionary: DriveDictionary, servo: ServoMotor) -> None:
        self.dictionary = dictionary
        self.servo = servo

    def enter_mode(self) -> None:
        """Enter the mode: the drive becomes enabled in it."""

    def leave_mode(self) -> None:
        """Leave the mode."""

    def handle_controlword(self, word: int, rising: int) -> None:
        """Process a controlword; `rising` has the bits that were 0 in the one before."""
        del word, rising

    def resume_motion(self) -> None:
        """Resume after a halt."""

    def handle_sync(self) -> None:
        """Process SYNC; the synchronous PDOs are in their objects."""

    def handle_motion_end(self) -> None:
        """Handle the end of a motion."""

    def handle_limit(self, sign: int) -> bool:
        """Handle a limit switch that the motor reaches. Return True if the mode has handled it."""
        del sign
        return False

    @property
    def status_bits(self) -> int:
        return 0


@dataclass(frozen=True, slots=True)
class _PositionSetPoint:
    target: float
    velocity: float
    up: float
    down: float


class ProfilePosition(OperationMode):
    """Set-points one at a time, or the next one while the present one is in progress."""

    def enter_mode(self) -> None:
        self._now: _PositionSetPoint | None = None
        self._next: _PositionSetPoint | None = None
        self._acknowledged = False

    leave_mode = enter_mode

    def handle_controlword(self, word: int, rising: int) -> None:
        if rising & START:
            self._offer_set_point(word)
        elif not word & START:
            self._acknowledged = self._next is not None

    def _offer_set_point(self, word: int) -> None:
        if self._next is not None:
            return  # the buffer is full: not acknowledged
        point = self._read_set_point(relative=bool(word & _RELATIVE))
        self._acknowledged = True
        if word & _IMMEDIATELY or not self.servo.is_busy:
            self._begin_set_point(point)
        else:
            self._next = point

    def _read_set_point(self, *, relative: bool) -> _PositionSetPoint:
        get, servo = self.dictionary.get_value, self.servo
        target = float(get(0x607A))
        if relative:
            point_before = self._next or self._now
            code = get(0x60F2) & 3
            target += (
                servo.actual_position
                if code == 2
                else servo.demand_position
                if code == 1 or point_before is None
                else point_before.target
            )
        clipped_target = servo.clip_target(target)
        if clipped_target != target:
            servo.internal_limit = True
        velocity = servo.read_velocity(0x6081)
        if get(0x607F) != UNLIMITED:
            velocity = min(velocity, servo.read_velocity(0x607F))
        up, down = servo.read_acceleration(0x6083), servo.read_acceleration(0x6084)
        return _PositionSetPoint(clipped_target, velocity, up, down)

    def _begin_set_point(self, point: _PositionSetPoint) -> None:
        self._now = point
        if point.velocity > 0:
            self.servo.run_at_tick(self._start_motion)

    def _start_motion(self) -> None:
        point, servo = self._now, self.servo
        if point is not None:
            servo.follow_plan(
                to_target(
                    servo.demand_speed, point.target - servo.demand_position, point.velocity, point.up, point.down
                )
            )

    def resume_motion(self) -> None:
        # A set-point at the present position causes no motion.
        if self._now is not None and (self.servo.demand_speed or self._now.target != self.servo.demand_position):
            self.servo.run_at_tick(self._start_motion)

    def handle_motion_end(self) -> None:
        if self._next is not None:
            point, self._next = self._next, None
            self._acknowledged = False
            self._begin_set_point(point)

    @property
    def status_bits(self) -> int:
        has_arrived = self._next is None and self.servo.is_settled()
        return ACKNOWLEDGED * self._acknowledged | REACHED * has_arrived | FOLLOWING_ERROR * self.servo.is_stuck


class ProfileVelocity(OperationMode):
    """The target velocity is followed as soon as it is written."""

    def enter_mode(self) -> None:
        self.resume_motion()

    def leave_mode(self) -> None:
        """Keep no state."""

    def resume_motion(self) -> None:
        self.servo.run_at_tick(self._start_motion)

    def _start_motion(self) -> None:
        servo = self.servo
        target = servo.read_velocity(0x60FF)
        if self.dictionary.get_value(0x607F) != UNLIMITED:
            speed_limit = servo.read_velocity(0x607F)
            target = min(max(target, -speed_limit), speed_limit)
        up, down = servo.read_acceleration(0x6083), servo.read_acceleration(0x6084)
        end = servo.clip_target(math.copysign(math.inf, target))
        if target and not math.isinf(end):
            plan = to_target(servo.demand_speed, end - servo.demand_position, abs(target), up, down)
        elif target or servo.demand_speed:
            plan = to_speed(servo.demand_speed, target, up, down)
        else:
            return
        servo.follow_plan(plan)

    def handle_motion_end(self) -> None:
        self.servo.internal_limit |= self.dictionary.get_value(0x60FF) != 0

    @property
    def status_bits(self) -> int:
        speed = self.servo.demand_speed
        is_at_speed = abs(self.servo.read_velocity(0x60FF) - speed) <= max(0.5, self.servo.read_velocity(0x606D))
        still_speeding_up = self.servo.is_busy and speed == 0
        return REACHED * (is_at_speed and not still_speeding_up) | SPEED_ZERO * (speed == 0)


class InterpolatedPosition(OperationMode):
    """Positions that arrive with SYNC; the motor moves linearly to each within one interpolation time period.

    cyclic: cyclic synchronous position; otherwise interpolated position, which follows only while bit 4 is set.
    lost: called when SYNC has been missing for too long.
    """

    def __init__(self, dictionary: DriveDictionary, servo: ServoMotor, missed: int, *, cyclic: bool) -> None:
        super().__init__(dictionary, servo)
        self._key = (0x607A, 0) if cyclic else (0x60C1, 1)
        self._cyclic = cyclic
        self._missed = missed
        self._on = False
        self._watchdog: ClockTimer | None = None
        self.sync_lost = lambda: None

    def enter_mode(self) -> None:
        """Set the target to the present position until a client writes another one."""
        self._on = self._cyclic
        self.servo.mover.set_interpolating(on=True)
        self.dictionary.put_value(*self._key, round(self.servo.demand_position))

    def leave_mode(self) -> None:
        self._on = False
        self.servo.mover.set_interpolating(on=False)
        self._cancel_watchdog()

    def handle_controlword(self, word: int, rising: int) -> None:
        if not self._cyclic:
            self._on = bool(word & START)
        if not self._on or word & HALT:
            self._cancel_watchdog()

    def handle_sync(self) -> None:
        if not self._on:
            return
        servo = self.servo
        target = float(
            self.dictionary.get_value(*self._key) + (self.dictionary.get_value(0x60B0) if self._cyclic else 0)
        )
        clipped_target = servo.clip_target(target)
        servo.internal_limit = clipped_target != target
        servo.run_at_tick(lambda: self._follow_target(clipped_target))
        self._cancel_watchdog()
        self._watchdog = servo.time.call_after(self._missed * servo.period_ns(), self._handle_missing_sync)

    def _follow_target(self, target: float) -> None:
        servo = self.servo
        negative, positive = servo.terminals.limit_states(servo.mechanical_position)
        distance = target - servo.demand_position
        if (distance < 0 and negative) or (distance > 0 and positive):
            servo.internal_limit = True
            return
        servo.mover.follow_target(target - servo.offset, servo.period_s())

    def _handle_missing_sync(self) -> None:
        # At standstill a missing SYNC does no harm.
        if self.servo.mover.is_running:
            self.sync_lost()

    def _cancel_watchdog(self) -> None:
        if self._watchdog is not None:
            self._watchdog.cancel()
            self._watchdog = None

    @property
    def status_bits(self) -> int:
        reach_bit = REACHED * (not self._cyclic and not self.servo.mover.is_running)
        return ACTIVE * self._on | reach_bit | FOLLOWING_ERROR * self.servo.is_stuck
