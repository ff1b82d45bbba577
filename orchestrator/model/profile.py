"""The motion of one axis in time: a piecewise polynomial, evaluated without Ruckig. Also its form on the bus.

Positions are relative to the start and divided by `scale_counts`: a straight line is then one shape with one scale per
axis, and the numbers stay well conditioned for any size of count.
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

LEAST_REST_S = 0.01
"""A rest at the beginning of a profile that is shorter changes nothing about when its axis is seen to move."""


class MotionState(NamedTuple):
    """The motion at an instant: counts, counts/s, counts/s²; the position is relative to the profile's start."""

    position: float
    velocity: float
    acceleration: float


class Segment(NamedTuple):
    """A span of constant jerk: its start (s after the profile's), length (s), and state there, in counts."""

    start_s: float
    duration_s: float
    position: float
    velocity: float
    acceleration: float
    jerk: float

    def state_at(self, t: float) -> MotionState:
        """The motion `t` s after the segment's start."""
        a, j = self.acceleration, self.jerk
        return MotionState(
            self.position + t * (self.velocity + t * (a / 2 + t * j / 6)),
            self.velocity + t * (a + t * j / 2),
            a + t * j,
        )


class _IntegrationCache:
    """Cache of values computed from a profile."""

    __slots__ = ("_peak_velocity", "_segments")

    _segments: list[Segment]
    _peak_velocity: float


