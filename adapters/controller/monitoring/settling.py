"""Following error, settling and rest: the deviation of axes from their command, and when they have reached it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from adapters.contract import ControllerReading
from adapters.controller.monitoring.polling import StatePolling
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.model.state import FaultReport

SETTLING_POLL_NS = 10 * NS_PER_MS
REST_POLL_NS = 50 * NS_PER_MS
LAST_MOTION_S = 0.5


@dataclass(frozen=True, slots=True)
class SettlingResult:
    """Result of settling.

    settled_s: by axis, from the end of its profile until it was seen inside its window.
    reason: which axis has not settled; empty if all have.
    wrong_ends: axes that rest elsewhere than where their step ends, in words."""

    settled_s: Mapping[str, float] = field(default_factory=dict[str, float])
    reason: str = ""
    wrong_ends: Mapping[str, str] = field(default_factory=dict[str, str])


class SettlingMonitor:
    """Deviations of one controller's axes, checked against the limits of the fleet file. polling: reads the controller
    and publishes at once."""

    def __init__(self, clock: Clock, status: ControllerStatus, polling: StatePolling) -> None:
        self._clock = clock
        self._status = status
        self._polling = polling

    def find_following_errors(self, reading: ControllerReading) -> list[FaultReport]:
        """Return a fault for each axis whose following error is too large; axes with the motor off are exempt."""
        faults: list[FaultReport] = []
        for name, axis in self._status.config.axes.items():
            axis_reading = reading.axes[name]
            if axis.following_error is None or not axis_reading.enabled:
                continue
            off = abs(axis_reading.actual_counts - axis_reading.commanded_counts) / float(axis.scale)
            if off > axis.following_error:
                text = f"axis {name} is {off:g} {axis.unit} off its command; {axis.following_error:g} are allowed"
                remedy = "find what blocks the axis; then disable and enable it, which accepts its present position"
                faults.append(FaultReport(code="following-error", text=text, remedy=remedy, axis=name))
        return faults

    async def wait_for_rest(self, axes: Sequence[str], within_ns: int) -> bool:
        """Wait until none of `axes` moves. Return whether that took at most `within_ns` and the controller was
        readable."""
        until_ns = self._clock.now_ns() + within_ns
        while self._clock.now_ns() < until_ns:
            await self._polling.poll_and_publish()
            reading = self._status.reading
            if reading is None:
                return False
            if not any(reading.axes[name].moving for name in axes):
                return True
            await sleep_ns(self._clock, REST_POLL_NS)
        return False

    def must_settle(self, axes: Sequence[str]) -> bool:
        """Whether one of `axes` must come to rest inside its window."""
        return any(self._status.config.axes[name].done == "in_position" for name in axes)

    async def wait_until_settled(self, axes: Sequence[str]) -> SettlingResult:
        """Wait, after the ends of the profiles of `axes`, until a reading shows them at rest, and those with `done:
        in_position` inside their windows."""
        configs = self._status.config.axes
        waiting_axes = [name for name in axes if configs[name].done == "in_position"]
        began_ns, settled_s = self._clock.now_ns(), dict[str, float]()
        while True:
            await self._polling.poll_and_publish()
            reading = self._status.require_online()
            gone_s = (self._clock.now_ns() - began_ns) / NS_PER_S
            for name in list(waiting_axes):
                axis, axis_reading = configs[name], reading.axes[name]
                off = abs(axis_reading.actual_counts - axis_reading.commanded_counts) / float(axis.scale)
                if off <= (axis.in_position_window or 0.0):
                    waiting_axes.remove(name)
                    settled_s[name] = gone_s
                elif gone_s > axis.in_position_timeout_s:
                    text = f"axis {name} is still {off:g} {axis.unit} off its target after {gone_s:.3g} s"
                    return SettlingResult(settled_s, f"{text}; its window is {axis.in_position_window:g}")
            # A drive may report motion for a moment after the end of its profile.
            moves = gone_s < LAST_MOTION_S and any(reading.axes[name].moving for name in axes)
            if not waiting_axes and not moves:
                return SettlingResult(settled_s)
            await sleep_ns(self._clock, SETTLING_POLL_NS)
