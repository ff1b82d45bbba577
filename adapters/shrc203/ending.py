"""End times of moves, from everything known about the controller's crystal and from the controller's own messages."""

from math import ceil

from adapters.contract import HostInterval
from adapters.shrc203.loaded import ArmedMove
from adapters.shrc203.lowering import ShrcAxisMove
from adapters.shrc203.shapes.pair import TwoPartMove
from adapters.shrc203.timing import ShrcTiming
from adapters.shrc203.wire.reply_queue import EOL
from adapters.shrc203.wire.session import ShrcSession
from adapters.shrc203.wire.status import ERRORS
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.inferred import InferredClock
from orchestrator.clock.timed import MIN_POLLED_DURATION_S

_DIGIT_CHARACTERS = len("1" + EOL)


class ShrcEndTimes:
    """End times of the moves of one connection. crystal: what is known about it, and learned from the moves."""

    def __init__(self, session: ShrcSession, clock: Clock, crystal: InferredClock) -> None:
        self._session = session
        self._clock = clock
        self._crystal = crystal

    def duration_bounds_ns(self, axis: ShrcAxisMove) -> tuple[int, int]:
        """Return the shortest and longest duration of an axis's move; the shortest without a pause between two
        moves."""
        shape = axis.running_shape
        gap_s = shape.gap_s if isinstance(shape, TwoPartMove) else 0.0
        least_ns, most_ns = self._crystal.crystal_rate.host_duration_ns(shape.duration_s, self._clock.now_ns())
        return least_ns - ceil(gap_s * NS_PER_S), most_ns

    def end_interval(
        self, move: ArmedMove, axis: ShrcAxisMove, completed_ns: int | None, rest_ns: int, *, arrived: bool
    ) -> HostInterval:
        """Return the interval of an axis's end: from its start and its duration, within the error of the controller's
        crystal, and before its completion line (or the reply that showed it at rest) can have been sent."""
        seen_ns = self._seen_ns(completed_ns, rest_ns)
        if not arrived:
            return HostInterval(min(move.start.earliest_ns, seen_ns), seen_ns)
        least_ns, most_ns = self.duration_bounds_ns(axis)
        latest_ns = seen_ns
        if not isinstance(axis.shape, TwoPartMove):  # the controller's pause between two moves is not guaranteed
            latest_ns = min(seen_ns, move.start.latest_ns + most_ns)
        return HostInterval(min(move.start.earliest_ns + least_ns, latest_ns), latest_ns)

    async def observe_end(self, move: ArmedMove, timing: ShrcTiming) -> None:
        """Query the axis repeatedly near its end, so that the latest instant before the end is known as well."""
        if timing.timed.duration_s < MIN_POLLED_DURATION_S:
            return
        session = self._session
        least_ns, most_ns = self.duration_bounds_ns(timing.axis)
        begin_ns = move.start.earliest_ns + least_ns - timing.timed.end_poll_lead_ns
        while timing.axis.motor in session.completions.expected and move.stopped_ns is None:
            if self._clock.now_ns() < begin_ns:
                await session.wait_changed(begin_ns)
            elif self._clock.now_ns() > move.start.latest_ns + most_ns or not await timing.still_moves():
                break

    def learn_crystal(self, move: ArmedMove, timing: ShrcTiming, completed_ns: int | None, rest_ns: int) -> None:
        """Learn the crystal's rate and the start delay from a move that has ended as planned."""
        axis, state = timing.axis, move.seen[timing.axis.motor]
        if state.is_busy or state.word & ERRORS or state.counts != axis.end_counts or move.stopped_ns is not None:
            return
        timing.timed.mark_ended(self._seen_ns(completed_ns, rest_ns))
        self._crystal.learn_from_move(
            timing.timed, move.start.earliest_ns, move.answered_ns, self._clock.now_ns(), move.start.late_ns
        )

    def _seen_ns(self, completed_ns: int | None, rest_ns: int) -> int:
        """Return the latest instant at which an axis can have ended."""
        return rest_ns if completed_ns is None else completed_ns - self._session.wire_ns(_DIGIT_CHARACTERS)
