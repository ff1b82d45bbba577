"""Motion of several axes from one state to another in one time: run-ups, turn-arounds and run-downs of a scan that
flies, so that every turn-around is rounded in all axes."""

from collections.abc import Sequence
from itertools import accumulate
from math import copysign
from typing import NamedTuple

import numpy as np

from orchestrator.plan.path_profiles import Array, FittedMotion
from orchestrator.plan.shape import JerkPart, WayEnd, WayLimits, solve_ways

SAME_S = 1e-9  # instants of two axes that are this close are one


class LineStop(NamedTuple):
    """How an axis that flies stops behind its windows, and begins before them. room: how far it goes at most, above 0;
    limits: with which it stays on the line of all that fly."""

    room: float
    limits: WayLimits


def solve_turn(begin: Sequence[WayEnd], end: Sequence[WayEnd], limits: Sequence[WayLimits]) -> FittedMotion:
    """The fastest motion of all axes together from one state to another, all in one time. Raises `PlanError`.

    One entry per axis in each argument. Velocities of `begin` and `end` are within the limits.
    """
    return _merge(solve_ways(begin, end, limits), begin, end)


def solve_stop(
    begin: Sequence[WayEnd], end: Sequence[WayEnd], limits: Sequence[WayLimits], stops: Sequence[LineStop]
) -> FittedMotion:
    """The same for axes that fly, the last ones, one for each of `stops`, and go no farther than its room beyond where
    they are in `begin`, and before where they are in `end`: they come to rest there, while the others move. Raises
    `PlanError`."""
    first = len(begin) - len(stops)
    rows = solve_ways(begin[:first], end[:first], limits[:first]) if first else []
    entries, leaves, line_limits = begin[first:], end[first:], [stop.limits for stop in stops]
    turn_ends = [
        WayEnd(entry.position + copysign(stop.room, entry.velocity)) for entry, stop in zip(entries, stops, strict=True)
    ]
    run_ups = [
        WayEnd(leave.position - copysign(stop.room, leave.velocity)) for leave, stop in zip(leaves, stops, strict=True)
    ]
    stopping = solve_ways(entries, turn_ends, line_limits)
    crossing = solve_ways(turn_ends, run_ups, limits[first:])
    starting = solve_ways(run_ups, leaves, line_limits)
    moved_s = sum(max(map(_find_duration_s, part)) for part in (stopping, crossing, starting))
    wait_s = max(map(_find_duration_s, rows), default=0.0) - moved_s
    wait_parts = [(wait_s, 0.0)] if wait_s > 0.0 else []
    flown_rows = [
        [*parts[0], *parts[1], *wait_parts, *parts[2]] for parts in zip(stopping, crossing, starting, strict=True)
    ]
    return _merge([*rows, *flown_rows], begin, end)


def _find_duration_s(row: Sequence[JerkPart]) -> float:
    return sum(length_s for length_s, _ in row)


def _merge(rows: Sequence[Sequence[JerkPart]], begin: Sequence[WayEnd], end: Sequence[WayEnd]) -> FittedMotion:
    """The segments of all axes on the instants of all of them."""
    times_s = _list_instants(rows)
    lengths, middles = np.diff(times_s)[:, None], (times_s[:-1] + times_s[1:]) / 2
    jerks = np.stack([_sample_jerks(row, middles) for row in rows], axis=1)
    changes = np.cumsum(jerks * lengths, axis=0)[:-1]
    accelerations = [state.acceleration for state in begin] + np.concatenate([np.zeros((1, len(rows))), changes])
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
