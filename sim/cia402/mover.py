"""The commanded motion of the motor, in closed form, with what it runs over."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_S, Timer
from sim.cia402.profile import Plan, straight
from sim.core.controller import Motion
from sim.core.devicetime import DeviceTime
from sim.core.ramps import first_at

LEAST = 0.5
"""Targets are whole units: what is nearer than this is the same one."""
PAUSE_NS = 500_000_000
"""An interpolated path may rest for so long, and is the same motion when it goes on: where it is slow, a period may
have no unit to go."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A place that calls when the motion passes it in direction `sign`, or begins beyond it."""

    place: float
    sign: int
    passed: Callable[[], None]


class Mover:
    """Positions are mechanical: in the user's units, from where the drive stood when it was built, never redefined.

    marks: gives the places to look out for, asked at the begin of each plan. ended: a plan that comes to rest is over.
    """

    def __init__(
        self, time: DeviceTime, axis: str, marks: Callable[[], Sequence[Mark]], ended: Callable[[], None]
    ) -> None:
        self._time = time
        self._axis = axis
        self._marks = marks
        self._ended = ended
        self._rest = 0.0
        self._base = 0.0
        self._plan: Plan | None = None
        self._begin_ns = 0
        self._timers: list[Timer] = []
        self._motion: Motion | None = None
        self.motions: list[Motion] = []
        self.shift: Callable[[], float] = lambda: 0.0
        """From mechanical to the user's positions, for the record of motions."""
        self.slowing = False
        """It comes to rest because of a stop."""
        self._interpolating = False
        self._path: Motion | None = None
        """An interpolated path that rests, and may go on."""
        self._ended_ns = 0

    # Where it is

    def _now(self) -> tuple[float, float]:
        if self._plan is None:
            return self._rest, 0.0
        displacement, speed = self._plan.at((self._time.now_ns() - self._begin_ns) / NS_PER_S)
        return self._base + displacement, speed

    @property
    def position(self) -> float:
        return self._now()[0]

    @property
    def speed(self) -> float:
        """Units per second of the drive's crystal."""
        return self._now()[1]

    @property
    def moving(self) -> bool:
        return self._plan is not None

    @property
    def running(self) -> bool:
        """Whether a motion is recorded as under way: also between the pieces of an interpolated path."""
        return self._motion is not None

    # Orders, which act now

    def go(self, plan: Plan, slowing: bool = False, here: float | None = None) -> None:
        """Leave what it does and follow `plan`, from `here` on. slowing: because of a stop."""
        here = self.position if here is None else here
        self._cancel()
        now_ns = self._time.now_ns()
        self._base, self._plan, self._begin_ns, self.slowing = here, plan, now_ns, slowing
        if self._motion is None:
            self._motion = self._paused(now_ns) or self._begun(now_ns, here)
        if slowing and self._motion.slowing_ns is None:
            self._motion.slowing_ns = self._time.true_ns(now_ns)
        self._watch(plan, 0.0)

    def _begun(self, now_ns: int, here: float) -> Motion:
        motion = Motion(self._axis, self._time.true_ns(now_ns), here + self.shift())
        self.motions.append(motion)
        return motion

    def _paused(self, now_ns: int) -> Motion | None:
        """The path that has only rested a little."""
        if not self._interpolating or self._path is None:
            return None
        motion, self._path = self._path, None
        if self._time.true_ns(now_ns) - self._ended_ns > PAUSE_NS:
            return None
        motion.end_ns = motion.end_counts = None
        return motion

    def look_again(self) -> None:
        """The marks are others than before."""
        if self._plan is not None:
            plan = self._plan
            self._cancel()
            self._watch(plan, (self._time.now_ns() - self._begin_ns) / NS_PER_S)

    def _watch(self, plan: Plan, from_s: float) -> None:
        if not math.isinf(plan.duration_s):
            self._call(plan.duration_s, self._over)
        for mark in self._marks():
            after_s = first_at(plan.segments, plan.duration_s, mark.place - self._base, mark.sign, from_s)
            if after_s is not None and not math.isinf(after_s):
                self._call(after_s, mark.passed)

    def follow(self, target: float, period_s: float) -> None:
        """One piece of an interpolated path, to `target` in `period_s`. `ended` is not called: the next may follow."""
        here = self.position  # live, it is another one when it is asked for again
        distance = target - here
        if abs(distance) >= LEAST:
            self.go(straight(distance, period_s), here=here)
        elif self._plan is None and self._motion is not None:
            # It has rested since the end of its last piece.
            self._path = self._motion
            self._close(self._ended_ns)

    def interpolate(self, on: bool) -> None:
        """Whether plans are pieces of a path: the end of one is not the end of the motion then."""
        self._interpolating, self._path = on, None
        if not on and self._plan is None and self._motion is not None:
            self._close(self._ended_ns)

    def halt_dead(self) -> None:
        """Stand still at once: the power stage is off, or it never moved."""
        self._rest = self.position
        self._cancel()
        self._plan = None
        if self._motion is not None:
            self._close(self._time.true_ns(self._time.now_ns()))

    def put(self, position: float) -> None:
        """Somebody has moved the motor, which is at rest."""
        self._rest = position

    # Inside

    def _call(self, after_s: float, callback: Callable[[], None]) -> None:
        at_ns = self._begin_ns + math.ceil(after_s * NS_PER_S)
        plan = self._plan

        def due() -> None:
            if self._plan is plan:
                callback()

        self._timers.append(self._time.call_at(at_ns, due))

    def _over(self) -> None:
        plan = self._plan
        assert plan is not None
        self._rest = self._base + plan.distance
        self._cancel()
        self._plan = None
        self._ended_ns = self._time.true_ns(self._begin_ns + round(plan.duration_s * NS_PER_S))
        if not self._interpolating:
            self._close(self._ended_ns)
            self._ended()

    def _close(self, at_ns: int) -> None:
        assert self._motion is not None
        self._motion.end_ns, self._motion.end_counts = at_ns, self._rest + self.shift()
        self._motion = None

    def _cancel(self) -> None:
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()
