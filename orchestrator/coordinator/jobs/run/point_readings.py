"""Measured positions at the points of a scan: readings of axes that stand where the point has sent them."""

from collections.abc import Iterable, Mapping
from fractions import Fraction

from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.coordinator.fleet.listening import Remove
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.fleet import Axis
from orchestrator.model.linear_map import MapError
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.state import AxisState, ControllerState

LOOK_NS, LAST_LOOKS = 5 * NS_PER_MS, 10
TOLERANCE_COUNTS = 1  # rounding of the last count


class PointReadings:
    """Takes readings from the end of the move to a point until the next point is reached. Controllers are read at their
    own rate: an axis that leaves a point before its next reading has none there."""

    def __init__(self, view: FleetView) -> None:
        self._view = view
        self._target: Mapping[str, float] = {}
        self._found: dict[str, float | None] = {}
        self._axes: frozenset[str] = frozenset()
        self._unlisten: Remove | None = None

    def begin_point(self, target: Mapping[str, float]) -> None:
        """The axes have reached a point. target: their positions, in their units."""
        self._target, self._found = target, dict.fromkeys(target)
        self._follow(frozenset(target))
        for controller in self._list_controllers(target):
            state = self._view.last_state(controller)
            if state is not None:
                self._take_state(state)

    def read_positions(self) -> dict[str, float | None]:
        """The last readings at the point, in the axes' units; None: there was none."""
        return dict(self._found)

    async def wait_for_last(self, clock: Clock) -> None:
        """Wait a moment for the readings at the last point: an event of its end may have overtaken the states."""
        for _ in range(LAST_LOOKS):
            if None not in self._found.values():
                return
            await sleep_ns(clock, LOOK_NS)

    def close(self) -> None:
        """Take no more readings."""
        self._follow(frozenset())

    def _follow(self, axes: frozenset[str]) -> None:
        """Take the readings of these axes, and of no others."""
        if axes == self._axes:
            return
        if self._unlisten is not None:
            self._unlisten()
        self._axes = axes
        self._unlisten = self._view.add_state_listener(self._take_state, self._list_controllers(axes))

    def _list_controllers(self, axes: Iterable[str]) -> list[str]:
        """The controllers of axes, also of those that virtual ones stand for."""
        return list(dict.fromkeys(map(controller_of, self._view.fleet.find_real_axes(axes))))

    def _take_state(self, state: ControllerState) -> None:
        fleet = self._view.fleet
        for axis, position in self._target.items():
            controller, name = split_name(axis)
            if axis in fleet.names.virtual:
                if controller in fleet.virtual_axes.groups_of.get(state.controller, ()):
                    self._take_virtual(axis, position)
            elif controller == state.controller and name in state.axes and state.mode != "offline":
                axis_now = state.axes[name]
                if _stands_at(fleet.axis(axis), axis_now, position):
                    self._found[axis] = axis_now.position

    def _take_virtual(self, axis: str, position: float) -> None:
        """Read a virtual axis where all its real ones are at rest, and have it at the point."""
        fleet, group = self._view.fleet, controller_of(axis)
        virtual_map = fleet.virtual_axes.maps[group]
        axes: list[AxisState] = []
        for name in virtual_map.real:
            controller, axis_name = split_name(name)
            state = self._view.last_state(controller)
            if state is None or state.mode == "offline" or self._view.is_silent(controller):
                return
            axes.append(state.axes[axis_name])
        if any(state.moving or state.homing for state in axes):
            return
        number, positions = virtual_map.virtual.index(axis), [state.position for state in axes]
        try:
            row = virtual_map.find_rows(positions)[number]
            target = virtual_map.observe([state.commanded for state in axes])[number]
            found_position = virtual_map.observe(positions)[number]
        except MapError:
            return
        lengths = (abs(fleet.axis(name).to_length(TOLERANCE_COUNTS)) for name in virtual_map.real)
        if abs(target - position) <= sum(abs(factor) * length for factor, length in zip(row, lengths, strict=True)):
            self._found[axis] = found_position


def _stands_at(axis: Axis, now: AxisState, position: float) -> bool:
    """Whether a reading is of the axis at rest, commanded to this position."""
    if now.moving or now.homing:
        return False
    off = now.axis_counts - axis.to_target_counts(Fraction(str(position)) - now.offset)
    if axis.turn_length is not None:
        turn = abs(axis.to_counts(axis.turn_length) - axis.to_counts(Fraction(0)))
        off = (off + turn // 2) % turn - turn // 2
    return abs(off) <= TOLERANCE_COUNTS
