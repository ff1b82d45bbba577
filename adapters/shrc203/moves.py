"""One move of a unit: loaded, checked, started by one line at an instant or by an input, followed to its end."""

import asyncio
from collections.abc import Mapping

from adapters.contract import CannotDo, DriverFault, Fired, Firer, Outcome, Span
from adapters.shrc203.axes import letter
from adapters.shrc203.ending import Ending
from adapters.shrc203.loaded import Move
from adapters.shrc203.lowering import AxisMove, ShrcLowered
from adapters.shrc203.options import Options
from adapters.shrc203.output import DrivenOutput
from adapters.shrc203.replies import REFUSALS, STATUS, amounts, entries, status
from adapters.shrc203.second import astray, load_second
from adapters.shrc203.session import EOL, Session
from adapters.shrc203.standby import COMPLETION_LATE_NS, Standby
from adapters.shrc203.status import ERRORS, UNSETTLED, why_stopped
from adapters.shrc203.timing import Timing
from adapters.shrc203.timing import timing as timing_of
from adapters.shrc203.unitstate import UnitState
from adapters.toolkit.firing import missed
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, sleep_ns
from orchestrator.clock.inferred import UnreadClock

_LOOK_NS = 50 * NS_PER_MS
_QUIET_NS = 60 * NS_PER_MS  # nothing is asked so shortly before T0
_OK_CHARACTERS = len("OK\r\n")


