"""Velocity profiles of one coordinate in closed form: pieces of constant acceleration, and smoothing over them.

Time is in samples, position in counts; so is everything derived (counts/sample, counts/sample^2). A register of
SP counts/s is SP/1024 counts/sample, one of AC counts/s^2 is AC/1048576 counts/sample^2 (L2293, L10032).
"""

from bisect import bisect_right
from dataclasses import dataclass
from math import ceil, exp, inf, log, sqrt

SPEED_UNIT = 1.0 / 1024
ACCELERATION_UNIT = 1.0 / 1048576
_TINY = 1e-6
_KEPT = 400  # samples of the past that stay readable: TV averages over 256 (L11021)


class VelocityProfile:
    """Position over time. Before its start it stands at its first position, after its end at its last."""

    __slots__ = ("_acc", "_lag", "_pos", "_start", "_vel", "end", "end_position", "end_velocity", "rate")

    def __init__(self, at: float, position: float, smoothing: float = 1.0, velocity: float = 0.0) -> None:
        self._start: list[float] = [at]
        self._pos: list[float] = [position]
        self._vel: list[float] = [velocity]
        self._acc: list[float] = [0.0]
        self._lag: list[float] = [0.0]
        self.end = at
        self.end_position = position
        self.end_velocity = velocity
        self.rate = -log(1.0 - smoothing) if smoothing < 1.0 else 0.0

    def append_piece(self, duration: float, acceleration: float) -> None:
        """Append a piece; `duration` may be infinite."""
        if duration <= 0.0:
            return
        start, position, velocity = self.end, self.end_position, self.end_velocity
        if self._start[-1] == start:
            self._pos[-1], self._vel[-1], self._acc[-1] = position, velocity, acceleration
        else:
            lag = self._lag_at(len(self._start) - 1, start) if self.rate else 0.0
            self._start.append(start)
            self._pos.append(position)
            self._vel.append(velocity)
            self._acc.append(acceleration)
            self._lag.append(lag)
        self.end = start + duration
        if duration != inf:
            self.end_position = position + velocity * duration + 0.5 * acceleration * duration * duration
            self.end_velocity = velocity + acceleration * duration

    def land_at(self, position: float) -> None:
        """End the profile exactly at `position`, at standstill."""
        self.end_position, self.end_velocity = position, 0.0

    def cut_after(self, at: float) -> None:
        """Discard the profile after `at`, so that pieces can be appended there from its state."""
        if at >= self.end:
            self.append_piece(at - self.end, 0.0)
            return
        index = max(bisect_right(self._start, at) - 1, 0)
        at = max(at, self._start[0])
        t = at - self._start[index]
        self.end = at
        self.end_position = self._pos[index] + self._vel[index] * t + 0.5 * self._acc[index] * t * t
        self.end_velocity = self._vel[index] + self._acc[index] * t
        keep = max(bisect_right(self._start, at - _KEPT) - 1, 0)
        for pieces in (self._start, self._pos, self._vel, self._acc, self._lag):
            del pieces[index + 1 :]
            del pieces[:keep]

    def shift_rest(self, distance: float) -> None:
        """Shift the rest of the profile by `distance` at once."""
        self._pos[-1] += distance
        self.end_position += distance

    def position(self, at: float) -> float:
        """Return the smoothed position at a time."""
        if at >= self.end:
            if self.rate and at < self.settled_time():
                return self.end_position - self._lag_at(len(self._start) - 1, self.end) * exp(
                    -self.rate * (at - self.end)
                )
            return self.end_position
        index = bisect_right(self._start, at) - 1
        if index < 0:
            return self._pos[0]
        t = at - self._start[index]
        position = self._pos[index] + self._vel[index] * t + 0.5 * self._acc[index] * t * t
        return position - self._lag_at(index, at) if self.rate else position

    def velocity(self, at: float) -> float:
        """Return the smoothed velocity at a time."""
        if self.rate:
            return 0.0 if at >= self.settled_time() else self.position(at + 0.5) - self.position(at - 0.5)
        return self.planned_velocity(at)

    def planned_velocity(self, at: float) -> float:
        """Return the velocity before smoothing, which AS, AD and AR evaluate (L6327)."""
        if at >= self.end:
            return 0.0
        index = bisect_right(self._start, at) - 1
        return self._vel[index] + self._acc[index] * (at - self._start[index]) if index >= 0 else 0.0

    def is_steady(self, at: float) -> bool:
        """Return whether the speed is constant; before its start a profile is as at its start."""
        return self.acceleration_at(max(at, self._start[0])) == 0.0

    def acceleration_at(self, at: float) -> float:
        index = bisect_right(self._start, at) - 1
        return self._acc[index] if index >= 0 and at < self.end else 0.0

    def settled_time(self) -> float:
        """Return when the last position has been commanded: after the end, the smoothing residue falls below one
        count."""
        if not self.rate or self.end == inf:
            return self.end
        residue = abs(self._lag_at(len(self._start) - 1, self.end))
        return self.end + log(residue) / self.rate if residue > 1.0 else self.end

    def last_sample(self) -> float:
        """Return the sample at which the last position is commanded; infinite when the profile has no end."""
        settle_time = self.settled_time()
        return inf if settle_time == inf else ceil(settle_time - _TINY)

    def break_times(self, after: float) -> list[float]:
        """Return the times after which the profile may change direction, in order, the last one perhaps infinite."""
        times: list[float] = []
        for index in range(max(bisect_right(self._start, after) - 1, 0), len(self._start)):
            start = self._start[index]
            stop = self._start[index + 1] if index + 1 < len(self._start) else self.end
            if self._acc[index]:
                turn = start - self._vel[index] / self._acc[index]
                if start < turn < stop:
                    times.append(turn)
            times.append(stop)
        if self.rate and self.end != inf:
            times.append(self.settled_time())
        return [time for time in times if time > after]

    def _lag_at(self, index: int, at: float) -> float:
        """Return the lag of the smoothed position: a one-pole low pass of the velocity."""
        rate, t = self.rate, at - self._start[index]
        slope = self._acc[index] / rate
        offset = (self._vel[index] - slope) / rate
        return offset + slope * t + (self._lag[index] - offset) * exp(-rate * t)


