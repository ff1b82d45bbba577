"""One step of a drive: its set-point, or the start of its stream, loaded and verified, held back for the SYNC of the
bus, and followed to its end."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from adapters.cia402 import path
from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen import states
from adapters.cia402.canopen.modes import wait_for_mode
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.interruption import failure_text, is_interrupted
from adapters.cia402.loading import StepLoader
from adapters.cia402.lowering import Cia402Lowered
from adapters.cia402.options import Cia402Options
from adapters.cia402.power import PowerStage
from adapters.cia402.shapes.switching import NOTHING_SWITCHED
from adapters.cia402.starting import DriveStarter
from adapters.cia402.step import DriveStep
from adapters.cia402.stream_outputs import StreamOutputs
from adapters.cia402.sync.starts import SyncScheduler
from adapters.cia402.sync.stream import TAIL_SYNCS
from adapters.cia402.timing import DriveTiming, standing_ns
from adapters.contract import ChunkFit, HostInterval, MoveOutcome, PathChunk
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.profile import Profile

_OVERDUE_NS = NS_PER_S  # a motion that ends later than this is blocked, or has never begun
_LONGEST_PATH_NS = 86_400 * NS_PER_S  # for which a path in chunks keeps the SYNC of its bus


@dataclass(frozen=True, slots=True)
class EndLimits:
    """How a step may end. settle_ns: how long the axis may move after its planned end. ramp: the deceleration of a
    drive that follows a stream (6084h)."""

    settle_ns: int
    ramp: int


class Cia402Mover:
    """Arm, start and follow the steps of one connection."""

    def __init__(
        self,
        options: Cia402Options,
        sync_scheduler: SyncScheduler,
        node: BusDrive,
        power: PowerStage,
        limits: EndLimits,
    ) -> None:
        self._node = node
        self._sync_scheduler = sync_scheduler
        self._power = power
        self._settle_ns = limits.settle_ns
        self._loader = StepLoader(node, power, limits.ramp)
        self._timing = DriveTiming(options, node.bus.bitrate)
        self._starter = DriveStarter(options, sync_scheduler, node, power)
        self._line = self._starter.line
        self._stream_outputs = self._starter.stream_outputs
        self.move: DriveStep | None = None
        self.busy: Callable[[], bool] = lambda: False
        """Whether another motion of the axis is in progress."""

    @property
    def is_operating(self) -> bool:
        """Whether a motion of this adapter is under way."""
        return (self.move is not None and self.move.started is not None) or self.busy()

    # Before the start

    async def load_move(self, lowered: Cia402Lowered, t0_ns: int) -> Mapping[str, int]:
        """Load the step. Raises `Refusal`; then nothing is loaded."""
        return await self._load(lowered, t0_ns, behind=False)

    async def load_behind(self, lowered: Cia402Lowered, t0_ns: int, *, at_once: bool) -> Mapping[str, int]:
        """The same right behind a step that has just ended. Raises `Refusal`."""
        del at_once  # loading checks where it stands in any case
        return await self._load(lowered, t0_ns, behind=True)

    async def _load(self, lowered: Cia402Lowered, t0_ns: int, *, behind: bool) -> Mapping[str, int]:
        node = self._node
        if self.move is not None or self.busy():
            raise Refusal("busy", "a motion is loaded or in progress", "disarm or stop it")
        # The last SYNC of a stream comes a period after its end, and may be late.
        course_ns = (
            0 if lowered.trajectory is None else (lowered.position_count + TAIL_SYNCS) * lowered.trajectory.period_ns
        )
        if lowered.chunk is not None and not lowered.chunk.last:
            course_ns = _LONGEST_PATH_NS
        self._stream_outputs.forget()
        shot = self._sync_scheduler.reserve_start(node.number, t0_ns, t0_ns + course_ns)
        move = self.move = DriveStep(
            lowered=lowered, t0_ns=t0_ns, sync_start=shot, boots=node.boots, left=node.left_bus, outputs=node.outputs
        )
        move.end_s = 0.0 if lowered.chunk is None else lowered.chunk.end_s
        try:
            return await self._loader.load_step(move.lowered, behind=behind)
        except BaseException:
            self._sync_scheduler.remove_drive(node.number, shot)
            self._drop_step(move)
            raise

    async def verify_move(self) -> None:
        """Check that the step is still loaded and the axis is where the plan starts. Raises `Refusal`."""
        await self._loader.verify_step(self._require_step())

    async def schedule_start(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Send the starting command and schedule its SYNC. Raises `Refusal`.

        advance_ns: of a step that no other drive takes part in: a SYNC of its own is reserved for the earlier T0. A
        SYNC of several drives is not advanced, because it starts all of them together.
        """
        move = self._require_step()
        if advance_ns:
            move.t0_ns -= advance_ns
            self._sync_scheduler.remove_drive(self._node.number, move.sync_start)
            move.sync_start = self._sync_scheduler.reserve_start(self._node.number, move.t0_ns, move.t0_ns)
        self._starter.schedule_start(move, start_tolerance_ns)

    async def unload_move(self) -> None:
        """Cancel the command that waits in the drive, and the SYNC unless other drives need it: nothing starts
        afterwards."""
        move = self.move
        if move is not None:
            self._drop_step(move)
            self._starter.cancel_start(move)
        await self._power.wait_for_stops()

    def record_stop(self, at_ns: int) -> None:
        """Record a stop that was written at that instant."""
        move = self.move
        if move is None:
            return
        move.stopped_ns = at_ns
        is_unwritten = not move.sync_start.fired.done()
        self._starter.cancel_start(move)
        if is_unwritten or not move.followed:
            self._drop_step(move)
        self._node.wake_waiting()

    async def halt_drive(self) -> None:
        """Halt a drive whose stream is not continued, and wait for its confirmation. Raises `ControllerFault`,
        `LinkClosed`."""
        move = self.move
        if (
            move is not None
            and move.streamed_move is not None
            and not move.streamed_move.is_done
            and move.sync_start.fired.done()
        ):
            await self._node.sdo.write_value(o.CONTROLWORD, states.ENABLE | states.HALT)
            await self._stream_outputs.make_passive(move)

    def cancel_waits(self) -> None:
        """Cancel everything that waits for an instant: the connection ends."""
        move = self.move
        if move is not None:
            self._drop_step(move)
            self._sync_scheduler.remove_drive(self._node.number, move.sync_start)
            if move.release is not None:
                move.release.cancel()

    # Streams that are continued

    async def load_chunk(self, chunk: PathChunk) -> ChunkFit:
        """Take the next chunk of the present path. Raises `Refusal`."""
        return path.load_chunk(self._require_step(), chunk)

    async def release_chunk(self, number: int) -> None:
        """Change over to the loaded chunk. Raises `Refusal`."""
        self._stream_outputs.switching = path.release_chunk(self._require_step(), number)

    async def retarget(self, profile: Profile, from_s: float) -> float:
        """Continue by another profile behind `from_s`; return how long it takes, s. Raises `Refusal`."""
        return path.change_course(self._require_step(), self._sync_scheduler, profile, from_s)

    # Outputs that are switched on the way

    @property
    def outputs(self) -> StreamOutputs:
        """What its streams do to outputs, and did."""
        return self._stream_outputs

    # After the start

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axis started; raise `ControllerFault` when it did not."""
        move = self._require_step()
        move.followed = True
        return await self._starter.wait_for_start(move)

    async def wait_for_end(self) -> MoveOutcome:
        """Wait until the drive reports its target as reached, or will not reach it."""
        move, node = self._require_step(), self._node
        if move.lowered.target is None or move.started is None:
            return await self._end_without_motion(move)
        is_over, end_span = await self._wait_until_over(move, move.started)
        if move.stopped_ns is None and not is_interrupted(node, move) and is_over:
            await self._line.wait_until_passive(move)
        trouble, lowered_step = failure_text(node, move), move.lowered
        if is_over and move.stopped_ns is None and not trouble:
            self._finish_step(move)
            self._stream_outputs.switching = NOTHING_SWITCHED
            earliest_ns, latest_ns = await self._complete_stream(move, end_span)
            return MoveOutcome("done", {lowered_step.axis: HostInterval(min(earliest_ns, latest_ns), latest_ns)})
        is_stopped = move.stopped_ns is not None
        await self._stream_outputs.make_passive(move)
        if is_stopped:
            await self._power.wait_for_stops()
        self._finish_step(move)
        now_ns = node.clock.now_ns()
        spans = {lowered_step.axis: HostInterval(min(move.started.earliest_ns, now_ns), now_ns)}
        stands = f"axis {lowered_step.axis} is at {node.actual}, its target is {lowered_step.target}"
        if is_stopped:
            return MoveOutcome("stopped", spans, f"stopped on request; {stands}")
        return MoveOutcome("fault", spans, f"{node.name} {trouble or 'does not come to its end'}; {stands}")

    async def _end_without_motion(self, move: DriveStep) -> MoveOutcome:
        at_t0 = {name: HostInterval(move.t0_ns, move.t0_ns) for name in move.lowered.durations_s}
        await self._line.wait_until_passive(move)
        self._finish_step(move)
        if move.stopped_ns is None:
            return MoveOutcome("done", at_t0)
        return MoveOutcome("stopped", at_t0, "stopped on request")

    async def _wait_until_over(self, move: DriveStep, started: HostInterval) -> tuple[bool, tuple[int, int]]:
        """Wait until the drive has arrived, is interrupted, or is overdue; return whether it is not overdue, and when
        the step ends as planned."""
        node, lowered_step = self._node, move.lowered
        earliest_ns, latest_ns = self._timing.end_interval(lowered_step, started)
        while True:
            if move.streamed_move is None:
                await node.wait_until(lambda: is_interrupted(node, move), earliest_ns)
            overdue_ns = latest_ns + self._settle_ns + _OVERDUE_NS + standing_ns(lowered_step)
            is_over = await node.wait_until(
                lambda since_ns=earliest_ns: self._has_arrived(move, since_ns) or is_interrupted(node, move),
                overdue_ns,
            )
            expected_span = self._timing.end_interval(move.lowered, started)
            if is_over or expected_span == (earliest_ns, latest_ns):
                return is_over, (earliest_ns, latest_ns)
            earliest_ns, latest_ns = expected_span  # the path was continued meanwhile

    async def _complete_stream(self, move: DriveStep, end_span: tuple[int, int]) -> tuple[int, int]:
        """Return when the step has ended, by the SYNCs of its stream if it has one, which the drive leaves."""
        if move.streamed_move is None or move.lowered.trajectory is None:
            return end_span
        end_span = self._timing.stream_end_interval(move.streamed_move, move.lowered.trajectory)
        await self._leave_stream()
        return end_span

    def _has_arrived(self, move: DriveStep, earliest_ns: int) -> bool:
        node = self._node
        if move.streamed_move is not None:
            return move.streamed_move.has_arrived
        return (
            node.clock.now_ns() >= earliest_ns
            and bool(node.status & states.TARGET_REACHED)
            and node.demand == move.lowered.target
        )

    async def _leave_stream(self) -> None:
        """Leave the stream: a drive that follows positions needs SYNC; in profile position mode it stays at rest
        without."""
        node = self._node
        node.send_control(states.ENABLE, o.PROFILE_POSITION_MODE)
        await wait_for_mode(node, o.PROFILE_POSITION_MODE)

    # Internals

    def _finish_step(self, move: DriveStep) -> None:
        self._line.make_passive(move)
        self._sync_scheduler.remove_drive(self._node.number, move.sync_start)
        self._drop_step(move)

    def _drop_step(self, move: DriveStep) -> None:
        move.dropped = True
        if self.move is move:
            self.move = None

    def _require_step(self) -> DriveStep:
        if self.move is None:
            raise Refusal("not-armed", "no step is loaded", "arm it first")
        return self.move