class Mover:
    """Arms, starts and follows moves of one connection. settle_ns: how long axes may stay BUSY after their end."""

    def __init__(
        self, options: Options, clock: Clock, firer: Firer, unit: UnitState, crystal: UnreadClock, settle_ns: int
    ) -> None:
        self._options = options
        self._clock = clock
        self._firer = firer
        self._unit = unit
        self._ending = Ending(unit.session, clock, crystal)
        self._settle_ns = settle_ns
        self._standby = Standby(unit, clock)
        self._output: DrivenOutput | None = None  # the last one that a step drove
        self.move: Move | None = None

    @property
    def _session(self) -> Session:
        return self._unit.session

    # Before the start

    async def arm(self, lowered: ShrcLowered, t0_ns: int) -> Mapping[str, int]:
        """Load the prebuffers and read everything back. Raises `CannotDo`."""
        async with self._unit.loading:
            return await self._arm(lowered, t0_ns)

    async def _arm(self, lowered: ShrcLowered, t0_ns: int) -> Mapping[str, int]:
        began_ns = self._clock.now_ns()
        if self._unit.untidy and self.move is None and not self._unit.chaining:
            await self._empty()
        if self.busy:
            raise CannotDo("busy", "a move is loaded or under way", "disarm or stop it")
        move = Move(lowered, t0_ns)
        if lowered.drive is not None:
            move.output = self._output = DrivenOutput(self._unit, self._clock, lowered.drive)
            await move.output.arm()
        if not lowered.moves:
            self.move = move
            return {}
        self._unit.by_hand -= move.motors
        # Something in an execution buffer would run before what is loaded here.
        await self._session.tell(f"GC:{letter(move.motors)}")
        self.move = move
        if lowered.wait is not None:
            await self._check_rest(lowered.moves)
            await self._standby.begin(lowered.wait, {each.motor: each.start_counts for each in lowered.moves})
            if self.move is not move:
                # What a stop could not find yet must not stay.
                await self._standby.end()
                raise CannotDo("stopped", "a stop came while arming", "")
        text = await self._session.tell_and_hear(lowered.load)
        loaded_ns = self._clock.now_ns()
        if text != lowered.load:
            raise CannotDo(
                "load-garbled", f"sent {lowered.load!r}, the unit has understood {text!r}", "check the cable; arm again"
            )
        if lowered.wait is not None:
            await self._standby.check(lowered.wait)
            self._compare(move, await self._unit.buffers.moves())
        else:
            await self._check_rest(lowered.moves)
            await self._check_loaded(move)
        if self.move is not move:
            raise CannotDo("stopped", "a stop came while arming", "")
        return {"wire": loaded_ns - began_ns, "verify": self._clock.now_ns() - loaded_ns}

    @property
    def busy(self) -> bool:
        """Whether something is loaded, waits or is under way."""
        return self.move is not None or bool(self._unit.waiting) or self._unit.chaining

    async def verify(self) -> None:
        """Still loaded, still where the plan starts. Raises `CannotDo`."""
        move = self._require()
        if not move.lowered.moves:
            return
        if move.lowered.wait is not None:
            await self._standby.check(move.lowered.wait)
        else:
            await self._check_rest(move.lowered.moves)
        if move.lowered.straight is not None:
            self._compare_line(move.lowered.straight.held, await self._unit.buffers.line())
        else:
            self._compare(move, await self._unit.buffers.moves())

    async def go(self, slack_ns: int, sooner_ns: int) -> None:
        """Have the starting line, or the one that switches the output, written so that its end is at the unit
        `lead_ns` before T0, or `slack_ns` later than promised; both are written at once. Axes that wait for an input
        need nothing more."""
        move = self._require()
        move.t0_ns -= sooner_ns
        lines = [move.lowered.start] if move.lowered.moves and not move.waits else []
        if move.output is not None:
            lines.append(move.output.on)
        if lines:
            self._schedule(move, lines, slack_ns)
        if move.lowered.moves:
            self._session.owe(move.motors, before=(each.motor for each in move.lowered.seconds))
        move.released = True

    def _schedule(self, move: Move, lines: list[str], slack_ns: int) -> None:
        data = "".join(line + EOL for line in lines).encode()
        at_ns = move.t0_ns - self._session.wire_ns(len(lines[0] + EOL)) - move.lowered.lead_ns
        latest_ns = self._options.latest_ns(at_ns, slack_ns)
        if self._clock.now_ns() >= at_ns:
            raise CannotDo("late", "the instant to write the starting line is past", "give more lead time")
        self._session.keep_quiet(latest_ns, at_ns)
        promised_ns = self._options.latest_ns(at_ns, 0)
        places = [self._session.expect(line, promised_ns, latest_ns) for line in lines]
        move.order = self._firer.schedule(self._session.link, data, at_ns, latest_ns)
        if move.output is not None:
            move.switching = places.pop()
            assert move.lowered.drive is not None
            edge_ns = sum(each.latest_ns for each in move.lowered.edge)
            move.output.follow(move.order, move.switching, move.t0_ns + edge_ns + move.lowered.drive.hold_ns)
        move.pending = places[0] if places else None

    async def disarm(self) -> None:
        """Take back the order to fire, then overwrite what is queued. Never starts a move."""
        move, self.move = self.move, None
        if move is not None:
            self._take_back(move)
        async with self._unit.loading:
            if not self._unit.chaining:
                await self._empty()

    async def tidy(self) -> None:
        """Empty the prebuffers that a stop has left, once nothing is loaded or under way."""
        async with self._unit.loading:
            if self._unit.untidy and self.move is None and not self._unit.chaining:
                await self._empty()

    async def _empty(self) -> None:
        if self._output is not None:
            await self._output.end()
        await self._standby.end()
        self._unit.untidy = not await self._unit.buffers.make_harmless(self._unit.excited)

    def forget(self) -> None:
        """The unit has lost what it was loaded with, or the connection ends."""
        self.move = None
        self._unit.waiting = {}
        if self._output is not None:
            self._output.forget()
            self._output = None

    def before_stop(self) -> list[str]:
        """Lines that go before a stop: what waits for an input, or has a second move to come, has nothing behind it
        then, whatever ends it."""
        motors = set(self._unit.waiting)
        if self.move is not None and self.move.released:
            motors |= {each.motor for each in self.move.lowered.seconds}
        return [f"MP:{motor}+P0" for motor in sorted(motors)]

    def after_stop(self) -> list[str]:
        """Lines that go behind a stop: the output that a step drives is passive then."""
        move = self.move
        return [move.output.off] if move is not None and move.output is not None and move.released else []

    def interrupted(self, at_ns: int) -> None:
        """A stop was written at that instant."""
        self._unit.untidy = True
        self._session.changed.set()
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
        if move.waits and move.released:
            self._session.owe_nothing()
        if move.order is None or not move.order.cancel():
            return False
        move.taken_back = True
        for pending in move.expected:
            self._session.forget(pending)
        self._session.end_quiet()
        if not move.waits:
            self._session.owe_nothing()
        return not move.waits

    # After the start

    async def started(self) -> Mapping[str, Span]:
        """When the axes started, all of them by one line.

        Not before its last character can have been at the unit: the line is handed over at `written`, and its
        characters take their time whatever else is late. Not after its `OK` can have begun to be sent at the latest:
        four characters before it was here, whatever was late on the way back; and `start_after_ok_us` after that.
        """
        move = self._require()
        fired = None if move.order is None else await self._fired(move)
        if move.waits:
            start = await self._line_start(move)
        elif fired is not None and move.pending is not None:
            start = await self._host_start(move, fired)
        else:
            start = Span(move.t0_ns, move.t0_ns)
        if move.output is not None:
            await move.output.switched()
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
            for pending in move.expected:
                self._session.forget(pending)
            self._session.owe_nothing()
            raise missed("the starting line", self._session.link, fired)
        for pending in move.expected:
            self._session.written(pending, fired.written_ns)
        self._session.end_quiet()
        return fired

    async def _host_start(self, move: Move, fired: Fired) -> Span:
        assert move.pending is not None and move.pending.reply is not None
        earliest_ns = fired.written_ns + self._session.wire_ns(len(move.lowered.start) + len(EOL))
        try:
            line = await move.pending.reply
        except DriverFault as error:
            latest_ns = await self._seen_moving(move, error)
        else:
            if line.text in REFUSALS:
                self._session.owe_nothing()
                raise DriverFault(
                    "not-started", f"the controller answered NG to {move.lowered.start!r}", "look at its display"
                )
            latest_ns = move.answered_ns = line.at_ns - self._session.wire_ns(_OK_CHARACTERS)
        latest_ns += self._options.start_after_ok_us * NS_PER_US
        return Span(min(earliest_ns, latest_ns), latest_ns, late_ns=self._options.beyond_ns(fired))

    async def _line_start(self, move: Move) -> Span:
        """When the input has started the axes: within the window that the terms give, and between the last question
        to which the move was still in its prebuffer and the beginning of the answer by which it had left it."""
        wait = move.lowered.wait
        assert wait is not None
        earliest_ns, latest_ns = (move.t0_ns + each for each in move.lowered.window_ns)
        if self._clock.now_ns() < move.t0_ns - _QUIET_NS and not await self._loaded(move):
            self.move = None
            await self._require_not_restarted()
            raise DriverFault(
                "not-started",
                f"the axes are moving before T0: input {wait.name} became active too early",
                "look at what drives it",
            )
        while True:
            while (now_ns := self._clock.now_ns()) < latest_ns:
                await self._session.wait_changed(latest_ns)
                self._require_no_stop(move)
            line = await self._session.ask_line("?:MPW", amounts(len(self._unit.controllable)))
            self._require_no_stop(move)
            found = dict(zip(self._unit.controllable, entries(line.text), strict=True))
            left = [each for each in move.lowered.firsts if found[each.motor] == each.distance]
            if not left:
                seen_ns = line.at_ns - self._session.wire_ns(len(line.text + EOL))
                await self._require_not_restarted()
                self._unit.waiting = {}
                return Span(earliest_ns, max(earliest_ns, min(latest_ns, seen_ns)))
            earliest_ns = max(earliest_ns, now_ns)
            if earliest_ns > latest_ns:
                self.move = None
                raise DriverFault(
                    "not-started",
                    f"axis {left[0].name} still waits: input {wait.name} (IN{wait.number}) was not seen active by "
                    f"{wait.latest_ns / 1e6:g} ms after T0",
                    "look at the wire, at `active` in the fleet file, and that no other input has changed",
                )

    def _require_no_stop(self, move: Move) -> None:
        if move.stopped_ns is not None:
            self.move = None
            raise DriverFault("not-started", "stopped while it waited for its line", "")

    async def _loaded(self, move: Move) -> bool:
        found = await self._unit.buffers.moves()
        return all(found[each.motor] == each.distance for each in move.lowered.firsts)

    async def _seen_moving(self, move: Move, error: DriverFault) -> int:
        """The answer to the starting line was lost: by when the axes moved, seen otherwise."""
        if self._session.completed:
            return min(self._session.completed.values())
        line = await self._session.ask_line("Q:SPC", STATUS)
        now = status(line.text, self._unit.controllable)
        if all(now[each.motor].busy or now[each.motor].counts != each.start_counts for each in move.lowered.moves):
            await self._require_not_restarted()
            return line.at_ns
        raise DriverFault("not-started", f"the axes do not move ({error.fault.text})", error.fault.remedy)

    async def _require_not_restarted(self) -> None:
        """A unit that was switched off and on has lost its move as well, and calls the place where it stands 0."""
        if await self._unit.is_restarted():
            raise DriverFault("not-started", "the unit was restarted before its start", "home it, and try again")

    async def outcome(self) -> Outcome:
        """Load the second moves, if there are any; wait for the completion lines; look at the unit itself when they do
        not come, or after a stop."""
        move = self._require()
        if not move.lowered.moves or move.started is None:
            return await self._nothing_moved(move)
        session = self._session
        unloaded = await self._load_second(move) if move.lowered.seconds else ""
        timing = self._unit.timing = timing_of(move.lowered, move.started, self._unit.closed_loop, session)
        try:
            return await self._followed(move, timing, unloaded)
        finally:
            self._unit.timing = None

    async def _followed(self, move: Move, timing: Timing | None, unloaded: str) -> Outcome:
        assert move.started is not None
        session = self._session
        look_ns = move.started.latest_ns + max(self._ending.took_ns(each)[1] for each in move.lowered.moves)
        look_ns += COMPLETION_LATE_NS
        give_up_ns = look_ns + self._settle_ns
        self._put_back_early(move)
        if timing is not None:
            await self._ending.look_closely(move, timing)
        while session.owed:
            await session.wait_changed(look_ns)
            self._put_back_early(move)
            if session.owed and (move.stopped_ns is not None or await self._at_rest(move)):
                break
            if self._clock.now_ns() > give_up_ns:
                break
            look_ns = max(look_ns, self._clock.now_ns() + _LOOK_NS)
        rest_ns = await self._wait_for_rest(move, self._clock.now_ns() + self._settle_ns)
        completed = dict(session.completed)
        session.owe_nothing()
        ended = {
            name: Span(move.t0_ns, move.t0_ns) for name, seconds in move.lowered.durations_s.items() if seconds == 0.0
        }
        if timing is not None and not unloaded:
            self._ending.learn(move, timing, completed.get(timing.axis.motor), rest_ns)
        reasons = [unloaded] if unloaded else []
        error = bool(unloaded)
        for each in move.lowered.moves:
            now = move.seen[each.motor]
            if now.busy:
                error = True
                what = "does not settle in its in-position range" if now.word & UNSETTLED else "does not come to rest"
                reasons.append(f"axis {each.name} {what}")
            arrived = now.counts == each.end_counts
            error = error or bool(now.word & ERRORS)
            if not arrived or now.word & ERRORS:
                reasons.append(why_stopped(each.name, now) or astray(each, now.counts))
            # The standby may have had a completion line of its own: there only the look at the unit counts.
            said_ns = None if move.waits else completed.get(each.motor)
            ended[each.name] = self._ending.span(move, each, said_ns, rest_ns, arrived)
        wrong = await move.output.passive() if move.output is not None else ""
        error = error or bool(wrong)
        reasons += [wrong] if wrong else []
        if self.move is move:
            self.move = None
        if not reasons:
            return Outcome("done", ended)
        if any(each.word & ERRORS for each in move.seen.values()):
            self._unit.untidy = True  # an emergency stop lets nothing be overwritten, and nothing start
        else:
            await self._unit.make_harmless()
        if move.stopped_ns is not None and not error:
            return Outcome("stopped", ended, "; ".join(["stopped on request", *reasons]))
        return Outcome("fault", ended, "; ".join(reasons))

    async def _load_second(self, move: Move) -> str:
        """Why the second moves will not run, "" if they will; then all axes are stopped here."""

        def still() -> None:
            if move.stopped_ns is not None:
                raise CannotDo("stopped", "stopped before its second move was loaded", "")

        wrong = await load_second(self._unit, move.lowered, still)
        if move.stopped_ns is not None:
            return ""
        if wrong:
            self.interrupted(self._session.interrupt(*self.before_stop(), *(f"L:{motor}" for motor in move.motors)))
        return wrong

    async def _nothing_moved(self, move: Move) -> Outcome:
        """The end of a step in which the controller only drives a line, if anything."""
        wrong = await move.output.passive() if move.output is not None else ""
        if self.move is move:
            self.move = None
        ended = {name: Span(move.t0_ns, move.t0_ns) for name in move.lowered.durations_s}
        if wrong:
            return Outcome("fault", ended, wrong)
        stopped = move.stopped_ns is not None
        return Outcome("stopped" if stopped else "done", ended, "stopped on request" if stopped else "")

    def _put_back_early(self, move: Move) -> None:
        """Completion lines that come before the move can have ended are those of the standby."""
        if not move.waits:
            return
        assert move.started is not None
        for each in move.lowered.moves:
            ended_ns = move.started.earliest_ns + self._ending.took_ns(each)[0]
            if self._session.completed.get(each.motor, ended_ns) < ended_ns:
                self._session.owe_again(each.motor)

    async def _at_rest(self, move: Move) -> bool:
        line = await self._session.ask_line("Q:SPC", STATUS)
        now = status(line.text, self._unit.controllable)
        move.seen = now
        return not any(now[motor].busy for motor in move.motors)

    async def _wait_for_rest(self, move: Move, until_ns: int) -> int:
        """Until all axes of the move are READY, or that instant; gives the instant of the last look."""
        while not await self._at_rest(move) and self._clock.now_ns() < until_ns:
            await sleep_ns(self._clock, _LOOK_NS)
        return self._clock.now_ns()

    # Inside

    def _require(self) -> Move:
        if self.move is None:
            raise CannotDo("not-armed", "no move is loaded", "arm it")
        return self.move

    async def _check_rest(self, moves: tuple[AxisMove, ...]) -> None:
        now = status(await self._session.ask("Q:SPC", STATUS), self._unit.controllable)
        for each in moves:
            axis = now[each.motor]
            if axis.busy:
                raise CannotDo("moving", f"axis {each.name} is moving", "wait, or stop it")
            if axis.word & ERRORS:
                raise CannotDo("fault", why_stopped(each.name, axis), "clear it with `tutti reset`")
            if axis.counts != each.start_counts:
                raise CannotDo(
                    "other-start",
                    f"axis {each.name} stands at {axis.counts} counts; the plan starts at {each.start_counts}",
                    "plan again from where it stands",
                )

    async def _check_loaded(self, move: Move) -> None:
        straight = move.lowered.straight
        if straight is not None:
            others = await self._unit.buffers.dangerous(line=straight.held)
        else:
            others = await self._unit.buffers.dangerous({each.motor: each.distance for each in move.lowered.firsts})
        if others:
            raise CannotDo(
                "not-loaded", f"the prebuffer of axis {letter(others)} does not hold what was loaded", "arm again"
            )

    def _compare_line(self, meant: str, found: str) -> None:
        if found != meant:
            raise CannotDo(
                "not-loaded", f"the line {found} is loaded instead of {meant}", "arm again; was the unit switched off?"
            )

    def _compare(self, move: Move, found: Mapping[int, int | None]) -> None:
        for each in move.lowered.firsts:
            if found[each.motor] != each.distance:
                raise CannotDo(
                    "not-loaded",
                    f"axis {each.name}: {found[each.motor]} pulses are loaded instead of {each.distance}",
                    "arm again; was the unit switched off?",
                )
