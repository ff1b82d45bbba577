"""The profile generator: runs paths on axes, ends them, and records what was commanded."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, auto

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Timer
from sim.core.controller import Motion
from sim.core.devicetime import DeviceTime
from sim.shrc203.axis import Axis, Phase
from sim.shrc203.grammar import MAX_PULSES
from sim.shrc203.options import Options
from sim.shrc203.path import Path, Triple, decelerated, endless

_TENTH_NS = NS_PER_S // 10


class Cause(Enum):
    """Why a motion ended."""

    END = auto()
    STOPPED = auto()
    """By L: or BEC:."""
    LIMIT = auto()
    SOFT_LIMIT = auto()
    ERROR = auto()


class Kind(Enum):
    """What a run is, as far as status bits and stops care."""

    MOVE = auto()
    JOG = auto()
    INTERPOLATION = auto()
    ORIGIN = auto()
    """Mechanical origin return."""
    ZERO = auto()
    """Logical origin return."""


@dataclass(slots=True, eq=False)
class Track:
    """The part of one axis in a run."""

    axis: Axis
    path: Path
    start: int
    """Position at the start, pls."""
    motion: Motion | None


@dataclass(slots=True, eq=False)
class Run:
    """One operation: one axis, or the axes of an interpolation together."""

    tracks: list[Track]
    kind: Kind
    triple: Triple
    """Gives the slope of a stop."""
    t0_ns: int
    """Device instant of the paths' origin."""
    ready: Callable[["Run", int, Cause], None]
    """Called with the device instant at which the axes are positioned, settled and have waited for W:."""
    end_cause: Cause = Cause.END
    end_sign: int = 0
    """Direction of the software limit that the run is planned to end at."""
    timer: Timer | None = None
    cause: Cause = Cause.END
    stopping: bool = False
    held: bool = False
    """Closed loop, and the stage does not get into position."""


@dataclass(frozen=True, slots=True)
class _Event:
    at_ns: int
    cause: Cause
    track: Track | None = None
    sign: int = 0
    error: str = ""


