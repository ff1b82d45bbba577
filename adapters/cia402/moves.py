"""One step of a drive: its set-point, or the start of its stream, loaded and verified, held back for the SYNC of the
bus, and followed to its end."""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from math import ceil, floor

from adapters.cia402 import objects as o
from adapters.cia402 import states
from adapters.cia402.costs import full_frame_ns, sync_ns
from adapters.cia402.course import SetpointTrajectory
from adapters.cia402.handshake import settle_handshake, standing_refusal
from adapters.cia402.lowering import Cia402Lowered, SyncOutput
from adapters.cia402.node import BusDrive
from adapters.cia402.objects import DictionaryObject
from adapters.cia402.options import Cia402Options
from adapters.cia402.power import PowerStage
from adapters.cia402.sdo import SdoAborted, bus_off_fault
from adapters.cia402.starts import SyncScheduler, SyncStart
from adapters.cia402.states import DriveState
from adapters.cia402.stream import COPIES, TAIL_SYNCS, StreamedMove
from adapters.cia402.switching import NOTHING_SWITCHED
from adapters.cia402.triggers import find_edge_times
from adapters.contract import ChunkFit, HostInterval, MoveOutcome, PathChunk, SwitchedOutput
from adapters.toolkit.firing import missed_write_fault
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, ClockTimer
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal

_FIRST_COUNT_NS = 50 * NS_PER_MS  # from a start to the first reported count of its motion
_OVERDUE_NS = NS_PER_S  # a motion that ends later than this is blocked, or has never begun
_LONGEST_PATH_NS = 86_400 * NS_PER_S  # for which a path in chunks keeps the SYNC of its bus
_MODES = {
    o.PROFILE_POSITION_MODE: "profile position",
    o.INTERPOLATED_MODE: "interpolated position",
    o.CYCLIC_MODE: "cyclic synchronous position",
}
_SHORTEST_SYNC = 2  # ratio of the bits of its longest form to its shortest one, at the most


