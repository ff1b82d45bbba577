"""The trigger output (L5366-L5477) and the TRIG lines that report it while a program runs (L5628)."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import ClockTimer
from sim.core.devicetime import DeviceTime
from sim.shrc203.axis import PathRun, StageAxis
from sim.shrc203.drive import PathGenerator

PULSE, TIMER, SCALE_PLUS, SCALE_MINUS = range(4)
"""Trigger modes as ?:T and program lines number them (L2157)."""

_HUNDREDTH_NS = 10_000_000


@dataclass(frozen=True, slots=True)
class TriggerSetting:
    """Setting of the trigger output: every `interval` pulses of `axis`, or every `interval` x 0.01 s."""

    mode: int
    axis: StageAxis | None
    interval: int

    def __str__(self) -> str:
        if self.axis is None:
            return f"{self.mode},{self.interval}"
        return f"{self.mode},{self.axis.name},{self.interval}"


class TriggerOutput:
    """Trigger output, one setting at a time. Pulses are computed only while a listener is registered."""

    def __init__(self, time: DeviceTime, drive: PathGenerator, scale_resolution_nm: int) -> None:
        self._resolution_nm = scale_resolution_nm
        self._time = time
        self._drive = drive
        self._timer: ClockTimer | None = None
        self._last: float = 0.0
        """Position of the last trigger, pls."""
        self.setting: TriggerSetting | None = None
        self.report: Callable[[], None] | None = None
        drive.on_start = self._follow_run

    def set_trigger(self, setting: TriggerSetting | None) -> None:
        """T:T, T:P, T:E; None: T:S."""
        self.setting = setting
        self._cancel_timers()
        if setting is None:
            return
        if setting.axis is not None:
            self._last = self._drive.exact_state(setting.axis, self._time.now_ns())[0]
        elif self.report is not None:
            self._schedule_tick(self._time.now_ns(), setting.interval * _HUNDREDTH_NS)

    def fire_pulse(self) -> None:
        """One trigger pulse."""
        if self.report is not None:
            self.report()

    def set_listener(self, report: Callable[[], None] | None) -> None:
        """Call `report` at every trigger from now on; None: stop."""
        self.report = report
        self.set_trigger(self.setting)

    def clear_trigger(self) -> None:
        self.report = None
        self.set_trigger(None)

    def _cancel_timers(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _schedule_tick(self, from_ns: int, period_ns: int) -> None:
        at_ns = from_ns + period_ns

        def handle_tick() -> None:
            self._schedule_tick(at_ns, period_ns)
            self.fire_pulse()

        self._timer = self._time.call_at(at_ns, handle_tick)

    def _follow_run(self, run: PathRun) -> None:
        setting = self.setting
        if self.report is None or setting is None or setting.axis is None or setting.axis.run is not run:
            return
        self._cancel_timers()
        self._arm_position(run, setting, run.t0_ns)

    def _pulse_interval(self, setting: TriggerSetting, axis: StageAxis) -> float:
        """The interval in drive pulses."""
        if setting.mode == PULSE:
            return float(setting.interval)
        return float(setting.interval * self._resolution_nm / axis.nm_per_pulse)

    def _arm_position(self, run: PathRun, setting: TriggerSetting, now_ns: int) -> None:
        """Wait for the next position, an interval away from the last trigger, in a direction that counts."""
        track = next(track for track in run.tracks if track.axis is setting.axis)
        after = (now_ns - run.t0_ns) * 1e-9
        signs = {PULSE: (1, -1), SCALE_PLUS: (1,), SCALE_MINUS: (-1,)}[setting.mode]
        step = self._pulse_interval(setting, track.axis)
        due: tuple[float, float] | None = None
        for sign in signs:
            place = self._last + sign * step
            t = track.path.first_at(place - track.start, sign, after)
            if t is not None and (due is None or t < due[0]):
                due = (t, place)
        if due is None:
            return
        at_ns, place = run.t0_ns + math.ceil(due[0] * 1e9 - 1e-6), due[1]

        def handle_position() -> None:
            self._timer = None
            if self.setting is setting and setting.axis is not None:
                self._last = place
                self.fire_pulse()
                if setting.axis.run is run:
                    self._arm_position(run, setting, at_ns)

        self._timer = self._time.call_at(at_ns, handle_position)
