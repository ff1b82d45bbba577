"""What one axis is doing: a sequence of motions and pauses, written as a generator."""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from enum import Enum, auto

from orchestrator.clock.base import Timer
from sim.ppsmc.axis import LIMIT_ERROR, Axis
from sim.ppsmc.drive import Drive, End
from sim.ppsmc.path import Path, Profile
from sim.ppsmc.sensors import Until, limit_of


class Kind(Enum):
    """Kinds of task."""

    POSITIONING = auto()
    JOG = auto()
    SPIN = auto()
    OSCILLATION = auto()
    HOMING = auto()


@dataclass(frozen=True, slots=True)
class Leg:
    """One motion. With `seeks_limit` a limit switch ends it without an error."""

    path: Path
    profile: Profile
    until: Until | None = None
    seeks_limit: bool = False
    soft: bool = False
    """At its `Until` it decelerates instead of stopping dead."""
    at_ns: int | None = None
    """Device time of the start; None: now."""


@dataclass(frozen=True, slots=True)
class Pause:
    """Stand still, device ns."""

    duration_ns: int


Steps = Generator[Leg | Pause, End, None]


class Task:
    """Runs the steps of one axis; `finished` is told whether they came to their end by themselves."""

    def __init__(
        self,
        drive: Drive,
        axis: Axis,
        kind: Kind,
        steps: Steps,
        finished: Callable[["Task", bool], None],
        limit_clears_reference: bool,
    ) -> None:
        self.axis = axis
        self.kind = kind
        self.leg: Leg | None = None
        self._drive = drive
        self._steps = steps
        self._finished = finished
        self._limit_clears_reference = limit_clears_reference
        self._timer: Timer | None = None

    def begin(self) -> None:
        """Make the first step; can end at once."""
        self.axis.task = self
        self._next(None)

    def stop(self) -> None:
        """As by q: decelerate, and forget the rest."""
        if self.axis.run is not None:
            self._drive.quit(self.axis.run)
        else:
            self._over(False)

    def abort(self) -> None:
        """Stop dead, and tell nobody."""
        if self._timer is not None:
            self._timer.cancel()
        if self.axis.run is not None:
            self._drive.halt(self.axis.run)
        self._steps.close()
        self.axis.task = None

    def _next(self, end: End | None) -> None:
        self._timer = None
        while True:
            try:
                step = next(self._steps) if end is None else self._steps.send(end)
            except StopIteration:
                self._over(True)
                return
            if isinstance(step, Pause):
                self.leg = None
                self._timer = self._drive.time.call_after(step.duration_ns, lambda: self._next(End.DONE))
                return
            self.leg = step
            sign = step.path.sign
            if sign == 0:
                end = End.DONE
            elif self._blocked(sign):
                if not step.seeks_limit:
                    self.axis.error = LIMIT_ERROR
                    self._over(False)
                    return
                end = End.LIMIT
            else:
                self._drive.start(
                    self.axis,
                    step.path,
                    step.profile,
                    self._ended,
                    until=step.until,
                    soft=step.soft,
                    at_ns=step.at_ns,
                )
                return

    def _blocked(self, sign: int) -> bool:
        """An axis never moves towards its active limit (L2996)."""
        axis = self.axis
        return axis.switches.on(limit_of(sign), axis.steps - axis.origin)

    def _ended(self, end: End) -> None:
        leg = self.leg
        if end is End.STOPPED:
            self._over(False)
        elif end is End.LIMIT and leg is not None and not leg.seeks_limit:
            self.axis.error = LIMIT_ERROR
            if self._limit_clears_reference:
                self.axis.referenced = False
            self._over(False)
        else:
            self._next(end)

    def _over(self, by_itself: bool) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._steps.close()
        self.axis.task = None
        self._finished(self, by_itself)
