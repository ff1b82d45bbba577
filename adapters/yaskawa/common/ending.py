"""The end of a move: watched until no axis moves, narrowed by the program's own stamps, and judged."""

from collections.abc import Sequence

from adapters.contract import HostInterval, MoveOutcome
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.following import FollowingStart
from adapters.yaskawa.common.gate import LATE_LOOK_TICKS
from adapters.yaskawa.common.lines import OutputPlayer
from adapters.yaskawa.common.loaded import EVIDENCE_WAIT_NS, SETTLE_NS, LoadedMove
from adapters.yaskawa.common.loads import YaskawaAxisMove
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.watchdog import StepWatchdog
from adapters.yaskawa.language.words import stop_code_meaning
from adapters.yaskawa.wire.record import DataRecord
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns

WATCH_NS = 100 * NS_PER_MS
_MISPLACED = "misplaced"
"""The state of an axis that nothing has stopped and that is not at its target."""


class SampleEnd:
    """The ends of one controller's moves."""

    LATE_TICKS = 4
    """Of a contour's stamps: two commands separate the last record from its stamp."""

    def __init__(
        self,
        device: SmcDevice,
        clock: Clock,
        options: YaskawaOptions,
        following: FollowingStart,
        player: OutputPlayer,
    ) -> None:
        self._device = device
        self._clock = clock
        self._watchdog = StepWatchdog(device, options)
        self._following = following
        self._player = player

    async def wait_for_end(self, loaded: LoadedMove) -> MoveOutcome:
        """Watch until no axis of the step moves, then return how it ended."""
        seen_ns = {move.axis: loaded.started[move.axis].earliest_ns for move in loaded.lowered.moves}
        end_spans: dict[str, HostInterval] = {}
        is_stopped = False
        while True:
            # A path becomes longer by every chunk.
            moves = loaded.lowered.moves
            planned_ns = {axis: loaded.t0_ns + round(s * 1e9) for axis, s in loaded.lowered.durations_s.items()}
            record, present_ticks = await self._read_present()
            if present_ticks not in (None, loaded.ticks):
                return await self._followed_outcome(loaded)
            for move in moves:
                if record.axes[move.index].is_moving:
                    seen_ns[move.axis] = record.sent_ns
                elif move.axis not in end_spans:
                    end_spans[move.axis] = HostInterval(seen_ns[move.axis], record.received_ns)
            if len(end_spans) == len(moves) and (
                loaded.lowered.switches is None or not await self._player.is_playing()
            ):
                break
            ticks = round((self._device.samples.current_mapping() or loaded.mapping).to_ticks(record.received_ns))
            deadline_ticks = max(ticks, self._following.released_ticks)
            await self._device.session.send_command(self._watchdog.extension_command(deadline_ticks))
            # Poll again soon after the next planned end: the stamps record only the last end.
            ends_ns = min((planned_ns[axis] for axis in seen_ns if axis not in end_spans), default=loaded.switched_ns)
            left_ns = ends_ns + SETTLE_NS - self._clock.now_ns()
            watch_ns = min(WATCH_NS, left_ns) if left_ns > 0 and not is_stopped else SETTLE_NS
            if not is_stopped:
                watch_ns = self._spare_turn(loaded, watch_ns)
            is_stopped = await self._device.stop_counts.sleep_to_stop(watch_ns) or is_stopped
        return await self._judge_end(loaded, moves, record, end_spans)

    async def _judge_end(
        self,
        loaded: LoadedMove,
        moves: Sequence[YaskawaAxisMove],
        record: DataRecord,
        end_spans: dict[str, HostInterval],
    ) -> MoveOutcome:
        """Return how the move ended. record: read when no axis moved any more."""
        reasons = {move.axis: self._end_reason(move, record) for move in moves}
        states = {state for state, _ in reasons.values()}
        if states <= {"done"}:
            late = await self._narrow_ends(loaded, end_spans)
            return MoveOutcome("fault", end_spans, late) if late else MoveOutcome("done", end_spans)
        text = "; ".join(f"axis {axis} {words}" for axis, (state, words) in reasons.items() if state != "done")
        (watchdog_fired,), _ = await self._device.session.read_numbers("XDOG")
        if watchdog_fired:
            text += "; by its own watchdog: the adapter did not extend its deadline, or its program had failed"
        misplaced_axes = {
            axis: f"axis {axis} {words}" for axis, (state, words) in reasons.items() if state == _MISPLACED
        }
        is_fault = bool(states & {"fault", _MISPLACED})
        return MoveOutcome("fault" if is_fault else "stopped", end_spans, text, misplaced_axes)

    def _spare_turn(self, loaded: LoadedMove, watch_ns: int) -> int:
        """Return how long to wait before the next query: queries take time from the program between a move and the one
        that follows it."""
        following, at_ns = self._following.move, self._clock.now_ns() + watch_ns
        if following is None or not following.released:
            return watch_ns
        mapping = following.mapping
        end_ns = mapping.to_host_ns(loaded.end_ticks)
        late_ns = max(end_ns, following.t0_ns) + round(LATE_LOOK_TICKS * mapping.tick_ns)
        return late_ns - self._clock.now_ns() if end_ns < at_ns < late_ns else watch_ns

    async def _read_present(self) -> tuple[DataRecord, int | None]:
        """Return a record and, if a move is loaded behind the present one, XT0 of the step that is executed."""
        if self._following.move is None:
            return await self._device.read_record(), None
        record, (ticks,) = await self._device.read_record_with("XT0")
        return record, int(ticks)

    async def _followed_outcome(self, loaded: LoadedMove) -> MoveOutcome:
        """Return how a move ended behind which another one has begun: at its target, or that one had not begun."""
        way, mapping = loaded.lowered.moving_axes, self._device.samples.current_mapping() or loaded.mapping
        names = [f"XZ{move.index + 1}" for move in way]
        if loaded.lowered.load.contour is not None:
            names = [min(names)] * len(names)
        ticks, *values = await self._device.session.read_many(["XZT", *names])
        if int(ticks) != loaded.ticks:
            return MoveOutcome("fault", {}, "the controller has begun another step; its stamps are lost")
        end_spans = {move.axis: loaded.started[move.axis] for move in loaded.lowered.moves}
        for move, value in zip(way, values, strict=True):
            begun_ns = loaded.started[move.axis].earliest_ns
            by_ns = mapping.to_host_ns(int(value) + 1)
            not_before_ns = begun_ns + round((move.samples - 1) * mapping.tick_ns)
            end_spans[move.axis] = HostInterval(not_before_ns, by_ns + mapping.bound_at_ns(by_ns))
        return MoveOutcome("done", end_spans)

    def _end_reason(self, move: YaskawaAxisMove, record: DataRecord) -> tuple[str, str]:
        if not move.samples:
            return "done", ""
        axis = record.axes[move.index]
        code = stop_code_meaning(axis.stop_code)
        if code.state == "done" and axis.commanded != move.end:
            return _MISPLACED, f"is at {axis.commanded} counts, not at {move.end}; it must be homed again"
        return code.state, code.text

    async def _narrow_ends(self, loaded: LoadedMove, ended: dict[str, HostInterval]) -> str:
        """Narrow the ends by the program's own stamps; return a message if a contour was fed too slowly.

        XEn is read after AM of axis n, or WC after a contour's last record, has passed: the axis had ended by then, but
        it may have ended long before, if the program reached the wait late. It cannot have ended before the duration of
        its profile, counted from its start. Axes that end within a contour read as moving until all of it is over, but
        they ended earlier by the records that they do not use.
        """
        way, load = loaded.lowered.moving_axes, loaded.lowered.load
        contour = load.contour
        # A contour has one stamp, that of the controller's first axis in it: a command line for all would be too long
        # (L12254).
        names = [f"XE{move.index + 1}" for move in way]
        operands = names if contour is None else [min(names), "XACT"]
        until_ns = self._clock.now_ns() + EVIDENCE_WAIT_NS
        while True:
            (is_done, ticks, *values) = await self._device.session.read_many(["XDONE", "XT0", *operands])
            if int(ticks) != loaded.ticks:
                ended.update((await self._followed_outcome(loaded)).ended)
                return ""
            if is_done:
                break
            if self._clock.now_ns() > until_ns:
                return ""
            # The axes have ended, but the program's last lines are still running.
            await sleep_ns(self._clock, SETTLE_NS)
        mapping = self._device.samples.current_mapping() or loaded.mapping
        total = 0 if contour is None else contour.record_ends[-1]
        for move in loaded.lowered.moves:
            if not move.samples:
                ended[move.axis] = loaded.started[move.axis]
        for number, move in enumerate(way):
            start, end_span = loaded.started[move.axis], ended[move.axis]
            not_before_ns = start.earliest_ns + round((move.samples - 1) * mapping.tick_ns)
            if contour is None:
                by_ns = mapping.to_host_ns(int(values[number]) + 1)
                not_before_ns = max(end_span.earliest_ns, not_before_ns)
            else:
                by_ns = mapping.to_host_ns(int(values[0]) + 1 - total + move.samples)
            ended[move.axis] = HostInterval(not_before_ns, min(end_span.latest_ns, by_ns + mapping.bound_at_ns(by_ns)))
        late = 0 if contour is None else int(values[0] - values[1]) - total
        if late > self.LATE_TICKS:
            return (
                f"the contour ended {late} samples late: its records came too slowly; raise the "
                "controller's option decode_us to the real duration of a command in its programs"
            )
        return ""
