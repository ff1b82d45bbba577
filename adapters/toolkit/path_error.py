"""How far what a controller executes is from its plan on the way, for makes that execute ramps and cruises."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

from orchestrator.model.profile import Profile

_Piece = tuple[float, float, float, float]
"""From an instant on: position, velocity, acceleration; in s and counts, in the sense of the profile."""


def path_error_counts(profile: Profile, legs: Iterable[tuple[float, float, float]]) -> float:
    """The largest distance between what is executed and the plan, from a common start.

    legs: (duration, speed at its begin, acceleration), one behind the other, in host seconds and counts along the way;
    all of them together go as far as the profile. Both are parabolas between their knots, so that the extremes of their
    difference are at knots or at its vertices. One count more, because a controller goes in whole ones.
    """
    distance = profile.end_counts - profile.start_counts
    sign = 1 if distance > 0 else -1
    executed: list[_Piece] = []
    clock_s = position = 0.0
    for duration_s, speed, acceleration in legs:
        if duration_s <= 0.0:  # it would hide what begins at the same instant
            continue
        executed.append((clock_s, sign * position, sign * speed, sign * acceleration))
        clock_s += duration_s
        position += duration_s * (speed + duration_s * acceleration / 2)
    executed.append((clock_s, float(distance), 0.0, 0.0))
    planned = [
        (each.start_s, each.position, each.velocity, each.acceleration)
        for each in profile.segments
        if each.duration_s > 0.0
    ]
    planned.append((profile.duration_s, float(distance), 0.0, 0.0))
    worst = 0.0
    for begin_s, end_s in pairwise(sorted({each[0] for each in (*executed, *planned)})):
        middle_s = (begin_s + end_s) / 2
        mine, plan = _at(executed, middle_s), _at(planned, middle_s)
        a = mine[3] - plan[3]
        v = mine[2] + (begin_s - mine[0]) * mine[3] - (plan[2] + (begin_s - plan[0]) * plan[3])
        x = _position(mine, begin_s) - _position(plan, begin_s)
        instants = [0.0, end_s - begin_s]
        if a and 0.0 < -v / a < end_s - begin_s:
            instants.append(-v / a)
        worst = max(worst, *(abs(x + t * (v + t * a / 2)) for t in instants))
    return worst + 1.0


def in_host_time(legs: Iterable[tuple[float, float, float]], factor: float) -> Iterator[tuple[float, float, float]]:
    """Legs in the host's time. factor: seconds of the unit's crystal in one of the host's."""
    for duration_s, speed, acceleration in legs:
        yield duration_s / factor, speed * factor, acceleration * factor**2


def _at(pieces: Sequence[_Piece], time_s: float) -> _Piece:
    """The piece that is under way."""
    return max((each for each in pieces if each[0] <= time_s), key=lambda each: each[0])


def _position(piece: _Piece, time_s: float) -> float:
    t = time_s - piece[0]
    return piece[1] + t * (piece[2] + t * piece[3] / 2)
