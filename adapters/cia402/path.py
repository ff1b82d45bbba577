"""Streams that are continued: by the chunk of a path behind the present one, or to another target."""

from dataclasses import replace
from math import ceil

from adapters.cia402.lowering import Cia402Lowered
from adapters.cia402.shapes.course import SetpointTrajectory
from adapters.cia402.shapes.switching import OutputSchedule
from adapters.cia402.step import DriveStep
from adapters.cia402.sync.starts import SyncScheduler
from adapters.cia402.sync.stream import TAIL_SYNCS
from adapters.cia402.triggers import continue_triggers
from adapters.contract import ChunkFit, PathChunk
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.profile import Profile


def load_chunk(move: DriveStep, chunk: PathChunk) -> ChunkFit:
    """Take the next chunk of the present path. This computer times every position: no clock drifts. Raises
    `Refusal`."""
    lowered_step = _require_path(move)
    trajectory = _make_trajectory(lowered_step, chunk)
    continue_triggers(lowered_step, chunk, trajectory.point_count)
    move.next_chunk = chunk
    return ChunkFit(trajectory.duration_s, 0, 0, 0, {lowered_step.axis: trajectory.path_error_counts})


def release_chunk(move: DriveStep, number: int) -> OutputSchedule:
    """Take positions from the loaded chunk, from the next one that is not sent yet, and return what its stream switches
    then. Raises `Refusal`."""
    lowered_step = _require_path(move)
    chunk, streamed_move = move.next_chunk, move.streamed_move
    if chunk is None or chunk.number != number or streamed_move is None:
        raise Refusal("not-loaded", f"chunk {number} of the path is not loaded", "load it first")
    move.next_chunk = None
    trajectory = _make_trajectory(lowered_step, chunk)
    period_s = trajectory.period_ns / NS_PER_S
    # Position n is that of the plan n + 1 periods after the start.
    first = max(streamed_move.next_number, ceil(chunk.begin_s / period_s - 1e-6) - 1)
    if first * period_s > min(move.end_s, chunk.end_s) or streamed_move.is_done:
        raise Refusal("late", "the positions up to the place where the path was to be continued are sent", "")
    schedule = continue_triggers(lowered_step, chunk, trajectory.point_count)
    change = lowered_step.switched.find_change(schedule)
    if change is not None and change < streamed_move.next_number:
        raise Refusal("late", "the outputs up to the place where the path was to be continued are schedule", "")
    streamed_move.continue_with(trajectory, first, schedule)
    move.end_s = chunk.end_s
    profile = trajectory.profile
    durations_s = {lowered_step.axis: trajectory.duration_s}
    move.lowered = replace(
        lowered_step,
        durations_s=durations_s,
        target=profile.end_counts,
        trajectory=trajectory,
        switched=schedule,
    )
    return schedule


def change_course(move: DriveStep, sync_scheduler: SyncScheduler, profile: Profile, from_s: float) -> float:
    """Take the positions that are not sent yet from another profile, which is the present one up to `from_s`; return
    how long it takes, s. Raises `Refusal`."""
    lowered_step, streamed_move = move.lowered, move.streamed_move
    if lowered_step.trajectory is None or streamed_move is None:
        raise Refusal("no-stream", "the drive follows no positions of this computer", "")
    trajectory = SetpointTrajectory(profile, lowered_step.trajectory.period_ns, is_chunk=True)
    number = streamed_move.next_number
    # Position n is that of the plan n + 1 periods after the start.
    if number * trajectory.period_ns / NS_PER_S > from_s or streamed_move.is_done:
        raise Refusal("late", "the positions behind the place where the move was to be continued are sent", "")
    sync_scheduler.extend_start(
        move.sync_start, move.t0_ns + (trajectory.point_count + TAIL_SYNCS) * trajectory.period_ns
    )
    streamed_move.continue_with(trajectory, number, lowered_step.switched)
    durations_s = {lowered_step.axis: trajectory.duration_s}
    move.lowered = replace(lowered_step, durations_s=durations_s, target=profile.end_counts, trajectory=trajectory)
    return trajectory.duration_s


def _make_trajectory(lowered: Cia402Lowered, chunk: PathChunk) -> SetpointTrajectory:
    assert lowered.trajectory is not None
    return SetpointTrajectory(chunk.profiles[lowered.axis], lowered.trajectory.period_ns, chunk.begin_s, is_chunk=True)


def _require_path(move: DriveStep) -> Cia402Lowered:
    if move.lowered.chunk is None or move.lowered.trajectory is None:
        raise Refusal("not-a-path", "the drive executes no path that can be continued", "")
    return move.lowered
