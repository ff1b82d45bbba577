"""The start of a step: its command waits in the drive for the SYNC, which is scheduled, cancelled, or proven."""

import asyncio
from collections.abc import Mapping
from contextlib import suppress

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen import states
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.setpoint import begin_motion
from adapters.cia402.interruption import failure_text, is_interrupted, not_started_fault
from adapters.cia402.options import Cia402Options
from adapters.cia402.output import DrivenLine
from adapters.cia402.power import PowerStage
from adapters.cia402.step import DriveStep
from adapters.cia402.stream_outputs import StreamOutputs
from adapters.cia402.sync.starts import SyncScheduler
from adapters.cia402.sync.stream import COPIES, StreamedMove
from adapters.cia402.timing import DriveTiming
from adapters.contract import HostInterval, WriteResult
from adapters.toolkit.firing import missed_write_fault
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import LATE_REMEDY, ControllerFault, Refusal

_FIRST_COUNT_NS = 50 * NS_PER_MS  # from a start to the first reported count of its motion


class DriveStarter:
    """Start the steps of one drive."""

    def __init__(
        self, options: Cia402Options, sync_scheduler: SyncScheduler, node: BusDrive, power: PowerStage
    ) -> None:
        self._options = options
        self._sync_scheduler = sync_scheduler
        self._node = node
        self._power = power
        self.line = DrivenLine(node, power)
        self.stream_outputs = StreamOutputs(options, sync_scheduler, node)
        self._timing = DriveTiming(options, node.bus.bitrate)

    def schedule_start(self, move: DriveStep, start_tolerance_ns: int) -> None:
        """Send the starting command, which waits in the drive for the SYNC, and schedule the SYNC so that the motion is
        at T0, or up to `start_tolerance_ns` later than guaranteed: but no later before a stream, whose further SYNCs
        have fixed instants. Raises `Refusal`."""
        node = self._node
        lowered_step = move.lowered
        if move.is_idle:
            return
        at_ns = move.t0_ns - lowered_step.lead_ns
        # The waiting command must arrive in the drive before the SYNC.
        if node.clock.now_ns() + NS_PER_MS >= at_ns:
            raise Refusal("late", "the instant to write the SYNC has passed", LATE_REMEDY)
        control = node.control if lowered_step.shape is None else states.ENABLE | states.NEW_SET_POINT
        course = lowered_step.trajectory
        outputs = self.line.prepare_edge(move)
        move.released = node.loaded = True
        frames = [node.control_at_sync(control, outputs)]
        if course is not None:
            ride = move.streamed_move = StreamedMove(
                node, course, lowered_step.switched, lambda: self._handle_stream_failure(move)
            )
            self.stream_outputs.begin(ride, lowered_step.switched)
            self._sync_scheduler.join_stream(node.number, move.sync_start, ride, at_ns, course.period_ns)
            frames += [ride.position_frame(0)] * COPIES
        elif node.switches_with_positions or (node.followed == o.TARGET and lowered_step.target is not None):
            # The SYNC also applies a waiting position: it must not be an older one.
            if node.followed == o.TARGET and lowered_step.target is not None:
                node.given = lowered_step.target
            frames.append(node.position_frame(node.given, outputs))
        latest_ns = self._options.latest_write_ns(at_ns, start_tolerance_ns if move.sync_start.stream is None else 0)
        self._sync_scheduler.load_frames(node.number, move.sync_start, frames, at_ns, latest_ns)

    def cancel_start(self, move: DriveStep) -> None:
        """Cancel the command that waits in the drive, and the SYNC unless other drives need it."""
        node = self._node
        waits = self._sync_scheduler.remove_drive(node.number, move.sync_start)
        self.line.make_passive(move)
        if waits:
            # Every SYNC applies the drive's last command; until then each command overwrites the waiting one.
            mode = o.PROFILE_POSITION_MODE if move.lowered.trajectory is not None and move.stopped_ns is None else None
            node.send_control(node.control & ~states.NEW_SET_POINT, mode)
            node.loaded = not self._sync_scheduler.apply_waiting()
        else:
            node.loaded = False

    def _handle_stream_failure(self, move: DriveStep) -> None:
        """Handle a stream that cannot continue: the drive brakes."""
        with suppress(LinkClosed):
            if move.stopped_ns is None and not move.dropped:
                self._power.write_stop(abort=False)
            self._sync_scheduler.remove_drive(self._node.number, move.sync_start)
            self._sync_scheduler.apply_waiting()

    async def wait_for_start(self, move: DriveStep) -> Mapping[str, HostInterval]:
        """Return when the axis started; raise `ControllerFault` when it did not."""
        node, timing, lowered_step = self._node, self._timing, move.lowered
        names = list(lowered_step.durations_s)
        if move.is_idle:
            return {name: HostInterval(move.t0_ns, move.t0_ns) for name in names}
        write = await self._wait_for_sync(move)
        if move.driven is not None:
            self.line.keep_active(move)
        if lowered_step.target is None:
            return {name: HostInterval(move.t0_ns, move.t0_ns) for name in names}
        earliest_ns, latest_ns = timing.guaranteed_start(write.written_ns)
        await self._require_acceptance(move, write.written_ns, latest_ns + node.answer_ns)
        begin_motion(node, lowered_step.target)
        await self._require_motion(move)
        accepted_ns = self._accepted_ns(move, write.written_ns)
        if accepted_ns:
            # It has not reported motion yet.
            latest_ns = max(earliest_ns, min(latest_ns, accepted_ns + timing.after_taking_ns))
        if lowered_step.trajectory is not None and lowered_step.trajectory.is_chunk:
            latest_ns += timing.still_ns(lowered_step.trajectory)[0]
        span = move.started = HostInterval(earliest_ns, latest_ns, late_ns=self._options.excess_delay_ns(write))
        if move.stopped_ns is None and move.streamed_move is None:
            node.send_control(states.ENABLE)
        return dict.fromkeys(names, span)

    async def _wait_for_sync(self, move: DriveStep) -> WriteResult:
        """Return the write of the SYNC, once it has happened in time."""
        write = await asyncio.shield(move.sync_start.fired)
        self._node.loaded = False
        if write is None or (move.stopped_ns is not None and move.stopped_ns < write.written_ns):
            raise ControllerFault("not-started", "the timed write was cancelled", "")
        if write.late:
            self.cancel_start(move)
            raise missed_write_fault("the SYNC", self._node.bus.can_link.byte_link, write)
        return write

    def _accepted_ns(self, move: DriveStep, written_ns: int) -> int:
        """Return when the drive has confirmed its starting command, after the SYNC at `written_ns`; 0: it has not."""
        said_ns = self._node.acknowledged_ns if move.streamed_move is None else self._node.answer.at_ns
        return said_ns if said_ns > written_ns else 0

    async def _require_acceptance(self, move: DriveStep, written_ns: int, until_ns: int) -> None:
        """Raise `ControllerFault` unless the drive confirms its starting command until then, or is stopped."""
        node = self._node
        is_taken = await node.wait_until(
            lambda: is_interrupted(node, move) or bool(self._accepted_ns(move, written_ns)), until_ns
        )
        if not self._accepted_ns(move, written_ns) and move.stopped_ns is None:
            # The drive may be slow, and start with a later SYNC: stop it, so that it does not start unexpectedly.
            await node.wait_until(lambda: not self._power.is_stopping, until_ns)
            raise not_started_fault(node, move, said=is_taken)

    async def _require_motion(self, move: DriveStep) -> None:
        """Raise `ControllerFault` for a drive that does not move: on a limit a set-point is accepted all the same."""
        node, start_counts = self._node, move.lowered.start_counts
        gone_ns = node.clock.now_ns() + _FIRST_COUNT_NS
        await node.wait_until(lambda: is_interrupted(node, move) or node.demand != start_counts, gone_ns)
        if move.stopped_ns is None and failure_text(node, move) and node.demand == start_counts:
            raise not_started_fault(node, move, said=True)
