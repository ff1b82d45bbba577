"""Profile generator: runs paths on axes, ends them, and records the commanded motions."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from sim.core.controller import CommandedMotion
from sim.core.devicetime import DeviceTime
from sim.shrc203.axis import AxisPhase, EndCause, PathRun, RunKind, RunOrder, RunTrack, StageAxis
from sim.shrc203.grammar import MAX_PULSES
from sim.shrc203.options import Shrc203Options
from sim.shrc203.path import AxisPath, deceleration_path, endless_path

_TENTH_NS = NS_PER_S // 10


@dataclass(frozen=True, slots=True)
class _RunEvent:
    at_ns: int
    cause: EndCause
    track: RunTrack | None = None
    sign: int = 0
    error: str = ""


class PathGenerator:
    """Runs of the axes of one unit."""

    def __init__(self, time: DeviceTime, options: Shrc203Options) -> None:
        self._time = time
        self._options = options
        self.motions: list[CommandedMotion] = []
        self.wait_tenths = 0
        """W:, tenths of a second (L2566)."""
        self.on_path: Callable[[PathRun], None] | None = None
        """Called with a run that begins, or whose paths have changed."""

    # Starting and stopping

    def start_run(
        self,
        paths: Sequence[tuple[StageAxis, AxisPath]],
        order: RunOrder,
        soft_sign: int = 0,
    ) -> PathRun:
        """Begin to move the axes along their paths at the device instant of `order`.

        soft_sign: the path ends early, at the software limit in this direction.
        """
        start_ns = self._time.true_ns(order.at_ns)
        tracks: list[RunTrack] = []
        for axis, path in paths:
            motion = None
            if path.end or math.isinf(path.duration) or path.first_toward(1, 0.0) is not None:
                motion = CommandedMotion(axis.name, start_ns, float(axis.position + axis.offset))
                self.motions.append(motion)
            tracks.append(RunTrack(axis, path, axis.position, motion))
        end_cause = EndCause.SOFT_LIMIT if soft_sign else EndCause.END
        run = PathRun(
            tracks=tracks,
            kind=order.kind,
            triple=order.triple,
            t0_ns=order.at_ns,
            ready=order.ready,
            end_cause=end_cause,
            end_sign=soft_sign,
        )
        for axis, _ in paths:
            axis.run, axis.phase = run, AxisPhase.MOVING
            axis.limit_stop, axis.soft_stop = False, 0
        self.rearm_run(run)
        if self.on_path is not None:
            self.on_path(run)
        return run

    def rearm_run(self, run: PathRun) -> None:
        """Recompute the end of the run after a change of its environment."""
        if run.timer is not None:
            run.timer.cancel()
            run.timer = None
        now_ns = max(self._time.now_ns(), run.t0_ns)
        event = self._next_event(run, now_ns)
        if event is not None:
            run.timer = self._time.call_at(max(event.at_ns, now_ns), lambda: self._end_run(run, event))

    def stop_run(self, run: PathRun) -> None:
        """Decelerate and end (L2955). Interpolations run at S, so they stop at once."""
        if run.held:
            self.stop_settling(run)
        elif run.tracks[0].axis.phase is not AxisPhase.MOVING:
            run.cause = EndCause.STOPPED
        elif not run.stopping:
            run.stopping, run.end_cause = True, EndCause.STOPPED
            self._record_slowing(run, self._time.now_ns())
            ramp = run.kind is not RunKind.INTERPOLATION
            self._rebase_paths(run, lambda x, v: deceleration_path(x, v if ramp else 0.0, run.triple))

    def change_speed(self, run: PathRun, speed: int) -> None:
        """Continue at constant `speed`, pls/s (JD:, L5138)."""
        self._rebase_paths(run, lambda x, v: endless_path(math.copysign(speed, v), x))

    def halt_run(self, run: PathRun, cause: EndCause) -> None:
        """Stop dead immediately."""
        if run.tracks[0].axis.phase is AxisPhase.MOVING:
            self._halt_tracks(run, self._time.now_ns())
        self._free_axes(run)
        run.ready(run, self._time.now_ns(), cause)

    def discard_run(self, run: PathRun) -> None:
        """Stop dead without notification: the power is off."""
        if run.tracks[0].axis.phase is AxisPhase.MOVING:
            self._halt_tracks(run, self._time.now_ns())
        self._free_axes(run)

    def restart_settling(self, run: PathRun) -> None:
        """Settle a stage that did not follow and is free again: the loop moves it into position."""
        if run.held:
            run.held = False
            self._settle_run(run, self._time.now_ns())

    def stop_settling(self, run: PathRun) -> None:
        """Stop waiting for a stage that does not reach its position (BEC:, L2448)."""
        if run.held:
            run.cause = EndCause.STOPPED
            self._finish_run(run, self._time.now_ns())

    # Positions of the axes

    def track_displacement(self, track: RunTrack, run: PathRun, at_ns: int) -> tuple[float, float]:
        """Return displacement and velocity (per device second) of a track at a device instant."""
        return track.path.state_at((at_ns - run.t0_ns) * 1e-9)

    def exact_state(self, axis: StageAxis, at_ns: int) -> tuple[float, float]:
        """Return the ideal commanded position and velocity (pls per device second) of an axis."""
        run = axis.run
        if run is None or axis.phase is not AxisPhase.MOVING:
            return float(axis.position), 0.0
        for track in run.tracks:
            if track.axis is axis:
                x, v = self.track_displacement(track, run, at_ns)
                return track.start + x, v
        return float(axis.position), 0.0

    def output_position(self, axis: StageAxis, at_ns: int) -> int:
        """Return the pulses output so far: the floor of the ideal distance (decision 8)."""
        run = axis.run
        if run is None or axis.phase is not AxisPhase.MOVING:
            return axis.position
        for track in run.tracks:
            if track.axis is axis:
                return track.start + _whole_pulses(self.track_displacement(track, run, at_ns)[0])
        return axis.position

    def scale_position(self, axis: StageAxis, at_ns: int) -> int:
        """Return the position of the stage by its scale, as position, pls."""
        return (
            axis.stalled_at if axis.stalled_at is not None else self.output_position(axis, at_ns) - axis.scale_deviation
        )

    # End of a run

    def _next_event(self, run: PathRun, now_ns: int) -> _RunEvent | None:
        time_s = (now_ns - run.t0_ns) * 1e-9
        best: _RunEvent | None = None
        longest = max(track.path.duration for track in run.tracks)
        if not math.isinf(longest):
            best = _RunEvent(run.t0_ns + round(longest * NS_PER_S), run.end_cause)
        for track in run.tracks:
            for sign in (1, -1):
                for t, cause, error in self._stop_instants(run, track, sign, time_s):
                    at_ns = run.t0_ns + math.ceil(t * NS_PER_S - 1e-6)
                    if best is None or at_ns < best.at_ns:
                        best = _RunEvent(at_ns, cause, track, sign, error)
        return best

    def _stop_instants(
        self, run: PathRun, track: RunTrack, sign: int, after: float
    ) -> list[tuple[float, EndCause, str]]:
        """Return the instants at which a limit on this axis would stop a motion in direction `sign`."""
        axis, path = track.axis, track.path
        stops: list[tuple[float | None, EndCause, str]] = []
        if axis.limits is not None:
            if axis.limit_on(sign, 0.0):
                stops.append((path.first_toward(sign, after), EndCause.LIMIT, ""))
        elif axis.travel is not None:
            stops.append((path.first_at(axis.travel[sign > 0] - track.start, sign, after), EndCause.LIMIT, ""))
        for bound, cause, error in self._counter_bounds(run, axis, sign):
            # Ending exactly there is allowed, continuing is not.
            passing = path.first_at(bound - axis.offset - track.start, sign, after)
            if passing is not None and passing < path.duration - 1e-9:
                stops.append((passing, cause, error))
        if axis.stalled_at is not None and axis.closed_loop:
            bound = axis.stalled_at + sign * self._options.overflow_pls - track.start
            stops.append((path.first_at(bound, sign, after), EndCause.ERROR, "S4"))
        return [(t, cause, error) for t, cause, error in stops if t is not None]

    def _counter_bounds(self, run: PathRun, axis: StageAxis, sign: int) -> list[tuple[int, EndCause, str]]:
        """Return the coordinates that a motion in direction `sign` must not pass (decisions 29 and 37)."""
        bounds = [(sign * MAX_PULSES, EndCause.ERROR, "S6")]
        if axis.soft_limits is not None and run.kind is not RunKind.ORIGIN:
            bounds.append((axis.soft_limits[sign > 0], EndCause.SOFT_LIMIT, ""))
        return bounds

    def _end_run(self, run: PathRun, event: _RunEvent) -> None:
        run.timer = None
        if event.track is None:
            self._finish_tracks(run, event.at_ns)
            if event.cause is EndCause.SOFT_LIMIT:
                run.tracks[0].axis.soft_stop = run.end_sign
        else:
            self._halt_tracks(run, event.at_ns)
            axis = event.track.axis
            if event.cause is EndCause.LIMIT:
                axis.limit_stop = True
            elif event.cause is EndCause.SOFT_LIMIT:
                axis.soft_stop = event.sign
            elif event.error:
                axis.errors.add(event.error)
        run.cause = event.cause
        for track in run.tracks:
            track.axis.phase = AxisPhase.SETTLING
        self._settle_run(run, event.at_ns)

    def _settle_run(self, run: PathRun, at_ns: int) -> None:
        closed_axis = [track.axis for track in run.tracks if track.axis.closed_loop]
        if run.cause is EndCause.END and any(axis.stalled_at not in (None, axis.position) for axis in closed_axis):
            run.held = True
            return
        wait_ns = round(self._options.settle_ms * NS_PER_MS) if closed_axis else 0
        if run.cause is EndCause.END:
            wait_ns += self.wait_tenths * _TENTH_NS
        if wait_ns:
            run.timer = self._time.call_at(at_ns + wait_ns, lambda: self._finish_run(run, at_ns + wait_ns))
        else:
            self._finish_run(run, at_ns)

    def _finish_run(self, run: PathRun, at_ns: int) -> None:
        self._free_axes(run)
        run.ready(run, at_ns, run.cause)

    def _free_axes(self, run: PathRun) -> None:
        if run.timer is not None:
            run.timer.cancel()
            run.timer = None
        for track in run.tracks:
            track.axis.run, track.axis.phase = None, AxisPhase.IDLE

    def _finish_tracks(self, run: PathRun, at_ns: int) -> None:
        for track in run.tracks:
            self._close_track(track, track.path.end, at_ns)

    def _halt_tracks(self, run: PathRun, at_ns: int) -> None:
        self._record_slowing(run, at_ns)
        for track in run.tracks:
            self._close_track(track, _whole_pulses(self.track_displacement(track, run, at_ns)[0]), at_ns)

    def _record_slowing(self, run: PathRun, at_ns: int) -> None:
        for track in run.tracks:
            if track.motion is not None and track.motion.slowing_ns is None:
                track.motion.slowing_ns = self._time.true_ns(at_ns)

    def _close_track(self, track: RunTrack, displacement: int, at_ns: int) -> None:
        axis = track.axis
        axis.position = track.start + displacement
        if track.motion is not None:
            track.motion.end_ns = self._time.true_ns(at_ns)
            track.motion.end_counts = float(axis.position + axis.offset)

    def _rebase_paths(self, run: PathRun, path: Callable[[float, float], AxisPath]) -> None:
        now_ns = self._time.now_ns()
        if now_ns < run.t0_ns:
            now_ns = run.t0_ns
        for track in run.tracks:
            x, v = self.track_displacement(track, run, now_ns)
            track.path = path(x, v)
        run.t0_ns = now_ns
        self.rearm_run(run)
        if self.on_path is not None:
            self.on_path(run)


def _whole_pulses(x: float) -> int:
    return math.trunc(x + math.copysign(1e-6, x))
