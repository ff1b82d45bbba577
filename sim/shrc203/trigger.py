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

TRIGGER_LINE = 7
"""The trigger output among the outputs of the environment, behind OUT1 to OUT6. Positive logic (TRG/LEV 0, L7549)."""

_HUNDREDTH_NS = 10_000_000
_WIDTH_NS = 10_000
"""TRG WIDTH 0, the only width that the manual names (L7550, decision 54)."""
_MOST_SPEED = 56_000
"""Above this speed, pls/s, "trigger may not be output" (L5395): here it never is (decision 53)."""
_REACHED = 1e-3
"""Pulses: the instant of a trigger is rounded up to a nanosecond."""


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
    """Trigger output, one setting at a time. Pulses are computed only while something is registered for them.

    listeners: of the level, with the number of the output. report: called at every trigger, of programs."""

    def __init__(self, time: DeviceTime, drive: PathGenerator, scale_resolution_nm: int) -> None:
        self._resolution_nm = scale_resolution_nm
        self._time = time
        self._drive = drive
        self._timer: ClockTimer | None = None
        self._last: float = 0.0
        """Position of the last trigger, pls."""
        self.setting: TriggerSetting | None = None
        self.report: Callable[[], None] | None = None
        self.listeners: list[Callable[[int, bool], None]] = []
        self.level = False
        self._fall: ClockTimer | None = None
        drive.on_path = self._follow_run

    def set_trigger(self, setting: TriggerSetting | None) -> None:
        """T:T, T:P, T:E; None: T:S."""
        self.setting = setting
        self._cancel_timers()
        if setting is None:
            return
        if setting.axis is not None:
            self._last = self._drive.exact_state(setting.axis, self._time.now_ns())[0]
        elif self._is_observed:
            self._schedule_tick(self._time.now_ns(), setting.interval * _HUNDREDTH_NS)

    def fire_pulse(self) -> None:
        """One trigger pulse."""
        if self.report is not None:
            self.report()
        if not self.listeners:
            return
        if self._fall is not None:
            self._fall.cancel()
        self._fall = self._time.call_after(_WIDTH_NS, self._end_pulse)
        self._set_level(level=True)

    def _end_pulse(self) -> None:
        self._fall = None
        self._set_level(level=False)

    def _set_level(self, *, level: bool) -> None:
        if level == self.level:
            return
        self.level = level
        for listener in self.listeners:
            listener(TRIGGER_LINE, level)

    @property
    def _is_observed(self) -> bool:
        return self.report is not None or bool(self.listeners)

    def set_listener(self, report: Callable[[], None] | None) -> None:
        """Call `report` at every trigger from now on; None: stop."""
        self.report = report
        self.set_trigger(self.setting)

    def clear_trigger(self) -> None:
        """Power-down."""
        self.report = None
        self.set_trigger(None)
        if self._fall is not None:
            self._fall.cancel()
            self._end_pulse()

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
        """Find the next trigger on a path that begins, or has changed."""
        setting = self.setting
        if not self._is_observed or setting is None or setting.axis is None or setting.axis.run is not run:
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
        time_s = (now_ns - run.t0_ns) * 1e-9
        signs = {PULSE: (1, -1), SCALE_PLUS: (1,), SCALE_MINUS: (-1,)}[setting.mode]
        step = self._pulse_interval(setting, track.axis)
        due: tuple[float, float, int] | None = None
        for sign in signs:
            position = self._last + sign * step
            t = track.path.first_at(position - track.start, sign, time_s)
            if t is not None and (due is None or t < due[0]):
                due = (t, position, sign)
        if due is None:
            return
        at_ns, (_, position, sign) = run.t0_ns + math.ceil(due[0] * 1e9 - 1e-6), due
        speed = abs(track.path.state_at(due[0] - 1e-9)[1])  # at the end of the path it is 0

        def handle_position() -> None:
            self._timer = None
            # Not if the axis was halted before it came there.
            if self.setting is setting and self._is_at(track.axis, position, sign):
                self._last = position
                if speed <= _MOST_SPEED:
                    self.fire_pulse()
                if track.axis.run is run:
                    self._arm_position(run, setting, at_ns)

        self._timer = self._time.call_at(at_ns, handle_position)

    def _is_at(self, axis: StageAxis, place: float, sign: int) -> bool:
        return sign * (self._drive.exact_state(axis, self._time.now_ns())[0] - place) >= -_REACHED
