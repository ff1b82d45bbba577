"""One move of a controller with text lines: loaded, checked, started by one command at an instant, followed to its
end."""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from math import ceil, floor

from adapters.contract import HostInterval, MoveOutcome, WriteResult
from adapters.toolkit.firing import missed_write_fault
from adapters.toolkit.host_start import moved_outcome, moving_intervals, require_time_left, resting_intervals
from adapters.toolkit.lines.lowering import LineLowered
from adapters.toolkit.lines.move import LineMove
from adapters.toolkit.lines.options import LineOptions
from adapters.toolkit.lines.session import ExpectedReply, LineReply
from adapters.toolkit.lines.unit import LineUnit
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns, sleep_until_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal

_QUIET_NS = 60 * NS_PER_MS  # before the start command no exchange begins any more
_QUIET_CHARACTERS = 150
_POLL_NS = 20 * NS_PER_MS
_OVERDUE_NS = 3 * NS_PER_S
_LOOKS = 3  # of a controller that has not begun to move, before it is taken for one that does not


class LineMover:
    """The moves of one connection."""

    def __init__(self, unit: LineUnit, options: LineOptions) -> None:
        self.move: LineMove | None = None
        self._unit = unit
        self._options = options
        self._clock = unit.clock
        self._dialect = unit.dialect

    # Before the start

    async def load_move(self, lowered: LineLowered, t0_ns: int) -> Mapping[str, int]:
        """Load a move. Raises `Refusal`; then nothing is loaded."""
        unit, began_ns = self._unit, self._clock.now_ns()
        stop_count = unit.stops
        if self.move is not None:
            raise Refusal("busy", "a move is loaded or in progress", "disarm or stop it")
        async with unit.commanding:
            await unit.wait_until_tidy()
            await unit.require_ready([axis_move.name for axis_move in lowered.moves])
            await self._require_start(lowered)
            unit.require_no_stop(stop_count)
            self.move = LineMove(lowered, t0_ns)
            try:
                if lowered.targets:
                    await unit.session.run_procedure(self._dialect.load_move(lowered.targets))
                unit.require_no_stop(stop_count)
            except BaseException:
                self.move = None
                if lowered.targets:
                    unit.begin_tidying()
                raise
        return {"load": self._clock.now_ns() - began_ns}

    async def _require_start(self, lowered: LineLowered) -> None:
        counts = (await self._unit.read_state()).counts
        for axis_move in lowered.moves:
            if counts[axis_move.name] != axis_move.start_counts:
                raise Refusal(
                    "other-start",
                    f"axis {axis_move.name} is at {counts[axis_move.name]} counts; "
                    f"the plan starts at {axis_move.start_counts}",
                    "plan again from the present position",
                )

    async def verify_move(self) -> None:
        """Check that the controller still holds the move, and stands where it starts. Raises `Refusal`."""
        move = self._require_move()
        if not move.lowered.targets:
            return
        state = await self._unit.read_state()
        if state.status.state != self._dialect.traits.armed_state or state.status.is_loaded is False:
            raise Refusal("not-armed", f"the controller is {state.status.state}: it holds no move", "arm it again")
        await self._require_start(move.lowered)
        if self._unit.session.restarted:
            raise Refusal("not-armed", "the controller has restarted", "arm it again")

    async def schedule_start(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Have the start command written at its instant. Raises `Refusal`."""
        del advance_ns
        move = self._require_move()
        if not move.lowered.targets:
            return
        step = self._dialect.start_move()
        wire_ns = len(step.data) * self._unit.session.link.char_ns
        at_ns = move.t0_ns - wire_ns - self._options.decode_us * NS_PER_US
        require_time_left(self._clock.now_ns(), at_ns)
        move.running = asyncio.get_running_loop().create_task(self._start_at(move, at_ns, start_tolerance_ns))
        move.running.add_done_callback(_retrieve_error)

    async def _start_at(
        self, move: LineMove, at_ns: int, start_tolerance_ns: int
    ) -> tuple[WriteResult, LineReply | None]:
        session, step = self._unit.session, self._dialect.start_move()
        await sleep_until_ns(self._clock, at_ns - _QUIET_NS - _QUIET_CHARACTERS * session.link.char_ns)
        async with session.turn:
            if session.restarted or self._unit.has_lost_session:
                raise ControllerFault("not-started", "the controller has restarted before its start", "try again")
            expected_reply: ExpectedReply | None = None
            if step.is_done is not None:
                expected_reply = session.expect(step.is_done)
            latest_ns = self._options.latest_write_ns(at_ns, start_tolerance_ns)
            order = move.order = self._unit.timed_writer.schedule_write(session.link, step.data, at_ns, latest_ns)
            write = await order.wait_until_written()
            if write.late or expected_reply is None:
                if expected_reply is not None:
                    session.disturb()
                return write, None
            timeout_ns = self._options.answer_ms * NS_PER_MS + (len(step.data) + 50) * session.link.char_ns
            try:
                return write, await session.wait_for_reply(expected_reply, timeout_ns, step)
            except ControllerFault:
                return write, None  # lost, but it may move

    async def unload_move(self) -> None:
        """Unload the move; nothing starts. Idempotent."""
        move, self.move = self.move, None
        if move is None:
            return
        await self.cancel_start(move)
        if move.lowered.targets:
            self._unit.begin_tidying()
            await self._unit.wait_until_tidy()

    def record_stop(self) -> None:
        """A stop was written: a start that is not written yet is cancelled; one that cannot be cancelled any more is
        followed by another stop."""
        move = self.move
        if move is not None:
            move.stopped = True
            if move.running is not None and not move.running.done() and not self._cancel_order(move):
                self._unit.stop_after(move.order)

    def handle_restart(self) -> None:
        """The controller says that it has restarted: it must not get the start command of a move that it has lost."""
        move = self.move
        if move is not None and move.running is not None and not move.running.done():
            self._cancel_order(move)

    async def cancel_start(self, move: LineMove) -> None:
        """Cancel the start command; a command that was written all the same is followed by a stop."""
        if move.running is None or move.running.done():
            return
        if not self._cancel_order(move):
            self._unit.stop_after(move.order)
        await asyncio.wait({move.running})

    def _cancel_order(self, move: LineMove) -> bool:
        """Return whether the start command is not and will not be written."""
        assert move.running is not None
        if move.order is not None and not move.order.cancel_write():
            return False
        move.running.cancel()
        return True

    # After the start

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axes started. Raises `ControllerFault`."""
        move = self._require_move()
        durations_s = move.lowered.durations_s
        if not move.lowered.targets:
            return moving_intervals(durations_s, HostInterval(move.t0_ns, move.t0_ns), move.t0_ns)
        if move.running is None:
            raise ControllerFault("not-started", "no start was scheduled", "release it first")
        try:
            write, reply = await asyncio.shield(move.running)
        except asyncio.CancelledError:
            if not move.running.cancelled():
                raise
            self._finish_move(move)
            raise ControllerFault("not-started", "the start was cancelled by a stop or a restart", "") from None
        except (Refusal, ControllerFault) as error:
            self._finish_move(move)
            raise ControllerFault("not-started", f"the start failed: {error}", "try again") from None
        if write.late:
            self._finish_move(move)
            raise missed_write_fault("the start command", self._unit.session.link, write)
        move.started = await self._find_start(move, write, reply)
        return moving_intervals(durations_s, move.started, move.t0_ns)

    async def _find_start(self, move: LineMove, fired: WriteResult, reply: LineReply | None) -> HostInterval:
        session = self._unit.session
        char_ns = session.link.char_ns
        wire_ns = len(self._dialect.start_move().data) * char_ns
        earliest_ns = fired.written_ns + wire_ns + self._options.decode_us * NS_PER_US
        late_ns = self._options.excess_delay_ns(fired)
        if reply is not None and self._dialect.traits.start_confirmed:
            latest_ns = max(earliest_ns, reply.at_ns - reply.characters * char_ns)
            return HostInterval(earliest_ns, latest_ns, late_ns=late_ns)
        for _ in range(_LOOKS):
            state = await self._unit.read_state()
            has_begun = any(
                state.counts[axis_move.name] != axis_move.start_counts
                for axis_move in move.lowered.moves
                if axis_move.distance
            )
            if state.status.state == "moving" or has_begun or move.stopped:
                return HostInterval(earliest_ns, max(earliest_ns, state.reply.at_ns), late_ns=late_ns)
            await sleep_ns(self._clock, _POLL_NS)
        self._finish_move(move)
        raise ControllerFault(
            "not-started", "the controller has not begun to move", "check its state; is a limit switch active?"
        )

    async def wait_for_end(self) -> MoveOutcome:
        """Follow the move to its end, and check where the axes stand."""
        move = self._require_move()
        lowered_step = move.lowered
        resting = resting_intervals(lowered_step.durations_s, move.t0_ns)
        if move.started is None:
            self._finish_move(move)
            return MoveOutcome("done", resting)
        try:
            return await self._follow_move(move, resting)
        finally:
            self._finish_move(move)

    async def _follow_move(self, move: LineMove, resting: dict[str, HostInterval]) -> MoveOutcome:
        start_span = move.started
        assert start_span is not None
        longest_s = max(move.lowered.durations_s.values())
        overdue_ns = start_span.latest_ns + ceil(longest_s * NS_PER_S * 1.1) + _OVERDUE_NS
        while True:
            state = await self._unit.read_state()
            if state.status.state != "moving":
                break
            if self._clock.now_ns() > overdue_ns and not move.stopped:
                self._unit.write_stop()
                move.stopped = True
                await self._unit.wait_until_tidy()
                state = await self._unit.read_state()
                reason = "the move does not end: it was stopped"
                return MoveOutcome("fault", move.rough_ends(state.reply.at_ns), reason)
            end_ns = start_span.earliest_ns + floor(longest_s * NS_PER_S)
            before_ns = end_ns - self._clock.now_ns() - 2 * _POLL_NS
            await sleep_ns(self._clock, min(max(_POLL_NS, before_ns), 5 * _POLL_NS))
        if move.stopped:
            await self._unit.wait_until_tidy()
            state = await self._unit.read_state()
        now_ns = state.reply.at_ns
        reasons = [
            f"axis {axis_move.name} is at {state.counts[axis_move.name]}, not at its target {axis_move.end_counts}"
            for axis_move in move.lowered.moves
            if state.counts[axis_move.name] != axis_move.end_counts
        ]
        if reasons or move.stopped:
            reasons = reasons or ["at the target already"]
            if state.status.state == "alarm" or await self._unit.is_restarted(state):
                reasons.append(state.status.alarm or "the controller has restarted")
                return MoveOutcome("fault", move.rough_ends(now_ns), "; ".join(reasons))
            return moved_outcome(move.rough_ends(now_ns), reasons, stopped=move.stopped, failed=False)
        end_spans = {
            axis_move.name: move.end_interval(self._options, axis_move.duration_s, now_ns)
            for axis_move in move.lowered.moves
            if axis_move.distance
        }
        return MoveOutcome("done", {**resting, **end_spans})

    def _finish_move(self, move: LineMove) -> None:
        if self.move is move:
            self.move = None

    def _require_move(self) -> LineMove:
        if self.move is None:
            raise Refusal("not-armed", "no move is loaded", "arm it first")
        return self.move


def _retrieve_error(task: "asyncio.Task[tuple[WriteResult, LineReply | None]]") -> None:
    """Retrieve the error of a start that nothing waits for any more."""
    with suppress(asyncio.CancelledError, Refusal, ControllerFault, LinkClosed):
        task.result()
