"""One move of a controller: loaded, checked, started by one command at an instant or by an input, followed to its
end."""

import asyncio
from collections.abc import Mapping

from adapters.contract import HostInterval, MoveOutcome, TimedWriter, WriteResult
from adapters.shrc203.axes import axis_argument
from adapters.shrc203.ending import ShrcEndTimes
from adapters.shrc203.loaded import ArmedMove
from adapters.shrc203.lowering import ShrcAxisMove, ShrcLowered
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.output import ShrcOutput
from adapters.shrc203.replies import REFUSALS, STATUS, parse_entries, parse_status, pulse_list
from adapters.shrc203.second import load_followup_moves, stray_text
from adapters.shrc203.session import EOL, ShrcSession
from adapters.shrc203.standby import COMPLETION_LATE_NS, InputWait
from adapters.shrc203.status import ERRORS, UNSETTLED, stop_reason
from adapters.shrc203.timing import ShrcTiming
from adapters.shrc203.timing import make_timing as timing_of
from adapters.shrc203.unitstate import ShrcState
from adapters.toolkit.firing import missed_write_fault
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, sleep_ns
from orchestrator.clock.inferred import UnreadClock
from orchestrator.model.errors import ControllerFault, Refusal

_POLL_NS = 50 * NS_PER_MS
_QUIET_NS = 60 * NS_PER_MS  # no exchange begins this shortly before T0
_OK_CHARACTERS = len("OK\r\n")


