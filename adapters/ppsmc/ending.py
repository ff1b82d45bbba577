"""The end of a started move: watched until its axes are at rest, and evaluated from everything that the controller
reports."""

from collections.abc import Mapping

from adapters.contract import HostInterval, MoveOutcome
from adapters.ppsmc.lowering import PpSmcAxisMove
from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.replies import StatusBits
from adapters.ppsmc.step import LoadedMove
from adapters.ppsmc.timing import PpSmcTiming
from adapters.ppsmc.timing import make_timing as timing_of
from adapters.ppsmc.unitstate import PpSmcReading, PpSmcState
from adapters.toolkit.host_start import MoverTools, moved_outcome, resting_intervals
from orchestrator.clock.base import NS_PER_MS, sleep_ns

_POLL_NS = 50 * NS_PER_MS
_FAST_POLL_NS = 5 * NS_PER_MS
_POLL_LINES = 8  # of a poll that this query may have to wait for
# Status bits may still read ready for a moment after a start, as observed on real controllers.
_READY_LAG_NS = 500 * NS_PER_MS


class PpSmcEndTimes:
    """End times of moves of one connection. crystal: what is known about it, and learned from the moves. settle_ns: how
    long axes may move after their planned end."""

    def __init__(self, options: PpSmcOptions, tools: MoverTools, unit: PpSmcState, settle_ns: int) -> None:
        self._quick_ns = options.decode_ns[0]
        self._crystal = tools.crystal
        self._clock = tools.clock
        self._unit = unit
        self._settle_ns = settle_ns

    async def watch_to_end(self, move: LoadedMove) -> MoveOutcome:
        """Wait until the axes of a started move are at rest, and return how they ended."""
        timing = timing_of(move.lowered, move.start, self._unit.closed, self._quick_ns)
        self._unit.on_reading = None if timing is None else timing.add_reading
        try:
            return await self._watch_axes(move, timing)
        finally:
            self._unit.on_reading = None

    async def _watch_axes(self, move: LoadedMove, timing: PpSmcTiming | None) -> MoveOutcome:
        due_ns = move.start.latest_ns + max(self._duration_bounds_ns(axis_move)[1] for axis_move in move.lowered.moves)
        give_up_ns = due_ns + _READY_LAG_NS + self._settle_ns
        ready_ns: dict[int, int] = {}
        while True:
            look = await self._unit.read_state(with_errors=self._is_due(move))
            for axis_move in move.lowered.moves:
                if look.is_ready(axis_move.motor) and self._has_ended(move, axis_move, look):
                    ready_ns.setdefault(axis_move.motor, look.at_ns)
                else:
                    ready_ns.pop(axis_move.motor, None)
            if len(ready_ns) == len(move.lowered.moves) or look.at_ns > give_up_ns:
                break
            await self._wait_for_next_poll(move, ready_ns)
        reasons, error = await self._evaluate_end(move, look)
        if timing is not None and not reasons:
            timing.record_end(ready_ns[timing.axis.motor])
            # The start is shown by the answer to a second query, which gives no information about the start delay.
            self._crystal.learn_from_move(
                timing.timed, self._arrived_ns(move), None, self._clock.now_ns(), move.start.late_ns
            )
        end_spans = resting_intervals(move.lowered.durations_s, move.t0_ns)
        for axis_move in move.lowered.moves:
            end_spans[axis_move.name] = self._end_interval(
                move, axis_move, ready_ns.get(axis_move.motor, look.at_ns), look
            )
        wrong = await move.output.wait_until_passive() if move.output is not None else ""
        error = error or bool(wrong)
        reasons += [wrong] if wrong else []
        return moved_outcome(end_spans, reasons, stopped=move.stopped_ns is not None, failed=error)

    def _is_due(self, move: LoadedMove) -> bool:
        """Return whether the whole move may have ended when it is this query's turn: a query that shows its end shows
        its errors as well."""
        longest_ns = max(self._duration_bounds_ns(axis_move)[0] for axis_move in move.lowered.moves)
        turn_ns = self._clock.now_ns() + _FAST_POLL_NS + _POLL_LINES * self._unit.slow_ns
        return turn_ns >= move.start.earliest_ns + longest_ns

    def _has_ended(self, move: LoadedMove, axis: PpSmcAxisMove, look: PpSmcReading) -> bool:
        """Return whether an axis that reads ready has ended: ready bits lag behind the start of a move."""
        if look.counts[axis.motor] == axis.end_counts or move.stopped_ns is not None:
            return True
        if look.bits[axis.motor] & (
            StatusBits.LIMIT_FORWARD | StatusBits.LIMIT_REVERSE | StatusBits.ENCODER_ERROR | StatusBits.BLOCKED
        ):
            return True
        return look.at_ns > move.start.latest_ns + _READY_LAG_NS

    async def _wait_for_next_poll(self, move: LoadedMove, seen: Mapping[int, int]) -> None:
        """Wait for the next query: a short time when an axis is about to end, so that its end is known precisely."""
        now_ns = self._clock.now_ns()
        dues = [
            move.start.earliest_ns + self._duration_bounds_ns(axis_move)[0]
            for axis_move in move.lowered.moves
            if axis_move.motor not in seen
        ]
        is_near = any(due - _POLL_NS < now_ns < due + _POLL_NS for due in dues)
        await sleep_ns(self._clock, _FAST_POLL_NS if is_near else _POLL_NS)

    async def _evaluate_end(self, move: LoadedMove, look: PpSmcReading) -> tuple[list[str], bool]:
        """Return the failures at the end, and whether they are more than a requested stop."""
        reasons: list[str] = []
        error = False
        errors = look.errors
        if errors is None:
            errors = {} if look.is_blocked else await self._unit.read_errors()
        for axis_move in move.lowered.moves:
            bits, counts = look.bits[axis_move.motor], look.counts[axis_move.motor]
            number, text = errors.get(axis_move.motor, (0, ""))
            if not look.is_ready(axis_move.motor):
                error = True
                reasons.append(f"axis {axis_move.name} does not come to rest")
            elif bits & StatusBits.ENCODER_ERROR:
                error = True
                reasons.append(
                    f"axis {axis_move.name}: its encoder does not show the target (closed loop has given up)"
                )
            elif number:
                error = True
                reasons.append(f"axis {axis_move.name}: the controller reports error {number} {text}".rstrip())
            elif counts != axis_move.end_counts:
                limit = bits & (StatusBits.LIMIT_FORWARD | StatusBits.LIMIT_REVERSE)
                error = error or bool(limit) or move.stopped_ns is None
                switch_text = "on a limit switch, " if limit else ""
                reasons.append(
                    f"axis {axis_move.name} is {switch_text}at {counts}, not at its target {axis_move.end_counts}"
                )
        return reasons, error

    def _end_interval(self, move: LoadedMove, axis: PpSmcAxisMove, seen_ns: int, look: PpSmcReading) -> HostInterval:
        """Return the interval of an axis's end: from its start and its duration, within the error of the crystal, and
        before it was seen at rest."""
        if look.counts[axis.motor] != axis.end_counts:
            return HostInterval(min(move.start.earliest_ns, seen_ns), seen_ns)
        least_ns, most_ns = self._duration_bounds_ns(axis)
        latest_ns = seen_ns
        if axis.motor not in self._unit.closed:
            latest_ns = min(seen_ns, move.start.latest_ns + most_ns)
        return HostInterval(min(move.start.earliest_ns + least_ns, latest_ns), latest_ns)

    def _duration_bounds_ns(self, axis: PpSmcAxisMove) -> tuple[int, int]:
        """Return the shortest and longest duration of an axis's move by everything known about the crystal."""
        return self._crystal.crystal_rate.host_duration_ns(axis.running_shape.duration_s, self._clock.now_ns())

    def _arrived_ns(self, move: LoadedMove) -> int:
        """Return the earliest instant at which the starting command reached the controller."""
        return move.start.earliest_ns - self._quick_ns
