"""Modes of operation: profile position, profile velocity, interpolated and cyclic synchronous position (CiA 402-2).

A mode acts only while the drive is in the state ENABLED.
"""

import math
from dataclasses import dataclass

from orchestrator.clock.base import Timer
from sim.cia402.dictionary import Dictionary
from sim.cia402.profile import to_speed, to_target
from sim.cia402.servo import UNLIMITED, Servo

PROFILE_POSITION, PROFILE_VELOCITY, HOMING, INTERPOLATED, CYCLIC = 1, 3, 6, 7, 8

HALT = 0x100
START = 0x10
_IMMEDIATELY = 0x20
_RELATIVE = 0x40

REACHED = 0x400
ACKNOWLEDGED = SPEED_ZERO = ACTIVE = FOLLOWS = 0x1000
FOLLOWING_ERROR = 0x2000


class Mode:
    """What the drive tells its mode. `bits` are those of the statusword that belong to it."""

    def __init__(self, dictionary: Dictionary, servo: Servo) -> None:
        self.dictionary = dictionary
        self.servo = servo

    def enter(self) -> None:
        """The drive is enabled in this mode from now on."""

    def leave(self) -> None:
        """It is not any more."""

    def control(self, word: int, rising: int) -> None:
        """A controlword; `rising` has the bits that were 0 in the one before."""
        del word, rising

    def resume(self) -> None:
        """Halt is over."""

    def sync(self) -> None:
        """SYNC has come, and synchronous PDOs are in their objects."""

    def ended(self) -> None:
        """The motor has come to rest."""

    def limit(self, sign: int) -> bool:
        """The motor runs into a limit switch. True: this mode has dealt with it."""
        del sign
        return False

    @property
    def bits(self) -> int:
        return 0


@dataclass(frozen=True, slots=True)
class _SetPoint:
    target: float
    velocity: float
    up: float
    down: float


class ProfilePosition(Mode):
    """Set-points one at a time, or the next one while the present one is under way."""

    def enter(self) -> None:
        self._now: _SetPoint | None = None
        self._next: _SetPoint | None = None
        self._acknowledged = False

    leave = enter

    def control(self, word: int, rising: int) -> None:
        if rising & START:
            self._offer(word)
        elif not word & START:
            self._acknowledged = self._next is not None

    def _offer(self, word: int) -> None:
        if self._next is not None:
            return  # the buffer is full: not acknowledged
        point = self._read(bool(word & _RELATIVE))
        self._acknowledged = True
        if word & _IMMEDIATELY or not self.servo.busy:
            self._begin(point)
        else:
            self._next = point

    def _read(self, relative: bool) -> _SetPoint:
        get, servo = self.dictionary.get, self.servo
        target = float(get(0x607A))
        if relative:
            before = self._next or self._now
            code = get(0x60F2) & 3
            target += servo.actual if code == 2 else servo.demand if code == 1 or before is None else before.target
        inside = servo.clipped(target)
        if inside != target:
            servo.internal_limit = True
        velocity = servo.velocity(0x6081)
        if get(0x607F) != UNLIMITED:
            velocity = min(velocity, servo.velocity(0x607F))
        up, down = servo.acceleration(0x6083), servo.acceleration(0x6084)
        return _SetPoint(inside, velocity, up, down)

    def _begin(self, point: _SetPoint) -> None:
        self._now = point
        if point.velocity > 0:
            self.servo.at_tick(self._go)

    def _go(self) -> None:
        point, servo = self._now, self.servo
        if point is not None:
            servo.go(to_target(servo.speed, point.target - servo.demand, point.velocity, point.up, point.down))

    def resume(self) -> None:
        # Who stands at its target already does not move.
        if self._now is not None and (self.servo.speed or self._now.target != self.servo.demand):
            self.servo.at_tick(self._go)

    def ended(self) -> None:
        if self._next is not None:
            point, self._next = self._next, None
            self._acknowledged = False
            self._begin(point)

    @property
    def bits(self) -> int:
        arrived = self._next is None and self.servo.settled()
        return ACKNOWLEDGED * self._acknowledged | REACHED * arrived | FOLLOWING_ERROR * self.servo.stuck


