"""Several lines of a scan as one motion: constant speed through the windows of each, and turn-arounds in between that
are rounded in all axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from orchestrator.model.fleet import Fleet
from orchestrator.plan.flying.lines import FlownLines
from orchestrator.plan.flying.motions import find_extremes, join_motions, move_motion
from orchestrator.plan.flying.turns import LineStop, solve_stop, solve_turn
from orchestrator.plan.path_profiles import Array, FittedMotion
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
        self._first_flown = len(self._axes) - len(lines.scan.flown_axes)
        """The number of the first axis that flies; they are the last ones."""
        self._turns: dict[tuple[int, ...], FittedMotion] = {}

    def plan(self, first: int, end: int) -> Flight:
        lines, flown_lines, at_s = self._lines, list[FlightLine](), 0.0
        begin_states = self._find_rest(lines.find_begin(first), first)
        parts: list[FittedMotion] = []
        while first < end:
            count = lines.count - first % lines.count
            entries, leaves = self._find_states(first, 0), self._find_states(first + count - 1, 1)
            parts += [self._turn(begin_states, entries), self._fly(first, count)]
            begin_s = at_s + parts[-2].duration_s
            flown_lines.append(FlightLine(first, count, begin_s, lines.window_s))
            at_s = begin_s + parts[-1].duration_s
            first, begin_states = first + count, leaves
        parts.append(self._turn(begin_states, self._find_rest(lines.find_end(first - 1), first - 1)))
        return Flight(flown_lines, join_motions(parts))

    def _find_rest(self, positions: Sequence[float], point: int) -> list[WayEnd]:
        """All axes at rest, those that fly at positions, the others where they are at a point."""
        states = [WayEnd(value) for value in self._lines.find_target(point).values()]
        return [*states[: self._first_flown], *map(WayEnd, positions)]

    def _find_states(self, point: int, part: int) -> list[WayEnd]:
        """All axes at the beginning of the window of a point, part 0, or at its end, part 1."""
        states = [WayEnd(value) for value in self._lines.find_target(point).values()]
        return [*states[: self._first_flown], *self._lines.find_states(point, part)]

    def _fly(self, point: int, count: int) -> FittedMotion:
        """All axes through the windows of so many points of one line."""
        motion, targets = self._lines.make_windows(point, count), list(self._lines.find_target(point).values())
        outer_places = np.array(targets[: self._first_flown])

        def add_outer(rows: Array, values: Array) -> Array:
            return np.hstack([np.broadcast_to(values, (len(rows), len(values))), rows])

        zeros = np.zeros(self._first_flown)
        return FittedMotion(
            motion.times_s,
            add_outer(motion.positions, outer_places),
            *(add_outer(rows, zeros) for rows in (motion.velocities, motion.accelerations, motion.jerks)),
        )

    def _turn(self, begin: Sequence[WayEnd], end: Sequence[WayEnd]) -> FittedMotion:
        """The fastest motion between two states."""
        ways = [end_state.position - begin_state.position for begin_state, end_state in zip(begin, end, strict=True)]
        rates = [value for states in (begin, end) for state in states[self._first_flown :] for value in state[1:]]
        key = tuple(round(value / NEAR) for value in (*ways, *rates))
        if key not in self._turns:
            origin = [state._replace(position=0.0) for state in begin]
            target = [state._replace(position=way) for way, state in zip(ways, end, strict=True)]
            self._turns[key] = self._solve(origin, target)
        return move_motion(self._turns[key], np.array([state.position for state in begin]))

    def _solve(self, begin: Sequence[WayEnd], end: Sequence[WayEnd]) -> FittedMotion:
        ways, first = [state.position for state in end], self._first_flown
        limits = self._find_limits(ways, 1.0)
        line_limits, rooms = self._lines.share_out(limits[first:]), self._lines.rooms
        if _are_at_rest(begin) or _are_at_rest(end):  # a run-up or a run-down
            return solve_turn(begin, end, [*limits[:first], *line_limits])
        turn = solve_turn(begin, end, self._find_limits(ways, self._use))
        if rooms is None:
            return turn
        # No farther than lines that begin and end at rest, whose room is checked before anything moves.
        ends = np.array([[state.position for state in states[first:]] for states in (begin, end)])
        least, most = (positions[first:] for positions in find_extremes(turn))
        if (least >= ends.min(axis=0) - rooms).all() and (most <= ends.max(axis=0) + rooms).all():
            return turn
        stops = [LineStop(*pair) for pair in zip(rooms, line_limits, strict=True)]
        return solve_stop(begin, end, limits, stops)

    def _find_limits(self, ways: Sequence[float], use: float) -> list[WayLimits]:
        """The limits of the axes on their ways, with the speed that the scan states for its moves between lines."""
        moves = [
            make_axis_move(name, axis, 0, round(way * float(axis.counts_per_unit)), 3)
            for way, (name, axis) in zip(ways, self._axes.items(), strict=True)
        ]
        limited_moves = limit_speeds(self._fleet, self._lines.scan, moves)
        flown_speeds = dict(zip(self._lines.scan.flown_axes, self._lines.turn_speeds, strict=True))
        limits: list[WayLimits] = []
        for (name, axis), move in zip(self._axes.items(), limited_moves, strict=True):
            speed = max(move.velocity / float(axis.scale), flown_speeds.get(name, 0.0))
            limits.append(WayLimits(speed, axis.limits.acceleration * use, find_jerk(axis) * use))
        return limits


def _are_at_rest(states: Sequence[WayEnd]) -> bool:
    return not any(state.velocity or state.acceleration for state in states)
