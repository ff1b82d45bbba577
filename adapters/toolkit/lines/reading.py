"""The reading of a controller with text lines, from its status."""

from collections.abc import Set
from dataclasses import replace

from adapters.contract import AxisReading, ControllerReading, HostInterval
from adapters.toolkit.lines.dialect import LineDialect
from adapters.toolkit.lines.unit import LineUnitState
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.fleet import Controller
from orchestrator.model.state import FaultReport


class LineReader:
    """The readings of one controller, which outlive its connections."""

    def __init__(self, config: Controller, dialect: LineDialect) -> None:
        self._config = config
        self._dialect = dialect
        self.was_sound = False
        """Whether the last status showed no alarm."""
        self._has_alarm = False
        """An alarm came while it was connected; one that it has from the beginning is its lock after power-up, where
        enabling its axes unlocks it."""
        self.lost_axes: set[str] = set()
        """The axes whose position is not known since an alarm; each until it is homed."""
        self.last: ControllerReading | None = None

    def repeat_moving(self, at_ns: int) -> ControllerReading | None:
        """Return the last reading again, with all axes in motion: a controller that searches may not answer. Its
        positions are as old as they are."""
        if self.last is None:
            return None
        axes = {name: replace(axis, moving=True) for name, axis in self.last.axes.items()}
        return replace(self.last, at_ns=at_ns, axes=axes, restarted=False)

    def make_reading(self, state: LineUnitState, enabled: Set[str], *, restarted: bool) -> ControllerReading:
        """Return the reading of a state, which is the last one from now on. enabled: the axes that are enabled."""
        self._note_alarm(state)
        interval = HostInterval(state.reply.sent_ns, state.reply.at_ns)
        at_ns = (interval.earliest_ns + interval.latest_ns) // 2
        is_locked = state.status.state == "alarm" and self._dialect.traits.switches_motors
        axes: dict[str, AxisReading] = {}
        for name, axis in self._config.axes.items():
            status, counts = state.status.axes[axis.motors[0]], state.counts[name]
            is_moving = status.moving and state.status.state == "moving"
            axes[name] = AxisReading(
                commanded_counts=counts,
                actual_counts=float(counts),
                velocity_counts_s=self._estimate_velocity(name, counts, at_ns) if is_moving else 0.0,
                moving=is_moving,
                enabled=name in enabled and not is_locked,
                position_lost=name in self.lost_axes,
                limit=status.limit,
            )
        faults: list[FaultReport] = []
        if self._has_alarm:
            faults.append(FaultReport(code="alarm", text=state.status.alarm, remedy="clear it with `tutti reset`"))
        self.last = ControllerReading(at_ns, axes, faults=faults, restarted=restarted, sampled=interval)
        return self.last

    def _note_alarm(self, state: LineUnitState) -> None:
        """Note an alarm: it may have stopped the motors dead."""
        is_alarm = state.status.state == "alarm"
        if is_alarm and (self.was_sound or not self._dialect.traits.switches_motors):
            self._has_alarm = True
            self.lost_axes.update(self._config.axes)
        self.was_sound = not is_alarm
        self._has_alarm = self._has_alarm and is_alarm

    def _estimate_velocity(self, axis: str, counts: int, at_ns: int) -> float:
        """Return the mean velocity since the last poll: the controller reports none."""
        if self.last is None or at_ns <= self.last.at_ns:
            return 0.0
        return (counts - self.last.axes[axis].commanded_counts) * NS_PER_S / (at_ns - self.last.at_ns)
