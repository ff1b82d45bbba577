"""One step of a controller: its program loaded and checked, started by the host or by a trigger line, followed to its
end."""

from collections.abc import Mapping

from adapters.contract import HostInterval, MoveOutcome
from adapters.smc30.loading import ProgramLoader
from adapters.smc30.lowering import SlotSchedule, Smc30Lowered
from adapters.smc30.options import Smc30DriverOptions
from adapters.smc30.session import ControllerBusy
from adapters.smc30.starting import Smc30Starter
from adapters.smc30.step import LoadedStep, passive_commands
from adapters.smc30.timing import Smc30Timing
from adapters.smc30.unitstate import ActivityReading, PositionReading, Smc30State
from adapters.toolkit.host_start import MoverTools
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.clock.timed import MIN_POLLED_DURATION_S
from orchestrator.model.errors import Refusal

_POLL_NS = 20 * NS_PER_MS
_GRAIN = 1.0  # steps: the manual does not state whether the counter rounds


class Smc30Mover:
    """Arm, start and follow the steps of one connection."""

    def __init__(self, options: Smc30DriverOptions, tools: MoverTools, unit: Smc30State, slots: SlotSchedule) -> None:
        self._clock = tools.clock
        self._unit = unit
        self._loader = ProgramLoader(tools.clock, unit)
        self._starter = Smc30Starter(options, tools, unit, slots)
        self._timing = Smc30Timing(options, tools)
        self.move: LoadedStep | None = None

    # Before the start

    async def load_move(self, lowered: Smc30Lowered, t0_ns: int) -> Mapping[str, int]:
        """Load the program and read it back; a program that waits for a trigger line begins to wait. Raises
        `Refusal`."""
        return await self._load(lowered, t0_ns, behind=False)

    async def load_behind(self, lowered: Smc30Lowered, t0_ns: int, *, at_once: bool) -> Mapping[str, int]:
        """The same right behind a step that has just ended. at_once: no check before the commit follows. Raises
        `Refusal`."""
        stages = await self._load(lowered, t0_ns, behind=True)
        if at_once and lowered.program and not lowered.by_register:
            # Where it stands is known from the end of the last step, unless it has lost its counter since.
            await self._unit.require_not_restarted("loaded", "home its axis, and arm it again")
        return stages

    async def _load(self, lowered: Smc30Lowered, t0_ns: int, *, behind: bool) -> Mapping[str, int]:
        if self.move is not None or self._unit.doing == "home":
            raise Refusal("busy", "a motion is loaded or in progress", "disarm or stop it")
        move = self.move = LoadedStep(lowered, t0_ns, behind)
        try:
            return await self._loader.load_step(move)
        except BaseException:
            if self.move is move and not move.running:
                self.move = None
            raise

    async def verify_move(self) -> None:
        """Check that the program is still loaded at the start of the plan, or still waits for its trigger line. Raises
        `Refusal`."""
        await self._loader.verify_step(self._require_step())

    async def schedule_start(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Schedule the starting command. Raises `Refusal`."""
        self._starter.schedule_start(self._require_step(), start_tolerance_ns, advance_ns)

    async def unload_move(self) -> None:
        """Cancel the starting command, or stop the waiting program: nothing starts afterwards."""
        move, self.move = self.move, None
        if move is not None and move.running and not self._starter.cancel_start(move):
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
        if self._starter.cancel_start(move) or not move.running or not move.followed:
            self.move = None
            self._unit.doing = "nothing"
        move.changed.set()

    def drop_start(self) -> None:
        """Cancel the timed write of the starting command: the connection ends."""
        move = self.move
        if move is not None and move.order is not None and move.order.cancel_write() and move.slot is not None:
            self._unit.session.line.slots.free_slot(move.slot)

    # After the start

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axis started; raise `ControllerFault` when it did not."""
        move = self._require_step()
        move.followed = True
        return await self._starter.wait_for_start(move)

    async def wait_for_end(self) -> MoveOutcome:
        """Wait until the program has ended, and check the final position."""
        move = self._require_step()
        lowered_step, unit = move.lowered, self._unit
        if not lowered_step.program or move.started is None:
            self._finish_step(move)
            return MoveOutcome(
                "done", {name: HostInterval(move.t0_ns, move.t0_ns) for name in lowered_step.durations_s}
            )
        activity = await self._wait_until_ready(move)
        if activity is None:
            return await self._kill_overdue(move)
        status, last_busy_ns = activity
        await unit.wait_for_stops()
        counts = unit.rest_counts = await self._counts_at_rest() if status.counts is None else status.counts
        self._finish_step(move)
        if lowered_step.target is None:
            is_done = move.stopped_ns is None
            end_spans = {name: HostInterval(move.t0_ns, move.t0_ns) for name in lowered_step.durations_s}
            return (
                MoveOutcome("done", end_spans) if is_done else MoveOutcome("stopped", end_spans, "stopped on request")
            )
        if counts == lowered_step.target:
            unit.limit = "none"
            self._timing.learn_crystal(move, status.at_ns)
            return MoveOutcome("done", {lowered_step.axis: self._timing.end_interval(move, last_busy_ns, status.at_ns)})
        return self._missed_outcome(move, lowered_step.target, counts, status.at_ns)

    async def _wait_until_ready(self, move: LoadedStep) -> tuple[ActivityReading, int] | None:
        """Wait until the controller executes nothing; return the answer that shows it, and when the last one came that
        did not; None: the motion is overdue."""
        least_ns, most_ns = self._timing.duration_bounds_ns(move)
        # The end of a long motion is queried without a pause, so that the latest instant before the end is known as
        # well.
        close = move.timed is not None and move.timed.duration_s >= MIN_POLLED_DURATION_S
        before_ns = 0 if move.timed is None or not close else move.timed.end_poll_lead_ns
        await move.sleep_until(self._clock, move.start.earliest_ns + least_ns - before_ns)
        overdue_ns = self._clock.now_ns() + self._timing.program_excess_ns(move)
        last_busy_ns = 0
        while (status := await self._unit.read_end()).busy:
            last_busy_ns = status.arrived_ns
            if move.timed is not None:
                move.timed.mark_moving(status.arrived_ns)
            if self._clock.now_ns() > overdue_ns and move.stopped_ns is None:
                return None
            if not close or move.stopped_ns is not None or self._clock.now_ns() > move.start.latest_ns + most_ns:
                await sleep_ns(self._clock, _POLL_NS)
        return status, last_busy_ns

    def _missed_outcome(self, move: LoadedStep, target: int, counts: int, at_ns: int) -> MoveOutcome:
        """Return how a step ended that is not at its target, but at rest at `counts`."""
        axis = move.lowered.axis
        span = HostInterval(min(move.start.earliest_ns, at_ns), at_ns)
        stands = f"axis {axis} is at {counts}, not at its target {target}"
        if move.stopped_ns is not None:
            return MoveOutcome("stopped", {axis: span}, f"stopped on request; {stands}")
        forward = target > move.lowered.start_counts
        self._unit.limit = "forward" if forward else "reverse"
        side = "CW" if forward else "CCW"
        return MoveOutcome(
            "fault",
            {axis: span},
            f"{stands}: has the {side} end-of-travel input stopped it, or its own error?",
        )

    def add_position(self, place: PositionReading) -> None:
        """Add a position that the controller has reported in motion."""
        move = self.move
        if move is not None and move.timed is not None:
            way = abs(place.counts - move.lowered.start_counts)
            move.timed.add_position(way, _GRAIN, place.arrived_ns, place.at_ns)

    def record_ready(self, asked_ns: int) -> None:
        """Record that the controller executed nothing at `asked_ns`: a step that should still move has ended."""
        move = self.move
        if move is not None and move.started is not None and asked_ns > move.start.latest_ns:
            move.changed.set()

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

    async def _counts_at_rest(self) -> int:
        while True:
            try:
                self._unit.rest_counts = await self._unit.read_position()
            except ControllerBusy:
                await sleep_ns(self._clock, _POLL_NS)
            else:
                return self._unit.rest_counts