# Not frozen, although no code changes one: a plan of 64 axes makes 64 of these, and freezing would double their cost.
@dataclass(slots=True)
class Profile(_IntegrationCache):
    """A motion that ends at rest, and begins at rest unless it is a chunk of a longer one.

    start_counts, end_counts: absolute commanded positions of the controller, exact; of a chunk, start_counts is where
    the whole motion begins.
    scale_counts: counts per unit of the shape (its sign is the direction).
    durations_s, accelerations, jerks: one entry per segment (additional accelerations, such as one at the end, are
    ignored): segment k starts with accelerations[k] and has constant jerks[k]; in units of the shape per second², ³.
    first_position, first_velocity: of a chunk, where and how fast it begins, in units of the shape (per second), from
    start_counts. Velocity and position are continuous from there.
    """

    start_counts: int
    end_counts: int
    scale_counts: float
    durations_s: Sequence[float]
    accelerations: Sequence[float]
    jerks: Sequence[float]
    first_position: float = 0.0
    first_velocity: float = 0.0

    @property
    def duration_s(self) -> float:
        """From the start of the axis to its end, in seconds."""
        return sum(self.durations_s)

    @property
    def rests_first(self) -> bool:
        """Whether it begins with a rest of more than a moment."""
        moves = bool(self.first_velocity or self.accelerations[0] or self.jerks[0])
        return not moves and self.durations_s[0] > LEAST_REST_S

    @property
    def segments(self) -> list[Segment]:
        """The segments in counts, each with its start; input of evaluation and lowering."""
        try:
            return self._segments
        except AttributeError:
            self._segments = self._integrate_segments()
            return self._segments

    def _integrate_segments(self) -> list[Segment]:
        segments: list[Segment] = []
        clock_s, scale = 0.0, self.scale_counts
        position, velocity = self.first_position * scale, self.first_velocity * scale
        # `Segment.state_at` written out: lowering and planning of a fleet run this some hundred times per step.
        for t, plain_a, plain_j in zip(self.durations_s, self.accelerations, self.jerks, strict=False):
            a, j = plain_a * scale, plain_j * scale
            segments.append(
                Segment(start_s=clock_s, duration_s=t, position=position, velocity=velocity, acceleration=a, jerk=j)
            )
            clock_s += t
            position += t * (velocity + t * (a / 2 + t * j / 6))
            velocity += t * (a + t * j / 2)
        return segments

    def state_at(self, time_s: float) -> MotionState:
        """The motion `time_s` after the start. Before the start it is as at the start; after the end the axis is at
        rest. The end is exact."""
        return self.make_evaluator()(time_s)

    def make_evaluator(self) -> Callable[[float], MotionState]:
        """`state_at` for many instants: integrates the segments once."""
        segments = self.segments
        starts = [segment.start_s for segment in segments]
        end_s = self.duration_s
        end = MotionState(float(self.end_counts - self.start_counts), 0.0, 0.0)
        begin = _AT_REST
        if self.first_position or self.first_velocity:
            begin = MotionState(segments[0].position, segments[0].velocity, segments[0].acceleration)

        def at(time_s: float) -> MotionState:
            if time_s <= 0.0:
                return begin
            if time_s >= end_s:
                return end
            segment = segments[bisect_right(starts, time_s) - 1]
            return segment.state_at(time_s - segment.start_s)

        return at

    @property
    def peak_velocity(self) -> float:
        """The largest speed, counts/s."""
        try:
            return self._peak_velocity
        except AttributeError:
            self._peak_velocity = self._find_peak_velocity()
            return self._peak_velocity

    def _find_peak_velocity(self) -> float:
        """The largest speed is at the end of a segment, or where the acceleration is zero."""
        speed = 0.0
        for _, t, _, v, a, j in self.segments:
            speed = max(speed, abs(v), abs(v + t * (a + t * j / 2)))
            if j and 0.0 < -a / j < t:
                speed = max(speed, abs(v - a * a / j / 2))
        return speed

    @property
    def peak_acceleration(self) -> float:
        """The largest acceleration or deceleration, counts/s². It is linear in a segment: largest at an end."""
        return max(
            (max(abs(e.acceleration), abs(e.acceleration + e.jerk * e.duration_s)) for e in self.segments), default=0.0
        )

    @property
    def end_error(self) -> tuple[float, float]:
        """The distance of the last segment's end from rest at `end_counts`: counts, counts/s. (0, 0) for a sound
        profile."""
        segments = self.segments
        last = segments[-1].state_at(segments[-1].duration_s) if segments else _AT_REST
        return abs(last.position - (self.end_counts - self.start_counts)), abs(last.velocity)

    @property
    def extent_counts(self) -> tuple[float, float]:
        """The smallest and largest absolute position during the motion, turning points inside segments included."""
        points = [self.first_position * self.scale_counts, float(self.end_counts - self.start_counts)]
        for segment in self.segments:
            points += (segment.position, segment.state_at(segment.duration_s).position)
            for root in find_turning_points(segment.velocity, segment.acceleration, segment.jerk):
                if 0.0 < root < segment.duration_s:
                    points.append(segment.state_at(root).position)
        return self.start_counts + min(points), self.start_counts + max(points)

    @property
    def is_still(self) -> bool:
        """Whether the axis stays where it is. One that comes back to its start, as on a circle, does not."""
        if self.end_counts != self.start_counts:
            return False
        low, high = self.extent_counts
        return high - low < 1.0

    @property
    def stays_between_ends(self) -> bool:
        """Whether no position is beyond the start or the end, to half a count; on a path an axis may turn back."""
        low, high = self.extent_counts
        first, last = sorted((self.start_counts, self.end_counts))
        return first - 0.5 <= low and high <= last + 0.5

    def stretch_time(self, factor: float) -> "Profile":
        """The same path in `factor` times the time (>= 1, so that limits that held still hold)."""
        return Profile(
            start_counts=self.start_counts,
            end_counts=self.end_counts,
            scale_counts=self.scale_counts,
            durations_s=[t * factor for t in self.durations_s],
            accelerations=[a / factor**2 for a in self.accelerations],
            jerks=[j / factor**3 for j in self.jerks],
            first_position=self.first_position,
            first_velocity=self.first_velocity / factor,
        )


_AT_REST = MotionState(0.0, 0.0, 0.0)


def find_turning_points(v: float, a: float, j: float) -> tuple[float, ...]:
    """The times at which v + a t + j t²/2 is zero."""
    if j == 0.0:
        return (-v / a,) if a else ()
    square = a * a - 2 * j * v
    if square < 0.0:
        return ()
    root = square**0.5
    return ((-a - root) / j, (-a + root) / j)
