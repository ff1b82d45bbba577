"""Where the axes of a connection are, with the instant of each reading, and a signal that shows it."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime

from bluesky.protocols import Reading
from ophyd_async.core import SignalR, SoftSignalBackend

from tutti import ReadPosition, Refusal, StateReading, TaskOwner, Tutti, controller_of

NS_PER_S = 1_000_000_000
INVALID = 3  # alarm severity of a reading that is old: the controller is offline
NO_ALARM = 0


@dataclass(frozen=True, slots=True)
class PlaceReading:
    """A position as it was read. read_ns: the end of the interval of fleet time in which that was, 0: not known.
    time_s: UTC of its middle, s since 1970. offline: the controller does not answer, and this is the last one."""

    position: float
    read_ns: int
    time_s: float
    offline: bool = False
    clock_bound_s: float = float("nan")


class PositionBackend(SoftSignalBackend[float]):
    """A signal whose readings have the instant at which the controller was read. axis: that it shows."""

    def __init__(self, axis: str) -> None:
        self._axis = axis
        super().__init__(float)

    def source(self, name: str, read: bool) -> str:  # noqa: FBT001 (the library's interface)
        """Where its values come from."""
        del name, read
        return f"tutti://{self._axis}"

    def show(self, reading: PlaceReading) -> None:
        """Show a reading, and pass it to what is subscribed."""
        severity = INVALID if reading.offline else NO_ALARM
        self.reading = Reading(value=reading.position, timestamp=reading.time_s, alarm_severity=severity)
        if self.callback is not None:
            self.callback(self.reading)


def make_position_signal(axis: str) -> tuple[SignalR[float], PositionBackend]:
    """The position of an axis, and what it is shown by."""
    backend = PositionBackend(axis)
    return SignalR(backend), backend


class PlaceReader:
    """Follows the states of controllers for the axes of a connection: one subscription for each controller."""

    def __init__(self) -> None:
        self._listeners: dict[str, list[Callable[[PlaceReading], None]]] = {}
        self._newest: dict[str, PlaceReading] = {}
        self._tasks = TaskOwner()
        self._followed = set[str]()
        self._first: dict[str, asyncio.Event] = {}
        self._utc_offset_ns = 0
        """UTC minus fleet time, by the reading that came last."""

    async def follow(self, tutti: Tutti, axis: str, show: Callable[[PlaceReading], None]) -> None:
        """Call `show` with every reading of an axis from now on; return after the first one."""
        self._listeners.setdefault(axis, []).append(show)
        if axis in self._newest:
            show(self._newest[axis])
        await self.wait_for_first(tutti, axis)

    async def wait_for_first(self, tutti: Tutti, axis: str) -> None:
        """Follow an axis, and wait until it was read once."""
        controller = controller_of(axis)
        first_event = self._first.setdefault(axis, asyncio.Event())
        if controller not in self._followed:
            self._followed.add(controller)
            self._tasks.spawn(self._follow_controller(tutti, controller))
        await first_event.wait()

    def find_utc_s(self, fleet_ns: int) -> float:
        """UTC of an instant of fleet time, s since 1970, by the last reading of a controller that is followed."""
        return (fleet_ns + self._utc_offset_ns) / NS_PER_S

    def note_place(self, axis: str, place: ReadPosition) -> None:
        """A position that a report has: states that were read before it do not replace it."""
        middle_ns = (place.read.earliest_ns + place.read.latest_ns) // 2
        time_s = self.find_utc_s(middle_ns)
        bound_s = self._newest[axis].clock_bound_s if axis in self._newest else float("nan")
        self._take(axis, PlaceReading(place.position, place.read.latest_ns, time_s, clock_bound_s=bound_s))

    def close(self) -> None:
        """End the subscriptions."""
        self._followed.clear()
        self._tasks.cancel_all()

    async def _follow_controller(self, tutti: Tutti, controller: str) -> None:
        axes = [name for name in (await tutti.list_names()).axes if controller_of(name) == controller]
        try:
            async for state in tutti.states(axes):
                self._take_state(state)
        except Refusal as error:
            if error.code != "closed":
                raise

    def _take_state(self, state: StateReading) -> None:
        time_s = datetime.fromisoformat(state.utc).timestamp()
        read_ns = 0
        if state.read is not None:
            read_ns = state.read.latest_ns
            self._utc_offset_ns = round(time_s * NS_PER_S) - (state.read.earliest_ns + read_ns) // 2
        bound_s = float("nan") if state.clock is None else state.clock.bound_ns / NS_PER_S
        for axis, axis_now in state.axes.items():
            is_offline = state.mode == "offline"
            self._take(axis, PlaceReading(axis_now.position, read_ns, time_s, is_offline, bound_s))

    def _take(self, axis: str, reading: PlaceReading) -> None:
        newest = self._newest.get(axis)
        if newest is not None and 0 < reading.read_ns < newest.read_ns:
            return
        self._newest[axis] = reading
        for show in self._listeners.get(axis, []):
            show(reading)
        if axis in self._first:
            self._first[axis].set()
