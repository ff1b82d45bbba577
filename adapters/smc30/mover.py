"""One step of a unit: its program loaded and checked, started by the host or by a wired line, followed to its end."""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field

from adapters.contract import CannotDo, DriverFault, FireOrder, Firer, Outcome, Span
from adapters.smc30.line import Shot
from adapters.smc30.lowering import LINES_BEFORE, Slots, SmcLowered
from adapters.smc30.options import Options
from adapters.smc30.session import Busy
from adapters.smc30.unitstate import Place, UnitState
from adapters.toolkit.firing import missed
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, Clock, sleep_ns
from orchestrator.clock.inferred import UnreadClock
from orchestrator.clock.timed import LONG_S, TimedMove

_LOOK_NS = 20 * NS_PER_MS
_GRAIN = 1.0  # steps: whether the counter rounds is not said
_OVERDUE_NS = NS_PER_S  # a motion that ends later than this is held, or has never begun


@dataclass(slots=True)
class Move:
    """A step that is loaded. order and shot: of its starting line, from `go` on. started: when it is known.
    Of a start by the host: arrived_ns, the end of its line was at the unit at the earliest; answered_ns, by then its
    answer was sent; timed: what is seen of the motion, where it says something of the crystal."""

    lowered: SmcLowered
    t0_ns: int
    order: FireOrder | None = None
    shot: Shot | None = None
    started: Span | None = None
    running: bool = False
    """Its program has been set going."""
    followed: bool = False
    """Somebody waits for its start or its end."""
    stopped_ns: int | None = None
    arrived_ns: int = 0
    answered_ns: int | None = None
    timed: TimedMove | None = None
    changed: asyncio.Event = field(default_factory=asyncio.Event)