@dataclass(frozen=True, slots=True)
class MoveSpeeds:
    """Speed, counts/sample, and ramps, counts/sample^2, of a move."""

    speed: float
    up: float
    down: float


def plan_move(profile: VelocityProfile, at: float, target: float, speeds: MoveSpeeds) -> None:
    """Plan from the state at `at` to standstill at `target`; trapezoid, or triangle when `speed` is not reached
    (L12829)."""
    speed, up, down = speeds.speed, speeds.up, speeds.down
    profile.cut_after(at)
    distance = target - profile.end_position
    sign = 1.0 if distance > 0 or (distance == 0 and profile.end_velocity > 0) else -1.0
    length, velocity = abs(distance), profile.end_velocity * sign
    if velocity < 0.0:
        profile.append_piece(-velocity / down, sign * down)
        length, velocity = abs(target - profile.end_position), 0.0
    if length <= 0.0 and velocity == 0.0:
        profile.land_at(target)
        return
    if velocity > speed:
        slow = (velocity - speed) / down
        length -= (velocity + speed) * 0.5 * slow
        profile.append_piece(slow, -sign * down)
        velocity = speed
    if speed <= 0.0:
        profile.append_piece(inf, 0.0)
        return
    peak = sqrt(max((length + velocity * velocity / (2 * up)) / (0.5 / up + 0.5 / down), 0.0))
    peak = max(min(peak, speed), velocity)
    profile.append_piece((peak - velocity) / up, sign * up)
    ramps = (peak * peak - velocity * velocity) / (2 * up) + peak * peak / (2 * down)
    if length - ramps > 1e-9 and peak > 0:
        profile.append_piece((length - ramps) / peak, 0.0)
    if peak > 0:
        profile.append_piece(peak / down, -sign * down)
    profile.land_at(target)


def plan_jog(profile: VelocityProfile, at: float, velocity: float, up: float, down: float) -> None:
    """Plan from the state at `at` to an endless run at `velocity` (L12942)."""
    profile.cut_after(at)
    present = profile.end_velocity
    if present * velocity < 0.0:
        profile.append_piece(abs(present) / down, -present / abs(present) * down)
        profile.end_velocity = present = 0.0
    change = velocity - present
    if change:
        rate = up if abs(velocity) > abs(present) else down
        profile.append_piece(abs(change) / rate, change / abs(change) * rate)
        profile.end_velocity = velocity
    profile.append_piece(inf, 0.0)


def plan_stop(profile: VelocityProfile, at: float, down: float) -> None:
    """Plan from the state at `at` to standstill (L10124)."""
    profile.cut_after(at)
    present = profile.end_velocity
    if present:
        profile.append_piece(abs(present) / down, -present / abs(present) * down)
    profile.land_at(profile.end_position)


def first_sample(profile: VelocityProfile, start: int, threshold: float, *, upward: bool) -> float:
    """Return the first sample >= `start` at which the rounded position is >= (or <=) `threshold`; infinite if never."""
    sign = 1.0 if upward else -1.0
    level = sign * threshold - 0.5 + (0.0 if upward else 1e-9)

    def is_reached(sample: int) -> bool:
        return sign * profile.position(sample) >= level

    if is_reached(start):
        return start
    low = start
    for stop in profile.break_times(start):
        if stop == inf:
            speed = sign * profile.velocity(low + 1)
            base = sign * profile.position(low + 1)
            speed = max(speed, sign * (profile.position(low + 4096) - profile.position(low)) / 4096)
            if speed <= 1e-12:
                return inf
            high = low + 8 + ceil(max(level - base, 0.0) / speed * 1.01)
            high += 0 if is_reached(high) else high - low
        else:
            high = max(ceil(stop - _TINY), low)
        if high > low and is_reached(high):
            while high - low > 1:
                middle = (low + high) // 2
                if is_reached(middle):
                    high = middle
                else:
                    low = middle
            return high
        low = high
    return inf
