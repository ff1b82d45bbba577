"""How long controllers are online, in fault and offline, and how long axes are jogged, by the states that arrive."""

from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.state import ControllerState

Count = Callable[[str, str, str, float], None]
"""Adds a value to a figure: kind, subject, figure, value."""


@dataclass(slots=True)
class _LastState:
    """since_ns: until then its times are counted. jogged: by axis, its last reading while it was jogged, in counts, and
    when that was."""

    status: str
    since_ns: int
    jogged: dict[str, tuple[float, int]]


class AvailabilityClock:
    """Counts the times of all controllers of `view`."""

    def __init__(self, view: FleetView, clock: Clock, count: Count) -> None:
        self._view = view
        self._clock = clock
        self._count = count
        self._last: dict[str, _LastState] = {}

    def take_state(self, state: ControllerState) -> None:
        """Count the time until now by what the controller was, if that has changed; and what is jogged."""
        status = "offline_s" if state.mode == "offline" else "fault_s" if state.faults else "online_s"
        last = self._last.get(state.controller)
        if last is None or last.status != status:
            self._count_time(state.controller, status)
        elif last.jogged or state.mode == "jogging":
            self._count_jogs(state, last.jogged)

    def tick(self) -> None:
        """Count the time until now; a controller that is silent is offline."""
        for controller in self._view.fleet.controllers:
            last = self._last.get(controller)
            silent = last is None or self._view.is_silent(controller)
            self._count_time(controller, "offline_s" if silent or last is None else last.status)

    def _count_time(self, controller: str, status: str) -> None:
        now_ns, last = self._clock.now_ns(), self._last.get(controller)
        if last is None:
            self._last[controller] = _LastState(status, now_ns, {})
            return
        if now_ns > last.since_ns:
            self._count("controller", controller, last.status, (now_ns - last.since_ns) / NS_PER_S)
        last.status, last.since_ns = status, now_ns

    def _count_jogs(self, state: ControllerState, jogged: dict[str, tuple[float, int]]) -> None:
        """Add the way and the time of axes that are jogged: from reading to reading."""
        axes, now_ns = self._view.fleet.controllers[state.controller].axes, self._clock.now_ns()
        for name in axes.keys() & state.axes.keys():
            last_jog, counts = jogged.pop(name, None), state.axes[name].raw_counts
            if state.mode == "jogging":
                jogged[name] = (counts, now_ns)
            if last_jog is not None and last_jog[0] != counts:
                full, way = f"{state.controller}.{name}", abs(axes[name].to_length(counts - last_jog[0]))
                self._count("axis", full, f"distance {axes[name].unit}", way)
                self._count("axis", full, "moving_s", (now_ns - last_jog[1]) / NS_PER_S)