@dataclass(slots=True, eq=False)
class DriveStep:
    """A loaded step.

    boots, left: how often the drive had started, and this computer had left the bus.
    streamed_move: its part in a stream. end_s: of a path, where the released chunk begins to brake; next_chunk: the one
    that is loaded behind it."""

    lowered: Cia402Lowered
    t0_ns: int
    sync_start: SyncStart
    boots: int
    left: int
    outputs: int
    streamed_move: StreamedMove | None = None
    released: bool = False
    followed: bool = False
    started: HostInterval | None = None
    stopped_ns: int | None = None
    release: ClockTimer | None = None
    end_s: float = 0.0
    next_chunk: PathChunk | None = None

    @property
    def driven(self) -> SyncOutput | None:
        """The trigger line that it drives, unless that is switched with the positions of a stream."""
        return None if self.lowered.switched.points else self.lowered.drive

    @property
    def waits_for_sync(self) -> bool:
        """Whether it was released and its SYNC has not come yet."""
        return self.released and not self.sync_start.fired.done()


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
        self._options = options
        self._node = node
        self._sync_scheduler = sync_scheduler
        self._power = power
        self._settle_ns = limits.settle_ns
        self._ramp = limits.ramp
        self.move: DriveStep | None = None
        self._switched: StreamedMove | None = None
        """The last stream, for what its outputs did."""
        self.switching = NOTHING_SWITCHED
        """What a stream has switched, until it is certain that it is passive again."""
        self.busy: Callable[[], bool] = lambda: False
        """Whether another motion of the axis is in progress."""

    # Before the start

    async def load_move(self, lowered: Cia402Lowered, t0_ns: int) -> Mapping[str, int]:
        """Load the step. Raises `Refusal`; then nothing is loaded."""
        node = self._node
        if self.move is not None or self.busy():
            raise Refusal("busy", "a motion is loaded or in progress", "disarm or stop it")
        # The last SYNC of a stream comes a period after its end, and may be late.
        course_ns = (
            0 if lowered.trajectory is None else (lowered.position_count + TAIL_SYNCS) * lowered.trajectory.period_ns
        )
        if lowered.chunk is not None and not lowered.chunk.last:
            course_ns = _LONGEST_PATH_NS
        self._switched = None
        shot = self._sync_scheduler.reserve_start(node.number, t0_ns, t0_ns + course_ns)
        move = self.move = DriveStep(
            lowered=lowered, t0_ns=t0_ns, sync_start=shot, boots=node.boots, left=node.left_bus, outputs=node.outputs
        )
        move.end_s = 0.0 if lowered.chunk is None else lowered.chunk.end_s
        try:
            return await self._load_step(move)
        except BaseException:
            self._sync_scheduler.remove_drive(node.number, shot)
            if self.move is move:
                self.move = None
            raise

    async def _load_step(self, move: DriveStep) -> Mapping[str, int]:
        node, lowered_step = self._node, move.lowered
        await self._power.wait_for_stops()
        began_ns, stops = node.clock.now_ns(), node.stops
        if lowered_step.drive is not None and node.outputs != lowered_step.drive.outputs_with(
            node.outputs, active=False
        ):
            raise Refusal(
                "line-level",
                f"output {lowered_step.drive.name} is already active",
                "make the trigger line passive; see `active` in the fleet file",
            )
        self._require_outputs(lowered_step)
        node.require_operational()
        if lowered_step.target is None:
            return {"wire": 0}
        self._require_start(move)
        loaded_values = await (
            self._load_set_point(lowered_step) if lowered_step.trajectory is None else self._load_stream(lowered_step)
        )
        loaded_ns = node.clock.now_ns()
        for obj, value in loaded_values.items():
            held_value = await node.sdo.read_value(obj)
            if held_value != value:
                raise Refusal(
                    "load-garbled",
                    f"{node.name} contains {held_value} in {obj}, and was given {value}",
                    "arm it again; is another master on the bus?",
                )
        if node.stops != stops:
            raise Refusal("stopped", "a stop came while arming", "")
        self._require_start(move)
        return {"wire": loaded_ns - began_ns, "verify": node.clock.now_ns() - loaded_ns}

    def _require_outputs(self, lowered: Cia402Lowered) -> None:
        """Raise `Refusal` for an output that is active already, or that the drive does not switch."""
        node = self._node
        active = lowered.switched.find_active(node.outputs)
        if active is not None:
            text = f"output {active.name} is already active"
            raise Refusal("line-level", text, "make it passive before the step; see `active` in the fleet file")
        mask = node.held.get(o.OUTPUT_MASK)
        for point in lowered.switched.points:
            if mask is not None and not mask & point.bit:
                raise Refusal(
                    "trigger-output",
                    f"output {point.name}: {o.OUTPUT_MASK} is {mask:#010x}, so that {node.name} does not switch it",
                    f"set bit {point.bit.bit_length() - 1} of it with the drive's own tool, and store it",
                )

    async def _load_set_point(self, lowered: Cia402Lowered) -> Mapping[DictionaryObject, int]:
        """Load the set-point; return the expected object values."""
        node, shape, target = self._node, lowered.shape, lowered.target
        assert shape is not None and target is not None
        stops = node.stops
        node.send_control(states.ENABLE, o.PROFILE_POSITION_MODE)
        await self._require_mode(o.PROFILE_POSITION_MODE, lambda: True)
        await settle_handshake(node, stops)
        await node.load_set_point(target, shape.velocity, shape.acceleration, shape.deceleration)
        return {
            o.TARGET: target,
            o.PROFILE_VELOCITY: shape.velocity,
            o.ACCELERATION: shape.acceleration,
            o.DECELERATION: shape.deceleration,
        }

    async def _load_stream(self, lowered: Cia402Lowered) -> Mapping[DictionaryObject, int]:
        """Prepare the stream: the drive follows its present position until the first SYNC."""
        node, start_counts = self._node, lowered.start_counts
        assert node.followed is not None
        node.give_position(start_counts)
        await node.sdo.write_value(o.DECELERATION, self._ramp)
        await node.sdo.write_value(node.followed, start_counts)
        node.send_control(states.ENABLE, lowered.mode)
        # Bit 12 that stands from another mode would be taken for the answer to bit 4.
        await self._require_mode(
            lowered.mode, lambda: lowered.mode != o.INTERPOLATED_MODE or not node.status & states.FOLLOWS
        )
        if lowered.mode == o.INTERPOLATED_MODE:
            node.send_control(states.ENABLE | states.FOLLOW)
            if not await node.wait_briefly(lambda: bool(node.status & states.FOLLOWS)):
                await node.query_status()
                raise Refusal("wrong-mode", f"{node.name} does not begin to interpolate", "see its manual")
        return {node.followed: start_counts, o.DECELERATION: self._ramp}

    async def _require_mode(self, mode: int, ready: Callable[[], bool]) -> None:
        """Raise `Refusal` (wrong-mode) unless the drive enters `mode`."""
        node = self._node
        is_ready = await node.wait_briefly(lambda: (node.mode == mode and ready()) or not node.is_enabled)
        if not is_ready or not node.is_enabled:
            await node.query_status()
            raise Refusal(
                "wrong-mode",
                f"{node.name} does not enter {_MODES[mode]} mode; it shows mode {node.mode} and is {node.state.value}",
                "does it support this mode (6502h)? Is another master on the bus?",
            )

    async def verify_move(self) -> None:
        """Check that the step is still loaded and the axis is where the plan starts. Raises `Refusal`."""
        move, node = self._require_step(), self._node
        await node.query_status()
        node.require_operational()
        if node.boots != move.boots:
            raise Refusal("not-loaded", f"{node.name} was switched off and on", "arm it again")
        if move.left != node.left_bus:
            raise Refusal("bus-off", f"{node.name} was unreachable meanwhile", "arm it again")
        if move.lowered.target is not None:
            self._require_start(move)
            if node.mode != move.lowered.mode:
                raise Refusal("not-loaded", f"{node.name} shows mode {node.mode} of operation", "arm it again")
            if move.lowered.trajectory is None and node.status & states.ACKNOWLEDGED:
                raise standing_refusal(node)

    async def schedule_start(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Send the starting command, which waits in the drive for the SYNC, and schedule the SYNC so that the motion is
        at T0, or up to `start_tolerance_ns` later than guaranteed: but no later before a stream, whose further SYNCs
        have fixed instants.

        advance_ns: ignored. A SYNC may start several drives, and only all of them together: its T0 cannot be advanced.
        """
        del advance_ns
        move, node = self._require_step(), self._node
        lowered_step = move.lowered
        if lowered_step.target is None and lowered_step.drive is None:
            return
        at_ns = move.t0_ns - lowered_step.lead_ns
        # The waiting command must arrive in the drive before the SYNC.
        if node.clock.now_ns() + NS_PER_MS >= at_ns:
            raise Refusal("late", "the instant to write the SYNC has passed", "increase the lead time")
        control = node.control if lowered_step.shape is None else states.ENABLE | states.NEW_SET_POINT
        course = lowered_step.trajectory
        outputs = node.outputs
        if move.driven is not None:
            outputs = move.driven.outputs_with(outputs, active=True)
            self._power.set_driving(driving=True, passive=move.driven.outputs_with(outputs, active=False))
        move.released = node.loaded = True
        frames = [node.control_at_sync(control, outputs)]
        if course is not None:
            ride = move.streamed_move = self._switched = StreamedMove(
                node, course, lowered_step.switched, lambda: self._handle_stream_failure(move)
            )
            self.switching = lowered_step.switched
            self._sync_scheduler.join_stream(node.number, move.sync_start, ride, at_ns, course.period_ns)
            frames += [ride.position_frame(0)] * COPIES
        elif node.switches_with_positions or (node.followed == o.TARGET and lowered_step.target is not None):
            # The SYNC also applies a waiting position: it must not be an older one.
            if node.followed == o.TARGET and lowered_step.target is not None:
                node.given = lowered_step.target
            frames.append(node.position_frame(node.given, outputs))
        latest_ns = self._options.latest_write_ns(at_ns, start_tolerance_ns if move.sync_start.stream is None else 0)
        self._sync_scheduler.load_frames(node.number, move.sync_start, frames, at_ns, latest_ns)

    async def unload_move(self) -> None:
        """Cancel the command that waits in the drive, and the SYNC unless other drives need it: nothing starts
        afterwards."""
        move, self.move = self.move, None
        if move is not None:
            self._cancel_start(move)
        await self._power.wait_for_stops()

    def _cancel_start(self, move: DriveStep) -> None:
        node = self._node
        waits = self._sync_scheduler.remove_drive(node.number, move.sync_start)
        self._make_passive(move)
        if waits:
            # Every SYNC applies the drive's last command; until then each command overwrites the waiting one.
            mode = o.PROFILE_POSITION_MODE if move.lowered.trajectory is not None and move.stopped_ns is None else None
            node.send_control(node.control & ~states.NEW_SET_POINT, mode)
            node.loaded = not self._sync_scheduler.apply_waiting()
        else:
            node.loaded = False

    def _make_passive(self, move: DriveStep) -> None:
        """Make the driven output passive, now and when its time is over."""
        if move.release is not None:
            move.release.cancel()
            move.release = None
        drive, node = move.driven, self._node
        if drive is not None:
            self._power.set_driving(driving=False, passive=0)
            node.outputs = drive.outputs_with(node.outputs, active=False)
            if move.released and node.mapped:
                node.send_control(node.control & ~states.NEW_SET_POINT)

    def record_stop(self, at_ns: int) -> None:
        """Record a stop that was written at that instant."""
        move = self.move
        if move is None:
            return
        move.stopped_ns = at_ns
        is_unwritten = not move.sync_start.fired.done()
        self._cancel_start(move)
        if is_unwritten or not move.followed:
            self.move = None
        self._node.wake_waiting()

    def _handle_stream_failure(self, move: DriveStep) -> None:
        """Handle a stream that cannot continue: the drive brakes."""
        with suppress(LinkClosed):
            if move.stopped_ns is None and self.move is move:
                self._power.write_stop(abort=False)
            self._sync_scheduler.remove_drive(self._node.number, move.sync_start)
            self._sync_scheduler.apply_waiting()

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
            await self._end_switching(move)

    def cancel_waits(self) -> None:
        """Cancel everything that waits for an instant: the connection ends."""
        move, self.move = self.move, None
        if move is not None:
            self._sync_scheduler.remove_drive(self._node.number, move.sync_start)
            if move.release is not None:
                move.release.cancel()

    # A path in chunks

    async def load_chunk(self, chunk: PathChunk) -> ChunkFit:
        """Take the next chunk of the present path. This computer times every position: no clock drifts. Raises
        `Refusal`."""
        move, lowered_step = self._require_path()
        trajectory = self._make_trajectory(lowered_step, chunk)
        move.next_chunk = chunk
        return ChunkFit(trajectory.duration_s, 0, 0, 0, {lowered_step.axis: trajectory.path_error_counts})

    async def release_chunk(self, number: int) -> None:
        """Take positions from the loaded chunk, from the next one that is not sent yet. Raises `Refusal`."""
        move, lowered_step = self._require_path()
        chunk, streamed_move = move.next_chunk, move.streamed_move
        if chunk is None or chunk.number != number or streamed_move is None:
            raise Refusal("not-loaded", f"chunk {number} of the path is not loaded", "load it first")
        move.next_chunk = None
        trajectory = self._make_trajectory(lowered_step, chunk)
        period_s = trajectory.period_ns / NS_PER_S
        # Position n is that of the plan n + 1 periods after the start.
        first = max(streamed_move.next_number, ceil(chunk.begin_s / period_s - 1e-6) - 1)
        if first * period_s > min(move.end_s, chunk.end_s) or streamed_move.is_done:
            raise Refusal("late", "the positions up to the place where the path was to be continued are sent", "")
        streamed_move.continue_with(trajectory, first)
        move.end_s = chunk.end_s
        profile = trajectory.profile
        durations_s = {lowered_step.axis: trajectory.duration_s}
        move.lowered = replace(lowered_step, durations_s=durations_s, target=profile.end_counts, trajectory=trajectory)

    def _make_trajectory(self, lowered: Cia402Lowered, chunk: PathChunk) -> SetpointTrajectory:
        assert lowered.trajectory is not None
        return SetpointTrajectory(
            chunk.profiles[lowered.axis], lowered.trajectory.period_ns, chunk.begin_s, is_chunk=True
        )

    def _require_path(self) -> tuple[DriveStep, Cia402Lowered]:
        move = self._require_step()
        if move.lowered.chunk is None or move.lowered.trajectory is None:
            raise Refusal("not-a-path", "the drive executes no path that can be continued", "")
        return move, move.lowered

    # After the start

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axis started; raise `ControllerFault` when it did not."""
        move, node = self._require_step(), self._node
        move.followed = True
        lowered_step = move.lowered
        names = list(lowered_step.durations_s)
        if lowered_step.target is None and lowered_step.drive is None:
            return {name: HostInterval(move.t0_ns, move.t0_ns) for name in names}
        write = await asyncio.shield(move.sync_start.fired)
        node.loaded = False
        if write is None or (move.stopped_ns is not None and move.stopped_ns < write.written_ns):
            raise ControllerFault("not-started", "the timed write was cancelled", "")
        if write.late:
            self._cancel_start(move)
            raise missed_write_fault("the SYNC", node.bus.can_link.byte_link, write)
        if move.driven is not None:
            self._keep_output_active(move)
        if lowered_step.target is None:
            return {name: HostInterval(move.t0_ns, move.t0_ns) for name in names}
        earliest_ns, latest_ns = self._guaranteed_start(write.written_ns)

        def accepted_ns() -> int:
            """Return when it has confirmed its starting command; 0: it has not."""
            said_ns = node.acknowledged_ns if move.streamed_move is None else node.answer.at_ns
            return said_ns if said_ns > write.written_ns else 0

        is_taken = await node.wait_until(
            lambda: self._interrupted_now(move) or bool(accepted_ns()), latest_ns + node.answer_ns
        )
        if not accepted_ns() and move.stopped_ns is None:
            # The drive may be slow, and start with a later SYNC: stop it, so that it does not start unexpectedly.
            await node.wait_until(lambda: not self._power.is_stopping, latest_ns + node.answer_ns)
            raise self._not_started_fault(move, said=is_taken)
        # On a limit a set-point is accepted, and nothing moves.
        gone_ns = node.clock.now_ns() + _FIRST_COUNT_NS
        await node.wait_until(lambda: self._interrupted_now(move) or node.demand != lowered_step.start_counts, gone_ns)
        if move.stopped_ns is None and self._failure_text(move) and node.demand == lowered_step.start_counts:
            raise self._not_started_fault(move, said=True)
        if accepted_ns():
            # It has not reported motion yet.
            latest_ns = max(earliest_ns, min(latest_ns, accepted_ns() + self._after_taking_ns))
        if lowered_step.trajectory is not None and lowered_step.trajectory.is_chunk:
            latest_ns += self._still_ns(lowered_step.trajectory)[0]
        span = move.started = HostInterval(earliest_ns, latest_ns, late_ns=self._options.excess_delay_ns(write))
        if move.stopped_ns is None and move.streamed_move is None:
            node.send_control(states.ENABLE)
        return dict.fromkeys(names, span)

    @property
    def _after_taking_ns(self) -> int:
        """Return the longest time from accepting a set-point to the motion."""
        options = self._options
        return (options.cycle_us + options.start_us + options.start_spread_us) * NS_PER_US

    def _guaranteed_start(self, written_ns: int) -> tuple[int, int]:
        """Return the guaranteed interval of the start after the SYNC was written at `written_ns`."""
        options, bitrate = self._options, self._node.bus.bitrate
        least_us = max(0, options.start_us - options.start_spread_us)
        earliest_ns = written_ns + sync_ns(bitrate) // _SHORTEST_SYNC + least_us * NS_PER_US
        wire_ns = options.wire_jitter_us * NS_PER_US + full_frame_ns(bitrate) + sync_ns(bitrate)
        return earliest_ns, written_ns + wire_ns + self._after_taking_ns

    def _not_started_fault(self, move: DriveStep, *, said: bool) -> ControllerFault:
        node = self._node
        if node.bus.is_off or move.left != node.left_bus:
            return bus_off_fault(node.name)
        reason = (
            "has not accepted its set-point with the SYNC" if not said else self._failure_text(move) or "does not move"
        )
        return ControllerFault(
            "not-started",
            f"{node.name} {reason}; it is {node.state.value}" + (f": {node.fault_text()}" if node.emergencies else ""),
            "check the cable and both terminations; is another master on the bus?",
        )

    async def wait_for_end(self) -> MoveOutcome:
        """Wait until the drive reports its target as reached, or will not reach it."""
        move, node, lowered_step = self._require_step(), self._node, self._require_step().lowered
        at_t0 = {name: HostInterval(move.t0_ns, move.t0_ns) for name in lowered_step.durations_s}
        if lowered_step.target is None or move.started is None:
            await self._wait_until_passive(move)
            self._finish_step(move)
            return (
                MoveOutcome("done", at_t0)
                if move.stopped_ns is None
                else MoveOutcome("stopped", at_t0, "stopped on request")
            )
        earliest_ns, latest_ns = self._end_interval(move, move.started)
        while True:
            if move.streamed_move is None:
                await node.wait_until(lambda: self._interrupted_now(move), earliest_ns)
            overdue_ns = latest_ns + self._settle_ns + _OVERDUE_NS + self._standing_ns(lowered_step)
            is_over = await node.wait_until(
                lambda since_ns=earliest_ns: self._has_arrived(move, since_ns) or self._interrupted_now(move),
                overdue_ns,
            )
            expected_span = self._end_interval(move, move.started)
            if is_over or expected_span == (earliest_ns, latest_ns):
                break
            earliest_ns, latest_ns = expected_span  # the path was continued meanwhile
        lowered_step = move.lowered
        if move.stopped_ns is None and not self._interrupted_now(move) and is_over:
            await self._wait_until_passive(move)
        trouble = self._failure_text(move)
        is_stopped = move.stopped_ns is not None
        is_done = is_over and not is_stopped and not trouble
        if not is_done:
            await self._end_switching(move)
        if is_stopped:
            await self._power.wait_for_stops()
        self._finish_step(move)
        now_ns = node.clock.now_ns()
        if is_done:
            self.switching = NOTHING_SWITCHED
            if move.streamed_move is not None and lowered_step.trajectory is not None:
                earliest_ns, latest_ns = self._stream_end_interval(move.streamed_move, lowered_step.trajectory)
                await self._leave_stream()
            return MoveOutcome("done", {lowered_step.axis: HostInterval(min(earliest_ns, latest_ns), latest_ns)})
        spans = {lowered_step.axis: HostInterval(min(move.started.earliest_ns, now_ns), now_ns)}
        stands = f"axis {lowered_step.axis} is at {node.actual}, its target is {lowered_step.target}"
        if is_stopped:
            return MoveOutcome("stopped", spans, f"stopped on request; {stands}")
        return MoveOutcome("fault", spans, f"{node.name} {trouble or 'does not come to its end'}; {stands}")

    def _has_arrived(self, move: DriveStep, earliest_ns: int) -> bool:
        node = self._node
        if move.streamed_move is not None:
            return move.streamed_move.has_arrived
        return (
            node.clock.now_ns() >= earliest_ns
            and bool(node.status & states.TARGET_REACHED)
            and node.demand == move.lowered.target
        )

    def _end_interval(self, move: DriveStep, started: HostInterval) -> tuple[int, int]:
        """Return when the step ends, as far as it is released."""
        lowered_step = move.lowered
        seconds, between_ns = lowered_step.durations_s[lowered_step.axis], self._between_ns(lowered_step)
        return (
            started.earliest_ns + self._device_ns(seconds, -1) - between_ns,
            started.latest_ns + self._device_ns(seconds, 1) + between_ns,
        )

    def _between_ns(self, lowered: Cia402Lowered) -> int:
        """Return the tolerance of the duration: a drive that was stopped may stand between two counts, and reports the
        nearer one, so that its path is up to half a count longer or shorter than planned."""
        if lowered.shape is None:
            return 0
        counts_s = lowered.shape.velocity / float(self._options.velocity_units)
        return ceil(0.5 / counts_s * NS_PER_S)

    def _still_ns(self, trajectory: SetpointTrajectory) -> tuple[int, int]:
        """Return how long an axis stands before its first count, and after its last one, by the slowest crystal."""
        periods_before_ns, periods_after_ns = (
            periods * trajectory.period_ns / NS_PER_S for periods in trajectory.still_periods
        )
        return self._device_ns(periods_before_ns, 1), self._device_ns(periods_after_ns, 1)

    def _standing_ns(self, lowered: Cia402Lowered) -> int:
        """Return how long a stream continues at rest, for outputs that are switched after its end."""
        course = lowered.trajectory
        return 0 if course is None else (lowered.position_count - course.point_count) * course.period_ns

    def _stream_end_interval(self, ride: StreamedMove, trajectory: SetpointTrajectory) -> tuple[int, int]:
        """Return the interval of the end: a period after its last SYNC took effect; on a path it may have been there
        before."""
        earliest_ns, latest_ns = self._guaranteed_start(ride.last_written_ns)
        if ride.last_answer_ns:
            latest_ns = max(earliest_ns, min(latest_ns, ride.last_answer_ns + self._after_taking_ns))
        period_s = trajectory.period_ns / NS_PER_S
        if trajectory.is_chunk:
            earliest_ns -= self._still_ns(trajectory)[1]
        return earliest_ns + self._device_ns(period_s, -1), latest_ns + self._device_ns(period_s, 1)

    async def _leave_stream(self) -> None:
        """Leave the stream: a drive that follows positions needs SYNC; in profile position mode it stays at rest
        without."""
        node = self._node
        node.send_control(states.ENABLE, o.PROFILE_POSITION_MODE)
        await node.wait_briefly(lambda: node.mode == o.PROFILE_POSITION_MODE)

    def _interrupted_now(self, move: DriveStep) -> bool:
        return move.stopped_ns is not None or bool(self._failure_text(move))

    def _failure_text(self, move: DriveStep) -> str:
        """Return what has happened to the drive since it was armed; empty: nothing."""
        node = self._node
        if node.boots != move.boots:
            return "was switched off and on"
        if node.bus.is_off or node.left_bus != move.left:
            return "was unreachable: this computer has left the bus (bus-off)"
        if node.state in (DriveState.FAULT, DriveState.REACTION):
            return f"has a fault: {node.fault_text()}"
        if move.streamed_move is not None and move.streamed_move.failure:
            return move.streamed_move.failure
        if move.lowered.target is not None and not node.is_enabled:
            return f"is {node.state.value}: was it switched off by its enable input, or stopped by another master?"
        if move.lowered.target is not None and node.status & states.INTERNAL_LIMIT:
            return "was stopped by its own limit (switch or software limit)"
        return ""

    # Outputs that are switched on the way

    async def _end_switching(self, move: DriveStep) -> None:
        """Make the outputs passive that a stream switches: by SDO, because the drive may not have been stopped, and be
        in another state than is known, in which a controlword could enable it."""
        node = self._node
        if not move.lowered.switched.points:
            return
        self._sync_scheduler.remove_drive(node.number, move.sync_start)
        with suppress(ControllerFault, SdoAborted):
            node.give_position(node.given)
            await node.sdo.write_value(o.OUTPUTS, node.outputs)
            self.switching = NOTHING_SWITCHED

    def take_edges(self) -> dict[str, SwitchedOutput]:
        """Return what the outputs with triggers did in the last step."""
        times = find_edge_times(self._options, self._node.bus.bitrate)
        return {} if self._switched is None else self._switched.edges.find_edges(times)

    # The driven trigger line

    def _keep_output_active(self, move: DriveStep) -> None:
        drive, node = move.driven, self._node
        assert drive is not None
        node.outputs = drive.outputs_with(node.outputs, active=True)

        def end_active_time() -> None:
            if self.move is move:
                with suppress(LinkClosed):
                    self._make_passive(move)
                node.wake_waiting()

        move.release = node.clock.call_at_ns(move.t0_ns + move.lowered.window_ns[1] + drive.active_ns, end_active_time)

    async def _wait_until_passive(self, move: DriveStep) -> None:
        """Wait until the driven trigger line is passive again."""
        if move.release is not None:
            await self._node.wait_until(
                lambda: move.release is None or self._interrupted_now(move), self._node.clock.now_ns() + 2**62
            )

    # Internals

    def _finish_step(self, move: DriveStep) -> None:
        self._make_passive(move)
        self._sync_scheduler.remove_drive(self._node.number, move.sync_start)
        if self.move is move:
            self.move = None

    def _require_step(self) -> DriveStep:
        if self.move is None:
            raise Refusal("not-armed", "no step is loaded", "arm it first")
        return self.move

    def _require_start(self, move: DriveStep) -> None:
        node, lowered_step = self._node, move.lowered
        if not node.is_enabled:
            raise Refusal(
                "not-enabled", f"axis {lowered_step.axis} is not enabled", f"enable {lowered_step.axis} first"
            )
        if node.demand != lowered_step.start_counts:
            raise Refusal(
                "other-start",
                f"axis {lowered_step.axis} is at {node.demand} counts; the plan starts at {lowered_step.start_counts}",
                "plan again from the present position",
            )

    def _device_ns(self, seconds: float, sign: int) -> int:
        """Return a duration by the slowest (1) or fastest (-1) crystal."""
        exact = seconds * NS_PER_S * (1 + sign * self._options.clock_ppm * 1e-6)
        return ceil(exact) if sign > 0 else floor(exact)
