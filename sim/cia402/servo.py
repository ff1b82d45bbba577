"""The motor under the control loop: user's units, limits, following error, and target reached."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from sim.cia402.dictionary import DriveDictionary
from sim.cia402.mover import MotionGenerator, PositionMark
from sim.cia402.options import DriveOptions
from sim.cia402.profile import MotionPlan, to_rest
from sim.cia402.terminals import DriveTerminals
from sim.core.devicetime import DeviceTime

AXIS = "1"
UNLIMITED = 0xFFFF_FFFF
"""Value that switches off a following error window, and other objects."""


@dataclass(frozen=True, slots=True)
class ServoEvents:
    """Calls of the motor.

    changed: a value visible to clients has changed.
    ended: a motion has ended.
    limit: the motor reaches a limit switch (-1 negative, 1 positive).
    strayed: the following error has been too large for too long.
    """

    changed: Callable[[], None]
    ended: Callable[[], None]
    limit: Callable[[int], None]
    strayed: Callable[[], None]


class ServoMotor:
    """Motor and control loop of one drive."""

    def __init__(
        self,
        dictionary: DriveDictionary,
        time: DeviceTime,
        options: DriveOptions,
        phase_ns: int,
        events: ServoEvents,
    ) -> None:
        self._dictionary = dictionary
        self._options = options
        self._phase_ns = phase_ns
        self._changed = events.changed
        self._ended = events.ended
        self._limit = events.limit
        self._strayed = events.strayed
        self._stuck_at: float | None = None
        self._pending = 0
        self._orders = 0
        self._rested_ns = 0
        self.time = time
        self.offset = 0.0
        """Offset from mechanical to the user's positions; set by homing."""
        self.internal_limit = False
        """Bit 11 of the statusword."""
        self.wanted: list[PositionMark] = []
        """Positions that a homing searches for."""
        self.terminals = DriveTerminals(options, events.changed)
        self.mover = MotionGenerator(time, AXIS, self._collect_marks, self._handle_rest)
        self.mover.shift = lambda: self.offset

    # Values, in the user's units

    @property
    def demand_position(self) -> float:
        return self.mover.current_position + self.offset

    @property
    def mechanical_position(self) -> float:
        """Actual mechanical position of the motor."""
        return self.mover.current_position if self._stuck_at is None else self._stuck_at

    @property
    def actual_position(self) -> float:
        return self.mechanical_position + self.offset

    @property
    def demand_speed(self) -> float:
        """Commanded speed, per second of the drive's crystal."""
        return self.mover.current_speed

    @property
    def is_busy(self) -> bool:
        """Return whether it moves, or will with one of the next ticks."""
        return self.mover.is_moving or self._pending > 0

    @property
    def is_stuck(self) -> bool:
        return self._stuck_at is not None

    def read_velocity(self, index: int, sub: int = 0) -> float:
        """Return an object in velocity units, as units per second."""
        return self._read_scaled(index, sub, 0x6096)

    def read_acceleration(self, index: int) -> float:
        """Return an object in acceleration units, as units per second squared; without 6084h, 6083h in its place."""
        if index == 0x6084 and not self._dictionary.has_object(index):
            index = 0x6083
        return self._read_scaled(index, 0, 0x6097)

    def velocity_units(self, speed: float) -> int:
        return round(speed * self._dictionary.get_value(0x6096, 2) / self._dictionary.get_value(0x6096, 1))

    def _read_scaled(self, index: int, sub: int, factor: int) -> float:
        get = self._dictionary.get_value
        return get(index, sub) * get(factor, 1) / get(factor, 2)

    def clip_target(self, target: float) -> float:
        """Return the nearest position within the software limits (0x607D; none when the lower is not below the
        upper)."""
        low, high = self._dictionary.get_value(0x607D, 1), self._dictionary.get_value(0x607D, 2)
        if low >= high:
            return target
        return min(max(target, low), high)

    # Orders

    def run_at_tick(self, action: Callable[[], None]) -> None:
        """Run `action` in the next tick of the control loop, unless another order replaces it."""
        cycle_ns = self._options.cycle_us * NS_PER_US
        now_ns = self.time.now_ns()
        at_ns = now_ns + (self._phase_ns - now_ns) % cycle_ns
        self._orders += 1
        self._pending = order = self._orders

        def run_action() -> None:
            if self._pending == order:
                self._pending = 0
                action()
                self._changed()

        if at_ns == now_ns:
            run_action()
        else:
            self.time.call_at(at_ns, run_action)

    def cancel_order(self) -> None:
        """Cancel the order for the next tick."""
        self._pending = 0

    def follow_plan(self, plan: MotionPlan, *, slowing: bool = False) -> None:
        """Follow `plan` from now on, unless a pressed limit switch forbids it."""
        direction = plan.distance if plan.distance else plan.segments[0].v
        negative, positive = self.terminals.limit_states(self.mechanical_position)
        if not slowing and ((direction < 0 and negative) or (direction > 0 and positive)):
            self._limit(-1 if direction < 0 else 1)
            return
        if not slowing:
            self.internal_limit = False
        self.mover.start_plan(plan, slowing=slowing)
        self._changed()

    def slow_down(self, rate: float) -> None:
        """Decelerate to standstill, from the next tick on."""

        def start_ramp() -> None:
            if self.mover.is_moving:
                self.follow_plan(to_rest(self.demand_speed, rate), slowing=True)

        self.run_at_tick(start_ramp)

    def switch_off(self) -> None:
        """Switch the power stage off: the motor stands still, and the demand becomes its position."""
        if self.is_busy:
            self._rested_ns = self.time.now_ns()
            self.time.call_after(self._settle_ns(), self._changed)
        self.cancel_order()
        self.mover.set_interpolating(on=False)
        self.mover.halt_dead()
        self.mover.set_position(self.mechanical_position)

    def _handle_rest(self) -> None:
        self._rested_ns = self.time.now_ns()
        self.time.call_after(self._settle_ns(), self._changed)
        self._ended()
        self._changed()

    # Target reached

    def _settle_ns(self) -> int:
        return self._options.settle_us * NS_PER_US + self._dictionary.get_value(0x6068) * NS_PER_MS

    def is_settled(self) -> bool:
        """Return whether the motor has been at rest in the position window for long enough."""
        if self.is_busy or self.time.now_ns() < self._rested_ns + self._settle_ns():
            return False
        return abs(self.demand_position - self.actual_position) <= self._dictionary.get_value(0x6067)

    # Environment

    def set_stalled(self, *, stalled: bool) -> None:
        self._stuck_at = self.mechanical_position if stalled else None
        self.mover.recheck_marks()
        self._changed()

    def push_motor(self, distance: float) -> None:
        if self._stuck_at is not None:
            self._stuck_at += distance
        self.mover.set_position(self.mover.current_position + distance)
        self._changed()

    def _collect_marks(self) -> list[PositionMark]:
        marks = self.terminals.position_marks(self._limit) + self.wanted
        window = self._dictionary.get_value(0x6065)
        if self._stuck_at is not None and window != UNLIMITED:
            marks += [
                PositionMark(self._stuck_at + sign * window, sign, self._watch_following_error) for sign in (-1, 1)
            ]
        return marks

    def _watch_following_error(self) -> None:
        def report_error() -> None:
            # Compared in whole units, as 0x60F4 reports it: at the edge of the window the error equals its width.
            if self._stuck_at is not None and round(
                abs(self.demand_position - self.actual_position)
            ) >= self._dictionary.get_value(0x6065):
                self._strayed()

        self.time.call_after(self._dictionary.get_value(0x6066) * NS_PER_MS, report_error)

    def period_s(self) -> float:
        """Interpolation time period, 0x60C2."""
        return self._dictionary.get_value(0x60C2, 1) * 10.0 ** self._dictionary.get_value(0x60C2, 2)

    def period_ns(self) -> int:
        return math.ceil(self.period_s() * NS_PER_S)
