"""One move of a controller: loaded, checked, started by one command at an instant or by an input, followed to its
end."""

import asyncio
from collections.abc import Mapping

from adapters.contract import HostInterval, MoveOutcome, TimedWriter, WriteResult
from adapters.ppsmc import loading
from adapters.ppsmc.ending import PpSmcEndTimes
from adapters.ppsmc.lowering import PpSmcAxisMove, PpSmcLowered
from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.output import PpSmcOutput
from adapters.ppsmc.replies import (
    ASK_INPUTS,
    ASK_OUTPUTS,
    ASK_POSITIONS,
    ASK_PROGRAM,
    ASK_STATUS,
    ASK_TARGETS,
    FormattedQuery,
    StatusBits,
)
from adapters.ppsmc.session import EOL, PendingBatch, PpSmcSession, as_refusal
from adapters.ppsmc.step import LoadedMove
from adapters.ppsmc.unitstate import PpSmcReading, PpSmcState
from adapters.toolkit.firing import missed_write_fault
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, sleep_ns, sleep_until_ns
from orchestrator.clock.inferred import UnreadClock
from orchestrator.model.errors import ControllerFault, Refusal

_FAST_POLL_NS = 5 * NS_PER_MS
# Status bits may still read ready for a moment after a start, as observed on real controllers.
_READY_LAG_NS = 500 * NS_PER_MS


