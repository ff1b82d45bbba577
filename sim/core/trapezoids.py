"""An axis that moves in trapezoids, in the time of its controller's crystal, with its ground truth."""

from collections.abc import Callable
from math import sqrt

from orchestrator.clock.base import NS_PER_S, ClockTimer
from sim.core.controller import CommandedMotion
from sim.core.devicetime import DeviceTime
from sim.core.ramps import RampSegment


class TrapezoidAxis:
    """One axis. record: the list that gets its motions. on_rest: called when a motion has ended."""

    def __init__(
        self, time: DeviceTime, name: str, record: list[CommandedMotion], on_rest: Callable[[], None] = lambda: None
    ) -> None:
        self.name = name
        self.on_rest = on_rest
        self._time = time
        self._record = record
        self._legs: list[RampSegment] = []
        self._start_ns = 0
        self._end_s = 0.0
        self._rest = 0.0
        self._target = 0.0
        self._acceleration = 1.0
        self._timer: ClockTimer | None = None
        self._motion: CommandedMotion | None = None
        self._origin = 0.0

    @property
    def is_moving(self) -> bool:
        return self._motion is not None

    @property
    def position(self) -> float:
        """The position register now."""
        if not self.is_moving:
            return self._rest
        return self._leg_at(self._now_s()).x_at(min(self._now_s(), self._end_s))

    @property
    def velocity(self) -> float:
        """Velocity now, per second of the controller's crystal."""
        if not self.is_moving or self._now_s() >= self._end_s:
            return 0.0
        return self._leg_at(self._now_s()).v_at(self._now_s())

    @property
    def true_velocity(self) -> float:
        """Velocity now, per true second."""
        return self.velocity * self._time.clock_rate()

    @property
    def physical_position(self) -> float:
        """Where the axis is, independent of its register."""
        return self.position + self._origin

    def set_position(self, value: float) -> None:
        """Set the register of an axis at rest; the axis does not move."""
        self._origin += self._rest - value
        self._rest = value

    def start_move(self, target: float, velocity: float, acceleration: float) -> None:
        """Move from rest to `target`; the speed is lower where the distance is too short for it."""
        start = self.position
        distance = abs(target - start)
        if distance == 0:
            return
        sign = 1 if target > start else -1
        peak = min(velocity, sqrt(distance * acceleration))
        ramp_s = peak / acceleration
        cruise_s = distance / peak - ramp_s
        top = sign * peak
        position_after = start + sign * peak * ramp_s / 2
        self._legs = [
            RampSegment(0.0, start, 0.0, sign * acceleration),
            RampSegment(ramp_s, position_after, top, 0.0),
            RampSegment(ramp_s + cruise_s, position_after + top * cruise_s, top, -sign * acceleration),
        ]
        self._begin(target, 2 * ramp_s + cruise_s, acceleration)

    def _begin(self, target: float, end_s: float, acceleration: float) -> None:
        self._start_ns = self._time.now_ns()
        self._target, self._end_s, self._acceleration = target, end_s, acceleration
        self._motion = CommandedMotion(self.name, self._time.clock.now_ns(), self.position)
        self._record.append(self._motion)
        self._set_timer()

    def brake(self, acceleration: float | None = None) -> None:
        """Slow down to rest, with the acceleration of the motion or another one."""
        motion = self._motion
        if motion is None or motion.slowing_ns is not None:
            return
        now_s, velocity, position = self._now_s(), self.velocity, self.position
        slope = self._acceleration if acceleration is None else acceleration
        took_s = abs(velocity) / slope
        self._legs = [RampSegment(now_s, position, velocity, -slope if velocity > 0 else slope)]
        self._end_s = now_s + took_s
        self._target = float(round(position + velocity * took_s / 2))
        motion.slowing_ns = self._time.clock.now_ns()
        self._set_timer()

    def halt(self) -> None:
        """Stop dead."""
        if self._motion is not None:
            self._target = float(round(self.position))
            self._finish()

    def _set_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        end_ns = self._start_ns + round(self._end_s * NS_PER_S)
        self._timer = self._time.call_at(max(end_ns, self._time.now_ns()), self._finish)

    def _finish(self) -> None:
        motion, self._motion = self._motion, None
        if self._timer is not None:
            self._timer.cancel()
        self._rest = self._target
        if motion is not None:
            motion.end_ns, motion.end_counts = self._time.clock.now_ns(), self._target
            self.on_rest()

    def _now_s(self) -> float:
        return (self._time.now_ns() - self._start_ns) / NS_PER_S

    def _leg_at(self, time_s: float) -> RampSegment:
        return next((leg for leg in reversed(self._legs) if leg.t <= time_s), self._legs[0])