class ShrcMover:
    """Arm, start and follow the moves of one connection. settle_ns: how long axes may stay BUSY after their end."""

    def __init__(
        self,
        options: ShrcOptions,
        clock: Clock,
        timed_writer: TimedWriter,
        unit: ShrcState,
        crystal: UnreadClock,
        settle_ns: int,
    ) -> None:
        self._options = options
        self._clock = clock
        self._timed_writer = timed_writer
        self._unit = unit
        self._end_times = ShrcEndTimes(unit.session, clock, crystal)
        self._settle_ns = settle_ns
        self._input_wait = InputWait(unit, clock)
        self._output: ShrcOutput | None = None  # the last output that a step drove
        self.move: ArmedMove | None = None

    @property
    def _session(self) -> ShrcSession:
        return self._unit.session

    # Before the start

    async def arm_move(self, lowered: ShrcLowered, t0_ns: int) -> Mapping[str, int]:
        """Load the prebuffers and read everything back. Raises `Refusal`."""
        async with self._unit.loading:
            return await self._load_and_verify(lowered, t0_ns)

    async def _load_and_verify(self, lowered: ShrcLowered, t0_ns: int) -> Mapping[str, int]:
        began_ns = self._clock.now_ns()
        if self._unit.untidy and self.move is None and not self._unit.chaining:
            await self._overwrite_queued()
        if self.is_busy:
            raise Refusal("busy", "a move is loaded or in progress", "disarm or stop it")
        move = ArmedMove(lowered, t0_ns)
        if lowered.drive is not None:
            move.output = self._output = ShrcOutput(self._unit, self._clock, lowered.drive)
            await move.output.read_and_check()
        if not lowered.moves:
            self.move = move
            return {}
        self._unit.jogging_motors -= move.motor_numbers
        # A move in an execution buffer would run before the moves loaded here.
        await self._session.send_setting(f"GC:{axis_argument(move.motor_numbers)}")
        self.move = move
        if lowered.wait is not None:
            await self._check_rest(lowered.moves)
            await self._input_wait.begin_wait(lowered.wait, {each.motor: each.start_counts for each in lowered.moves})
            if self.move is not move:
                # A move that a stop did not find must not stay.
                await self._input_wait.end_wait()
                raise Refusal("stopped", "a stop came while arming", "")
        text = await self._session.set_and_echo(lowered.load)
        loaded_ns = self._clock.now_ns()
        if text != lowered.load:
            raise Refusal(
                "load-garbled",
                f"sent {lowered.load!r}, the controller has understood {text!r}",
                "check the cable; arm again",
            )
        if lowered.wait is not None:
            await self._input_wait.check_wait(lowered.wait)
            self._compare_moves(move, await self._unit.prebuffers.read_moves())
        else:
            await self._check_rest(lowered.moves)
            await self._check_loaded(move)
        if self.move is not move:
            raise Refusal("stopped", "a stop came while arming", "")
        return {"wire": loaded_ns - began_ns, "verify": self._clock.now_ns() - loaded_ns}

    @property
    def is_busy(self) -> bool:
        """Whether a move is loaded, waiting or in progress."""
        return self.move is not None or bool(self._unit.waiting) or self._unit.chaining

    async def verify_armed(self) -> None:
        """Check that the move is still loaded and the axes are where the plan starts. Raises `Refusal`."""
        move = self._require_move()
        if not move.lowered.moves:
            return
        if move.lowered.wait is not None:
            await self._input_wait.check_wait(move.lowered.wait)
        else:
            await self._check_rest(move.lowered.moves)
        if move.lowered.straight is not None:
            self._compare_line(move.lowered.straight.loaded_reply, await self._unit.prebuffers.read_interpolation())
        else:
            self._compare_moves(move, await self._unit.prebuffers.read_moves())

    async def schedule_start(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Schedule the starting command, or the one that switches the output, so that its end reaches the controller
        `lead_ns` before T0, or up to `start_tolerance_ns` later than guaranteed; both are written at once. Axes that
        wait for an input need no command."""
        move = self._require_move()
        move.t0_ns -= advance_ns
        lines = [move.lowered.start] if move.lowered.moves and not move.waits_for_input else []
        if move.output is not None:
            lines.append(move.output.on_command)
        if lines:
            self._schedule_writes(move, lines, start_tolerance_ns)
        if move.lowered.moves:
            self._session.expect_completions(
                move.motor_numbers, before=(each.motor for each in move.lowered.followup_moves)
            )
        move.released = True

    def _schedule_writes(self, move: ArmedMove, lines: list[str], start_tolerance_ns: int) -> None:
        data = "".join(line + EOL for line in lines).encode()
        at_ns = move.t0_ns - self._session.wire_ns(len(lines[0] + EOL)) - move.lowered.lead_ns
        latest_ns = self._options.latest_write_ns(at_ns, start_tolerance_ns)
        if self._clock.now_ns() >= at_ns:
            raise Refusal("late", "the instant to write the starting command has passed", "increase the lead time")
        self._session.keep_quiet(latest_ns, at_ns)
        promised_ns = self._options.latest_write_ns(at_ns, 0)
        places = [self._session.expect_reply(line, promised_ns, latest_ns) for line in lines]
        move.order = self._timed_writer.schedule_write(self._session.link, data, at_ns, latest_ns)
        if move.output is not None:
            move.switching = places.pop()
            assert move.lowered.drive is not None
            edge_ns = sum(each.latest_ns for each in move.lowered.edge)
            move.output.follow_write(move.order, move.switching, move.t0_ns + edge_ns + move.lowered.drive.active_ns)
        move.pending = places[0] if places else None

    async def disarm_move(self) -> None:
        """Cancel the timed write, then overwrite the queued moves. Never starts a move."""
        move, self.move = self.move, None
        if move is not None:
            self._cancel_start(move)
        async with self._unit.loading:
            if not self._unit.chaining:
                await self._overwrite_queued()

    async def empty_prebuffers(self) -> None:
        """Empty the prebuffers that a stop has left filled, once no move is loaded or in progress."""
        async with self._unit.loading:
            if self._unit.untidy and self.move is None and not self._unit.chaining:
                await self._overwrite_queued()

    async def _overwrite_queued(self) -> None:
        if self._output is not None:
            await self._output.make_passive()
        await self._input_wait.end_wait()
        self._unit.untidy = not await self._unit.prebuffers.make_harmless(self._unit.excited)

    def drop_move(self) -> None:
        """Drop the move: the controller has lost it, or the connection ends."""
        self.move = None
        self._unit.waiting = {}
        if self._output is not None:
            self._output.drop_output()
            self._output = None

    def commands_before_stop(self) -> list[str]:
        """Return the commands before a stop: they overwrite the move queued after an input wait or a first move, so
        that nothing follows whatever ends the present one."""
        motors = set(self._unit.waiting)
        if self.move is not None and self.move.released:
            motors |= {each.motor for each in self.move.lowered.followup_moves}
        return [f"MP:{motor}+P0" for motor in sorted(motors)]

    def commands_after_stop(self) -> list[str]:
        """Return the commands after a stop: they make the output that a step drives passive."""
        move = self.move
        return [move.output.off_command] if move is not None and move.output is not None and move.released else []

    def record_stop(self, at_ns: int) -> None:
        """Record a stop that was written at that instant."""
        self._unit.untidy = True
        self._session.changed.set()
        move = self.move
        if move is None:
            return
        move.stopped_ns = at_ns
        if move.output is not None:
            move.output.drop_output()
        if self._cancel_start(move) or not move.released:
            self.move = None

    def _cancel_start(self, move: ArmedMove) -> bool:
        """Cancel the timed write; return whether no axis has started or will start."""
        if move.waits_for_input and move.released:
            self._session.expect_no_completion()
        if move.order is None or not move.order.cancel_write():
            return False
        move.cancelled = True
        for pending in move.expected_replies:
            self._session.remove_expected(pending)
        self._session.end_quiet()
        if not move.waits_for_input:
            self._session.expect_no_completion()
        return not move.waits_for_input

    # After the start

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axes started, all of them by one command.

        The start is not earlier than the arrival of the command's last character: the command is handed over at
        `written`, and its characters take their time whatever else is late. It is not later than the instant at which
        its `OK` can have been sent (four characters before it was received, whatever delayed it) plus
        `start_after_ok_us`.
        """
        move = self._require_move()
        fired = None if move.order is None else await self._wait_for_write(move)
        if move.waits_for_input:
            start = await self._line_start(move)
        elif fired is not None and move.pending is not None:
            start = await self._host_start(move, fired)
        else:
            start = HostInterval(move.t0_ns, move.t0_ns)
        if move.output is not None:
            await move.output.wait_until_switched()
        move.started = start
        stay = {name for name, s in move.lowered.durations_s.items() if s == 0.0}
        return {n: HostInterval(move.t0_ns, move.t0_ns) if n in stay else start for n in move.lowered.durations_s}

    async def _wait_for_write(self, move: ArmedMove) -> WriteResult:
        assert move.order is not None
        try:
            fired = await move.order.wait_until_written()
        except asyncio.CancelledError:
            if not move.cancelled:
                raise
            raise ControllerFault("not-started", "the timed write was cancelled", "") from None
        if fired.late:
            for pending in move.expected_replies:
                self._session.remove_expected(pending)
            self._session.expect_no_completion()
            raise missed_write_fault("the starting command", self._session.link, fired)
        for pending in move.expected_replies:
            self._session.record_write(pending, fired.written_ns)
        self._session.end_quiet()
        return fired

    async def _host_start(self, move: ArmedMove, fired: WriteResult) -> HostInterval:
        assert move.pending is not None and move.pending.reply is not None
        earliest_ns = fired.written_ns + self._session.wire_ns(len(move.lowered.start) + len(EOL))
        try:
            line = await move.pending.reply
        except ControllerFault as error:
            latest_ns = await self._wait_for_motion(move, error)
        else:
            if line.text in REFUSALS:
                self._session.expect_no_completion()
                raise ControllerFault(
                    "not-started", f"the controller answered NG to {move.lowered.start!r}", "see its display"
                )
            latest_ns = move.answered_ns = line.at_ns - self._session.wire_ns(_OK_CHARACTERS)
        latest_ns += self._options.start_after_ok_us * NS_PER_US
        return HostInterval(min(earliest_ns, latest_ns), latest_ns, late_ns=self._options.excess_delay_ns(fired))

    async def _line_start(self, move: ArmedMove) -> HostInterval:
        """Return when the input has started the axes: within the window of the terms, and between the last query that
        found the move in its prebuffer and the reply that no longer did."""
        wait = move.lowered.wait
        assert wait is not None
        earliest_ns, latest_ns = (move.t0_ns + each for each in move.lowered.window_ns)
        if self._clock.now_ns() < move.t0_ns - _QUIET_NS and not await self._is_loaded(move):
            self.move = None
            await self._require_not_restarted()
            raise ControllerFault(
                "not-started",
                f"the axes are moving before T0: input {wait.name} became active too early",
                "find the source of its signal",
            )
        while True:
            while (now_ns := self._clock.now_ns()) < latest_ns:
                await self._session.wait_changed(latest_ns)
                self._require_no_stop(move)
            line = await self._session.query_line("?:MPW", pulse_list(len(self._unit.controllable)))
            self._require_no_stop(move)
            found = dict(zip(self._unit.controllable, parse_entries(line.text), strict=True))
            left = [each for each in move.lowered.first_moves if found[each.motor] == each.distance]
            if not left:
                seen_ns = line.at_ns - self._session.wire_ns(len(line.text + EOL))
                await self._require_not_restarted()
                self._unit.waiting = {}
                return HostInterval(earliest_ns, max(earliest_ns, min(latest_ns, seen_ns)))
            earliest_ns = max(earliest_ns, now_ns)
            if earliest_ns > latest_ns:
                self.move = None
                raise ControllerFault(
                    "not-started",
                    f"axis {left[0].name} still waits: input {wait.name} (IN{wait.number}) was not active "
                    f"by {wait.latest_ns / 1e6:g} ms after T0",
                    "check the trigger wiring, `active` in the fleet file, and that no other input has changed",
                )

    def _require_no_stop(self, move: ArmedMove) -> None:
        if move.stopped_ns is not None:
            self.move = None
            raise ControllerFault("not-started", "stopped while it waited for its trigger line", "")

    async def _is_loaded(self, move: ArmedMove) -> bool:
        found = await self._unit.prebuffers.read_moves()
        return all(found[each.motor] == each.distance for each in move.lowered.first_moves)

    async def _wait_for_motion(self, move: ArmedMove, error: ControllerFault) -> int:
        """Return when the axes moved, by other evidence: the reply to the starting command was lost."""
        if self._session.completed:
            return min(self._session.completed.values())
        line = await self._session.query_line("Q:SPC", STATUS)
        now = parse_status(line.text, self._unit.controllable)
        if all(now[each.motor].is_busy or now[each.motor].counts != each.start_counts for each in move.lowered.moves):
            await self._require_not_restarted()
            return line.at_ns
        raise ControllerFault("not-started", f"the axes do not move ({error.text})", error.remedy)

    async def _require_not_restarted(self) -> None:
        """Check for a restart: a controller that was power-cycled has also lost its move, and its present position
        reads 0."""
        if await self._unit.is_restarted():
            raise ControllerFault("not-started", "the controller restarted before its start", "home it, and try again")

    async def wait_for_end(self) -> MoveOutcome:
        """Load the follow-up moves, if any; wait for the completion lines; query the controller when they do not
        arrive, or after a stop."""
        move = self._require_move()
        if not move.lowered.moves or move.started is None:
            return await self._nothing_moved(move)
        session = self._session
        unloaded = await self._load_followup(move) if move.lowered.followup_moves else ""
        timing = self._unit.timing = timing_of(move.lowered, move.started, self._unit.closed_loop, session)
        try:
            return await self._follow_to_end(move, timing, unloaded)
        finally:
            self._unit.timing = None

    async def _follow_to_end(self, move: ArmedMove, timing: ShrcTiming | None, unloaded: str) -> MoveOutcome:
        assert move.started is not None
        session = self._session
        look_ns = move.started.latest_ns + max(
            self._end_times.duration_bounds_ns(each)[1] for each in move.lowered.moves
        )
        look_ns += COMPLETION_LATE_NS
        give_up_ns = look_ns + self._settle_ns
        self._discard_early_completions(move)
        if timing is not None:
            await self._end_times.observe_end(move, timing)
        while session.expected_completions:
            await session.wait_changed(look_ns)
            self._discard_early_completions(move)
            if session.expected_completions and (move.stopped_ns is not None or await self._is_at_rest(move)):
                break
            if self._clock.now_ns() > give_up_ns:
                break
            look_ns = max(look_ns, self._clock.now_ns() + _POLL_NS)
        rest_ns = await self._wait_for_rest(move, self._clock.now_ns() + self._settle_ns)
        completed = dict(session.completed)
        session.expect_no_completion()
        ended = {
            name: HostInterval(move.t0_ns, move.t0_ns)
            for name, seconds in move.lowered.durations_s.items()
            if seconds == 0.0
        }
        if timing is not None and not unloaded:
            self._end_times.learn_crystal(move, timing, completed.get(timing.axis.motor), rest_ns)
        reasons = [unloaded] if unloaded else []
        error = bool(unloaded)
        for each in move.lowered.moves:
            now = move.seen[each.motor]
            if now.is_busy:
                error = True
                what = "does not settle in its in-position range" if now.word & UNSETTLED else "does not come to rest"
                reasons.append(f"axis {each.name} {what}")
            arrived = now.counts == each.end_counts
            error = error or bool(now.word & ERRORS)
            if not arrived or now.word & ERRORS:
                reasons.append(stop_reason(each.name, now) or stray_text(each, now.counts))
            # The input wait may send a completion line of its own: then only the query counts.
            said_ns = None if move.waits_for_input else completed.get(each.motor)
            ended[each.name] = self._end_times.end_interval(move, each, said_ns, rest_ns, arrived)
        wrong = await move.output.wait_until_passive() if move.output is not None else ""
        error = error or bool(wrong)
        reasons += [wrong] if wrong else []
        if self.move is move:
            self.move = None
        if not reasons:
            return MoveOutcome("done", ended)
        if any(each.word & ERRORS for each in move.seen.values()):
            self._unit.untidy = True  # in an emergency stop nothing can be overwritten, and nothing starts
        else:
            await self._unit.make_harmless()
        if move.stopped_ns is not None and not error:
            return MoveOutcome("stopped", ended, "; ".join(["stopped on request", *reasons]))
        return MoveOutcome("fault", ended, "; ".join(reasons))

    async def _load_followup(self, move: ArmedMove) -> str:
        """Load the follow-up moves; return why they will not run, "" if they will. On a failure all axes are stopped
        here."""

        def check_not_stopped() -> None:
            if move.stopped_ns is not None:
                raise Refusal("stopped", "stopped before its follow-up move was loaded", "")

        wrong = await load_followup_moves(self._unit, move.lowered, check_not_stopped)
        if move.stopped_ns is not None:
            return ""
        if wrong:
            self.record_stop(
                self._session.write_at_once(
                    *self.commands_before_stop(), *(f"L:{motor}" for motor in move.motor_numbers)
                )
            )
        return wrong

    async def _nothing_moved(self, move: ArmedMove) -> MoveOutcome:
        """Return the outcome of a step in which the controller only drives a trigger line, if anything."""
        wrong = await move.output.wait_until_passive() if move.output is not None else ""
        if self.move is move:
            self.move = None
        ended = {name: HostInterval(move.t0_ns, move.t0_ns) for name in move.lowered.durations_s}
        if wrong:
            return MoveOutcome("fault", ended, wrong)
        stopped = move.stopped_ns is not None
        return MoveOutcome("stopped" if stopped else "done", ended, "stopped on request" if stopped else "")

    def _discard_early_completions(self, move: ArmedMove) -> None:
        """Discard completion lines that come before the move can have ended: the input wait sent them."""
        if not move.waits_for_input:
            return
        assert move.started is not None
        for each in move.lowered.moves:
            ended_ns = move.started.earliest_ns + self._end_times.duration_bounds_ns(each)[0]
            if self._session.completed.get(each.motor, ended_ns) < ended_ns:
                self._session.expect_again(each.motor)

    async def _is_at_rest(self, move: ArmedMove) -> bool:
        line = await self._session.query_line("Q:SPC", STATUS)
        now = parse_status(line.text, self._unit.controllable)
        move.seen = now
        return not any(now[motor].is_busy for motor in move.motor_numbers)

    async def _wait_for_rest(self, move: ArmedMove, until_ns: int) -> int:
        """Wait until all axes of the move are READY, or until that instant; return the instant of the last query."""
        while not await self._is_at_rest(move) and self._clock.now_ns() < until_ns:
            await sleep_ns(self._clock, _POLL_NS)
        return self._clock.now_ns()

    # Internals

    def _require_move(self) -> ArmedMove:
        if self.move is None:
            raise Refusal("not-armed", "no move is loaded", "arm it first")
        return self.move

    async def _check_rest(self, moves: tuple[ShrcAxisMove, ...]) -> None:
        now = parse_status(await self._session.send_query("Q:SPC", STATUS), self._unit.controllable)
        for each in moves:
            axis = now[each.motor]
            if axis.is_busy:
                raise Refusal("moving", f"axis {each.name} is moving", "wait for its end, or stop it")
            if axis.word & ERRORS:
                raise Refusal("fault", stop_reason(each.name, axis), "clear it with `tutti reset`")
            if axis.counts != each.start_counts:
                raise Refusal(
                    "other-start",
                    f"axis {each.name} is at {axis.counts} counts; the plan starts at {each.start_counts}",
                    "plan again from the present position",
                )

    async def _check_loaded(self, move: ArmedMove) -> None:
        straight = move.lowered.straight
        if straight is not None:
            others = await self._unit.prebuffers.find_dangerous(interpolation=straight.loaded_reply)
        else:
            others = await self._unit.prebuffers.find_dangerous(
                {each.motor: each.distance for each in move.lowered.first_moves}
            )
        if others:
            raise Refusal(
                "not-loaded",
                f"the prebuffer of axis {axis_argument(others)} does not contain the loaded move",
                "arm it again",
            )

    def _compare_line(self, meant: str, found: str) -> None:
        if found != meant:
            raise Refusal(
                "not-loaded",
                f"the path {found} is loaded instead of {meant}",
                "arm it again; was the controller switched off?",
            )

    def _compare_moves(self, move: ArmedMove, found: Mapping[int, int | None]) -> None:
        for each in move.lowered.first_moves:
            if found[each.motor] != each.distance:
                raise Refusal(
                    "not-loaded",
                    f"axis {each.name}: {found[each.motor]} pulses are loaded instead of {each.distance}",
                    "arm it again; was the controller switched off?",
                )
