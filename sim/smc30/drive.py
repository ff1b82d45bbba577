"""The motor: position counter, end-of-travel inputs, and the one run of steps that is being made."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from orchestrator.clock.base import NS_PER_S, Timer
from sim.core.controller import LimitSwitch, Motion
from sim.core.devicetime import DeviceTime
from sim.smc30.profile import Profile, stop_ramp

MOST = 8_388_607
LEAST = -8_388_608
_WHOLE = 1e-6  # steps: what rounding of times and square roots may be short of a step


class End(Enum):
    """Why a run of steps is over."""

    DONE = auto()
    """The steps asked for, or a stop ramp, are made."""
    SWITCH = auto()
    """The end-of-travel input of its direction is active (L771-L827)."""
    OVERFLOW = auto()
    """The position counter is at its limit (L1239-L1247)."""
    HALTED = auto()
    """Stopped at once by the firmware."""


Ended = Callable[[End], None]


@dataclass(slots=True)
class _Run:
    """Steps in one direction. Steps of the profile are counted from where the counter was at the start of the run."""

    sign: int
    profile: Profile
    again: Callable[[float], Profile]
    """The profile of so many steps, for what the Stop input leaves."""
    start_rate: float
    slope: float
    ended: Ended
    motion: Motion
    origin_ns: int
    """Device instant that the profile's time counts from."""
    timer: Timer | None = None


@dataclass(slots=True)
class _Frozen:
    """What the Stop input has interrupted."""

    sign: int
    steps: float
    again: Callable[[float], Profile]
    start_rate: float
    slope: float
    ended: Ended


