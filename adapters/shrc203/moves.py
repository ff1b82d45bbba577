"""One move of a controller: loaded, checked, started by one command at an instant or by an input, followed to its
end."""

from collections.abc import Mapping
from contextlib import suppress
from functools import partial

from adapters.contract import HostInterval, MoveOutcome
from adapters.shrc203 import checks
from adapters.shrc203.following import ShrcFollower, load_followup_moves
from adapters.shrc203.loaded import ArmedMove
from adapters.shrc203.lowering import ShrcLowered
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.output import ShrcOutput
from adapters.shrc203.standby import InputWait
from adapters.shrc203.start_write import ShrcStartWrite
from adapters.shrc203.starting import ShrcStarts
from adapters.shrc203.triggers import ShrcTriggers
from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import axis_argument
from adapters.toolkit.driven_output import DrivenOutput
from adapters.toolkit.host_start import MoverTools, moving_intervals, unmoved_outcome
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.errors import Refusal

CONFIRMED_NS = 100 * NS_PER_MS  # a move that was read back so recently needs no further check before the commit


class ShrcMover:
    """Arm, start and follow the moves of one connection. settle_ns: how long axes may stay BUSY after their end."""

    def __init__(self, options: ShrcOptions, tools: MoverTools, unit: ShrcState, settle_ns: int) -> None:
        self._clock = tools.clock
        self._start_write = ShrcStartWrite(options, tools, unit.session)
        self._unit = unit
        self._session = unit.session
        self._starts = ShrcStarts(options, tools.clock, unit, self._clear_move)
        self._follower = ShrcFollower(tools, unit, settle_ns)
        self._input_wait = InputWait(unit, tools.clock)
        self.triggers = ShrcTriggers(options, tools.clock, tools.crystal, unit)
        self._output: DrivenOutput[ShrcOutput] | None = None  # the last output that a step drove
        self.move: ArmedMove | None = None
        self._rests: dict[int, int] = {}
        """Where the last move has left the motors, counts; only until anything else may have moved them."""

    # Before the start

    async def load_move(self, lowered: ShrcLowered, t0_ns: int) -> Mapping[str, int]:
        """Load the prebuffers and read everything back. Raises `Refusal`."""
        async with self._unit.loading:
            return await self._load_and_verify(lowered, t0_ns)

    async def _load_and_verify(self, lowered: ShrcLowered, t0_ns: int) -> Mapping[str, int]:
        began_ns = self._clock.now_ns()
        self._rests = {}
        if self.move is None and not self._unit.chaining:
            if self._unit.untidy:
                await self._overwrite_queued()
            await self._unit.end_trigger()
        if self.is_busy:
            raise Refusal("busy", "a move is loaded or in progress", "disarm or stop it")
        move = ArmedMove(lowered, t0_ns)
        self.triggers.forget()
        if lowered.drive is not None:
            move.output = self._output = DrivenOutput(self._clock, ShrcOutput(self._unit, lowered.drive))
            await move.output.port.read_and_check()
        if not lowered.moves:
            self.move = move
            return {}
        self._unit.jogging_motors -= move.motor_numbers
        # A move in an execution buffer would run before the moves loaded here.
        await self._session.send_setting(f"GC:{axis_argument(move.motor_numbers)}")
        self.move = move
        if lowered.trigger is not None:
            await self.triggers.begin(lowered.trigger, move)
        if lowered.wait is not None:
            await checks.check_rest(self._unit, lowered.moves)
            await self._input_wait.begin_wait(
                lowered.wait, {axis_move.motor: axis_move.start_counts for axis_move in lowered.moves}
            )
            if self.move is not move:
                # A move that a stop did not find must not stay.
                await self._input_wait.end_wait()
                raise Refusal("stopped", "a stop came while arming", "")
        text = await self._session.set_and_echo(lowered.load)
        loaded_ns = self._clock.now_ns()
        _require_same(lowered.load, text)
        if lowered.wait is not None:
            await self._input_wait.check_wait(lowered.wait)
            checks.compare_moves(move.lowered, await self._unit.prebuffers.read_moves())
        else:
            await checks.check_rest(self._unit, lowered.moves)
            await checks.check_loaded(self._unit, lowered)
        self._require_present(move)
        return {"wire": loaded_ns - began_ns, "verify": self._clock.now_ns() - loaded_ns}

    async def load_behind(self, lowered: ShrcLowered, t0_ns: int, *, at_once: bool) -> Mapping[str, int]:
        """Load a move right behind one that has just ended: its execution buffer is executed, the prebuffers are empty,
        and the last query has shown the axes at rest where this one starts. Raises `Refusal`."""
        del at_once  # it reads back and looks at the axes in any case
        starts = {axis_move.motor: axis_move.start_counts for axis_move in lowered.moves}
        rests = starts.items() <= self._rests.items()
        plain = lowered.wait is None and lowered.drive is None and lowered.trigger is None
        tidy = not self._unit.untidy and not self._unit.trigger_set
        if not (plain and rests and tidy) or self.is_busy:
            return await self.load_move(lowered, t0_ns)
        self.triggers.forget()
        async with self._unit.loading:
            began_ns = self._clock.now_ns()
            move = self.move = ArmedMove(lowered, t0_ns)
            self._unit.jogging_motors -= move.motor_numbers

            text = await self._session.set_and_echo(lowered.load, partial(self._require_present, move))
            self._require_present(move)
            _require_same(lowered.load, text)
            move.read_back_ns = self._clock.now_ns()
            return {"wire": move.read_back_ns - began_ns}

    @property
    def is_busy(self) -> bool:
        """Whether a move is loaded, waiting or in progress."""
        return self.move is not None or bool(self._unit.waiting) or self._unit.chaining

    async def verify_move(self) -> None:
        """Check that the move is still loaded and the axes are where the plan starts. Raises `Refusal`."""
        move = self._require_move()
        if not move.lowered.moves or self._clock.now_ns() - move.read_back_ns < CONFIRMED_NS:
            return
        if move.lowered.wait is not None:
            await self._input_wait.check_wait(move.lowered.wait)
        else:
            await checks.check_rest(self._unit, move.lowered.moves)
        await checks.check_prebuffers(self._unit, move.lowered)

    async def schedule_start(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Schedule the starting command, or the one that switches the output, so that its end reaches the controller
        `lead_ns` before T0, or up to `start_tolerance_ns` later than guaranteed; both are written at once. Axes that
        wait for an input need no command."""
        move = self._require_move()
        move.t0_ns -= advance_ns
        if move.start_commands:
            self._start_write.schedule_lines(move, move.start_commands, start_tolerance_ns)
        if move.lowered.moves:
            self._session.completions.expect(
                move.motor_numbers, before=(followup_move.motor for followup_move in move.lowered.followup_moves)
            )
        move.released = True

    async def unload_move(self) -> None:
        """Cancel the timed write, then overwrite the queued moves. Never starts a move."""
        move, self.move = self.move, None
        if move is not None:
            self._start_write.cancel_start(move)
        async with self._unit.loading:
            if not self._unit.chaining:
                await self._overwrite_queued()
                await self._unit.end_trigger()

    async def empty_prebuffers(self) -> None:
        """Empty the prebuffers that a stop has left filled, once no move is loaded or in progress."""
        async with self._unit.loading:
            if self._unit.untidy and self.move is None and not self._unit.chaining:
                await self._overwrite_queued()
        await self._end_trigger()

    async def _end_trigger(self) -> None:
        """End the trigger output, unless a step is loaded that has set it. Raises `Refusal`."""
        async with self._unit.loading:
            if self.move is None:
                await self._unit.end_trigger()

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
            motors |= {followup_move.motor for followup_move in self.move.lowered.followup_moves}
        return [f"MP:{motor}+P0" for motor in sorted(motors)]

    def commands_after_stop(self) -> list[str]:
        """Return the commands after a stop: they make the output that a step drives passive."""
        return [] if self.move is None else self.move.off_commands

    def record_stop(self, at_ns: int) -> None:
        """Record a stop that was written at that instant."""
        self._unit.untidy = True
        self._rests = {}
        self._session.changed.set()
        move = self.move
        if move is None:
            return
        move.stopped_ns = at_ns
        if move.output is not None:
            move.output.drop_output()
        if self._start_write.cancel_start(move) or not move.released:
            self.move = None

    # After the start

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axes started, all of them by one command.

        The start is not earlier than the arrival of the command's last character: the command is handed over at
        `written`, and its characters take their time whatever else is late. It is not later than the instant at which
        its `OK` can have been sent (four characters before it was received, whatever delayed it) plus
        `start_after_ok_us`.
        """
        move = self._require_move()
        write = None if move.order is None else await self._start_write.wait_for_write(move, move.order)
        if move.lowered.moves and move.lowered.wait is not None:
            start = await self._starts.line_start(move, move.lowered.wait)
        elif write is not None and move.pending is not None:
            start = await self._starts.host_start(move, write, move.pending)
        else:
            start = HostInterval(move.t0_ns, move.t0_ns)
        if move.output is not None and move.switching is not None:
            await move.output.port.wait_until_switched(move.switching)
        move.started = start
        return moving_intervals(move.lowered.durations_s, start, move.t0_ns)

    async def wait_for_end(self) -> MoveOutcome:
        """Load the follow-up moves, if any; wait for the completion lines; query the controller when they do not
        arrive, or after a stop."""
        move = self._require_move()
        if not move.lowered.moves or move.started is None:
            wrong = await move.output.wait_until_passive() if move.output is not None else ""
            self._forget_move(move)
            return unmoved_outcome(move.lowered.durations_s, move.t0_ns, wrong, stopped=move.stopped_ns is not None)
        unloaded_text = await self._load_followup(move) if move.lowered.followup_moves else ""
        outcome = await self._follower.follow_to_end(move, unloaded_text, lambda: self._forget_move(move))
        if move.lowered.trigger is not None:
            with suppress(Refusal):  # of an axis that is still busy, or has failed: a poll repeats it
                await self._end_trigger()
        if outcome.state == "done":
            self._rests = {motor: axis.counts for motor, axis in move.seen.items()}
        return outcome

    async def _load_followup(self, move: ArmedMove) -> str:
        """Load the follow-up moves; return why they will not run, "" if they will. On a failure all axes are stopped
        here."""
        wrong = await load_followup_moves(self._unit, move)
        if wrong:
            motors = (f"L:{motor}" for motor in move.motor_numbers)
            self.record_stop(self._session.write_at_once(*self.commands_before_stop(), *motors))
        return wrong

    # Internals

    def _forget_move(self, move: ArmedMove) -> None:
        if self.move is move:
            self.move = None

    def _clear_move(self) -> None:
        self.move = None

    def _require_present(self, move: ArmedMove) -> None:
        if self.move is not move:
            raise Refusal("stopped", "a stop came while arming", "")

    def _require_move(self) -> ArmedMove:
        if self.move is None:
            raise Refusal("not-armed", "no move is loaded", "arm it first")
        return self.move


def _require_same(sent: str, understood: str) -> None:
    if understood != sent:
        raise Refusal(
            "load-garbled",
            f"sent {sent!r}, the controller has understood {understood!r}",
            "check the cable; arm again",
        )
