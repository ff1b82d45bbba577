"""Motion of several axes from one state to another in one time: run-ups, turn-arounds and run-downs of a scan that
flies.

Ruckig solves each of them from state to state, with one duration for all axes, so that every turn-around is rounded in
all of them. Ruckig's Community edition sends intermediate waypoints to a web service: it is never given any.
"""

from collections.abc import Sequence
from itertools import accumulate
from math import copysign
from typing import Any, NamedTuple

import numpy as np
from ruckig import InputParameter  # pyright: ignore[reportUnknownVariableType]

from orchestrator.plan.path_profiles import FittedMotion
from orchestrator.plan.shape import ask_ruckig, list_jerks

SAME_S = 1e-9  # instants of two axes that are this close are one


Row = list[tuple[float, float]]
"""Lengths, s, and jerks of one axis, one after the other; it has no acceleration before them."""


class TurnLimits(NamedTuple):
    """The limits of one axis, in its unit/s, /s² and /s³."""

    velocity: float
    acceleration: float
    jerk: float


class AxisState(NamedTuple):
    """Where an axis is and how fast, without acceleration; in its unit, and per s."""

    position: float
    velocity: float = 0.0


def solve_turn(begin: Sequence[AxisState], end: Sequence[AxisState], limits: Sequence[TurnLimits]) -> FittedMotion:
    """The fastest motion of all axes together from one state to another, all in one time. Raises `PlanError`.

    One entry per axis in each argument. Velocities of `begin` and `end` are within the limits.
    """
    return _merge(_solve_rows(begin, end, limits), begin, end)


def solve_stop(
    begin: Sequence[AxisState], end: Sequence[AxisState], limits: Sequence[TurnLimits], flown: int, room: float
) -> FittedMotion:
    """The same for an axis that flies, number `flown`, and goes no farther than `room` beyond where it is in `begin`,
    and before where it is in `end`: it comes to rest there, while the others move. Raises `PlanError`."""
    others = [number for number in range(len(begin)) if number != flown]
    rows: list[Row] = [[] for _ in begin]
    if others:
        columns = [[values[number] for number in others] for values in (begin, end, limits)]
        for number, row in zip(others, _solve_rows(*columns), strict=True):  # pyright: ignore[reportArgumentType]
            rows[number] = row
    before, after = begin[flown], end[flown]
    rests = [
        AxisState(state.position + copysign(room, sign * state.velocity)) for state, sign in ((before, 1), (after, -1))
    ]
    ways = [(before, rests[0]), (rests[0], rests[1]), (rests[1], after)]
    down, across, up = (_solve_rows([one], [other], [limits[flown]])[0] for one, other in ways)
    others_s = max((sum(length for length, _ in row) for row in rows), default=0.0)
    wait_s = others_s - sum(length for length, _ in [*down, *across, *up])
    rows[flown] = [*down, *across, *([(wait_s, 0.0)] if wait_s > 0.0 else []), *up]
    return _merge(rows, begin, end)


def _solve_rows(begin: Sequence[AxisState], end: Sequence[AxisState], limits: Sequence[TurnLimits]) -> list[Row]:
    """The fastest way of all axes, in one time: by axis, lengths (s) and jerks of its segments."""
    count = len(begin)
    question: Any = InputParameter(count)  # pyright: ignore[reportUnknownVariableType]
    # Seconds at full speed: Ruckig's tolerances are absolute.
    scales = [limit.velocity for limit in limits]
    question.current_position = [0.0] * count
    question.current_velocity = [state.velocity / scale for state, scale in zip(begin, scales, strict=True)]
    question.current_acceleration = [0.0] * count
    ways = [after.position - before.position for before, after in zip(begin, end, strict=True)]
    question.target_position = [way / scale for way, scale in zip(ways, scales, strict=True)]
    question.target_velocity = [state.velocity / scale for state, scale in zip(end, scales, strict=True)]
    question.target_acceleration = [0.0] * count
    question.max_velocity = [1.0] * count
    question.max_acceleration = [limit.acceleration / limit.velocity for limit in limits]
    question.max_jerk = [limit.jerk / limit.velocity for limit in limits]
    profiles = ask_ruckig(question, count).profiles[0]
    return [
        [(length, jerk * scale) for length, jerk in list_jerks(profile) if length > 0.0]
        for profile, scale in zip(profiles, scales, strict=True)
    ]


def _merge(rows: Sequence[Row], begin: Sequence[AxisState], end: Sequence[AxisState]) -> FittedMotion:
    """The segments of all axes on the instants of all of them."""
    ends = [list(accumulate(length for length, _ in row)) for row in rows]
    duration_s = max(axis_ends[-1] for axis_ends in ends if axis_ends)
    instants = sorted({0.0, duration_s, *(at_s for axis_ends in ends for at_s in axis_ends)})
    kept = [0.0]
    for at_s in instants[1:]:
        if at_s - kept[-1] > SAME_S:
            kept.append(at_s)
    kept[-1] = duration_s
    times_s = np.array(kept)
    lengths, middles = np.diff(times_s)[:, None], (times_s[:-1] + times_s[1:]) / 2
    jerks = np.zeros((len(middles), len(rows)))
    for column, (row, axis_ends) in enumerate(zip(rows, ends, strict=True)):
        if row:
            k = np.minimum(np.searchsorted(axis_ends, middles), len(row) - 1)
            jerks[:, column] = np.where(middles < axis_ends[-1], np.array([jerk for _, jerk in row])[k], 0.0)
    accelerations = np.concatenate([np.zeros((1, len(rows))), np.cumsum(jerks * lengths, axis=0)])[:-1]
    steps = lengths * (accelerations + lengths * jerks / 2)
    velocities = np.concatenate([[[state.velocity for state in begin]], steps]).cumsum(axis=0)
    ways = lengths * (velocities[:-1] + lengths * (accelerations / 2 + lengths * jerks / 6))
    positions = np.concatenate([[[state.position for state in begin]], ways]).cumsum(axis=0)
    # Exact where the next part begins, so that nothing adds up from part to part.
    positions[-1], velocities[-1] = ([state[n] for state in end] for n in (0, 1))
    return FittedMotion(times_s, positions, velocities, accelerations, jerks)