class ProfileVelocity(Mode):
    """The target velocity is followed as soon as it is written."""

    def enter(self) -> None:
        self.resume()

    def leave(self) -> None:
        """Nothing is kept."""

    def resume(self) -> None:
        self.servo.at_tick(self._go)

    def _go(self) -> None:
        servo = self.servo
        target = servo.velocity(0x60FF)
        if self.dictionary.get(0x607F) != UNLIMITED:
            most = servo.velocity(0x607F)
            target = min(max(target, -most), most)
        up, down = servo.acceleration(0x6083), servo.acceleration(0x6084)
        end = servo.clipped(math.copysign(math.inf, target))
        if target and not math.isinf(end):
            plan = to_target(servo.speed, end - servo.demand, abs(target), up, down)
        elif target or servo.speed:
            plan = to_speed(servo.speed, target, up, down)
        else:
            return
        servo.go(plan)

    def ended(self) -> None:
        self.servo.internal_limit |= self.dictionary.get(0x60FF) != 0

    @property
    def bits(self) -> int:
        speed = self.servo.speed
        reached = abs(self.servo.velocity(0x60FF) - speed) <= max(0.5, self.servo.velocity(0x606D))
        still_speeding_up = self.servo.busy and speed == 0
        return REACHED * (reached and not still_speeding_up) | SPEED_ZERO * (speed == 0)


class Interpolated(Mode):
    """Positions that come with SYNC; the motor goes there in a straight line within one interpolation time period.

    cyclic: cyclic synchronous position; else interpolated position, which follows only while bit 4 is set. lost: SYNC
    has not come for too long.
    """

    def __init__(self, dictionary: Dictionary, servo: Servo, cyclic: bool, missed: int) -> None:
        super().__init__(dictionary, servo)
        self._key = (0x607A, 0) if cyclic else (0x60C1, 1)
        self._cyclic = cyclic
        self._missed = missed
        self._on = False
        self._watchdog: Timer | None = None
        self.lost = lambda: None

    def enter(self) -> None:
        """The target is where the motor stands until a client says otherwise."""
        self._on = self._cyclic
        self.servo.mover.interpolate(True)
        self.dictionary.put(*self._key, round(self.servo.demand))

    def leave(self) -> None:
        self._on = False
        self.servo.mover.interpolate(False)
        self._quiet()

    def control(self, word: int, rising: int) -> None:
        if not self._cyclic:
            self._on = bool(word & START)
        if not self._on or word & HALT:
            self._quiet()

    def sync(self) -> None:
        if not self._on:
            return
        servo = self.servo
        target = float(self.dictionary.get(*self._key) + (self.dictionary.get(0x60B0) if self._cyclic else 0))
        inside = servo.clipped(target)
        servo.internal_limit = inside != target
        servo.at_tick(lambda: self._follow(inside))
        self._quiet()
        self._watchdog = servo.time.call_after(self._missed * servo.period_ns(), self._starved)

    def _follow(self, target: float) -> None:
        servo = self.servo
        negative, positive = servo.terminals.limits(servo.mechanical)
        way = target - servo.demand
        if (way < 0 and negative) or (way > 0 and positive):
            servo.internal_limit = True
            return
        servo.mover.follow(target - servo.offset, servo.period_s())

    def _starved(self) -> None:
        # At rest nobody is harmed when SYNC ends.
        if self.servo.mover.running:
            self.lost()

    def _quiet(self) -> None:
        if self._watchdog is not None:
            self._watchdog.cancel()
            self._watchdog = None

    @property
    def bits(self) -> int:
        reached = REACHED * (not self._cyclic and not self.servo.mover.running)
        return ACTIVE * self._on | reached | FOLLOWING_ERROR * self.servo.stuck
