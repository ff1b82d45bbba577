"""One move of a unit: loaded, checked, started by one line at an instant or by an input, followed to its end."""

import asyncio
from collections.abc import Mapping

from adapters.contract import CannotDo, DriverFault, Fired, Firer, Outcome, Span
from adapters.ppsmc import loading
from adapters.ppsmc.ending import Ending
from adapters.ppsmc.lowering import AxisMove, SmcLowered
from adapters.ppsmc.options import Options
from adapters.ppsmc.output import DrivenOutput
from adapters.ppsmc.replies import (
    ASK_INPUTS,
    ASK_OUTPUTS,
    ASK_POSITIONS,
    ASK_PROGRAM,
    ASK_STATUS,
    ASK_TARGETS,
    Bits,
    Query,
)
from adapters.ppsmc.session import EOL, Pending, Session, refusal
from adapters.ppsmc.step import Move
from adapters.ppsmc.unitstate import Look, UnitState
from adapters.toolkit.firing import missed
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, sleep_ns, sleep_until_ns
from orchestrator.clock.inferred import UnreadClock

_LOOK_SOON_NS = 5 * NS_PER_MS
# Status bits may still say ready for a moment after a start, as a client of real units has found.
_LAG_NS = 500 * NS_PER_MS


class Mover:
    """Arms, starts and follows moves of one connection. settle_ns: how long axes may move after their due end."""

    def __init__(
        self, options: Options, clock: Clock, firer: Firer, unit: UnitState, crystal: UnreadClock, settle_ns: int
    ) -> None:
        self._options = options
        self._clock = clock
        self._firer = firer
        self._unit = unit
        self._ending = Ending(options, clock, unit, crystal, settle_ns)
        self._output: DrivenOutput | None = None  # the last one that a step drove
        self.move: Move | None = None

    @property
    def _session(self) -> Session:
        return self._unit.session

    # Before the start

    async def arm(self, lowered: SmcLowered, t0_ns: int) -> Mapping[str, int]:
        """Load speeds and targets, or a program, and read everything back. Raises `CannotDo`."""
        async with self._unit.loading:
            try:
                return await self._arm(lowered, t0_ns)
            except DriverFault as error:
                if error.fault.code == "blocked":
                    raise refusal(error) from None
                raise

    async def _arm(self, lowered: SmcLowered, t0_ns: int) -> Mapping[str, int]:
        unit, began_ns = self._unit, self._clock.now_ns()
        if self.move is not None:
            raise CannotDo("busy", "a move is loaded or under way", "disarm or stop it")
        unit.require_enabled(each.name for each in lowered.moves)
        move = Move(lowered, t0_ns)
        unit.by_hand -= move.motors
        lock = ["remote"] if self._options.panel == "lock" else []
        heard = await self._session.settle(lock, *loading.checks(lowered))
        look = loading.require_rest(unit, lowered, heard)
        # Without it `tbg` moves nothing while any switch is active (L2994); axes never move towards an active one.
        move.ignore_limits = look.on_limit
        if lowered.drive is not None:
            move.output = self._output = DrivenOutput(unit, self._clock, lowered.drive)
            move.output.check(int(heard.text(ASK_OUTPUTS)))
        checked_ns = self._clock.now_ns()
        self.move = move
        if lowered.by_program:
            await loading.load_program(unit, lowered)
        elif lowered.moves:
            await loading.load_targets(unit, self._options, lowered)
        if self.move is not move:
            raise CannotDo("stopped", "a stop came while arming", "")
        return {"verify": checked_ns - began_ns, "wire": self._clock.now_ns() - checked_ns}

    async def verify(self) -> None:
        """Still loaded, still where the plan starts. Raises `CannotDo`."""
        move = self._require()
        lowered = move.lowered
        queries = loading.checks(lowered)
        if lowered.by_program:
            queries.append(ASK_PROGRAM)
        elif lowered.moves:
            queries.append(ASK_TARGETS)
        try:
            heard = await self._session.ask(*queries)
        except DriverFault as error:
            if error.fault.code == "blocked":
                raise refusal(error) from None
            raise
        look = loading.require_rest(self._unit, lowered, heard)
        if look.on_limit != move.ignore_limits:
            raise CannotDo("limit", "a limit switch has changed since the move was armed", "arm again")
        if move.output is not None:
            move.output.check(int(heard.text(ASK_OUTPUTS)))
        if lowered.by_program:
            loading.require_program(loading.program_lines(self._unit, lowered), heard.lines(ASK_PROGRAM))
        elif lowered.moves:
            loading.require_targets(self._unit, lowered, heard.one(ASK_TARGETS))

    async def go(self, slack_ns: int, sooner_ns: int) -> None:
        """Start the program that waits for the line; have the starting line, or the one that switches an output,
        written so that it is executed at T0, or `slack_ns` later than promised. Raises `CannotDo`."""
        move = self._require()
        move.t0_ns -= sooner_ns
        if move.waits:
            await self._begin_wait(move)
        line = ""
        if move.lowered.moves and not move.waits:
            line = move.start_line
        elif move.output is not None:
            line = move.output.on
        if line:
            # What is still being answered would be executed before the starting line, and delay it.
            async with self._session.alone():
                if self.move is not move:
                    raise CannotDo("stopped", "a stop came before the start", "")
                self._schedule(move, line, slack_ns)
        move.released = True

    async def _begin_wait(self, move: Move) -> None:
        """The program begins to wait only now: until the gate is open, no edge starts anything."""
        wait = move.lowered.wait
        assert wait is not None
        first_ns = move.t0_ns + move.lowered.window_ns[0]
        if self._clock.now_ns() + 12 * self._unit.slow_ns >= first_ns:
            raise CannotDo("late", "the program can not be started before its line may come", "give more lead time")
        loading.require_rest(self._unit, move.lowered, await self._session.ask(*loading.checks(move.lowered)))
        if self.move is not move:
            raise CannotDo("stopped", "a stop came before the start", "")
        move.released = True
        heard = await self._session.say((move.start_line,), ASK_STATUS, ASK_POSITIONS, ASK_INPUTS)
        look = self._unit.looked(heard.one(ASK_STATUS), heard.one(ASK_POSITIONS), heard.written_ns)
        if wait.is_active(int(heard.text(ASK_INPUTS))) or not all(look.ready(motor) for motor in move.motors):
            self._unit.write_stop("q")
            raise CannotDo(
                "line-level", f"input {wait.name} has become active before T0", "look at what drives it; arm again"
            )
        if not look.program:
            raise CannotDo(
                "not-waiting",
                f"the program does not run after `{move.start_line}`",
                "free all axes of the unit from their limit switches, or set `iel1` there",
            )

    def _schedule(self, move: Move, line: str, slack_ns: int) -> None:
        at_ns = move.t0_ns - self._session.wire_ns(len(line + EOL)) - move.lowered.lead_ns
        latest_ns = self._options.latest_ns(at_ns, slack_ns)
        if self._clock.now_ns() >= at_ns:
            raise CannotDo("late", "the instant to write the starting line is past", "give more lead time")
        queries: list[Query] = [ASK_STATUS, ASK_POSITIONS]
        if move.output is not None:
            queries.append(ASK_OUTPUTS)
        self._session.keep_quiet(latest_ns, at_ns)
        move.pending = self._session.expect((line,), queries, latest_ns)
        move.order = self._firer.schedule(self._session.link, move.pending.data, at_ns, latest_ns)
        if move.output is not None:
            assert move.lowered.drive is not None
            edge_ns = sum(each.latest_ns for each in move.lowered.edge)
            move.output.follow(move.order, move.t0_ns + edge_ns + move.lowered.drive.hold_ns)

    async def disarm(self) -> None:
        """Take back the order to fire, end a waiting program, and empty the buffers. Never starts a move."""
        move, self.move = self.move, None
        fired = False
        if move is not None:
            fired = not self._take_back(move) and move.order is not None
        if move is not None and move.released and (move.waits or fired):
            # A program that waits, or what was fired this very moment: it ends before anything is unloaded.
            self._unit.write_stop("q")
        async with self._unit.loading:
            if self._output is not None:
                await self._output.end()
            await self.tidy_now()

    async def tidy(self) -> None:
        """Empty the target buffer after a stop, once nothing is loaded or under way."""
        async with self._unit.loading:
            if self._unit.untidy and self.move is None:
                await self.tidy_now()

    async def tidy_now(self) -> None:
        """`tbc`; an axis in motion makes the unit ignore it, and is left to the next poll."""
        if self._session.blocked:
            self._unit.untidy = True
            return
        try:
            heard = await self._session.settle(("tbc",), ASK_STATUS, ASK_POSITIONS)
        except DriverFault as error:
            if error.fault.code != "blocked":
                raise
            self._unit.untidy = True
            return
        self._unit.untidy = not self._unit.looked(heard.one(ASK_STATUS), heard.one(ASK_POSITIONS), 0).idle

    def forget(self) -> None:
        """The unit has lost what it was loaded with, or the connection ends."""
        move, self.move = self.move, None
        if move is not None:
            self._take_back(move)
        if self._output is not None:
            self._output.forget()
            self._output = None

    def after_stop(self) -> list[str]:
        """Lines that go with a stop: the output that a step drives is passive then."""
        move = self.move
        return [move.output.off] if move is not None and move.output is not None and move.released else []

    def interrupted(self, at_ns: int) -> None:
        """A stop was written at that instant."""
        self._unit.untidy = True
        move = self.move
        if move is None:
            return
        move.stopped_ns = at_ns
        if move.output is not None:
            move.output.forget()
        if self._take_back(move) or not move.released:
            self.move = None

    def _take_back(self, move: Move) -> bool:
        """Cancel the order to fire; whether nothing was or will be started."""
        if move.order is None or not move.order.cancel():
            return False
        move.taken_back = True
        if move.pending is not None:
            self._session.forget(move.pending)
            move.pending.fail(DriverFault("not-started", "the order to start was taken back", ""))
        self._session.end_quiet()
        return not move.waits

    # After the start

    async def started(self) -> Mapping[str, Span]:
        """When the axes started, all of them by one line.

        Not before that was written and executed as quickly as it can be. Not after the unit has answered, to a
        question that it was asked behind the line, that they move; less what it takes to answer at the least.
        """
        move = self._require()
        try:
            return await self._started(move)
        except DriverFault:
            if self.move is move:
                self.move = None  # what has started of it is the caller's to stop
            raise

    async def _started(self, move: Move) -> Mapping[str, Span]:
        fired = None if move.order is None else await self._fired(move)
        if move.waits:
            start = await self._line_start(move)
        elif fired is not None and move.lowered.moves:
            start = await self._host_start(move, fired)
        else:
            start = Span(move.t0_ns, move.t0_ns)
        if move.output is not None and move.pending is not None:
            await self._require_edge(move, move.output, move.pending)
        move.started = start
        stay = {name for name, s in move.lowered.durations_s.items() if s == 0.0}
        return {n: Span(move.t0_ns, move.t0_ns) if n in stay else start for n in move.lowered.durations_s}

    async def _fired(self, move: Move) -> Fired:
        assert move.order is not None
        try:
            fired = await move.order.done()
        except asyncio.CancelledError:
            if not move.taken_back:
                raise
            raise DriverFault("not-started", "the order to start was taken back", "") from None
        if fired.late:
            if move.pending is not None:
                self._session.forget(move.pending)
            raise missed("the starting line", self._session.link, fired)
        if move.pending is not None:
            self._session.written(move.pending, fired.written_ns)
        self._session.end_quiet()
        return fired

    async def _require_edge(self, move: Move, output: DrivenOutput, pending: Pending) -> None:
        """Raises `DriverFault` when the output was not switched; an answer that was lost says nothing."""
        try:
            heard = await asyncio.shield(pending.answered)
        except DriverFault:
            return
        if move.stopped_ns is None:
            output.require_switched(int(heard.text(ASK_OUTPUTS)))

    async def _host_start(self, move: Move, fired: Fired) -> Span:
        assert move.pending is not None
        quick_ns = self._options.decode_ns[0]
        earliest_ns = fired.written_ns + self._session.wire_ns(len(move.start_line) + len(EOL)) + quick_ns
        try:
            heard = await asyncio.shield(move.pending.answered)
        except DriverFault:
            look = await self._unit.look()  # the answer was lost, or the unit was blocked behind it
            answered_ns = look.at_ns
        else:
            status = heard.one(ASK_STATUS)
            look = self._unit.looked(status, heard.one(ASK_POSITIONS), heard.written_ns)
            answered_ns = status.at_ns
            if not all(self._unit_moves(look, each, by_status=True) for each in move.lowered.moves):
                answered_ns = look.at_ns
        give_up_ns = self._clock.now_ns() + _LAG_NS
        while not all(self._unit_moves(look, each) for each in move.lowered.moves):
            if move.stopped_ns is not None or self._clock.now_ns() > give_up_ns:
                left = next(each for each in move.lowered.moves if not self._unit_moves(look, each))
                raise self._not_started(move, left, look)
            await sleep_ns(self._clock, _LOOK_SOON_NS)
            look = await self._unit.look()
            answered_ns = look.at_ns
        self._require_not_restarted()
        latest_ns = answered_ns - quick_ns + self._options.start_skew_us * NS_PER_US
        return Span(min(earliest_ns, latest_ns), latest_ns, late_ns=self._options.beyond_ns(fired))

    def _require_not_restarted(self) -> None:
        """A unit that was switched off and on stands elsewhere by its own account, and is not ready at first."""
        if self._session.restarted:
            raise DriverFault("not-started", "the unit was restarted before its start", "home it, and try again")

    @staticmethod
    def _unit_moves(look: Look, move: AxisMove, by_status: bool = False) -> bool:
        return not look.ready(move.motor) or (not by_status and look.counts[move.motor] != move.start_counts)

    def _not_started(self, move: Move, axis: AxisMove, look: Look) -> DriverFault:
        why = "it does not move"
        if move.stopped_ns is not None:
            why = "it was stopped"
        elif look.bits[axis.motor] & (Bits.LIMIT_FORWARD | Bits.LIMIT_REVERSE):
            why = "it is on a limit switch"
        return DriverFault(
            "not-started",
            f"axis {axis.name} has not started after `{move.start_line}`: {why}",
            "look at its limit switches, at `emips`, and for messages on the unit's screen",
            axis.name,
        )

    async def _line_start(self, move: Move) -> Span:
        """When the input has started the axes: within the window that the terms give, and before the unit has
        answered that they move."""
        wait = move.lowered.wait
        assert wait is not None
        earliest_ns, latest_ns = (move.t0_ns + each for each in move.lowered.window_ns)
        quick_ns = self._options.decode_ns[0]
        early_ns = earliest_ns - 20 * NS_PER_MS - 4 * self._unit.slow_ns
        if self._clock.now_ns() < early_ns:
            await sleep_until_ns(self._clock, early_ns - 2 * self._unit.slow_ns)
            look = await self._unit.look()
            if any(self._unit_moves(look, each) for each in move.lowered.moves):
                self._require_not_restarted()
                raise DriverFault(
                    "not-started",
                    f"the axes move before T0: input {wait.name} became active too early",
                    "look at what drives it",
                )
        await sleep_until_ns(self._clock, max(earliest_ns, self._clock.now_ns()))
        while True:
            look = await self._unit.look()
            if move.stopped_ns is not None:
                raise DriverFault("not-started", "stopped while it waited for its line", "")
            left = [each for each in move.lowered.moves if not self._unit_moves(look, each)]
            if not left:
                self._require_not_restarted()
                return Span(earliest_ns, max(earliest_ns, min(latest_ns, look.at_ns - quick_ns)))
            if look.begun_ns > latest_ns and not (look.bits[left[0].motor] & Bits.PROGRAM):
                raise self._not_started(move, left[0], look)
            if look.begun_ns > latest_ns:
                self._unit.write_stop("q")
                raise DriverFault(
                    "not-started",
                    f"axis {left[0].name} still waits: input {wait.name} (bit {wait.bit}) was not seen active by "
                    f"{wait.latest_ns / 1e6:g} ms after T0",
                    "look at the wire, and at `active` in the fleet file",
                )
            await sleep_ns(self._clock, _LOOK_SOON_NS)

    async def outcome(self) -> Outcome:
        """Watch the axes until they are at rest. In closed loop they may make further moves after the planned one."""
        move = self._require()
        try:
            if not move.lowered.moves or move.started is None:
                return await self._nothing_moved(move)
            return await self._ending.watched(move)
        finally:
            if self.move is move:
                self.move = None
                self._unit.untidy = True  # the buffer may keep its targets

    async def _nothing_moved(self, move: Move) -> Outcome:
        """The end of a step in which the controller only drives a line, if anything."""
        wrong = await move.output.passive() if move.output is not None else ""
        ended = {name: Span(move.t0_ns, move.t0_ns) for name in move.lowered.durations_s}
        if wrong:
            return Outcome("fault", ended, wrong)
        stopped = move.stopped_ns is not None
        return Outcome("stopped" if stopped else "done", ended, "stopped on request" if stopped else "")

    def _require(self) -> Move:
        if self.move is None:
            raise CannotDo("not-armed", "no move is loaded", "arm it")
        return self.move
