"""Motion of several axes from one state to another in one time: run-ups, turn-arounds and run-downs of a scan that
flies, so that every turn-around is rounded in all axes."""

from collections.abc import Sequence
from itertools import accumulate
from math import copysign

import numpy as np

from orchestrator.plan.path_profiles import Array, FittedMotion
from orchestrator.plan.shape import JerkPart, WayEnd, WayLimits, solve_ways

SAME_S = 1e-9  # instants of two axes that are this close are one


def solve_turn(begin: Sequence[WayEnd], end: Sequence[WayEnd], limits: Sequence[WayLimits]) -> FittedMotion:
    """The fastest motion of all axes together from one state to another, all in one time. Raises `PlanError`.

    One entry per axis in each argument. Velocities of `begin` and `end` are within the limits.
    """
    return _merge(solve_ways(begin, end, limits), begin, end)


def solve_stop(
    begin: Sequence[WayEnd], end: Sequence[WayEnd], limits: Sequence[WayLimits], flown: int, room: float
) -> FittedMotion:
    """The same for an axis that flies, number `flown`, and goes no farther than `room` beyond where it is in `begin`,
    and before where it is in `end`: it comes to rest there, while the others move. Raises `PlanError`."""
    numbers = [number for number in range(len(begin)) if number != flown]
    rows: list[list[JerkPart]] = [[] for _ in begin]
    if numbers:
        ways = solve_ways([begin[n] for n in numbers], [end[n] for n in numbers], [limits[n] for n in numbers])
        for number, row in zip(numbers, ways, strict=True):
            rows[number] = row
    entry, leave = begin[flown], end[flown]
    turn_end = WayEnd(entry.position + copysign(room, entry.velocity))
    run_up = WayEnd(leave.position - copysign(room, leave.velocity))
    parts = [
        solve_ways([first], [second], [limits[flown]])[0]
        for first, second in ((entry, turn_end), (turn_end, run_up), (run_up, leave))
    ]
    wait_s = max(map(_find_duration_s, rows)) - sum(map(_find_duration_s, parts))
    rows[flown] = [*parts[0], *parts[1], *([(wait_s, 0.0)] if wait_s > 0.0 else []), *parts[2]]
    return _merge(rows, begin, end)


def _find_duration_s(row: Sequence[JerkPart]) -> float:
    return sum(length_s for length_s, _ in row)


def _merge(rows: Sequence[Sequence[JerkPart]], begin: Sequence[WayEnd], end: Sequence[WayEnd]) -> FittedMotion:
    """The segments of all axes on the instants of all of them."""
    times_s = _list_instants(rows)
    lengths, middles = np.diff(times_s)[:, None], (times_s[:-1] + times_s[1:]) / 2
    jerks = np.stack([_sample_jerks(row, middles) for row in rows], axis=1)
    accelerations = np.concatenate([np.zeros((1, len(rows))), np.cumsum(jerks * lengths, axis=0)])[:-1]
    steps = lengths * (accelerations + lengths * jerks / 2)
    velocities = np.concatenate([[[state.velocity for state in begin]], steps]).cumsum(axis=0)
    ways = lengths * (velocities[:-1] + lengths * (accelerations / 2 + lengths * jerks / 6))
    positions = np.concatenate([[[state.position for state in begin]], ways]).cumsum(axis=0)
    # Exact where the next part begins, so that nothing adds up from part to part.
    positions[-1], velocities[-1] = ([state[n] for state in end] for n in (0, 1))
    return FittedMotion(times_s, positions, velocities, accelerations, jerks)


def _list_instants(rows: Sequence[Sequence[JerkPart]]) -> Array:
    """The instants between the segments of all axes."""
    ends = {at_s for row in rows for at_s in accumulate(length_s for length_s, _ in row)}
    instants = [0.0]
    for at_s in sorted(ends):
        if at_s - instants[-1] > SAME_S:
            instants.append(at_s)
    instants[-1] = max(ends)
    return np.array(instants)


def _sample_jerks(row: Sequence[JerkPart], times_s: Array) -> Array:
    """The jerk of an axis at instants; none behind its segments."""
    ends = np.cumsum([length_s for length_s, _ in row])
    return np.array([*(jerk for _, jerk in row), 0.0])[np.searchsorted(ends, times_s)]
