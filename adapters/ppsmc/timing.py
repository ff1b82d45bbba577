"""What is seen of a move's times: where an axis is on its way, whether it still moves, and when it has ended.

All axes of a unit have one crystal: the one that moves longest stands for all. Looked at are moves that the host has
started, in open loop: an axis that is corrected says that it moves after its move, and a program has lines before it.
"""

from collections.abc import Set

from adapters.contract import Span
from adapters.ppsmc.lowering import AxisMove, SmcLowered
from adapters.ppsmc.unitstate import Look
from orchestrator.clock.timed import TimedMove


class Timing:
    """The times of one move of an axis that has started. quick_ns: a command takes that at the least."""

    def __init__(self, axis: AxisMove, timed: TimedMove, quick_ns: int) -> None:
        self.axis = axis
        self.timed = timed
        self._quick_ns = quick_ns

    def looked(self, look: Look) -> None:
        """Take what a look says: of the status behind the question for it, of the position behind that one."""
        counts = look.counts[self.axis.motor]
        if look.blocked or look.ready(self.axis.motor) or counts is None:
            return
        self.timed.moved(look.begun_ns)
        way = abs(counts - self.axis.start_counts)
        self.timed.stood(way, look.grains[self.axis.motor], look.begun_ns + self._quick_ns, look.at_ns)

    def ended(self, ready_ns: int) -> None:
        """It was seen ready in a look whose position was answered then: a command later than its status."""
        self.timed.ended(ready_ns - self._quick_ns)


def timing(lowered: SmcLowered, started: Span, closed: Set[int], quick_ns: int) -> Timing | None:
    """Of the longest move that says something about the crystal."""
    if lowered.by_program:
        return None
    found = [
        (each.shape.duration_s, each.motor, each, each.shape.legs)
        for each in lowered.moves
        if each.shape is not None and each.motor not in closed
    ]
    if not found:
        return None
    duration_s, _, axis, legs = max(found)
    return Timing(axis, TimedMove(duration_s, legs, (started.earliest_ns, started.latest_ns)), quick_ns)
