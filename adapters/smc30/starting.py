"""The start of a step: its command in its slot on the line, or the wait for a trigger line; and the proof of it."""

from collections.abc import Mapping

from adapters.contract import HostInterval
from adapters.smc30.lowering import SlotSchedule
from adapters.smc30.options import Smc30DriverOptions
from adapters.smc30.slots import StartSlot
from adapters.smc30.step import LoadedStep
from adapters.smc30.unitstate import Smc30State
from adapters.toolkit.firing import missed_write_fault
from adapters.toolkit.host_start import MoverTools, wait_for_write
from orchestrator.clock.timed import TimedMove
from orchestrator.model.errors import LATE_REMEDY, ControllerFault, Refusal


class Smc30Starter:
    """Start the steps of one controller."""

    def __init__(self, options: Smc30DriverOptions, tools: MoverTools, unit: Smc30State, slots: SlotSchedule) -> None:
        self._options = options
        self._clock = tools.clock
        self._timed_writer = tools.timed_writer
        self._unit = unit
        self._slots = slots

    def schedule_start(self, move: LoadedStep, start_tolerance_ns: int, advance_ns: int) -> None:
        """Schedule the starting command in its slot, so that the motion or the edge is at T0, or up to
        `start_tolerance_ns` later than guaranteed: but no later where the next controller's slot follows."""
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
            raise Refusal("late", "the instant to write the starting command has passed", LATE_REMEDY)
        shot = StartSlot(session.unit, at_ns, wire_ns, self._slots.each_ns, start_tolerance_ns)
        session.line.slots.reserve_slot(shot)
        move.slot = shot
        move.order = self._timed_writer.schedule_write(session.line.link, data, at_ns, latest_ns)
        move.running = True
        self._unit.doing = "step"

    def cancel_start(self, move: LoadedStep) -> bool:
        """Cancel the timed write of the starting command; return whether it was not and will not be written."""
        if move.order is None or not move.order.cancel_write():
            return False
        if move.slot is not None:
            self._unit.session.line.slots.free_slot(move.slot)
        move.running = False
        return True

    async def wait_for_start(self, move: LoadedStep) -> Mapping[str, HostInterval]:
        """Return when the axis started; raise `ControllerFault` when it did not."""
        lowered_step = move.lowered
        if not lowered_step.program:
            return {name: HostInterval(move.t0_ns, move.t0_ns) for name in lowered_step.durations_s}
        span = await (self._started_by_line(move) if lowered_step.wait is not None else self._started_by_host(move))
        move.started = span
        shape = lowered_step.shape
        # The interpreter takes time between several commands, and for a driven output after the motion.
        if lowered_step.wait is None and lowered_step.drive is None and shape is not None and len(shape.parts) == 1:
            move.timed = TimedMove(shape.duration_s, shape.motion_legs, (span.earliest_ns, span.latest_ns))
        await move.sleep_until(self._clock, span.latest_ns)
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
            session.line.slots.free_slot(slot)
            move.running = False
            raise missed_write_fault("the starting command", session.line.link, write)
        late_ns = self._options.excess_delay_ns(write)
        session.line.slots.record_write(slot, late_ns)
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
        not move; one that was just power-cycled reports its position as 0."""
        status, target = await self._unit.read_end(), move.lowered.target
        if status.busy or move.stopped_ns is not None or (target and status.counts == target):
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
        await move.sleep_until(self._clock, latest_ns)
        if (await self._unit.read_status()).busy or move.stopped_ns is not None:
            return HostInterval(earliest_ns, latest_ns, seen=False)
        if await self._unit.read_position() == move.lowered.target and await self._unit.holds_sentinel():
            return HostInterval(earliest_ns, latest_ns)
        raise ControllerFault(
            "not-started",
            f"axis {move.lowered.axis} no longer waits, and is at {await self._unit.read_position()}",
            "was the controller stopped or switched off manually?",
        )
