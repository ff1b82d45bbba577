"""Coordinate systems S and T: queues of segments and the speed along them (L6872-L7077, L11292-L11711)."""

from bisect import bisect_right
from dataclasses import dataclass
from math import inf, sqrt

from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.motion.profile import ACCELERATION_UNIT, SPEED_UNIT, VelocityProfile
from sim.yaskawa.motion.segments import PathSegment, Point

SEGMENTS = 511
LONGEST = 2_000_000_000
_TINY = 1e-9
_KEPT_POINTS = 16


@dataclass(frozen=True, slots=True)
class _SegmentGoal:
    """End of a segment along the path, the speed wanted in it, and the square of the speed that it may end with."""

    stop: float
    wanted: float
    limit: float


class CoordinateSystem:
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
        self.clear_queue()

    def clear_queue(self) -> None:
        """`CS`: an empty queue."""
        self.segments: list[PathSegment] = []
        self._bounds: list[float] = [0.0]
        self._points: dict[float, Point] = {}
        self.ended = False
        self.profile: VelocityProfile | None = None
        self._override: tuple[int, float] | None = None

    def select_axes(self, axes: tuple[str, ...], tangent: str | None = None, *, linear: bool) -> None:
        """`LM` and `VM`: set the axes of the next sequence."""
        self.clear_queue()
        self.axes, self.linear, self.tangent = axes, linear, tangent

    def queue_end(self) -> Point:
        """Return the end of the queue, in the coordinates of the sequence."""
        return self.segments[-1].end if self.segments else (0.0,) * len(self.axes)

    def add_segment(self, segment: PathSegment, now: int) -> None:
        """Queue a segment; refused with 30 (an arc shorter than a sample at its speed; lines may be, as in L13219 to
        13270), 31, 32."""
        speed = segment.entry_speed if segment.entry_speed is not None else self.speed
        if segment.length <= 0.0 or (segment.is_arc and segment.length < speed * SPEED_UNIT):
            raise CommandError(30)
        if self._bounds[-1] + segment.length > LONGEST:
            raise CommandError(31)
        if self.free_entries(now) <= 0:
            raise CommandError(32)
        if not self.running and not self.segments:
            self.length = 0.0
        self.segments.append(segment)
        self._bounds.append(self._bounds[-1] + segment.length)
        self.length = self._bounds[-1]
        if self.running:
            self.plan_speed(now)

    def finish_queue(self, now: int) -> None:
        """`LE`, `VE`: end the sequence."""
        self.ended = True
        if self.running:
            self.plan_speed(now)

    def free_entries(self, now: int) -> int:
        """Return the free entries of the queue (L6886)."""
        return SEGMENTS - len(self.segments) + (self.segment_index(now) if self.running else 0)

    def begin_path(self, at: int, origin: Point) -> None:
        """`BG`: start the path at `at`; `origin` are the axes' positions then, which become 0,0 (L13296)."""
        self.running, self.stopping = True, False
        self.start, self.origin = at, origin
        self.mark = 0.0
        self.profile = VelocityProfile(at, 0.0, self.smoothing)
        self.plan_speed(at)

    def travelled_distance(self, at: float) -> float:
        """Return the path distance at a time."""
        return self.profile.position(at) if self.profile is not None else 0.0

    def path_velocity(self, at: float) -> float:
        """Return the velocity along the path, counts/sample."""
        return self.profile.velocity(at) if self.profile is not None else 0.0

    def segment_index(self, at: float) -> int:
        """Return the number of the segment in execution."""
        if self.profile is None or not self.segments:
            return self.last_index
        return self._index_of(self.travelled_distance(at))

    def point_at(self, at: float) -> Point:
        """Return the coordinates of the sequence at a time; cached, because each axis reads the same instants."""
        point = self._points.get(at)
        if point is None:
            if len(self._points) >= _KEPT_POINTS:
                self._points.clear()
            point = self._points[at] = self.point_along(self.travelled_distance(at))
        return point

    def point_along(self, along: float) -> Point:
        index = self._index_of(along)
        return self.segments[index].point_at(along - self._bounds[index])

    def heading_at(self, at: float) -> float:
        along = self.travelled_distance(at)
        index = self._index_of(along)
        return self.segments[index].heading_at(along - self._bounds[index])

    def segment_start(self, at: float) -> Point:
        """Return the start of the segment in execution."""
        return self.segments[self.segment_index(at)].start if self.segments else (0.0,) * len(self.axes)

    def end_sample(self) -> float:
        """Return the sample of the last commanded position."""
        return self.profile.last_sample() if self.profile is not None else inf

    def stop_path(self, at: int) -> None:
        """Decelerate along the path and drop the rest (L13007, D34)."""
        self.stopping = True
        self._points.clear()
        profile = self.profile
        if profile is None:
            return
        profile.cut_after(at)
        rate = self.deceleration * ACCELERATION_UNIT
        room = self._bounds[-1] - profile.end_position
        speed = profile.end_velocity
        needed_speed = speed * speed / (2 * rate)
        if needed_speed > room:
            time = (speed - sqrt(max(speed * speed - 2 * rate * room, 0.0))) / rate
            profile.append_piece(time, -rate)
        else:
            profile.append_piece(speed / rate, -rate)
        profile.land_at(profile.end_position)

    def plan_speed(self, at: int) -> None:
        """Plan the speed along the path from the state at `at`, with the present registers."""
        profile = self.profile
        self._points.clear()
        if profile is None or self.stopping:
            return
        profile.cut_after(at)
        up, down = self.acceleration * ACCELERATION_UNIT, self.deceleration * ACCELERATION_UNIT
        index = self._index_of(profile.end_position)
        limits = self._exit_limits(index, down)
        speed = self._speed_before(index)
        for number in range(index, len(self.segments)):
            segment = self.segments[number]
            if segment.entry_speed is not None and number > index:
                speed = segment.entry_speed
            wanted_speed = speed * self.ratio * SPEED_UNIT
            goal = _SegmentGoal(self._bounds[number + 1], wanted_speed, limits[number - index])
            if not self._cross_segment(profile, goal, up, down):
                return
        profile.land_at(self._bounds[-1])

    def replan_speed(self, at: int) -> None:
        """`VS`, `VA`, `VD`, `VR` during motion: they take effect at once (L13037, L13059)."""
        if self.profile is not None and self.running:
            self._override = (self.segment_index(at), self.speed)
        self.plan_speed(at)

    def _speed_before(self, index: int) -> float:
        """Return the vector speed in force in segment `index`: `VS`, or the last `<n` since (L13037)."""
        first, speed = (0, self.speed) if self._override is None else (self._override[0] + 1, self._override[1])
        for segment in self.segments[first : index + 1]:
            speed = speed if segment.entry_speed is None else segment.entry_speed
        return speed

    def _index_of(self, along: float) -> int:
        return min(max(bisect_right(self._bounds, along + _TINY) - 1, 0), max(len(self.segments) - 1, 0))

    def _exit_limits(self, index: int, down: float) -> list[float]:
        """Return for each segment from `index` on the square of the speed that it may end with."""
        following = 0.0 if self.ended else inf
        limits: list[float] = []
        for number in range(len(self.segments) - 1, index - 1, -1):
            leave = self.segments[number].exit_speed
            limit = following if leave is None else min(following, (leave * SPEED_UNIT) ** 2)
            limits.append(limit)
            following = limit + 2 * down * self.segments[number].length
        return limits[::-1]

    @staticmethod
    def _cross_segment(profile: VelocityProfile, goal: _SegmentGoal, up: float, down: float) -> bool:
        """Append pieces up to the goal; return False when the wanted speed is 0 and the path stops before it."""
        stop, goal_speed, limit = goal.stop, goal.wanted, goal.limit
        speed, room = profile.end_velocity, stop - profile.end_position

        def leave_free(v: float, a: float) -> float:
            """Return the distance, from speed v under acceleration a, until braking must begin."""
            if limit == inf:
                return inf
            return (limit + 2 * down * room - v * v) / (2 * (a + down))

        if speed > goal_speed:
            distance = min((speed * speed - goal_speed * goal_speed) / (2 * down), room)
            end_speed = sqrt(max(speed * speed - 2 * down * distance, 0.0))
            profile.append_piece((speed - end_speed) / down, -down)
            speed, room = end_speed, room - distance
        elif speed < goal_speed:
            distance = min((goal_speed * goal_speed - speed * speed) / (2 * up), room, max(leave_free(speed, up), 0.0))
            end_speed = sqrt(speed * speed + 2 * up * distance)
            profile.append_piece((end_speed - speed) / up, up)
            speed, room = end_speed, room - distance
        if room <= _TINY:
            return True
        if goal_speed <= 0.0:
            profile.land_at(profile.end_position)
            profile.append_piece(inf, 0.0)
            return False
        cruise = min(room, max(leave_free(speed, 0.0), 0.0))
        if cruise > 0.0 and speed > 0.0:
            profile.append_piece(cruise / speed, 0.0)
            room -= cruise
        if room > _TINY and speed > 0.0:
            end_speed = sqrt(max(speed * speed - 2 * down * room, 0.0))
            profile.append_piece((speed - end_speed) / down, -down)
        return True


@dataclass(frozen=True, slots=True)
class SequencePath:
    """One axis of a sequence: `index` into its coordinates, or the tangent axis for index -1."""

    system: CoordinateSystem
    index: int

    def position(self, at: float) -> float:
        system = self.system
        if self.index < 0:
            return system.tangent_zero + system.tangent_scale * system.heading_at(at)
        return system.origin[self.index] + system.point_at(at)[self.index]

    def velocity(self, at: float) -> float:
        return self.position(at + 0.5) - self.position(at - 0.5)
