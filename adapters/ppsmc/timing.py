"""Observed times of a move: the position of an axis in motion, whether it still moves, and when it has ended.

All axes of a controller have one crystal: the one that moves longest represents all. Only moves that the host has
started, in open loop, are observed: an axis in closed loop reads as moving after its move, and a program has other jobs
first.
"""

from collections.abc import Set

from adapters.contract import HostInterval
from adapters.ppsmc.lowering import PpSmcAxisMove, PpSmcLowered
from adapters.ppsmc.unitstate import PpSmcReading
from orchestrator.clock.timed import TimedMove


class PpSmcTiming:
    """The times of one move of an axis that has started. quick_ns: shortest execution time of a command."""

    def __init__(self, axis: PpSmcAxisMove, timed: TimedMove, quick_ns: int) -> None:
        self.axis = axis
        self.timed = timed
        self._quick_ns = quick_ns

    def add_reading(self, look: PpSmcReading) -> None:
        """Add the observations of a poll: the status is as of its query, the position as of the following query."""
        counts = look.counts[self.axis.motor]
        if look.is_blocked or look.is_ready(self.axis.motor) or counts is None:
            return
        self.timed.mark_moving(look.begun_ns)
        way = abs(counts - self.axis.start_counts)
        self.timed.add_position(way, look.grains[self.axis.motor], look.begun_ns + self._quick_ns, look.at_ns)

    def record_end(self, ready_ns: int) -> None:
        """Record that the axis was seen ready in a poll whose position was answered then: a command later than its
        status."""
        self.timed.mark_ended(ready_ns - self._quick_ns)


def make_timing(lowered: PpSmcLowered, started: HostInterval, closed: Set[int], quick_ns: int) -> PpSmcTiming | None:
    """Return the timing of the longest move that provides information about the crystal."""
    if lowered.by_program:
        return None
    candidates = [
        (move.shape.duration_s, move.motor, move, move.shape.motion_legs)
        for move in lowered.moves
        if move.shape is not None and move.motor not in closed
    ]
    if not candidates:
        return None
    duration_s, _, axis, legs = max(candidates)
    return PpSmcTiming(axis, TimedMove(duration_s, legs, (started.earliest_ns, started.latest_ns)), quick_ns)
