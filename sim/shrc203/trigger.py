"""The trigger output (L5366-L5477) and the TRIG lines that report it while a program runs (L5628)."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import Timer
from sim.core.devicetime import DeviceTime
from sim.shrc203.axis import Axis
from sim.shrc203.drive import Drive, Run

PULSE, TIMER, SCALE_PLUS, SCALE_MINUS = range(4)
"""Trigger modes as ?:T and program lines number them (L2157)."""

_HUNDREDTH_NS = 10_000_000


@dataclass(frozen=True, slots=True)
class Setting:
    """What the trigger output does: every `interval` pulses of `axis`, or every `interval` x 0.01 s."""

    mode: int
    axis: Axis | None
    interval: int

    def __str__(self) -> str:
        if self.axis is None:
            return f"{self.mode},{self.interval}"
        return f"{self.mode},{self.axis.name},{self.interval}"


class Trigger:
    """One setting at a time. Pulses are worked out only while somebody is told of them."""

    def __init__(self, time: DeviceTime, drive: Drive, scale_resolution_nm: int) -> None:
        self._resolution_nm = scale_resolution_nm
        self._time = time
        self._drive = drive
        self._timer: Timer | None = None
        self._last: float = 0.0
        """Position of the last trigger, pls."""
        self.setting: Setting | None = None
        self.report: Callable[[], None] | None = None
        drive.on_start = self._follow

    def set(self, setting: Setting | None) -> None:
        """T:T, T:P, T:E; None: T:S."""
        self.setting = setting
        self._cancel()
        if setting is None:
            return
        if setting.axis is not None:
            self._last = self._drive.exact(setting.axis, self._time.now_ns())[0]
        elif self.report is not None:
            self._tick(self._time.now_ns(), setting.interval * _HUNDREDTH_NS)

    def fire(self) -> None:
        """One trigger pulse."""
        if self.report is not None:
            self.report()

    def watch(self, report: Callable[[], None] | None) -> None:
        """Tell `report` of every trigger from now on; None: nobody."""
        self.report = report
        self.set(self.setting)

    def clear(self) -> None:
        self.report = None
        self.set(None)

    def _cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _tick(self, from_ns: int, period_ns: int) -> None:
        at_ns = from_ns + period_ns

        def due() -> None:
            self._tick(at_ns, period_ns)
            self.fire()

        self._timer = self._time.call_at(at_ns, due)

    def _follow(self, run: Run) -> None:
        setting = self.setting
        if self.report is None or setting is None or setting.axis is None or setting.axis.run is not run:
            return
        self._cancel()
        self._arm(run, setting, run.t0_ns)

    def _step(self, setting: Setting, axis: Axis) -> float:
        """The interval in drive pulses."""
        if setting.mode == PULSE:
            return float(setting.interval)
        return float(setting.interval * self._resolution_nm / axis.nm_per_pulse)

    def _arm(self, run: Run, setting: Setting, now_ns: int) -> None:
        """Wait for the next place, an interval away from the last trigger, in a direction that counts."""
        track = next(track for track in run.tracks if track.axis is setting.axis)
        after = (now_ns - run.t0_ns) * 1e-9
        signs = {PULSE: (1, -1), SCALE_PLUS: (1,), SCALE_MINUS: (-1,)}[setting.mode]
        step = self._step(setting, track.axis)
        due: tuple[float, float] | None = None
        for sign in signs:
            place = self._last + sign * step
            t = track.path.first_at(place - track.start, sign, after)
            if t is not None and (due is None or t < due[0]):
                due = (t, place)
        if due is None:
            return
        at_ns, place = run.t0_ns + math.ceil(due[0] * 1e9 - 1e-6), due[1]

        def passed() -> None:
            self._timer = None
            if self.setting is setting and setting.axis is not None:
                self._last = place
                self.fire()
                if setting.axis.run is run:
                    self._arm(run, setting, at_ns)

        self._timer = self._time.call_at(at_ns, passed)