class PpSmcMover:
    """Arm, start and follow the moves of one connection. settle_ns: how long axes may move after their planned end."""

    def __init__(
        self,
        options: PpSmcOptions,
        clock: Clock,
        timed_writer: TimedWriter,
        unit: PpSmcState,
        crystal: UnreadClock,
        settle_ns: int,
    ) -> None:
        self._options = options
        self._clock = clock
        self._timed_writer = timed_writer
        self._unit = unit
        self._end_times = PpSmcEndTimes(options, clock, unit, crystal, settle_ns)
        self._output: PpSmcOutput | None = None  # the last output that a step drove
        self.move: LoadedMove | None = None

    @property
    def _session(self) -> PpSmcSession:
        return self._unit.session

    # Before the start

    async def arm_move(self, lowered: PpSmcLowered, t0_ns: int) -> Mapping[str, int]:
        """Load speeds and targets, or a program, and read everything back. Raises `Refusal`."""
        async with self._unit.loading:
            try:
                return await self._load_and_verify(lowered, t0_ns)
            except ControllerFault as error:
                if error.code == "blocked":
                    raise as_refusal(error) from None
                raise

    async def _load_and_verify(self, lowered: PpSmcLowered, t0_ns: int) -> Mapping[str, int]:
        unit, began_ns = self._unit, self._clock.now_ns()
        if self.move is not None:
            raise Refusal("busy", "a move is loaded or in progress", "disarm or stop it")
        unit.require_enabled(each.name for each in lowered.moves)
        move = LoadedMove(lowered, t0_ns)
        unit.jogging_motors -= move.motor_numbers
        lock = ["remote"] if self._options.panel == "lock" else []
        heard = await self._session.send_repeatable(lock, *loading.check_queries(lowered))
        look = loading.require_rest(unit, lowered, heard)
        # Without it `tbg` moves nothing while any switch is active (L2994); axes never move towards an active one.
        move.ignore_limits = look.on_limit
        if lowered.drive is not None:
            move.output = self._output = PpSmcOutput(unit, self._clock, lowered.drive)
            move.output.check_passive(int(heard.first_text(ASK_OUTPUTS)))
        checked_ns = self._clock.now_ns()
        self.move = move
        if lowered.by_program:
            await loading.load_program(unit, lowered)
        elif lowered.moves:
            await loading.load_targets(unit, self._options, lowered)
        if self.move is not move:
            raise Refusal("stopped", "a stop came while arming", "")
        return {"verify": checked_ns - began_ns, "wire": self._clock.now_ns() - checked_ns}

    async def verify_armed(self) -> None:
        """Check that the move is still loaded and the axes are where the plan starts. Raises `Refusal`."""
        move = self._require_move()
        lowered = move.lowered
        queries = loading.check_queries(lowered)
        if lowered.by_program:
            queries.append(ASK_PROGRAM)
        elif lowered.moves:
            queries.append(ASK_TARGETS)
        try:
            heard = await self._session.send_queries(*queries)
        except ControllerFault as error:
            if error.code == "blocked":
                raise as_refusal(error) from None
            raise
        look = loading.require_rest(self._unit, lowered, heard)
        if look.on_limit != move.ignore_limits:
            raise Refusal("limit", "a limit switch has changed since the move was armed", "arm it again")
        if move.output is not None:
            move.output.check_passive(int(heard.first_text(ASK_OUTPUTS)))
        if lowered.by_program:
            loading.require_program(loading.program_lines(self._unit, lowered), heard.reply_texts(ASK_PROGRAM))
        elif lowered.moves:
            loading.require_targets(self._unit, lowered, heard.first_line(ASK_TARGETS))

    async def schedule_start(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Start the program that waits for the trigger line; schedule the starting command, or the one that switches an
        output, so that it is executed at T0, or up to `start_tolerance_ns` later than guaranteed. Raises `Refusal`."""
        move = self._require_move()
        move.t0_ns -= advance_ns
        if move.waits_for_input:
            await self._begin_wait(move)
        line = ""
        if move.lowered.moves and not move.waits_for_input:
            line = move.start_command
        elif move.output is not None:
            line = move.output.on_command
        if line:
            # Outstanding exchanges would be executed before the starting command, and delay it.
            async with self._session.exclusive_lock():
                if self.move is not move:
                    raise Refusal("stopped", "a stop came before the start", "")
                self._schedule_write(move, line, start_tolerance_ns)
        move.released = True

    async def _begin_wait(self, move: LoadedMove) -> None:
        """Start the waiting program only now: until `go`, no edge starts anything."""
        wait = move.lowered.wait
        assert wait is not None
        first_ns = move.t0_ns + move.lowered.window_ns[0]
        if self._clock.now_ns() + 12 * self._unit.slow_ns >= first_ns:
            raise Refusal(
                "late", "the program cannot be started before its trigger edge may come", "increase the lead time"
            )
        loading.require_rest(
            self._unit, move.lowered, await self._session.send_queries(*loading.check_queries(move.lowered))
        )
        if self.move is not move:
            raise Refusal("stopped", "a stop came before the start", "")
        move.released = True
        heard = await self._session.send_once((move.start_command,), ASK_STATUS, ASK_POSITIONS, ASK_INPUTS)
        look = self._unit.parse_state(heard.first_line(ASK_STATUS), heard.first_line(ASK_POSITIONS), heard.written_ns)
        if wait.is_active(int(heard.first_text(ASK_INPUTS))) or not all(
            look.is_ready(motor) for motor in move.motor_numbers
        ):
            self._unit.write_stop("q")
            raise Refusal(
                "line-level",
                f"input {wait.name} has become active before T0",
                "find the source of its signal; arm it again",
            )
        if not look.program_runs:
            raise Refusal(
                "not-waiting",
                f"the program does not run after `{move.start_command}`",
                "move all axes of the controller off their limit switches, or set `iel1` there",
            )

    def _schedule_write(self, move: LoadedMove, line: str, start_tolerance_ns: int) -> None:
        at_ns = move.t0_ns - self._session.wire_ns(len(line + EOL)) - move.lowered.lead_ns
        latest_ns = self._options.latest_write_ns(at_ns, start_tolerance_ns)
        if self._clock.now_ns() >= at_ns:
            raise Refusal("late", "the instant to write the starting command has passed", "increase the lead time")
        queries: list[FormattedQuery] = [ASK_STATUS, ASK_POSITIONS]
        if move.output is not None:
            queries.append(ASK_OUTPUTS)
        self._session.keep_quiet(latest_ns, at_ns)
        move.pending = self._session.expect_batch((line,), queries, latest_ns)
        move.order = self._timed_writer.schedule_write(self._session.link, move.pending.data, at_ns, latest_ns)
        if move.output is not None:
            assert move.lowered.drive is not None
            edge_ns = sum(each.latest_ns for each in move.lowered.edge)
            move.output.follow_write(move.order, move.t0_ns + edge_ns + move.lowered.drive.active_ns)

    async def disarm_move(self) -> None:
        """Cancel the timed write, end a waiting program, and empty the buffers. Never starts a move."""
        move, self.move = self.move, None
        fired = False
        if move is not None:
            fired = not self._cancel_start(move) and move.order is not None
        if move is not None and move.released and (move.waits_for_input or fired):
            # A waiting program, or a command written this very moment: it ends before anything is unloaded.
            self._unit.write_stop("q")
        async with self._unit.loading:
            if self._output is not None:
                await self._output.make_passive()
            await self.clear_targets_now()

    async def clear_targets(self) -> None:
        """Empty the target buffer after a stop, once no move is loaded or in progress."""
        async with self._unit.loading:
            if self._unit.untidy and self.move is None:
                await self.clear_targets_now()

    async def clear_targets_now(self) -> None:
        """Send `tbc`; the controller ignores it while an axis moves, then the next poll repeats it."""
        if self._session.blocked:
            self._unit.untidy = True
            return
        try:
            heard = await self._session.send_repeatable(("tbc",), ASK_STATUS, ASK_POSITIONS)
        except ControllerFault as error:
            if error.code != "blocked":
                raise
            self._unit.untidy = True
            return
        self._unit.untidy = not self._unit.parse_state(
            heard.first_line(ASK_STATUS), heard.first_line(ASK_POSITIONS), 0
        ).is_idle

    def drop_move(self) -> None:
        """Drop the move: the controller has lost it, or the connection ends."""
        move, self.move = self.move, None
        if move is not None:
            self._cancel_start(move)
        if self._output is not None:
            self._output.drop_output()
            self._output = None

    def commands_after_stop(self) -> list[str]:
        """Return the commands to send with a stop: they make the output that a step drives passive."""
        move = self.move
        return [move.output.off_command] if move is not None and move.output is not None and move.released else []

    def record_stop(self, at_ns: int) -> None:
        """Record a stop that was written at that instant."""
        self._unit.untidy = True
        move = self.move
        if move is None:
            return
        move.stopped_ns = at_ns
        if move.output is not None:
            move.output.drop_output()
        if self._cancel_start(move) or not move.released:
            self.move = None

    def _cancel_start(self, move: LoadedMove) -> bool:
        """Cancel the timed write; return whether no axis has started or will start."""
        if move.order is None or not move.order.cancel_write():
            return False
        move.cancelled = True
        if move.pending is not None:
            self._session.remove_expected(move.pending)
            move.pending.set_failure(ControllerFault("not-started", "the timed write was cancelled", ""))
        self._session.end_quiet()
        return not move.waits_for_input

    # After the start

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axes started, all of them by one command.

        The start is not earlier than the write plus the shortest execution time. It is not later than the controller's
        answer, to a query sent after the command, that they move, less the shortest answering time.
        """
        move = self._require_move()
        try:
            return await self._start_intervals(move)
        except ControllerFault:
            if self.move is move:
                self.move = None  # the caller stops the axes that have started
            raise

    async def _start_intervals(self, move: LoadedMove) -> Mapping[str, HostInterval]:
        fired = None if move.order is None else await self._wait_for_write(move)
        if move.waits_for_input:
            start = await self._line_start(move)
        elif fired is not None and move.lowered.moves:
            start = await self._host_start(move, fired)
        else:
            start = HostInterval(move.t0_ns, move.t0_ns)
        if move.output is not None and move.pending is not None:
            await self._require_edge(move, move.output, move.pending)
        move.started = start
        stay = {name for name, s in move.lowered.durations_s.items() if s == 0.0}
        return {n: HostInterval(move.t0_ns, move.t0_ns) if n in stay else start for n in move.lowered.durations_s}

    async def _wait_for_write(self, move: LoadedMove) -> WriteResult:
        assert move.order is not None
        try:
            fired = await move.order.wait_until_written()
        except asyncio.CancelledError:
            if not move.cancelled:
                raise
            raise ControllerFault("not-started", "the timed write was cancelled", "") from None
        if fired.late:
            if move.pending is not None:
                self._session.remove_expected(move.pending)
            raise missed_write_fault("the starting command", self._session.link, fired)
        if move.pending is not None:
            self._session.record_write(move.pending, fired.written_ns)
        self._session.end_quiet()
        return fired

    async def _require_edge(self, move: LoadedMove, output: PpSmcOutput, pending: PendingBatch) -> None:
        """Raise `ControllerFault` when the output was not switched; a lost answer proves nothing."""
        try:
            heard = await asyncio.shield(pending.answered)
        except ControllerFault:
            return
        if move.stopped_ns is None:
            output.require_switched(int(heard.first_text(ASK_OUTPUTS)))

    async def _host_start(self, move: LoadedMove, fired: WriteResult) -> HostInterval:
        assert move.pending is not None
        quick_ns = self._options.decode_ns[0]
        earliest_ns = fired.written_ns + self._session.wire_ns(len(move.start_command) + len(EOL)) + quick_ns
        try:
            heard = await asyncio.shield(move.pending.answered)
        except ControllerFault:
            look = await self._unit.read_state()  # the answer was lost, or the controller was blocked after it
            answered_ns = look.at_ns
        else:
            status = heard.first_line(ASK_STATUS)
            look = self._unit.parse_state(status, heard.first_line(ASK_POSITIONS), heard.written_ns)
            answered_ns = status.at_ns
            if not all(self._is_moving(look, each, by_status=True) for each in move.lowered.moves):
                answered_ns = look.at_ns
        give_up_ns = self._clock.now_ns() + _READY_LAG_NS
        while not all(self._is_moving(look, each) for each in move.lowered.moves):
            if move.stopped_ns is not None or self._clock.now_ns() > give_up_ns:
                left = next(each for each in move.lowered.moves if not self._is_moving(look, each))
                raise self._not_started_fault(move, left, look)
            await sleep_ns(self._clock, _FAST_POLL_NS)
            look = await self._unit.read_state()
            answered_ns = look.at_ns
        self._require_not_restarted()
        latest_ns = answered_ns - quick_ns + self._options.start_skew_us * NS_PER_US
        return HostInterval(min(earliest_ns, latest_ns), latest_ns, late_ns=self._options.excess_delay_ns(fired))

    def _require_not_restarted(self) -> None:
        """Check for a restart: a controller that was power-cycled reports another position, and is not ready at
        first."""
        if self._session.restarted:
            raise ControllerFault("not-started", "the controller restarted before its start", "home it, and try again")

    @staticmethod
    def _is_moving(look: PpSmcReading, move: PpSmcAxisMove, by_status: bool = False) -> bool:
        return not look.is_ready(move.motor) or (not by_status and look.counts[move.motor] != move.start_counts)

    def _not_started_fault(self, move: LoadedMove, axis: PpSmcAxisMove, look: PpSmcReading) -> ControllerFault:
        why = "it does not move"
        if move.stopped_ns is not None:
            why = "it was stopped"
        elif look.bits[axis.motor] & (StatusBits.LIMIT_FORWARD | StatusBits.LIMIT_REVERSE):
            why = "it is on a limit switch"
        return ControllerFault(
            "not-started",
            f"axis {axis.name} has not started after `{move.start_command}`: {why}",
            "check its limit switches, `emips`, and the messages on the controller's screen",
            axis.name,
        )

    async def _line_start(self, move: LoadedMove) -> HostInterval:
        """Return when the input has started the axes: within the window of the terms, and before the controller has
        answered that they move."""
        wait = move.lowered.wait
        assert wait is not None
        earliest_ns, latest_ns = (move.t0_ns + each for each in move.lowered.window_ns)
        quick_ns = self._options.decode_ns[0]
        early_ns = earliest_ns - 20 * NS_PER_MS - 4 * self._unit.slow_ns
        if self._clock.now_ns() < early_ns:
            await sleep_until_ns(self._clock, early_ns - 2 * self._unit.slow_ns)
            look = await self._unit.read_state()
            if any(self._is_moving(look, each) for each in move.lowered.moves):
                self._require_not_restarted()
                raise ControllerFault(
                    "not-started",
                    f"the axes move before T0: input {wait.name} became active too early",
                    "find the source of its signal",
                )
        await sleep_until_ns(self._clock, max(earliest_ns, self._clock.now_ns()))
        while True:
            look = await self._unit.read_state()
            if move.stopped_ns is not None:
                raise ControllerFault("not-started", "stopped while it waited for its trigger line", "")
            left = [each for each in move.lowered.moves if not self._is_moving(look, each)]
            if not left:
                self._require_not_restarted()
                return HostInterval(earliest_ns, max(earliest_ns, min(latest_ns, look.at_ns - quick_ns)))
            if look.begun_ns > latest_ns and not (look.bits[left[0].motor] & StatusBits.PROGRAM):
                raise self._not_started_fault(move, left[0], look)
            if look.begun_ns > latest_ns:
                self._unit.write_stop("q")
                raise ControllerFault(
                    "not-started",
                    f"axis {left[0].name} still waits: input {wait.name} (bit {wait.bit}) was not active "
                    f"by {wait.latest_ns / 1e6:g} ms after T0",
                    "check the trigger wiring, and `active` in the fleet file",
                )
            await sleep_ns(self._clock, _FAST_POLL_NS)

    async def wait_for_end(self) -> MoveOutcome:
        """Watch the axes until they are at rest. In closed loop they may make further moves after the planned one."""
        move = self._require_move()
        try:
            if not move.lowered.moves or move.started is None:
                return await self._nothing_moved(move)
            return await self._end_times.watch_to_end(move)
        finally:
            if self.move is move:
                self.move = None
                self._unit.untidy = True  # the buffer may keep its targets

    async def _nothing_moved(self, move: LoadedMove) -> MoveOutcome:
        """Return the outcome of a step in which the controller only drives a trigger line, if anything."""
        wrong = await move.output.wait_until_passive() if move.output is not None else ""
        ended = {name: HostInterval(move.t0_ns, move.t0_ns) for name in move.lowered.durations_s}
        if wrong:
            return MoveOutcome("fault", ended, wrong)
        stopped = move.stopped_ns is not None
        return MoveOutcome("stopped" if stopped else "done", ended, "stopped on request" if stopped else "")

    def _require_move(self) -> LoadedMove:
        if self.move is None:
            raise Refusal("not-armed", "no move is loaded", "arm it first")
        return self.move
