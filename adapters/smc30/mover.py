"""One step of a controller: its program loaded and checked, started by the host or by a trigger line, followed to its
end."""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field

from adapters.contract import HostInterval, MoveOutcome, TimedWrite
from adapters.smc30.line import StartSlot
from adapters.smc30.lowering import LINES_BEFORE, SlotSchedule, Smc30Lowered
from adapters.smc30.options import Smc30DriverOptions
from adapters.smc30.session import ControllerBusy
from adapters.smc30.unitstate import PositionReading, Smc30State
from adapters.toolkit.firing import missed_write_fault
from adapters.toolkit.host_start import MoverTools, wait_for_write
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns
from orchestrator.clock.timed import MIN_POLLED_DURATION_S, TimedMove
from orchestrator.model.errors import ControllerFault, Refusal

_POLL_NS = 20 * NS_PER_MS
_GRAIN = 1.0  # steps: the manual does not state whether the counter rounds
_OVERDUE_NS = NS_PER_S  # a motion that ends later than this is blocked, or has never begun


@dataclass(slots=True)
class LoadedStep:
    """A loaded step.

    order, slot: of its starting command, from `go` on.
    started: the interval of the start, when known.
    arrived_ns: for a start by the host, the earliest arrival of the end of its command at the controller.
    answered_ns: the latest instant at which its answer was sent.
    timed: observations of the motion, where they provide information about the crystal."""

    lowered: Smc30Lowered
    t0_ns: int
    order: TimedWrite | None = None
    slot: StartSlot | None = None
    started: HostInterval | None = None
    running: bool = False
    """Its program has been started."""
    followed: bool = False
    """A task waits for its start or its end."""
    stopped_ns: int | None = None
    arrived_ns: int = 0
    answered_ns: int | None = None
    timed: TimedMove | None = None
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def start(self) -> HostInterval:
        """The interval of the start, known once `started` is set."""
        if self.started is None:
            raise RuntimeError("the step has not started")
        return self.started