class Drive:
    """Runs of the axes of one unit."""

    def __init__(self, time: DeviceTime, options: Options) -> None:
        self._time = time
        self._options = options
        self.motions: list[Motion] = []
        self.wait_tenths = 0
        """W:, tenths of a second (L2566)."""
        self.on_start: Callable[[Run], None] | None = None

    # Starting and stopping

    def start(
        self,
        paths: Sequence[tuple[Axis, Path]],
        triple: Triple,
        kind: Kind,
        at_ns: int,
        ready: Callable[[Run, int, Cause], None],
        soft_sign: int = 0,
    ) -> Run:
        """Begin to move the axes along their paths at device instant `at_ns`.

        soft_sign: the path ends early, at the software limit in this direction.
        """
        start_ns = self._time.true_ns(at_ns)
        tracks: list[Track] = []
        for axis, path in paths:
            motion = None
            if path.end or math.isinf(path.duration) or path.first_toward(1, 0.0) is not None:
                motion = Motion(axis.name, start_ns, float(axis.position + axis.offset))
                self.motions.append(motion)
            tracks.append(Track(axis, path, axis.position, motion))
        run = Run(tracks, kind, triple, at_ns, ready, Cause.SOFT_LIMIT if soft_sign else Cause.END, soft_sign)
        for axis, _ in paths:
            axis.run, axis.phase = run, Phase.MOVING
            axis.limit_stop, axis.soft_stop = False, 0
        self.rearm(run)
        if self.on_start is not None:
            self.on_start(run)
        return run

    def rearm(self, run: Run) -> None:
        """Work out anew what ends the run: something in the world around it has changed."""
        if run.timer is not None:
            run.timer.cancel()
            run.timer = None
        now_ns = max(self._time.now_ns(), run.t0_ns)
        event = self._next_event(run, now_ns)
        if event is not None:
            run.timer = self._time.call_at(max(event.at_ns, now_ns), lambda: self._end(run, event))

    def stop(self, run: Run) -> None:
        """Decelerate and end (L2955). Interpolations run at S, so they stop at once."""
        if run.held:
            self.give_up(run)
        elif run.tracks[0].axis.phase is not Phase.MOVING:
            run.cause = Cause.STOPPED
        elif not run.stopping:
            run.stopping, run.end_cause = True, Cause.STOPPED
            self._slowing(run, self._time.now_ns())
            ramp = run.kind is not Kind.INTERPOLATION
            self._rebase(run, lambda x, v: decelerated(x, v if ramp else 0.0, run.triple))

    def change_speed(self, run: Run, speed: int) -> None:
        """Go on at constant `speed`, pls/s (JD:, L5138)."""
        self._rebase(run, lambda x, v: endless(math.copysign(speed, v), x))

    def halt(self, run: Run, cause: Cause) -> None:
        """Stop dead, now."""
        if run.tracks[0].axis.phase is Phase.MOVING:
            self._halt_tracks(run, self._time.now_ns())
        self._release(run)
        run.ready(run, self._time.now_ns(), cause)

    def drop(self, run: Run) -> None:
        """Stop dead and tell nobody: the power has gone."""
        if run.tracks[0].axis.phase is Phase.MOVING:
            self._halt_tracks(run, self._time.now_ns())
        self._release(run)

    def settle_again(self, run: Run) -> None:
        """A stage that did not follow is free again: the loop brings it into position."""
        if run.held:
            run.held = False
            self._settle(run, self._time.now_ns())

    def give_up(self, run: Run) -> None:
        """Ends waiting for a stage that does not get into position (BEC:, L2448)."""
        if run.held:
            run.cause = Cause.STOPPED
            self._done(run, self._time.now_ns())

    # Where the axes are

    def displacement(self, track: Track, run: Run, at_ns: int) -> tuple[float, float]:
        """Displacement and velocity (per device second) of a track at a device instant."""
        return track.path.at((at_ns - run.t0_ns) * 1e-9)

    def exact(self, axis: Axis, at_ns: int) -> tuple[float, float]:
        """Ideal commanded position and velocity (pls per device second) of an axis."""
        run = axis.run
        if run is None or axis.phase is not Phase.MOVING:
            return float(axis.position), 0.0
        for track in run.tracks:
            if track.axis is axis:
                x, v = self.displacement(track, run, at_ns)
                return track.start + x, v
        return float(axis.position), 0.0

    def position(self, axis: Axis, at_ns: int) -> int:
        """Pulses given out so far: the floor of the ideal distance (decision 8)."""
        run = axis.run
        if run is None or axis.phase is not Phase.MOVING:
            return axis.position
        for track in run.tracks:
            if track.axis is axis:
                return track.start + _whole(self.displacement(track, run, at_ns)[0])
        return axis.position

    def followed(self, axis: Axis, at_ns: int) -> int:
        """Where the stage is by its scale, as position, pls."""
        return axis.stalled_at if axis.stalled_at is not None else self.position(axis, at_ns) - axis.slip

    # What ends a run

    def _next_event(self, run: Run, now_ns: int) -> _Event | None:
        after = (now_ns - run.t0_ns) * 1e-9
        best: _Event | None = None
        longest = max(track.path.duration for track in run.tracks)
        if not math.isinf(longest):
            best = _Event(run.t0_ns + round(longest * NS_PER_S), run.end_cause)
        for track in run.tracks:
            for sign in (1, -1):
                for t, cause, error in self._boundaries(run, track, sign, after):
                    at_ns = run.t0_ns + math.ceil(t * NS_PER_S - 1e-6)
                    if best is None or at_ns < best.at_ns:
                        best = _Event(at_ns, cause, track, sign, error)
        return best

    def _boundaries(self, run: Run, track: Track, sign: int, after: float) -> list[tuple[float, Cause, str]]:
        """Instants at which something on this axis would stop a motion in direction `sign`."""
        axis, path = track.axis, track.path
        found: list[tuple[float | None, Cause, str]] = []
        if axis.limits is not None:
            if axis.limit_on(sign, 0.0):
                found.append((path.first_toward(sign, after), Cause.LIMIT, ""))
        elif axis.travel is not None:
            found.append((path.first_at(axis.travel[sign > 0] - track.start, sign, after), Cause.LIMIT, ""))
        for bound, cause, error in self._counter_bounds(run, axis, sign):
            # Ending there is allowed, going on is not.
            passing = path.first_at(bound - axis.offset - track.start, sign, after)
            if passing is not None and passing < path.duration - 1e-9:
                found.append((passing, cause, error))
        if axis.stalled_at is not None and axis.closed_loop:
            bound = axis.stalled_at + sign * self._options.overflow_pls - track.start
            found.append((path.first_at(bound, sign, after), Cause.ERROR, "S4"))
        return [(t, cause, error) for t, cause, error in found if t is not None]

    def _counter_bounds(self, run: Run, axis: Axis, sign: int) -> list[tuple[int, Cause, str]]:
        """Coordinates that a motion in direction `sign` must not pass (decisions 29 and 37)."""
        bounds = [(sign * MAX_PULSES, Cause.ERROR, "S6")]
        if axis.soft_limits is not None and run.kind is not Kind.ORIGIN:
            bounds.append((axis.soft_limits[sign > 0], Cause.SOFT_LIMIT, ""))
        return bounds

    def _end(self, run: Run, event: _Event) -> None:
        run.timer = None
        if event.track is None:
            self._finish_tracks(run, event.at_ns)
            if event.cause is Cause.SOFT_LIMIT:
                run.tracks[0].axis.soft_stop = run.end_sign
        else:
            self._halt_tracks(run, event.at_ns)
            axis = event.track.axis
            if event.cause is Cause.LIMIT:
                axis.limit_stop = True
            elif event.cause is Cause.SOFT_LIMIT:
                axis.soft_stop = event.sign
            elif event.error:
                axis.errors.add(event.error)
        run.cause = event.cause
        for track in run.tracks:
            track.axis.phase = Phase.SETTLING
        self._settle(run, event.at_ns)

    def _settle(self, run: Run, at_ns: int) -> None:
        closed = [track.axis for track in run.tracks if track.axis.closed_loop]
        if run.cause is Cause.END and any(axis.stalled_at not in (None, axis.position) for axis in closed):
            run.held = True
            return
        wait_ns = round(self._options.settle_ms * NS_PER_MS) if closed else 0
        if run.cause is Cause.END:
            wait_ns += self.wait_tenths * _TENTH_NS
        if wait_ns:
            run.timer = self._time.call_at(at_ns + wait_ns, lambda: self._done(run, at_ns + wait_ns))
        else:
            self._done(run, at_ns)

    def _done(self, run: Run, at_ns: int) -> None:
        self._release(run)
        run.ready(run, at_ns, run.cause)

    def _release(self, run: Run) -> None:
        if run.timer is not None:
            run.timer.cancel()
            run.timer = None
        for track in run.tracks:
            track.axis.run, track.axis.phase = None, Phase.IDLE

    def _finish_tracks(self, run: Run, at_ns: int) -> None:
        for track in run.tracks:
            self._close(track, track.path.end, at_ns)

    def _halt_tracks(self, run: Run, at_ns: int) -> None:
        self._slowing(run, at_ns)
        for track in run.tracks:
            self._close(track, _whole(self.displacement(track, run, at_ns)[0]), at_ns)

    def _slowing(self, run: Run, at_ns: int) -> None:
        for track in run.tracks:
            if track.motion is not None and track.motion.slowing_ns is None:
                track.motion.slowing_ns = self._time.true_ns(at_ns)

    def _close(self, track: Track, displacement: int, at_ns: int) -> None:
        axis = track.axis
        axis.position = track.start + displacement
        if track.motion is not None:
            track.motion.end_ns = self._time.true_ns(at_ns)
            track.motion.end_counts = float(axis.position + axis.offset)

    def _rebase(self, run: Run, path: Callable[[float, float], Path]) -> None:
        now_ns = self._time.now_ns()
        if now_ns < run.t0_ns:
            now_ns = run.t0_ns
        for track in run.tracks:
            x, v = self.displacement(track, run, now_ns)
            track.path = path(x, v)
        run.t0_ns = now_ns
        self.rearm(run)


def _whole(x: float) -> int:
    return math.trunc(x + math.copysign(1e-6, x))
