"""Segments of linear and vector sequences: lines and arcs in the coordinates of the sequence (L6872, L11466, L3791)."""

from dataclasses import dataclass, replace
from math import atan2, cos, degrees, hypot, radians, sin

Point = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class PathSegment:
    """A piece of path. `length` in counts along the path; speeds in counts/s, None when not given.

    `radius` 0 is a straight line from `start` to `end`; otherwise an arc from `angle` over `sweep` degrees.
    """

    start: Point
    end: Point
    length: float
    entry_speed: float | None
    exit_speed: float | None
    radius: float = 0.0
    angle: float = 0.0
    sweep: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)

    @property
    def is_arc(self) -> bool:
        """Whether it is an arc; else a straight line."""
        return self.radius != 0.0

    def point_at(self, along: float) -> Point:
        """Return the coordinates at `along` counts from the start."""
        share = min(max(along / self.length, 0.0), 1.0)
        if not self.radius:
            return tuple(a + (b - a) * share for a, b in zip(self.start, self.end, strict=True))
        first, angle = radians(self.angle), radians(self.angle + self.sweep * share)
        return (
            self.start[0] + self.radius * (cos(angle) - cos(first)) * self.scale[0],
            self.start[1] + self.radius * (sin(angle) - sin(first)) * self.scale[1],
        )

    def heading_at(self, along: float) -> float:
        """Return the direction of travel in the plane, degrees."""
        if not self.radius:
            return degrees(atan2(self.end[1] - self.start[1], self.end[0] - self.start[0]))
        turn = 90.0 if self.sweep > 0 else -90.0
        return self.angle + self.sweep * min(max(along / self.length, 0.0), 1.0) + turn


def linear_segment(start: Point, end: Point, scale: Point, entry: float | None, leave: float | None) -> PathSegment:
    """Make a straight segment; its length is measured before `scale` stretches the axes."""
    length = hypot(*((b - a) / s for a, b, s in zip(start, end, scale, strict=True)))
    return PathSegment(start, end, length, entry, leave)


@dataclass(frozen=True, slots=True)
class ArcShape:
    """An arc from `angle` over `sweep`, degrees, positive is CCW; elliptic when `scale` differs from 1."""

    radius: float
    angle: float
    sweep: float
    scale: tuple[float, float]


def arc_segment(start: Point, arc: ArcShape, entry: float | None, leave: float | None) -> PathSegment:
    """Make a circular or elliptic segment."""
    length = abs(arc.radius * radians(arc.sweep))
    shape = PathSegment(
        start=start,
        end=start,
        length=length or 1.0,
        entry_speed=entry,
        exit_speed=leave,
        radius=arc.radius,
        angle=arc.angle,
        sweep=arc.sweep,
        scale=arc.scale,
    )
    return replace(shape, end=shape.point_at(length), length=length)
