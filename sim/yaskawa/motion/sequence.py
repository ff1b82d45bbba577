"""Coordinate systems S and T: queues of segments and the speed along them (L6872-L7077, L11292-L11711)."""

from bisect import bisect_right
from dataclasses import dataclass
from math import inf, sqrt

from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.motion.profile import ACCELERATION_UNIT, SPEED_UNIT, Profile
from sim.yaskawa.motion.segments import Point, Segment

SEGMENTS = 511
LONGEST = 2_000_000_000
_TINY = 1e-9
_KEPT_POINTS = 16


class System:
    """One coordinate system. Registers in counts/s and counts/s^2; time in samples, `s` in counts along the path."""

    def __init__(self, name: str, registers: tuple[int, int, int]) -> None:
        self.name = name
        self.axes: tuple[str, ...] = ()
        self.tangent: str | None = None
        self.linear = True
        self.speed, self.acceleration, self.deceleration = (float(register) for register in registers)
        self.ratio = 1.0
        self.smoothing = 1.0
        self.ellipse = (1.0, 1.0)
        self.ellipse_terms: tuple[int, int] = (1, 1)
        self.tangent_scale = 1.0
        self.tangent_zero = 0.0
        self.running = False
        self.stopping = False
        self.mark = 0.0
        """Path distance that AV counts from."""
        self.start = 0
        self.last_index = 0
        self.length = 0.0
        self.origin: Point = ()
        self.clear()

    def clear(self) -> None:
        """`CS`: an empty queue."""
        self.segments: list[Segment] = []
        self._bounds: list[float] = [0.0]
        self._points: dict[float, Point] = {}
        self.ended = False
        self.profile: Profile | None = None
        self._override: tuple[int, float] | None = None

    def select(self, axes: tuple[str, ...], linear: bool, tangent: str | None = None) -> None:
        """`LM` and `VM`: the axes of the sequence to come."""
        self.clear()
        self.axes, self.linear, self.tangent = axes, linear, tangent

    def tail(self) -> Point:
        """Where the queue ends, in the coordinates of the sequence."""
        return self.segments[-1].end if self.segments else (0.0,) * len(self.axes)

    def add(self, segment: Segment, now: int) -> None:
        """Queue a segment; refused with 30, 31, 32."""
        speed = segment.entry_speed if segment.entry_speed is not None else self.speed
        if segment.length <= 0.0 or segment.length < speed * SPEED_UNIT:
            raise CommandError(30)
        if self._bounds[-1] + segment.length > LONGEST:
            raise CommandError(31)
        if self.free(now) <= 0:
            raise CommandError(32)
        if not self.running and not self.segments:
            self.length = 0.0
        self.segments.append(segment)
        self._bounds.append(self._bounds[-1] + segment.length)
        self.length = self._bounds[-1]
        if self.running:
            self.plan(now)

    def finish(self, now: int) -> None:
        """`LE`, `VE`: no more segments."""
        self.ended = True
        if self.running:
            self.plan(now)

    def free(self, now: int) -> int:
        """Places left in the queue (L6886)."""
        return SEGMENTS - len(self.segments) + (self.index(now) if self.running else 0)

    def begin(self, at: int, origin: Point) -> None:
        """`BG`: the path starts at `at`; `origin` are the axes' positions then, which become 0,0 (L13296)."""
        self.running, self.stopping = True, False
        self.start, self.origin = at, origin
        self.mark = 0.0
        self.profile = Profile(at, 0.0, self.smoothing)
        self.plan(at)

    def travelled(self, at: float) -> float:
        """Path distance at a time."""
        return self.profile.position(at) if self.profile is not None else 0.0

    def velocity(self, at: float) -> float:
        """Along the path, counts/sample."""
        return self.profile.velocity(at) if self.profile is not None else 0.0

    def index(self, at: float) -> int:
        """Number of the segment in execution."""
        if self.profile is None or not self.segments:
            return self.last_index
        return self._index_of(self.travelled(at))

    def point(self, at: float) -> Point:
        """Coordinates of the sequence at a time; kept, because each axis asks for the same instants."""
        found = self._points.get(at)
        if found is None:
            if len(self._points) >= _KEPT_POINTS:
                self._points.clear()
            found = self._points[at] = self.point_along(self.travelled(at))
        return found

    def point_along(self, along: float) -> Point:
        index = self._index_of(along)
        return self.segments[index].point(along - self._bounds[index])

    def heading(self, at: float) -> float:
        along = self.travelled(at)
        index = self._index_of(along)
        return self.segments[index].heading(along - self._bounds[index])

    def intersection(self, at: float) -> Point:
        """Where the segment in execution began."""
        return self.segments[self.index(at)].start if self.segments else (0.0,) * len(self.axes)

    def end(self) -> float:
        """The sample of the last commanded position."""
        return self.profile.last_sample() if self.profile is not None else inf

    def stop(self, at: int) -> None:
        """Decelerate along the path and drop the rest (L13007, D34)."""
        self.stopping = True
        self._points.clear()
        profile = self.profile
        if profile is None:
            return
        profile.cut(at)
        rate = self.deceleration * ACCELERATION_UNIT
        room = self._bounds[-1] - profile.end_position
        speed = profile.end_velocity
        needed = speed * speed / (2 * rate)
        if needed > room:
            time = (speed - sqrt(max(speed * speed - 2 * rate * room, 0.0))) / rate
            profile.extend(time, -rate)
        else:
            profile.extend(speed / rate, -rate)
        profile.land(profile.end_position)

    def plan(self, at: int) -> None:
        """Lay the speed over the path from the state at `at`, with the registers as they are now."""
        profile = self.profile
        self._points.clear()
        if profile is None or self.stopping:
            return
        profile.cut(at)
        up, down = self.acceleration * ACCELERATION_UNIT, self.deceleration * ACCELERATION_UNIT
        index = self._index_of(profile.end_position)
        limits = self._exit_limits(index, down)
        speed = self._speed_before(index)
        for number in range(index, len(self.segments)):
            segment = self.segments[number]
            if segment.entry_speed is not None and number > index:
                speed = segment.entry_speed
            wanted = speed * self.ratio * SPEED_UNIT
            if not self._cross(profile, self._bounds[number + 1], wanted, limits[number - index], up, down):
                return
        profile.land(self._bounds[-1])

    def retarget(self, at: int) -> None:
        """`VS`, `VA`, `VD`, `VR` during motion: they take effect at once (L13037, L13059)."""
        if self.profile is not None and self.running:
            self._override = (self.index(at), self.speed)
        self.plan(at)

    def _speed_before(self, index: int) -> float:
        """The vector speed in force in segment `index`: `VS`, or the last `<n` since (L13037)."""
        first, speed = (0, self.speed) if self._override is None else (self._override[0] + 1, self._override[1])
        for segment in self.segments[first : index + 1]:
            speed = speed if segment.entry_speed is None else segment.entry_speed
        return speed

    def _index_of(self, along: float) -> int:
        return min(max(bisect_right(self._bounds, along + _TINY) - 1, 0), max(len(self.segments) - 1, 0))

    def _exit_limits(self, index: int, down: float) -> list[float]:
        """For each segment from `index` on, the square of the speed that it may end with."""
        following = 0.0 if self.ended else inf
        limits: list[float] = []
        for number in range(len(self.segments) - 1, index - 1, -1):
            leave = self.segments[number].exit_speed
            limit = following if leave is None else min(following, (leave * SPEED_UNIT) ** 2)
            limits.append(limit)
            following = limit + 2 * down * self.segments[number].length
        return limits[::-1]

    @staticmethod
    def _cross(profile: Profile, stop: float, wanted: float, limit: float, up: float, down: float) -> bool:
        """Append pieces up to `stop`; False when the speed wanted is 0 and the path is held before it."""
        speed, room = profile.end_velocity, stop - profile.end_position

        def leave_free(v: float, a: float) -> float:
            """Distance, from speed v under acceleration a, until braking must begin."""
            if limit == inf:
                return inf
            return (limit + 2 * down * room - v * v) / (2 * (a + down))

        if speed > wanted:
            distance = min((speed * speed - wanted * wanted) / (2 * down), room)
            after = sqrt(max(speed * speed - 2 * down * distance, 0.0))
            profile.extend((speed - after) / down, -down)
            speed, room = after, room - distance
        elif speed < wanted:
            distance = min((wanted * wanted - speed * speed) / (2 * up), room, max(leave_free(speed, up), 0.0))
            after = sqrt(speed * speed + 2 * up * distance)
            profile.extend((after - speed) / up, up)
            speed, room = after, room - distance
        if room <= _TINY:
            return True
        if wanted <= 0.0:
            profile.land(profile.end_position)
            profile.extend(inf, 0.0)
            return False
        cruise = min(room, max(leave_free(speed, 0.0), 0.0))
        if cruise > 0.0 and speed > 0.0:
            profile.extend(cruise / speed, 0.0)
            room -= cruise
        if room > _TINY and speed > 0.0:
            after = sqrt(max(speed * speed - 2 * down * room, 0.0))
            profile.extend((speed - after) / down, -down)
        return True


@dataclass(frozen=True, slots=True)
class SequencePath:
    """One axis of a sequence: `index` into its coordinates, or the tangent axis for index -1."""

    system: System
    index: int

    def position(self, at: float) -> float:
        system = self.system
        if self.index < 0:
            return system.tangent_zero + system.tangent_scale * system.heading(at)
        return system.origin[self.index] + system.point(at)[self.index]

    def velocity(self, at: float) -> float:
        return self.position(at + 0.5) - self.position(at - 0.5)