class Drive:
    """One motor. `_counter` is the position counter and `_place` the steps from the first power-up, both at rest."""

    def __init__(self, time: DeviceTime, axis: str, motions: list[Motion], travel: tuple[int, int] | None) -> None:
        self._time = time
        self._axis = axis
        self._motions = motions
        self._travel = travel
        self._limits: LimitSwitch | None = None
        self._counter = 0
        self._place = 0
        self._run: _Run | None = None
        self._frozen: _Frozen | None = None
        self.held = False
        """The Stop input is active."""
        self.overflow = False
        """The counter's limit has stopped the motor, and nobody has set the counter since (decision 17)."""

    # Position

    @property
    def moving(self) -> bool:
        return self._run is not None

    @property
    def occupied(self) -> bool:
        """A run goes on, or is to go on once the Stop input is released."""
        return self._run is not None or self._frozen is not None

    def exact(self) -> tuple[float, float]:
        """Counter, not rounded to whole steps, and steps per device second."""
        if self._run is None:
            return float(self._counter), 0.0
        steps, rate = self._progress(self._run)
        return self._counter + self._run.sign * steps, self._run.sign * rate

    @property
    def counter(self) -> int:
        """The position counter: steps that have been made."""
        return self._counter + self._made()

    @property
    def place(self) -> int:
        """Steps from the first power-up."""
        return self._place + self._made()

    def set_counter(self, value: int) -> None:
        self.overflow = False
        self._counter = value - self._made()

    def _made(self) -> int:
        run = self._run
        return 0 if run is None else run.sign * math.floor(self._progress(run)[0] + _WHOLE)

    def _progress(self, run: _Run) -> tuple[float, float]:
        return run.profile.at((self._time.now_ns() - run.origin_ns) / NS_PER_S)

    # Runs

    def start(
        self,
        sign: int,
        steps: float,
        again: Callable[[float], Profile],
        start_rate: float,
        slope: float,
        ended: Ended,
    ) -> None:
        """Make `steps` (may be infinite) in a direction; `ended` is called once, perhaps before this returns."""
        if self.held:
            self._frozen = _Frozen(sign, steps, again, start_rate, slope, ended)
            return
        if steps < 1:
            ended(End.DONE)
        elif self.switch(sign):
            ended(End.SWITCH)
        elif self._room(sign) < 1:
            self.overflow = True
            ended(End.OVERFLOW)
        else:
            motion = Motion(self._axis, self._time.clock.now_ns(), float(self._counter))
            self._motions.append(motion)
            now_ns = self._time.now_ns()
            self._run = _Run(sign, again(steps), again, start_rate, slope, ended, motion, now_ns)
            self._schedule(self._run)

    def _room(self, sign: int) -> int:
        return MOST - self._counter if sign > 0 else self._counter - LEAST

    def _schedule(self, run: _Run) -> None:
        """One event: whichever of the end of the profile, the counter's limit and a travel switch comes first."""
        if run.timer is not None:
            run.timer.cancel()
        steps, end = run.profile.distance, End.DONE
        room = self._room(run.sign)
        if room < steps:
            steps, end = float(room), End.OVERFLOW
        if self._travel is not None and self._limits is None:
            low, high = self._travel
            way = high - self._place if run.sign > 0 else self._place - low
            if way < steps:
                steps, end = float(way), End.SWITCH
        due_ns = run.origin_ns + math.ceil(run.profile.reached_s(steps) * NS_PER_S)
        run.timer = self._time.call_at(due_ns, lambda: self._finish(run, round(steps), end))

    def _finish(self, run: _Run, steps: int, end: End) -> None:
        self._close(run, steps)
        self.overflow = self.overflow or end is End.OVERFLOW
        run.ended(end)

    def _close(self, run: _Run, steps: int) -> None:
        if run.timer is not None:
            run.timer.cancel()
        self._counter += run.sign * steps
        self._place += run.sign * steps
        run.motion.end_ns = self._time.clock.now_ns()
        run.motion.end_counts = float(self._counter)
        self._run = None

    def _cut(self) -> _Run | None:
        """Stop at once, on the last step made; what ran."""
        run = self._run
        if run is not None:
            self._close(run, abs(self._made()))
        return run

    def halt(self, end: End = End.HALTED) -> None:
        """Stop at once, and tell who asked for the run."""
        frozen, self._frozen = self._frozen, None
        run = self._cut()
        for over in (run, frozen):
            if over is not None:
                over.ended(end)

    def kill(self) -> None:
        """Stop at once and tell nobody."""
        self._frozen = None
        self._cut()

    def ramp_down(self) -> None:
        """Decelerate with the parameters of the run (L1950-L1954); it ends as if its steps were made."""
        frozen, self._frozen = self._frozen, None
        if frozen is not None:
            frozen.ended(End.DONE)
        run = self._run
        if run is None:
            return
        steps, rate = self._progress(run)
        ramp = stop_ramp(steps, rate, run.start_rate, run.slope, run.profile.distance)
        if ramp is None:
            self.halt(End.DONE)
            return
        if run.motion.slowing_ns is None:
            run.motion.slowing_ns = self._time.clock.now_ns()
        run.profile, run.origin_ns = ramp, self._time.now_ns()
        self._schedule(run)

    # Inputs

    def push(self, steps: int) -> None:
        """Somebody moves the axis at rest by hand: nothing counts it."""
        if self._run is not None:
            raise ValueError("the motor holds the axis")
        self._place += steps

    def hold(self, held: bool) -> None:
        """The Stop input: freeze; on release restart what is left from the start rate (decision 20)."""
        self.held = held
        if held:
            if (run := self._run) is not None:
                distance = run.profile.distance
                made = abs(self._made())
                self._cut()
                self._frozen = _Frozen(run.sign, distance - made, run.again, run.start_rate, run.slope, run.ended)
        elif (frozen := self._frozen) is not None:
            self._frozen = None
            self.start(frozen.sign, frozen.steps, frozen.again, frozen.start_rate, frozen.slope, frozen.ended)

    def switch(self, sign: int) -> bool:
        """Whether the end-of-travel input of a direction is active."""
        if self._limits is not None:
            return self._limits in ("both", "forward" if sign > 0 else "reverse")
        if self._travel is None:
            return False
        return self.place >= self._travel[1] if sign > 0 else self.place <= self._travel[0]

    def set_limits(self, limits: LimitSwitch) -> None:
        """Active end-of-travel inputs, which do not follow the travel meanwhile."""
        self._limits = None if limits == "none" else limits
        if (run := self._run) is None:
            return
        if self.switch(run.sign):
            self.halt(End.SWITCH)
        else:
            self._schedule(run)