class Smc30Mover:
    """Arm, start and follow the steps of one connection."""

    def __init__(self, options: Smc30DriverOptions, tools: MoverTools, unit: Smc30State, slots: SlotSchedule) -> None:
        self._options = options
        self._clock = tools.clock
        self._timed_writer = tools.timed_writer
        self._unit = unit
        self._crystal = tools.crystal
        self._slots = slots
        self.move: LoadedStep | None = None

    # Before the start

    async def load_move(self, lowered: Smc30Lowered, t0_ns: int) -> Mapping[str, int]:
        """Load the program and read it back; a program that waits for a trigger line begins to wait. Raises
        `Refusal`."""
        if self.move is not None or self._unit.doing == "home":
            raise Refusal("busy", "a motion is loaded or in progress", "disarm or stop it")
        move = self.move = LoadedStep(lowered, t0_ns)
        try:
            return await self._arm_loaded(move)
        except BaseException:
            if self.move is move and not move.running:
                self.move = None
            raise

    async def _arm_loaded(self, move: LoadedStep) -> Mapping[str, int]:
        lowered_step, unit = move.lowered, self._unit
        if not lowered_step.program:
            return {}
        if lowered_step.target is not None and not unit.enabled:
            raise Refusal(
                "not-enabled", f"axis {lowered_step.axis} is not enabled", f"enable {lowered_step.axis} first"
            )
        began_ns, stop_count = self._clock.now_ns(), unit.session.stops
        async with unit.loading:
            await unit.wait_for_stops()
            async with unit.exclusive_turn():
                loaded_ns = await self._load_program(move, stop_count)
        unit.session.require_no_stop(stop_count)
        return {"wire": loaded_ns - began_ns, "verify": self._clock.now_ns() - loaded_ns}

    async def _load_program(self, move: LoadedStep, since: int) -> int:
        """Check the position, load the program and read it back, and start its wait if it has one; return when it was
        loaded."""
        lowered_step, unit = move.lowered, self._unit
        await self._require_start(lowered_step)
        await unit.load_program(lowered_step.program, since)
        loaded_ns = self._clock.now_ns()
        if lowered_step.wait is not None or lowered_step.drive is not None:
            await self._require_passive(lowered_step)
        if lowered_step.wait is None:
            return loaded_ns
        # A start by the host is verified before the commit; this program runs from now on.
        await unit.require_not_restarted("armed", "arm it again; its axis must be homed before")
        move.running = True
        await unit.run_program(since, "step")
        if not (await unit.read_status()).busy:
            raise Refusal(
                "line-level",
                f"axis {lowered_step.axis} has not begun to wait for input {lowered_step.wait.name}",
                "is the trigger line already active?",
            )
        return loaded_ns

    async def verify_move(self) -> None:
        """Check that the program is still loaded at the start of the plan, or still waits for its trigger line. Raises
        `Refusal`."""
        move = self._require_step()
        lowered_step, unit = move.lowered, self._unit
        if not lowered_step.program:
            return
        if lowered_step.wait is not None:
            if not (await unit.read_status()).busy:
                raise Refusal(
                    "not-armed",
                    f"axis {lowered_step.axis} no longer waits for input {lowered_step.wait.name}",
                    "arm it again; was the trigger line active, or was the controller stopped or switched off?",
                )
            return
        await self._require_start(lowered_step)
        try:
            is_loaded = unit.program == lowered_step.program and await unit.holds_sentinel()
        except ControllerBusy:
            is_loaded = False
        if not is_loaded:
            raise Refusal("not-loaded", f"{unit.session.name} has lost its program", "arm it again")

    async def schedule_start(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Schedule the starting command in its slot, so that the motion or the edge is at T0, or up to
        `start_tolerance_ns` later than guaranteed: but no later where the next controller's slot follows."""
        move = self._require_step()
        move.t0_ns -= advance_ns
        lowered_step, session = move.lowered, self._unit.session
        if not lowered_step.program or lowered_step.wait is not None:
            return
        data = session.frame_command("E")
        wire_ns = session.line.wire_ns(len(data))
        at_ns = move.t0_ns - lowered_step.lead_ns - wire_ns
        if self._slots.count > 1:
            start_tolerance_ns = 0
        latest_ns = self._options.latest_write_ns(at_ns, start_tolerance_ns)
        if self._clock.now_ns() >= at_ns:
            raise Refusal("late", "the instant to write the starting command has passed", "increase the lead time")
        shot = StartSlot(session.unit, at_ns, wire_ns, self._slots.each_ns, start_tolerance_ns)
        session.line.reserve_slot(shot)
        move.slot = shot
        move.order = self._timed_writer.schedule_write(session.line.link, data, at_ns, latest_ns)
        move.running = True
        self._unit.doing = "step"

    async def unload_move(self) -> None:
        """Cancel the starting command, or stop the waiting program: nothing starts afterwards."""
        move, self.move = self.move, None
        if move is not None and move.running and not self._cancel_start(move):
            # Z ends a waiting program as well as one that has begun to move (L2128-L2130).
            self._unit.write_stop("Z", *passive_commands(move.lowered))
        if move is not None:
            self._unit.doing = "nothing"
        await self._unit.wait_for_stops()

    def record_stop(self, at_ns: int) -> None:
        """Record a stop that was written at that instant."""
        move = self.move
        if move is None:
            return
        move.stopped_ns = at_ns
        if self._cancel_start(move) or not move.running or not move.followed:
            self.move = None
            self._unit.doing = "nothing"
        move.changed.set()

    def drop_start(self) -> None:
        """Cancel the timed write of the starting command: the connection ends."""
        move = self.move
        if move is not None and move.order is not None and move.order.cancel_write() and move.slot is not None:
            self._unit.session.line.free_slot(move.slot)

    def _cancel_start(self, move: LoadedStep) -> bool:
        """Cancel the timed write of the starting command; return whether it was not and will not be written."""
        if move.order is None or not move.order.cancel_write():
            return False
        if move.slot is not None:
            self._unit.session.line.free_slot(move.slot)
        move.running = False
        return True

    # After the start

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axis started; raise `ControllerFault` when it did not."""
        move = self._require_step()
        move.followed = True
        lowered_step = move.lowered
        if not lowered_step.program:
            return {name: HostInterval(move.t0_ns, move.t0_ns) for name in lowered_step.durations_s}
        span = await (self._started_by_line(move) if lowered_step.wait is not None else self._started_by_host(move))
        move.started = span
        shape = lowered_step.shape
        # The interpreter takes time between several commands, and for a driven output after the motion.
        if lowered_step.wait is None and lowered_step.drive is None and shape is not None and len(shape.parts) == 1:
            move.timed = TimedMove(shape.duration_s, shape.motion_legs, (span.earliest_ns, span.latest_ns))
        await self._sleep_until(move, span.latest_ns)
        if lowered_step.wait is None and lowered_step.target not in (None, lowered_step.start_counts):
            await self._require_motion(move)
        start_spans = {} if lowered_step.target is None else dict.fromkeys(lowered_step.durations_s, span)
        return {name: start_spans.get(name, HostInterval(move.t0_ns, move.t0_ns)) for name in lowered_step.durations_s}

    async def _started_by_host(self, move: LoadedStep) -> HostInterval:
        """Return the start: not earlier than the arrival of the command at the controller, not later than the begin of
        its answer, plus the program's time."""
        order, slot = move.order, move.slot
        if order is None or slot is None:
            raise ControllerFault("not-started", "no starting command was scheduled", "arm it again")
        session = self._unit.session
        write = await wait_for_write(order, lambda: not move.running)
        if write.late:
            session.line.free_slot(slot)
            move.running = False
            raise missed_write_fault("the starting command", session.line.link, write)
        late_ns = self._options.excess_delay_ns(write)
        session.line.record_write(slot, late_ns)
        reply = await slot.answer
        at_unit_ns = move.arrived_ns = write.written_ns + slot.wire_ns
        least_ns, most_ns = move.lowered.program_ns
        if reply is not None and reply.text == "Y":
            latest_ns = move.answered_ns = reply.at_ns - session.line.wire_ns(reply.characters)
        elif move.stopped_ns is not None or (await self._unit.read_status()).busy:
            # Its answer is lost or late, but the program runs; the command may have been as late as the answer.
            latest_ns = self._clock.now_ns()
        else:
            move.running = False
            answer_text = "nothing" if reply is None else "a garbled line" if reply.text is None else repr(reply.text)
            raise ControllerFault(
                "not-started",
                f"{session.name} has answered {answer_text} to the starting command, and does not move",
                "check cable and power; do two controllers have its address?",
            )
        return HostInterval(min(at_unit_ns, latest_ns) + least_ns, latest_ns + most_ns, late_ns=late_ns)

    async def _require_motion(self, move: LoadedStep) -> None:
        """Verify that the axis has moved: a controller whose end-of-travel input is active accepts the command and does
        not move; one that was just power-cycled reports its position with another value."""
        if (await self._unit.read_status()).busy or move.stopped_ns is not None:
            return
        if not await self._unit.holds_sentinel():
            move.running = False
            raise ControllerFault("not-started", f"{self._unit.session.name} restarted before its start", "try again")
        if await self._unit.read_position() == move.lowered.start_counts:
            move.running = False
            raise ControllerFault(
                "not-started",
                f"axis {move.lowered.axis} has accepted the starting command, and has not moved",
                "is an end-of-travel input active?",
            )

    async def _started_by_line(self, move: LoadedStep) -> HostInterval:
        """Return the window of the trigger line. The controller itself shows only that it is not ready: it may still be
        waiting."""
        earliest_ns, latest_ns = (move.t0_ns + limit_ns for limit_ns in move.lowered.window_ns)
        await self._sleep_until(move, latest_ns)
        if (await self._unit.read_status()).busy or move.stopped_ns is not None:
            return HostInterval(earliest_ns, latest_ns, seen=False)
        if await self._unit.read_position() == move.lowered.target and await self._unit.holds_sentinel():
            return HostInterval(earliest_ns, latest_ns)
        raise ControllerFault(
            "not-started",
            f"axis {move.lowered.axis} no longer waits, and is at {await self._unit.read_position()}",
            "was the controller stopped or switched off manually?",
        )

    async def wait_for_end(self) -> MoveOutcome:
        """Wait until the program has ended, and check the final position."""
        move = self._require_step()
        lowered_step, unit = move.lowered, self._unit
        if not lowered_step.program or move.started is None:
            self._finish_step(move)
            return MoveOutcome(
                "done", {name: HostInterval(move.t0_ns, move.t0_ns) for name in lowered_step.durations_s}
            )
        least_ns, most_ns = self._duration_bounds_ns(move)
        # The end of a long motion is queried without a pause, so that the latest instant before the end is known as
        # well.
        close = move.timed is not None and move.timed.duration_s >= MIN_POLLED_DURATION_S
        before_ns = 0 if move.timed is None or not close else move.timed.end_poll_lead_ns
        await self._sleep_until(move, move.start.earliest_ns + least_ns - before_ns)
        overdue_ns = self._clock.now_ns() + self._program_excess_ns(move)
        last_busy_ns = 0
        while (status := await unit.read_status()).busy:
            last_busy_ns = status.arrived_ns
            if move.timed is not None:
                move.timed.mark_moving(status.arrived_ns)
            if self._clock.now_ns() > overdue_ns and move.stopped_ns is None:
                return await self._kill_overdue(move)
            if not close or move.stopped_ns is not None or self._clock.now_ns() > move.start.latest_ns + most_ns:
                await sleep_ns(self._clock, _POLL_NS)
        await unit.wait_for_stops()
        counts = await self._counts_at_rest()
        self._finish_step(move)
        if lowered_step.target is None:
            is_done = move.stopped_ns is None
            end_spans = {name: HostInterval(move.t0_ns, move.t0_ns) for name in lowered_step.durations_s}
            return (
                MoveOutcome("done", end_spans) if is_done else MoveOutcome("stopped", end_spans, "stopped on request")
            )
        if counts == lowered_step.target:
            unit.limit = "none"
            self._learn_crystal(move, status.at_ns)
            return MoveOutcome("done", {lowered_step.axis: self._end_interval(move, last_busy_ns, status.at_ns)})
        span = HostInterval(min(move.start.earliest_ns, status.at_ns), status.at_ns)
        stands = f"axis {lowered_step.axis} is at {counts}, not at its target {lowered_step.target}"
        if move.stopped_ns is not None:
            return MoveOutcome("stopped", {lowered_step.axis: span}, f"stopped on request; {stands}")
        forward = lowered_step.target > lowered_step.start_counts
        unit.limit = "forward" if forward else "reverse"
        side = "CW" if forward else "CCW"
        return MoveOutcome(
            "fault",
            {lowered_step.axis: span},
            f"{stands}: has the {side} end-of-travel input stopped it, or its own error?",
        )

    def add_position(self, place: PositionReading) -> None:
        """Add a position that the controller has reported in motion."""
        move = self.move
        if move is not None and move.timed is not None:
            way = abs(place.counts - move.lowered.start_counts)
            move.timed.add_position(way, _GRAIN, place.arrived_ns, place.at_ns)

    def _learn_crystal(self, move: LoadedStep, ready_ns: int) -> None:
        """Learn the crystal's rate and the start delay from a motion that has ended as planned."""
        if move.timed is None or move.stopped_ns is not None:
            return
        lowered_step = move.lowered
        move.timed.mark_ended(ready_ns)
        program_ns = sum(lowered_step.program_ns) // 2
        answered_ns = None if move.answered_ns is None else move.answered_ns + program_ns
        # Without the delay, which is not the same in all programs.
        began_ns = move.arrived_ns + program_ns - LINES_BEFORE * self._options.line_us * NS_PER_US
        self._crystal.learn_from_move(move.timed, began_ns, answered_ns, self._clock.now_ns(), move.start.late_ns)

    def record_ready(self, asked_ns: int) -> None:
        """Record that the controller executed nothing at `asked_ns`: a step that should still move has ended."""
        move = self.move
        if move is not None and move.started is not None and asked_ns > move.start.latest_ns:
            move.changed.set()

    def _end_interval(self, move: LoadedStep, last_busy_ns: int, ready_ns: int) -> HostInterval:
        """Return the interval of the end: from its start and its duration, within the error of the crystal, and before
        the answer that it is ready.

        The motion may be followed by more program lines; then the busy state gives no information.
        """
        least_ns, most_ns = self._duration_bounds_ns(move)
        earliest_ns = move.start.earliest_ns + least_ns - self._gap_spread_ns(move)
        latest_ns = move.start.latest_ns + most_ns + self._gap_spread_ns(move)
        if move.lowered.drive is None:
            earliest_ns = max(earliest_ns, last_busy_ns)
        latest_ns = min(latest_ns, ready_ns)
        return HostInterval(min(earliest_ns, latest_ns), latest_ns)

    async def _kill_overdue(self, move: LoadedStep) -> MoveOutcome:
        """Handle a motion that is blocked by its Stop input, or still waits: it is killed, because it could continue at
        any moment (L830-L842)."""
        self._unit.write_stop("K", *passive_commands(move.lowered))
        await self._unit.wait_for_stops()
        counts = await self._counts_at_rest()
        self._finish_step(move)
        now_ns = self._clock.now_ns()
        lowered_step = move.lowered
        if counts == lowered_step.start_counts and lowered_step.wait is not None:
            reason = f"axis {lowered_step.axis} has not started: input {lowered_step.wait.name} did not become active"
        else:
            reason = f"axis {lowered_step.axis} does not reach its end and is at {counts}: is its Stop input active?"
        return MoveOutcome(
            "fault", dict.fromkeys(lowered_step.durations_s, HostInterval(move.start.earliest_ns, now_ns)), reason
        )

    # Internals

    def _finish_step(self, move: LoadedStep) -> None:
        if self.move is move:
            self.move = None
            self._unit.doing = "nothing"

    def _require_step(self) -> LoadedStep:
        if self.move is None:
            raise Refusal("not-armed", "no step is loaded", "arm it first")
        return self.move

    async def _require_start(self, lowered: Smc30Lowered) -> None:
        counts = await self._unit.require_ready()
        if lowered.target is not None and counts != lowered.start_counts:
            raise Refusal(
                "other-start",
                f"axis {lowered.axis} is at {counts} steps; the plan starts at {lowered.start_counts}",
                "plan again from the present position",
            )

    async def _require_passive(self, lowered: Smc30Lowered) -> None:
        """Check that the awaited or driven trigger line is not active yet."""
        try:
            inputs, outputs = await self._unit.read_points()
        except ControllerBusy:
            raise Refusal(
                "moving", f"{self._unit.session.name} executes a program", "wait for its end, or stop it"
            ) from None
        for kind, point, levels in (("input", lowered.wait, inputs), ("output", lowered.drive, outputs)):
            if point is not None and levels[point.number] == point.high:
                raise Refusal(
                    "line-level",
                    f"{kind} {point.name} ({point.number}) is already active",
                    "make the trigger line passive; see `active` in the fleet file",
                )

    async def _counts_at_rest(self) -> int:
        while True:
            try:
                self._unit.rest_counts = await self._unit.read_position()
            except ControllerBusy:
                await sleep_ns(self._clock, _POLL_NS)
            else:
                return self._unit.rest_counts

    async def _sleep_until(self, move: LoadedStep, at_ns: int) -> None:
        """Wait until that instant, or a stop."""
        if move.stopped_ns is not None:
            return
        timer = self._clock.call_at_ns(at_ns, move.changed.set)
        try:
            if self._clock.now_ns() < at_ns:
                await move.changed.wait()
        finally:
            timer.cancel()
        move.changed.clear()

    def _duration_bounds_ns(self, move: LoadedStep) -> tuple[int, int]:
        """Return the shortest and longest duration of the motion by everything known about the crystal."""
        shape = move.lowered.shape
        return self._crystal.crystal_rate.host_duration_ns(
            0.0 if shape is None else shape.duration_s, self._clock.now_ns()
        )

    def _gap_spread_ns(self, move: LoadedStep) -> int:
        shape = move.lowered.shape
        return 0 if shape is None else 2 * (len(shape.parts) - 1) * self._options.line_spread_us * NS_PER_US

    def _program_excess_ns(self, move: LoadedStep) -> int:
        """Return how much longer than the motion its program may take."""
        hold_times = [int(line[1:]) for line in move.lowered.program if line.startswith("D") and move.lowered.drive]
        return _OVERDUE_NS + sum(hold_times) * 10 * NS_PER_MS


def passive_commands(lowered: Smc30Lowered) -> tuple[str, ...]:
    """Return the commands that make the driven output passive."""
    drive = lowered.drive
    return () if drive is None else (f"{'C' if drive.high else 'A'}{drive.number}",)
