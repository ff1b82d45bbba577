"""Observed times of a move: the position of an axis in motion, whether it still moves, and when it has ended.

All axes of a controller have one crystal: the one that moves longest represents all. Only moves by one command that the
host has started, in open loop, are observed closely: a settling axis is BUSY after its move, two moves have a hand-over
between them, the start by a trigger line is known by its window only, and `KP:` has speeds that are not whole numbers.
"""

from collections.abc import Mapping

from adapters.contract import HostInterval
from adapters.shrc203.lowering import ShrcAxisMove, ShrcLowered
from adapters.shrc203.shapes.trapezoid import ShrcTrapezoid
from adapters.shrc203.wire.replies import READY, AxisStatus
from adapters.shrc203.wire.reply_queue import EOL, ShrcLine
from adapters.shrc203.wire.session import ShrcSession
from orchestrator.clock.timed import TimedMove

_GRAIN = 1.0  # pulses: the manual does not state whether the counter rounds


class ShrcTiming:
    """The times of one move of an axis that has started."""

    def __init__(self, axis: ShrcAxisMove, timed: TimedMove, session: ShrcSession) -> None:
        self.axis = axis
        self.timed = timed
        self._session = session

    def add_reading(self, command: str, line: ShrcLine, now: Mapping[int, AxisStatus]) -> None:
        """Add the observations of a poll."""
        state = now[self.axis.motor]
        asked_ns = line.command_ns + self._session.wire_ns(len(command + EOL))
        told_ns = line.at_ns - self._session.wire_ns(len(line.text + EOL))
        self.timed.add_position(abs(state.counts - self.axis.start_counts), _GRAIN, asked_ns, told_ns)
        if state.is_busy:
            self.timed.mark_moving(asked_ns)

    async def still_moves(self) -> bool:
        """Query whether the axis still moves; False also without a reply, which later exchanges will detect."""
        command = f"!:{self.axis.motor}S"
        line = await self._session.try_query(command, READY)
        if line is None or line.text != "B":
            return False
        self.timed.mark_moving(line.command_ns + self._session.wire_ns(len(command + EOL)))
        return True


def make_timing(
    lowered: ShrcLowered, started: HostInterval, closed_loop: Mapping[int, bool], session: ShrcSession
) -> ShrcTiming | None:
    """Return the timing of the longest move that provides information about the crystal."""
    if lowered.wait is not None:
        return None
    candidates = [
        (move.shape.duration_s, move.motor, move, move.shape.motion_legs)
        for move in lowered.moves
        if isinstance(move.shape, ShrcTrapezoid) and not closed_loop.get(move.motor)
    ]
    if not candidates:
        return None
    duration_s, _, axis, legs = max(candidates)
    return ShrcTiming(axis, TimedMove(duration_s, legs, (started.earliest_ns, started.latest_ns)), session)
