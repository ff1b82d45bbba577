"""What is seen of a move's times: where an axis is on its way, whether it still moves, and when it has ended.

All axes of a unit have one crystal: the one that moves longest stands for all. Looked at closely are moves by one
command that the host has started, in open loop: an axis that settles is BUSY after its move, two moves have a hand-over
between them, a line that starts axes is known by its window only, and `KP:` has speeds that are no whole numbers.
"""

from collections.abc import Mapping

from adapters.contract import Span
from adapters.shrc203.lowering import AxisMove, ShrcLowered
from adapters.shrc203.replies import READY, AxisStatus
from adapters.shrc203.session import EOL, Line, Session
from adapters.shrc203.trapezoid import Trapezoid
from orchestrator.clock.timed import TimedMove

_GRAIN = 1.0  # pulses: whether the counter rounds is not said


class Timing:
    """The times of one move of an axis that has started."""

    def __init__(self, axis: AxisMove, timed: TimedMove, session: Session) -> None:
        self.axis = axis
        self.timed = timed
        self._session = session

    def looked(self, command: str, line: Line, now: Mapping[int, AxisStatus]) -> None:
        """Take what a poll says."""
        each = now[self.axis.motor]
        asked_ns = line.asked_ns + self._session.wire_ns(len(command + EOL))
        told_ns = line.at_ns - self._session.wire_ns(len(line.text + EOL))
        self.timed.stood(abs(each.counts - self.axis.start_counts), _GRAIN, asked_ns, told_ns)
        if each.busy:
            self.timed.moved(asked_ns)

    async def still_moves(self) -> bool:
        """Ask whether it does; False also when there is no answer, which others will find out in their turn."""
        command = f"!:{self.axis.motor}S"
        line = await self._session.try_to_ask(command, READY)
        if line is None or line.text != "B":
            return False
        self.timed.moved(line.asked_ns + self._session.wire_ns(len(command + EOL)))
        return True


def timing(lowered: ShrcLowered, started: Span, closed_loop: Mapping[int, bool], session: Session) -> Timing | None:
    """Of the longest move that says something about the crystal."""
    if lowered.wait is not None:
        return None
    found = [
        (each.shape.duration_s, each.motor, each, each.shape.legs)
        for each in lowered.moves
        if isinstance(each.shape, Trapezoid) and not closed_loop.get(each.motor)
    ]
    if not found:
        return None
    duration_s, _, axis, legs = max(found)
    return Timing(axis, TimedMove(duration_s, legs, (started.earliest_ns, started.latest_ns)), session)
