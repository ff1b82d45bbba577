"""Path error of an executed move relative to its plan, for makes that execute ramps and cruises."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

from orchestrator.model.profile import Profile

_Segment = tuple[float, float, float, float]
"""One motion segment, from an instant on: position, velocity, acceleration; in s and counts, in the direction of the
profile."""


def path_error_counts(profile: Profile, legs: Iterable[tuple[float, float, float]]) -> float:
    """Return the largest distance between the executed motion and the plan, from a common start.

    legs: (duration, initial speed, acceleration), consecutive, in host seconds and counts along the path; together they
    cover the distance of the profile. Both motions are parabolas between their knots, so that the extremes of their
    difference are at knots or at its vertices. One count is added, because a controller moves in whole counts.
    """
    distance = profile.end_counts - profile.start_counts
    sign = 1 if distance > 0 else -1
    executed_segments: list[_Segment] = []
    clock_s = position = 0.0
    for duration_s, speed, acceleration in legs:
        if duration_s <= 0.0:  # it would hide the segment that begins at the same instant
            continue
        executed_segments.append((clock_s, sign * position, sign * speed, sign * acceleration))
        clock_s += duration_s
        position += duration_s * (speed + duration_s * acceleration / 2)
    executed_segments.append((clock_s, float(distance), 0.0, 0.0))
    planned_segments = [
        (segment.start_s, segment.position, segment.velocity, segment.acceleration)
        for segment in profile.segments
        if segment.duration_s > 0.0
    ]
    planned_segments.append((profile.duration_s, float(distance), 0.0, 0.0))
    worst = 0.0
    for begin_s, end_s in pairwise(sorted({segment[0] for segment in (*executed_segments, *planned_segments)})):
        middle_s = (begin_s + end_s) / 2
        own_segment, plan = _segment_at(executed_segments, middle_s), _segment_at(planned_segments, middle_s)
        a = own_segment[3] - plan[3]
        v = own_segment[2] + (begin_s - own_segment[0]) * own_segment[3] - (plan[2] + (begin_s - plan[0]) * plan[3])
        x = _position_at(own_segment, begin_s) - _position_at(plan, begin_s)
        instants = [0.0, end_s - begin_s]
        if a and 0.0 < -v / a < end_s - begin_s:
            instants.append(-v / a)
        worst = max(worst, *(abs(x + t * (v + t * a / 2)) for t in instants))
    return worst + 1.0


def legs_in_host_time(
    legs: Iterable[tuple[float, float, float]], factor: float
) -> Iterator[tuple[float, float, float]]:
    """Convert legs to the host's time. factor: seconds of the controller's crystal per host second."""
    for duration_s, speed, acceleration in legs:
        yield duration_s / factor, speed * factor, acceleration * factor**2


def _segment_at(pieces: Sequence[_Segment], time_s: float) -> _Segment:
    """Return the segment that is active at `time_s`."""
    return max((piece for piece in pieces if piece[0] <= time_s), key=lambda piece: piece[0])


def _position_at(piece: _Segment, time_s: float) -> float:
    t = time_s - piece[0]
    return piece[1] + t * (piece[2] + t * piece[3] / 2)