class Mover:
    """Arms, starts and follows steps of one connection."""

    def __init__(
        self, options: Options, clock: Clock, firer: Firer, unit: UnitState, crystal: UnreadClock, slots: Slots
    ) -> None:
        self._options = options
        self._clock = clock
        self._firer = firer
        self._unit = unit
        self._crystal = crystal
        self._slots = slots
        self.move: Move | None = None

    # Before the start

    async def arm(self, lowered: SmcLowered, t0_ns: int) -> Mapping[str, int]:
        """Load the program and read it back; one that waits for a line begins to wait. Raises `CannotDo`."""
        if self.move is not None or self._unit.doing == "home":
            raise CannotDo("busy", "a motion is loaded or under way", "disarm or stop it")
        move = self.move = Move(lowered, t0_ns)
        try:
            return await self._arm(move)
        except BaseException:
            if self.move is move and not move.running:
                self.move = None
            raise

    async def _arm(self, move: Move) -> Mapping[str, int]:
        lowered, unit = move.lowered, self._unit
        if not lowered.program:
            return {}
        if lowered.target is not None and not unit.enabled:
            raise CannotDo("not-enabled", f"axis {lowered.axis} is not enabled", f"enable {lowered.axis} first")
        began_ns, since = self._clock.now_ns(), unit.session.stops
        async with unit.loading:
            await unit.stopped()
            async with unit.in_one_go():
                loaded_ns = await self._load(move, since)
        unit.session.require_no_stop(since)
        return {"wire": loaded_ns - began_ns, "verify": self._clock.now_ns() - loaded_ns}

    async def _load(self, move: Move, since: int) -> int:
        """Check where it stands, load the program and read it back, and have it wait if it is to wait; when it was
        loaded."""
        lowered, unit = move.lowered, self._unit
        await self._require_start(lowered)
        await unit.load(lowered.program, since)
        loaded_ns = self._clock.now_ns()
        if lowered.wait is not None or lowered.drive is not None:
            await self._require_passive(lowered)
        if lowered.wait is None:
            return loaded_ns
        # A start by the host is verified before it is promised; here the program goes from now on.
        await unit.require_not_restarted("armed", "arm again; its axis has to be homed before")
        move.running = True
        await unit.run(since, "step")
        if not (await unit.status()).busy:
            raise CannotDo(
                "line-level",
                f"axis {lowered.axis} has not begun to wait for input {lowered.wait.name}",
                "is the line active already?",
            )
        return loaded_ns

    async def verify(self) -> None:
        """Still loaded, still where the plan starts, or still waiting for its line. Raises `CannotDo`."""
        move = self._require()
        lowered, unit = move.lowered, self._unit
        if not lowered.program:
            return
        if lowered.wait is not None:
            if not (await unit.status()).busy:
                raise CannotDo(
                    "not-armed",
                    f"axis {lowered.axis} does not wait for input {lowered.wait.name} any more",
                    "arm again; has the line been active, or was the unit stopped or switched off?",
                )
            return
        await self._require_start(lowered)
        try:
            known = unit.program == lowered.program and await unit.holds_sentinel()
        except Busy:
            known = False
        if not known:
            raise CannotDo("not-loaded", f"{unit.session.name} has lost its program", "arm again")

    async def go(self, slack_ns: int, sooner_ns: int) -> None:
        """Have the starting line written in its slot, so that the motion or the edge is at T0, or `slack_ns` later than
        promised: but not where the next unit's slot follows."""
        move = self._require()
        move.t0_ns -= sooner_ns
        lowered, session = move.lowered, self._unit.session
        if not lowered.program or lowered.wait is not None:
            return
        data = session.framed("E")
        wire_ns = session.line.wire_ns(len(data))
        at_ns = move.t0_ns - lowered.lead_ns - wire_ns
        if self._slots.count > 1:
            slack_ns = 0
        latest_ns = self._options.latest_ns(at_ns, slack_ns)
        if self._clock.now_ns() >= at_ns:
            raise CannotDo("late", "the instant to write the starting line is past", "give more lead time")
        shot = Shot(session.unit, at_ns, wire_ns, self._slots.each_ns, slack_ns)
        session.line.reserve(shot)
        move.shot = shot
        move.order = self._firer.schedule(session.line.link, data, at_ns, latest_ns)
        move.running = True
        self._unit.doing = "step"

    async def disarm(self) -> None:
        """Take back the starting line, or stop the waiting program. Nothing starts any more."""
        move, self.move = self.move, None
        if move is not None and move.running and not self._taken_back(move):
            # Z ends a program that waits as well as one that has begun to move (L2128-L2130).
            self._unit.stop("Z", *passive(move.lowered))
        if move is not None:
            self._unit.doing = "nothing"
        await self._unit.stopped()

    def interrupted(self, at_ns: int) -> None:
        """A stop was written at that instant."""
        move = self.move
        if move is None:
            return
        move.stopped_ns = at_ns
        if self._taken_back(move) or not move.running or not move.followed:
            self.move = None
            self._unit.doing = "nothing"
        move.changed.set()

    def _taken_back(self, move: Move) -> bool:
        """Cancel the order to write the starting line; whether it was not and will not be written."""
        if move.order is None or not move.order.cancel():
            return False
        if move.shot is not None:
            self._unit.session.line.release(move.shot)
        move.running = False
        return True

    # After the start

    async def started(self) -> Mapping[str, Span]:
        """When the axis started; raises `DriverFault` when it did not."""
        move = self._require()
        move.followed = True
        lowered = move.lowered
        if not lowered.program:
            return {name: Span(move.t0_ns, move.t0_ns) for name in lowered.durations_s}
        span = await (self._started_by_line(move) if lowered.wait is not None else self._started_by_host(move))
        move.started = span
        shape = lowered.shape
        # Between several commands the interpreter takes its time, and behind the motion a driven output.
        if lowered.wait is None and lowered.drive is None and shape is not None and len(shape.parts) == 1:
            move.timed = TimedMove(shape.duration_s, shape.legs, (span.earliest_ns, span.latest_ns))
        await self._sleep_until(move, span.latest_ns)
        if lowered.wait is None and lowered.target not in (None, lowered.start_counts):
            await self._see_it_gone(move)
        moving = {} if lowered.target is None else dict.fromkeys(lowered.durations_s, span)
        return {name: moving.get(name, Span(move.t0_ns, move.t0_ns)) for name in lowered.durations_s}

    async def _started_by_host(self, move: Move) -> Span:
        """Not before the line can have been at the unit, not after its answer can have begun to be sent; and from
        there on what the program takes."""
        assert move.order is not None and move.shot is not None
        session = self._unit.session
        try:
            fired = await move.order.done()
        except asyncio.CancelledError:
            if move.running:
                raise
            raise DriverFault("not-started", "the order to start was taken back", "") from None
        if fired.late:
            session.line.release(move.shot)
            move.running = False
            raise missed("the starting line", session.line.link, fired)
        late_ns = self._options.beyond_ns(fired)
        session.line.written(move.shot, late_ns)
        reply = await move.shot.heard
        at_unit_ns = move.arrived_ns = fired.written_ns + move.shot.wire_ns
        least_ns, most_ns = move.lowered.program_ns
        if reply is not None and reply.text == "Y":
            latest_ns = move.answered_ns = reply.at_ns - session.line.wire_ns(reply.characters)
        elif move.stopped_ns is not None or (await self._unit.status()).busy:
            # Its answer is lost or late, but it is at it; the line may have been as late as the answer.
            latest_ns = self._clock.now_ns()
        else:
            move.running = False
            said = "nothing" if reply is None else "a garbled line" if reply.text is None else repr(reply.text)
            raise DriverFault(
                "not-started",
                f"{session.name} has answered {said} to the starting line, and does not move",
                "check cable and power; is its address given twice?",
            )
        return Span(min(at_unit_ns, latest_ns) + least_ns, latest_ns + most_ns, late_ns=late_ns)

    async def _see_it_gone(self, move: Move) -> None:
        """A unit whose end-of-travel input is active takes the order, and stays where it is; so does one that has just
        been switched on again, and calls that place another."""
        if (await self._unit.status()).busy or move.stopped_ns is not None:
            return
        if not await self._unit.holds_sentinel():
            move.running = False
            raise DriverFault("not-started", f"{self._unit.session.name} was restarted before its start", "try again")
        if await self._unit.position() == move.lowered.start_counts:
            move.running = False
            raise DriverFault(
                "not-started",
                f"axis {move.lowered.axis} has taken the order to start, and has not left its place",
                "is an end-of-travel input active?",
            )

    async def _started_by_line(self, move: Move) -> Span:
        """By the line's window. The unit itself shows only that it is not ready: it may still be waiting."""
        earliest_ns, latest_ns = (move.t0_ns + each for each in move.lowered.window_ns)
        await self._sleep_until(move, latest_ns)
        if (await self._unit.status()).busy or move.stopped_ns is not None:
            return Span(earliest_ns, latest_ns, seen=False)
        if await self._unit.position() == move.lowered.target and await self._unit.holds_sentinel():
            return Span(earliest_ns, latest_ns)
        raise DriverFault(
            "not-started",
            f"axis {move.lowered.axis} does not wait any more, and stands at {await self._unit.position()}",
            "was the unit stopped or switched off by hand?",
        )

    async def outcome(self) -> Outcome:
        """Wait until the program has ended, and see where the axis stands."""
        move = self._require()
        lowered, unit = move.lowered, self._unit
        if not lowered.program or move.started is None:
            self._over(move)
            return Outcome("done", {name: Span(move.t0_ns, move.t0_ns) for name in lowered.durations_s})
        least_ns, most_ns = self._took_ns(move)
        # The end of a long motion is asked for without a pause, so that it is also known when it had not come yet.
        close = move.timed is not None and move.timed.duration_s >= LONG_S
        before_ns = 0 if move.timed is None or not close else move.timed.before_ns
        await self._sleep_until(move, move.started.earliest_ns + least_ns - before_ns)
        overdue_ns = self._clock.now_ns() + self._program_slack_ns(move)
        last_busy_ns = 0
        while (now := await unit.status()).busy:
            last_busy_ns = now.arrived_ns
            if move.timed is not None:
                move.timed.moved(now.arrived_ns)
            if self._clock.now_ns() > overdue_ns and move.stopped_ns is None:
                return await self._overdue(move)
            if not close or move.stopped_ns is not None or self._clock.now_ns() > move.started.latest_ns + most_ns:
                await sleep_ns(self._clock, _LOOK_NS)
        await unit.stopped()
        counts = await self._counts_at_rest()
        self._over(move)
        if lowered.target is None:
            done = move.stopped_ns is None
            ended = {name: Span(move.t0_ns, move.t0_ns) for name in lowered.durations_s}
            return Outcome("done", ended) if done else Outcome("stopped", ended, "stopped on request")
        if counts == lowered.target:
            unit.limit = "none"
            self._learn(move, now.at_ns)
            return Outcome("done", {lowered.axis: self._end(move, last_busy_ns, now.at_ns)})
        span = Span(min(move.started.earliest_ns, now.at_ns), now.at_ns)
        stands = f"axis {lowered.axis} stands at {counts}, not at its target {lowered.target}"
        if move.stopped_ns is not None:
            return Outcome("stopped", {lowered.axis: span}, f"stopped on request; {stands}")
        forward = lowered.target > lowered.start_counts
        unit.limit = "forward" if forward else "reverse"
        side = "CW" if forward else "CCW"
        return Outcome(
            "fault", {lowered.axis: span}, f"{stands}: has the {side} end-of-travel input stopped it, or its own error?"
        )

    def told(self, place: Place) -> None:
        """The unit has said in motion where it is."""
        move = self.move
        if move is not None and move.timed is not None:
            way = abs(place.counts - move.lowered.start_counts)
            move.timed.stood(way, _GRAIN, place.arrived_ns, place.at_ns)

    def _learn(self, move: Move, ready_ns: int) -> None:
        """What a motion that has ended as planned says of the crystal, and of the time to the start."""
        if move.timed is None or move.stopped_ns is not None:
            return
        lowered = move.lowered
        move.timed.ended(ready_ns)
        program_ns = sum(lowered.program_ns) // 2
        answered_ns = None if move.answered_ns is None else move.answered_ns + program_ns
        # Without the delay, which is not the same in all programs.
        began_ns = move.arrived_ns + program_ns - LINES_BEFORE * self._options.line_us * NS_PER_US
        self._crystal.learn(move.timed, began_ns, answered_ns, self._clock.now_ns())

    def seen_ready(self, asked_ns: int) -> None:
        """The unit executes nothing, by an answer to what was asked then: a step that should still move has ended."""
        move = self.move
        if move is not None and move.started is not None and asked_ns > move.started.latest_ns:
            move.changed.set()

    def _end(self, move: Move, last_busy_ns: int, ready_ns: int) -> Span:
        """By its start and its duration, as far as the crystal may be wrong; and before it answered that it is ready.

        Behind the motion there may be more program lines, so that being busy tells nothing when there are.
        """
        assert move.started is not None
        least_ns, most_ns = self._took_ns(move)
        earliest_ns = move.started.earliest_ns + least_ns - self._gap_spread_ns(move)
        latest_ns = move.started.latest_ns + most_ns + self._gap_spread_ns(move)
        if move.lowered.drive is None:
            earliest_ns = max(earliest_ns, last_busy_ns)
        latest_ns = min(latest_ns, ready_ns)
        return Span(min(earliest_ns, latest_ns), latest_ns)

    async def _overdue(self, move: Move) -> Outcome:
        """Held by its Stop input, or still waiting: killed, because it would go on whenever it likes (L830-L842)."""
        assert move.started is not None
        self._unit.stop("K", *passive(move.lowered))
        await self._unit.stopped()
        counts = await self._counts_at_rest()
        self._over(move)
        now_ns = self._clock.now_ns()
        lowered = move.lowered
        if counts == lowered.start_counts and lowered.wait is not None:
            reason = f"axis {lowered.axis} has not started: input {lowered.wait.name} did not become active"
        else:
            reason = f"axis {lowered.axis} does not come to its end and stands at {counts}: is its Stop input active?"
        return Outcome("fault", dict.fromkeys(lowered.durations_s, Span(move.started.earliest_ns, now_ns)), reason)

    # Inside

    def _over(self, move: Move) -> None:
        if self.move is move:
            self.move = None
            self._unit.doing = "nothing"

    def _require(self) -> Move:
        if self.move is None:
            raise CannotDo("not-armed", "no step is loaded", "arm it")
        return self.move

    async def _require_start(self, lowered: SmcLowered) -> None:
        found = await self._unit.ready()
        if lowered.target is not None and found != lowered.start_counts:
            raise CannotDo(
                "other-start",
                f"axis {lowered.axis} stands at {found} steps; the plan starts at {lowered.start_counts}",
                "plan again from where it stands",
            )

    async def _require_passive(self, lowered: SmcLowered) -> None:
        """The line that is waited for, or driven, must not be active yet."""
        try:
            inputs, outputs = await self._unit.points()
        except Busy:
            raise CannotDo("moving", f"{self._unit.session.name} executes a program", "wait, or stop it") from None
        for kind, point, levels in (("input", lowered.wait, inputs), ("output", lowered.drive, outputs)):
            if point is not None and levels[point.number] == point.high:
                raise CannotDo(
                    "line-level",
                    f"{kind} {point.name} ({point.number}) is active already",
                    "make the line passive; see `active` in the fleet file",
                )

    async def _counts_at_rest(self) -> int:
        while True:
            try:
                self._unit.rest_counts = await self._unit.position()
            except Busy:
                await sleep_ns(self._clock, _LOOK_NS)
            else:
                return self._unit.rest_counts

    async def _sleep_until(self, move: Move, at_ns: int) -> None:
        """Until that instant, or a stop."""
        if move.stopped_ns is not None:
            return
        timer = self._clock.call_at_ns(at_ns, move.changed.set)
        try:
            if self._clock.now_ns() < at_ns:
                await move.changed.wait()
        finally:
            timer.cancel()
        move.changed.clear()

    def _took_ns(self, move: Move) -> tuple[int, int]:
        """What the motion takes by all that is known of the crystal, least and most."""
        shape = move.lowered.shape
        return self._crystal.rate.took_ns(0.0 if shape is None else shape.duration_s, self._clock.now_ns())

    def _gap_spread_ns(self, move: Move) -> int:
        shape = move.lowered.shape
        return 0 if shape is None else 2 * (len(shape.parts) - 1) * self._options.line_spread_us * NS_PER_US

    def _program_slack_ns(self, move: Move) -> int:
        """How much longer than the motion its program may take."""
        held = [int(line[1:]) for line in move.lowered.program if line.startswith("D") and move.lowered.drive]
        return _OVERDUE_NS + sum(held) * 10 * NS_PER_MS


def passive(lowered: SmcLowered) -> tuple[str, ...]:
    """What makes the driven output passive."""
    drive = lowered.drive
    return () if drive is None else (f"{'C' if drive.high else 'A'}{drive.number}",)
