"""Several lines of a scan as one motion: constant speed through the windows of each, and turn-arounds in between that
are rounded in all axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from orchestrator.model.fleet import Fleet
from orchestrator.plan.flying.lines import FlownLines
from orchestrator.plan.flying.motions import find_extremes, glide, join_motions, move_motion
from orchestrator.plan.flying.turns import solve_stop, solve_turn
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
        self._flown = len(self._axes) - 1
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

    def _find_rest(self, position: float, point: int) -> list[WayEnd]:
        """All axes at rest, that which flies at a position, the others where they are at a point."""
        states = [WayEnd(value) for value in self._lines.find_target(point).values()]
        return [*states[:-1], WayEnd(position)]

    def _find_state(self, point: int, part: float) -> list[WayEnd]:
        """All axes in a part of the window of a point, while it is flown."""
        states = [WayEnd(value) for value in self._lines.find_target(point).values()]
        velocity = self._lines.find_velocity(point)
        way = (part - 0.5) * self._lines.window_s * velocity
        return [*states[:-1], WayEnd(states[-1].position + way, velocity)]

    def _turn(self, begin: Sequence[WayEnd], end: Sequence[WayEnd]) -> FittedMotion:
        """The fastest motion between two states."""
        ways = [end_state.position - begin_state.position for begin_state, end_state in zip(begin, end, strict=True)]
        speeds = [begin[self._flown].velocity, end[self._flown].velocity]
        key = tuple(round(value / NEAR) for value in (*ways, *speeds))
        if key not in self._turns:
            origin = [WayEnd(0.0, state.velocity) for state in begin]
            target = [WayEnd(way, state.velocity) for way, state in zip(ways, end, strict=True)]
            self._turns[key] = self._solve(origin, target)
        return move_motion(self._turns[key], np.array([state.position for state in begin]))

    def _solve(self, begin: Sequence[WayEnd], end: Sequence[WayEnd]) -> FittedMotion:
        entry, leave, room = begin[self._flown], end[self._flown], self._lines.run_up
        ways = [state.position for state in end]
        if not (entry.velocity and leave.velocity):  # a run-up or a run-down
            return solve_turn(begin, end, self._find_limits(ways, 1.0))
        turn = solve_turn(begin, end, self._find_limits(ways, self._use))
        # No farther than lines that begin and end at rest, whose room is checked before anything moves.
        least, most = (float(positions[self._flown]) for positions in find_extremes(turn))
        ends = [entry.position, leave.position]
        if least >= min(ends) - room and most <= max(ends) + room:
            return turn
        return solve_stop(begin, end, self._find_limits(ways, 1.0), self._flown, room)

    def _find_limits(self, ways: Sequence[float], use: float) -> list[WayLimits]:
        """The limits of the axes on their ways, with the speed that the scan states for its moves between lines."""
        moves = [
            make_axis_move(name, axis, 0, round(way * float(axis.counts_per_unit)), 3)
            for way, (name, axis) in zip(ways, self._axes.items(), strict=True)
        ]
        limited_moves = limit_speeds(self._fleet, self._lines.scan, moves)
        limits: list[WayLimits] = []
        for axis, move in zip(self._axes.values(), limited_moves, strict=True):
            speed = move.velocity / float(axis.scale)
            if axis is self._axes[self._lines.axis]:
                speed = max(speed, self._lines.speed)
            limits.append(WayLimits(speed, axis.limits.acceleration * use, find_jerk(axis) * use))
        return limits
