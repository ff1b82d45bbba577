"""When axes have ended, by all that is known of the unit's crystal and by what the unit itself says."""

from math import ceil

from adapters.contract import Span
from adapters.shrc203.loaded import Move
from adapters.shrc203.lowering import AxisMove
from adapters.shrc203.pair import Pair
from adapters.shrc203.session import EOL, Session
from adapters.shrc203.status import ERRORS
from adapters.shrc203.timing import Timing
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.inferred import UnreadClock
from orchestrator.clock.timed import LONG_S

_DIGIT_CHARACTERS = len("1" + EOL)


class Ending:
    """Ends of the moves of one connection. crystal: what is known of it, and learned from the moves."""

    def __init__(self, session: Session, clock: Clock, crystal: UnreadClock) -> None:
        self._session = session
        self._clock = clock
        self._crystal = crystal

    def took_ns(self, axis: AxisMove) -> tuple[int, int]:
        """What an axis's move takes, least and most; at the least without a pause between two moves."""
        assert axis.shape is not None
        gap_s = axis.shape.gap_s if isinstance(axis.shape, Pair) else 0.0
        least_ns, most_ns = self._crystal.rate.took_ns(axis.shape.duration_s, self._clock.now_ns())
        return least_ns - ceil(gap_s * NS_PER_S), most_ns

    def span(self, move: Move, axis: AxisMove, completed_ns: int | None, rest_ns: int, arrived: bool) -> Span:
        """When an axis ended. By its start and its duration, as far as the unit's crystal may be wrong; and before
        its completion line (or the reply that showed it at rest) can have begun to be sent."""
        assert move.started is not None
        seen_ns = self._seen_ns(completed_ns, rest_ns)
        if not arrived:
            return Span(min(move.started.earliest_ns, seen_ns), seen_ns)
        least_ns, most_ns = self.took_ns(axis)
        latest_ns = seen_ns
        if not isinstance(axis.shape, Pair):  # how long the unit takes between two moves is not guaranteed
            latest_ns = min(seen_ns, move.started.latest_ns + most_ns)
        return Span(min(move.started.earliest_ns + least_ns, latest_ns), latest_ns)

    async def look_closely(self, move: Move, timing: Timing) -> None:
        """Ask again and again about the end, so that it is also known when it had not come yet."""
        assert move.started is not None
        if timing.timed.duration_s < LONG_S:
            return
        session = self._session
        least_ns, most_ns = self.took_ns(timing.axis)
        begin_ns = move.started.earliest_ns + least_ns - timing.timed.before_ns
        while timing.axis.motor in session.owed and move.stopped_ns is None:
            if self._clock.now_ns() < begin_ns:
                await session.wait_changed(begin_ns)
            elif self._clock.now_ns() > move.started.latest_ns + most_ns or not await timing.still_moves():
                break

    def learn(self, move: Move, timing: Timing, completed_ns: int | None, rest_ns: int) -> None:
        """What a move says of the crystal and of the time to the start, if it has ended as planned."""
        assert move.started is not None
        axis, now = timing.axis, move.seen[timing.axis.motor]
        if now.busy or now.word & ERRORS or now.counts != axis.end_counts or move.stopped_ns is not None:
            return
        timing.timed.ended(self._seen_ns(completed_ns, rest_ns))
        self._crystal.learn(timing.timed, move.started.earliest_ns, move.answered_ns, self._clock.now_ns())

    def _seen_ns(self, completed_ns: int | None, rest_ns: int) -> int:
        """By when an axis had ended."""
        return rest_ns if completed_ns is None else completed_ns - self._session.wire_ns(_DIGIT_CHARACTERS)
