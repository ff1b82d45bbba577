"""The pulse generators: running paths, in closed form between events, and the truth about them."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto

from orchestrator.clock.base import NS_PER_S, Timer
from sim.core.controller import Motion
from sim.core.devicetime import DeviceTime
from sim.ppsmc.axis import Axis
from sim.ppsmc.path import Path, Profile, decelerated, respin
from sim.ppsmc.sensors import Until, limit_of


class End(Enum):
    """Why a motion ended."""

    DONE = auto()
    STOPPED = auto()
    """By q, with its ramp."""
    LIMIT = auto()
    """By a limit switch, dead (L2546)."""
    SWITCH = auto()
    """Where it was told to: at its `Until`."""


Ended = Callable[[End], None]


@dataclass(slots=True, eq=False)
class Run:
    """A running motion of one axis. Path displacements count from `base`."""

    axis: Axis
    path: Path
    profile: Profile
    start_ns: int
    """Device time at the path's time 0; just ahead of now at a skewed start."""
    base: int
    until: Until | None
    ended: Ended
    motion: Motion
    soft: bool = False
    """At its `Until` it decelerates instead of stopping dead."""
    found: bool = False
    stopping: bool = False
    quit: bool = False
    timer: Timer | None = None

    def seconds(self, now_ns: int) -> float:
        return (now_ns - self.start_ns) / NS_PER_S


@dataclass(slots=True)
class Drive:
    """Moves axes along paths, until the end, a stop, or a switch."""

    time: DeviceTime
    motions: list[Motion] = field(default_factory=list[Motion])

    def start(
        self,
        axis: Axis,
        path: Path,
        profile: Profile,
        ended: Ended,
        *,
        until: Until | None = None,
        soft: bool = False,
        at_ns: int | None = None,
    ) -> None:
        """Run `path` from the axis's counter, now or at device time `at_ns` just ahead."""
        now_ns = self.time.now_ns()
        start_ns = now_ns if at_ns is None else max(now_ns, at_ns)
        true_ns = self.time.clock.now_ns() if start_ns == now_ns else self.time.true_ns(start_ns)
        motion = Motion(axis.name, true_ns, self.coordinate(axis, axis.steps))
        run = Run(axis, path, profile, start_ns, axis.steps, until, ended, motion, soft)
        axis.run = run
        self.motions.append(motion)
        self.arm(run)

    def quit(self, run: Run) -> None:
        """Decelerate to the start-stop speed and stop (L2546)."""
        run.quit = True
        run.motion.slowing_ns = self.time.clock.now_ns()
        self._slow(run)

    def respin(self, run: Run, sign: int, profile: Profile) -> None:
        """Go over to another endless speed."""
        run.profile = profile
        self._replace(run, lambda x, v: respin(x, v, sign, profile))

    def halt(self, run: Run) -> None:
        """Stop dead where it is, and tell nobody: the power went, or the unit is reset."""
        self._settle(run, None)

    def arm(self, run: Run) -> None:
        """Find what ends the motion first, from how switches and path stand now."""
        if run.timer is not None:
            run.timer.cancel()
            run.timer = None
        seconds = max(0.0, run.seconds(self.time.now_ns()))
        reason = End.STOPPED if run.stopping else End.DONE
        due, bound = run.path.duration, None
        for sign in (1, -1):
            for until, end in ((Until(limit_of(sign), True), End.LIMIT), (run.until, End.SWITCH)):
                found = None if until is None else self._meets(run, until, sign, seconds)
                if found is not None and found[0] < due:
                    (due, bound), reason = found, end
        if math.isinf(due):
            return
        at_ns = run.start_ns + math.ceil(due * NS_PER_S - 1e-3)
        if due <= seconds and at_ns <= self.time.now_ns():
            self._finish(run, reason, bound)
        else:
            run.timer = self.time.call_at(at_ns, lambda: self._finish(run, reason, bound))

    def _meets(self, run: Run, until: Until, sign: int, after: float) -> tuple[float, float | None] | None:
        """When `until` first holds while moving in direction `sign`, and at which displacement (None: where it is)."""
        axis = run.axis
        toward = run.path.first_at(-sign * math.inf, sign, after)
        if toward is None:
            return None
        place = run.base + run.path.at(toward)[0] - axis.origin
        if axis.switches.on(until.switch, round(place)) == until.on:
            return toward, None
        bound = axis.switches.bound(until, place, sign)
        if bound is None:
            return None
        displacement = bound + axis.origin - run.base
        at = run.path.first_at(displacement, sign, after)
        return None if at is None else (at, displacement)

    def _slow(self, run: Run) -> None:
        if not run.stopping:
            run.stopping = True
            self._replace(run, lambda x, v: decelerated(x, v, run.profile))

    def _replace(self, run: Run, successor: Callable[[float, float], Path]) -> None:
        now_ns = self.time.now_ns()
        x, v = run.path.at(run.seconds(now_ns))
        run.start_ns = now_ns
        run.path = successor(x, v)
        self.arm(run)

    def _finish(self, run: Run, reason: End, bound: float | None) -> None:
        if reason is End.SWITCH and run.soft and not run.stopping:
            run.found = True
            run.until = None
            self._slow(run)
            return
        end = run.path.end if reason in (End.DONE, End.STOPPED) else bound
        self._settle(run, end)
        run.ended(End.SWITCH if run.found and reason is End.STOPPED and not run.quit else reason)

    def _settle(self, run: Run, displacement: float | None) -> None:
        if run.timer is not None:
            run.timer.cancel()
            run.timer = None
        axis = run.axis
        if displacement is None:
            displacement = run.path.at(run.seconds(self.time.now_ns()))[0]
        axis.steps = run.base + round(displacement)
        axis.run = None
        # A halt can come before a skewed start.
        run.motion.end_ns = max(run.motion.start_ns, self.time.clock.now_ns())
        run.motion.end_counts = self.coordinate(axis, axis.steps)

    # Where the axis is

    def exact(self, axis: Axis) -> tuple[float, float]:
        """Step counter, not rounded, and velocity (steps per device second), now."""
        run = axis.run
        if run is None:
            return float(axis.steps), 0.0
        x, v = run.path.at(run.seconds(self.time.now_ns()))
        return run.base + x, v

    def counter(self, axis: Axis) -> int:
        """The step counter now."""
        return round(self.exact(axis)[0])

    @staticmethod
    def coordinate(axis: Axis, steps: float) -> float:
        """`steps` in the axis's unit."""
        settings = axis.settings
        return (
            steps
            * settings.gden.numerator
            * settings.gnum.denominator
            / (settings.gden.denominator * settings.gnum.numerator)
        )
