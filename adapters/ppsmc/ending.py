"""How a started move ends: watched until its axes are at rest, and judged by all that the unit says."""

from collections.abc import Mapping

from adapters.contract import Outcome, Span
from adapters.ppsmc.lowering import AxisMove
from adapters.ppsmc.options import Options
from adapters.ppsmc.replies import Bits
from adapters.ppsmc.step import Move
from adapters.ppsmc.timing import Timing
from adapters.ppsmc.timing import timing as timing_of
from adapters.ppsmc.unitstate import Look, UnitState
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.clock.inferred import UnreadClock

_LOOK_NS = 50 * NS_PER_MS
_LOOK_SOON_NS = 5 * NS_PER_MS
# Status bits may still say ready for a moment after a start, as a client of real units has found.
_LAG_NS = 500 * NS_PER_MS


class Ending:
    """Ends of moves of one connection. crystal: what is known of it, and learned from the moves. settle_ns: how long
    axes may move after their due end."""

    def __init__(self, options: Options, clock: Clock, unit: UnitState, crystal: UnreadClock, settle_ns: int) -> None:
        self._quick_ns = options.decode_ns[0]
        self._crystal = crystal
        self._clock = clock
        self._unit = unit
        self._settle_ns = settle_ns

    async def watched(self, move: Move) -> Outcome:
        """Wait until the axes of a move that has started are at rest, and say how they ended."""
        assert move.started is not None
        timing = timing_of(move.lowered, move.started, self._unit.closed, self._quick_ns)
        self._unit.watched = None if timing is None else timing.looked
        try:
            return await self._watched(move, timing)
        finally:
            self._unit.watched = None

    async def _watched(self, move: Move, timing: Timing | None) -> Outcome:
        assert move.started is not None
        due_ns = move.started.latest_ns + max(self._took_ns(each)[1] for each in move.lowered.moves)
        give_up_ns = due_ns + _LAG_NS + self._settle_ns
        seen: dict[int, int] = {}
        while True:
            look = await self._unit.look()
            for each in move.lowered.moves:
                if look.ready(each.motor) and self._ended(move, each, look):
                    seen.setdefault(each.motor, look.at_ns)
                else:
                    seen.pop(each.motor, None)
            if len(seen) == len(move.lowered.moves) or look.at_ns > give_up_ns:
                break
            await self._pause(move, seen)
        reasons, error = await self._judge(move, look)
        if timing is not None and not reasons:
            timing.ended(seen[timing.axis.motor])
            # What shows the start is the answer to a second question, which says nothing of the time to it.
            self._crystal.learn(timing.timed, self._arrived_ns(move), None, self._clock.now_ns())
        ended = {name: Span(move.t0_ns, move.t0_ns) for name, s in move.lowered.durations_s.items() if s == 0.0}
        for each in move.lowered.moves:
            ended[each.name] = self._end(move, each, seen.get(each.motor, look.at_ns), look)
        wrong = await move.output.passive() if move.output is not None else ""
        error = error or bool(wrong)
        reasons += [wrong] if wrong else []
        if not reasons:
            return Outcome("done", ended)
        if move.stopped_ns is not None and not error:
            return Outcome("stopped", ended, "; ".join(["stopped on request", *reasons]))
        return Outcome("fault", ended, "; ".join(reasons))

    def _ended(self, move: Move, axis: AxisMove, look: Look) -> bool:
        """Whether an axis that says it is ready has ended: ready bits lag behind the start of a move."""
        assert move.started is not None
        if look.counts[axis.motor] == axis.end_counts or move.stopped_ns is not None:
            return True
        if look.bits[axis.motor] & (Bits.LIMIT_FORWARD | Bits.LIMIT_REVERSE | Bits.ENCODER_ERROR | Bits.BLOCKED):
            return True
        return look.at_ns > move.started.latest_ns + _LAG_NS

    async def _pause(self, move: Move, seen: Mapping[int, int]) -> None:
        """Until the next look: soon when an axis is about to end, so that its end is known well."""
        assert move.started is not None
        now_ns = self._clock.now_ns()
        dues = [
            move.started.earliest_ns + self._took_ns(each)[0] for each in move.lowered.moves if each.motor not in seen
        ]
        soon = any(due - _LOOK_NS < now_ns < due + _LOOK_NS for due in dues)
        await sleep_ns(self._clock, _LOOK_SOON_NS if soon else _LOOK_NS)

    async def _judge(self, move: Move, look: Look) -> tuple[list[str], bool]:
        """What is wrong with the end, and whether that is more than a stop on request."""
        reasons: list[str] = []
        error = False
        said = {} if look.blocked else await self._unit.errors()
        for each in move.lowered.moves:
            bits, counts = look.bits[each.motor], look.counts[each.motor]
            number, text = said.get(each.motor, (0, ""))
            if not look.ready(each.motor):
                error = True
                reasons.append(f"axis {each.name} does not come to rest")
            elif bits & Bits.ENCODER_ERROR:
                error = True
                reasons.append(f"axis {each.name}: its encoder does not show the target (closed loop has given up)")
            elif number:
                error = True
                reasons.append(f"axis {each.name}: the unit reports error {number} {text}".rstrip())
            elif counts != each.end_counts:
                limit = bits & (Bits.LIMIT_FORWARD | Bits.LIMIT_REVERSE)
                error = error or bool(limit) or move.stopped_ns is None
                where = "on a limit switch, " if limit else ""
                reasons.append(f"axis {each.name} stands {where}at {counts}, not at its target {each.end_counts}")
        return reasons, error

    def _end(self, move: Move, axis: AxisMove, seen_ns: int, look: Look) -> Span:
        """When an axis ended: by its start and its duration, as far as the crystal may be wrong, and before it was
        seen at rest."""
        assert move.started is not None
        if look.counts[axis.motor] != axis.end_counts:
            return Span(min(move.started.earliest_ns, seen_ns), seen_ns)
        least_ns, most_ns = self._took_ns(axis)
        latest_ns = seen_ns
        if axis.motor not in self._unit.closed:
            latest_ns = min(seen_ns, move.started.latest_ns + most_ns)
        return Span(min(move.started.earliest_ns + least_ns, latest_ns), latest_ns)

    def _took_ns(self, axis: AxisMove) -> tuple[int, int]:
        """What an axis's move takes by all that is known of the crystal, least and most."""
        assert axis.shape is not None
        return self._crystal.rate.took_ns(axis.shape.duration_s, self._clock.now_ns())

    def _arrived_ns(self, move: Move) -> int:
        """The earliest instant at which the starting line was at the unit."""
        assert move.started is not None
        return move.started.earliest_ns - self._quick_ns
