"""Several lines of a scan as one motion: constant speed through the windows of each, and turn-arounds in between that
are rounded in all axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from orchestrator.model.fleet import Fleet
from orchestrator.plan.flying.lines import FlownLines
from orchestrator.plan.flying.motions import find_extremes, glide, join_motions, move_motion
from orchestrator.plan.flying.turns import LineStop, solve_stop, solve_turn
from orchestrator.plan.path_profiles import FittedMotion
from orchestrator.plan.shape import WayEnd, WayLimits
from orchestrator.plan.speeds import limit_speeds
from orchestrator.plan.targets import find_jerk, make_axis_move

NEAR = 1e-9  # of a position: turn-arounds that are this alike are one


class FlightLine(NamedTuple):
    """Windows of one line that are flown. first: the point of the first of them, from 0; points: of them; begin_s: when
    the first one begins, in the time of the motion; window_s: the time in each."""

    first: int
    points: int
    begin_s: float
    window_s: float

    @property
    def end_s(self) -> float:
        """When its last window is over."""
        return self.begin_s + self.points * self.window_s


@dataclass(frozen=True, slots=True)
class Flight:
    """Lines that are flown in one motion. motion: of all axes of the scan, in their order and units, in user
    positions, from rest to rest."""

    lines: Sequence[FlightLine]
    motion: FittedMotion

    @property
    def duration_s(self) -> float:
        """Of the whole motion."""
        return self.motion.duration_s


def plan_flight(lines: FlownLines, fleet: Fleet, span: tuple[int, int], use: float = 1.0) -> Flight:
    """The motion through the windows of the points from `span[0]` on, before `span[1]`, which begins a line.

    use: of the acceleration and jerk of the axes in turn-arounds, above 0 to 1. Raises `PlanError`.
    """
    return _FlightPlanner(lines, fleet, use).plan(*span)


class _FlightPlanner:
    def __init__(self, lines: FlownLines, fleet: Fleet, use: float) -> None:
        self._lines = lines
        self._fleet = fleet
        self._use = use
        self._axes = {name: fleet.axis(name) for name in lines.scan.axes}
        self._first_flown = len(self._axes) - len(lines.axes)
        """The number of the first axis that flies; they are the last ones."""
        self._turns: dict[tuple[int, ...], FittedMotion] = {}

    def plan(self, first: int, end: int) -> Flight:
        lines, flown_lines, at_s = self._lines, list[FlightLine](), 0.0
        begin_state = self._find_rest(lines.find_begin(first), first)
        parts: list[FittedMotion] = []
        while first < end:
            count = lines.count - first % lines.count
            entry, leave = self._find_state(first, 0.0), self._find_state(first + count - 1, 1.0)
            parts += [self._turn(begin_state, entry), glide(entry, count * lines.window_s)]
            begin_s = at_s + parts[-2].duration_s
            flown_lines.append(FlightLine(first, count, begin_s, lines.window_s))
            at_s = begin_s + parts[-1].duration_s
            first, begin_state = first + count, leave
        parts.append(self._turn(begin_state, self._find_rest(lines.find_ends(first - 1).end, first - 1)))
        return Flight(flown_lines, join_motions(parts))

    def _find_rest(self, positions: Sequence[float], point: int) -> list[WayEnd]:
        """All axes at rest, those that fly at positions, the others where they are at a point."""
        states = [WayEnd(value) for value in self._lines.find_target(point).values()]
        return [*states[: self._first_flown], *map(WayEnd, positions)]

    def _find_state(self, point: int, part: float) -> list[WayEnd]:
        """All axes in a part of the window of a point, while it is flown."""
        states = [WayEnd(value) for value in self._lines.find_target(point).values()]
        velocities, after_s = self._lines.find_velocities(point), (part - 0.5) * self._lines.window_s
        flown_states = zip(states[self._first_flown :], velocities, strict=True)
        return [
            *states[: self._first_flown],
            *(WayEnd(state.position + after_s * velocity, velocity) for state, velocity in flown_states),
        ]

    def _turn(self, begin: Sequence[WayEnd], end: Sequence[WayEnd]) -> FittedMotion:
        """The fastest motion between two states."""
        ways = [end_state.position - begin_state.position for begin_state, end_state in zip(begin, end, strict=True)]
        speeds = [state.velocity for states in (begin, end) for state in states[self._first_flown :]]
        key = tuple(round(value / NEAR) for value in (*ways, *speeds))
        if key not in self._turns:
            origin = [WayEnd(0.0, state.velocity) for state in begin]
            target = [WayEnd(way, state.velocity) for way, state in zip(ways, end, strict=True)]
            self._turns[key] = self._solve(origin, target)
        return move_motion(self._turns[key], np.array([state.position for state in begin]))

    def _solve(self, begin: Sequence[WayEnd], end: Sequence[WayEnd]) -> FittedMotion:
        ways, first = [state.position for state in end], self._first_flown
        limits = self._find_limits(ways, 1.0)
        straight_limits = self._share_out(limits[first:])
        if not (begin[first].velocity and end[first].velocity):  # a run-up or a run-down
            return solve_turn(begin, end, [*limits[:first], *straight_limits])
        turn = solve_turn(begin, end, self._find_limits(ways, self._use))
        # No farther than lines that begin and end at rest, whose room is checked before anything moves.
        rooms = np.array([float(self._lines.find_run_up(axis)) for axis in self._lines.axes])
        ends = np.array([[state.position for state in states[first:]] for states in (begin, end)])
        least, most = (positions[first:] for positions in find_extremes(turn))
        if (least >= ends.min(axis=0) - rooms).all() and (most <= ends.max(axis=0) + rooms).all():
            return turn
        stops = [LineStop(*pair) for pair in zip(rooms.tolist(), straight_limits, strict=True)]
        return solve_stop(begin, end, limits, stops)

    def _share_out(self, limits: Sequence[WayLimits]) -> list[WayLimits]:
        """The limits of the axes that fly, in proportion to their ways along a line: so they stay on it."""
        shares = [axis.share for axis in self._lines.axes]
        velocity, acceleration, jerk = (
            min(value / share for value, share in zip(values, shares, strict=True))
            for values in zip(*limits, strict=True)
        )
        return [WayLimits(velocity * share, acceleration * share, jerk * share) for share in shares]

    def _find_limits(self, ways: Sequence[float], use: float) -> list[WayLimits]:
        """The limits of the axes on their ways, with the speed that the scan states for its moves between lines."""
        moves = [
            make_axis_move(name, axis, 0, round(way * float(axis.counts_per_unit)), 3)
            for way, (name, axis) in zip(ways, self._axes.items(), strict=True)
        ]
        limited_moves = limit_speeds(self._fleet, self._lines.scan, moves)
        flown_speeds = {axis.name: self._lines.find_speed(axis) for axis in self._lines.axes}
        limits: list[WayLimits] = []
        for (name, axis), move in zip(self._axes.items(), limited_moves, strict=True):
            speed = max(move.velocity / float(axis.scale), flown_speeds.get(name, 0.0))
            limits.append(WayLimits(speed, axis.limits.acceleration * use, find_jerk(axis) * use))
        return limits
