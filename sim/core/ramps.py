"""Motion of one axis at piecewise constant acceleration: steps, steps/s and steps/s² over seconds from the start."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

TINY = 1e-9
"""Displacements closer than this are equal."""


@dataclass(frozen=True, slots=True)
class RampSegment:
    """Constant acceleration `a` from time `t` on, starting at displacement `x` with velocity `v`."""

    t: float
    x: float
    v: float
    a: float

    def x_at(self, t: float) -> float:
        """Displacement at time `t`."""
        dt = t - self.t
        return self.x + (self.v + 0.5 * self.a * dt) * dt

    def v_at(self, t: float) -> float:
        """Velocity at time `t`."""
        return self.v + self.a * (t - self.t)

    def moves_in_direction(self, sign: int) -> bool:
        """Return whether the segment moves in direction `sign`."""
        return sign * self.v > 0 or (self.v == 0 and sign * self.a > 0)

    def time_to_cover(self, distance: float) -> float:
        """Return the time into the segment after which `distance` is covered."""
        if self.a == 0.0:
            return distance / self.v
        root = math.sqrt(max(0.0, self.v * self.v + 2.0 * self.a * distance))
        # This form avoids cancellation: 2d / (v ± root), with the root's sign that of the motion.
        return 2.0 * distance / (self.v + math.copysign(root, self.v or self.a))


def first_at(segments: Sequence[RampSegment], duration: float, bound: float, sign: int, after: float) -> float | None:
    """Return the first time >= `after` at or beyond `bound` in direction `sign` while moving in that direction.

    No segment reverses; the last one ends at `duration`.
    """
    for segment, end_s in _segments_in_direction(segments, duration, sign, after):
        begin = max(after, segment.t)
        if sign * (segment.x_at(begin) - bound) >= -TINY:
            return begin
        if math.isinf(end_s):
            return segment.t + segment.time_to_cover(bound - segment.x)
        if sign * (segment.x_at(end_s) - bound) >= -TINY:
            return min(end_s, segment.t + segment.time_to_cover(bound - segment.x))
    return None


def first_toward(segments: Sequence[RampSegment], duration: float, sign: int, after: float) -> float | None:
    """Return the first time >= `after` with motion in direction `sign`."""
    for segment, _ in _segments_in_direction(segments, duration, sign, after):
        return max(after, segment.t)
    return None


def _segments_in_direction(
    segments: Sequence[RampSegment], duration: float, sign: int, after: float
) -> Iterator[tuple[RampSegment, float]]:
    """Yield the segments in direction `sign` that end later than `after`, each with its end."""
    ends = [segment.t for segment in segments[1:]] + [duration]
    for segment, end in zip(segments, ends, strict=True):
        if end > after and segment.moves_in_direction(sign):
            yield segment, end
