"""Motor records of the axes of a fleet: their drivers by jobs and manual control, their readings by its states."""

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from datetime import datetime

from integrations.epics.lanes import GATHER_S, Lane
from integrations.epics.readings import AxisReading
from integrations.epics.record import MotorRecord
from tutti import (
    AxisInfo,
    Disable,
    Enable,
    Home,
    JobReport,
    Refusal,
    SetPosition,
    StateReading,
    TaskOwner,
    Tutti,
    running,
)

STALE_S = 3.0  # a controller publishes its state at least once a second
REST_S = 5.0


class FleetAxis:
    """One axis, as the driver of its record."""

    def __init__(self, lane: Lane, info: AxisInfo, first: AxisReading, velocity: float) -> None:
        self._lane = lane
        self._info = info
        self._tasks = TaskOwner()
        self._is_moving = False
        self._further: float | None = None
        self._released = asyncio.Event()
        self._read = asyncio.Event()
        self.record = MotorRecord(info, first, velocity, self)

    def move(self, target: float, velocity: float) -> None:
        """As `AxisDriver.move`."""
        speed = min(1.0, velocity / self._info.velocity)
        if not self._is_moving:
            self._is_moving = True
            self._begin(self._move(self._lane.move(self._info.name, target, speed), speed))
        elif not self._lane.redirect(self._info.name, target):
            self._further = target  # the move is over, and its end is not known to the record yet

    def jog(self, velocity: float) -> None:
        """As `AxisDriver.jog`."""
        self._released = asyncio.Event()
        self._begin(self._lane.jog(self._info.name, velocity, self._released))

    def home(self) -> None:
        """As `AxisDriver.home`."""
        self._begin(self._lane.run(self._info.name, Home(axes=[self._info.name])))

    def set_position(self, position: float) -> None:
        """As `AxisDriver.set_position`."""
        step, counts = SetPosition(axes={self._info.name: position}), abs(self._info.resolution)
        self._begin(self._change(step, lambda reading: abs(reading.commanded - position) <= counts))

    def enable(self, *, on: bool) -> None:
        """As `AxisDriver.enable`."""
        step = (Enable if on else Disable)(axes=[self._info.name])
        self._begin(self._change(step, lambda reading: reading.enabled == on))

    def stop(self) -> None:
        """As `AxisDriver.stop`."""
        self._released.set()
        self._tasks.spawn(self._lane.stop(self._info.name))

    def take(self, reading: AxisReading) -> None:
        """Take a newer reading."""
        self.record.read(reading)
        self._read.set()

    def close(self) -> None:
        """End what goes on; its jobs end with their session."""
        self._tasks.cancel_all()

    def _begin(self, operation: Coroutine[None, None, str | None]) -> None:
        self._tasks.spawn(self._run(operation))

    async def _change(self, step: SetPosition | Enable | Disable, shows: Callable[[AxisReading], bool]) -> str | None:
        """Run a step that moves nothing; it has ended for the record once a reading shows what it has changed, since a
        client that waits for the end reads the fields then."""
        error = await self._lane.run(self._info.name, step)
        if error is None:
            await self._wait_for_reading(shows)
        return error

    async def _move(self, ending: Awaitable[str | None], speed: float) -> str | None:
        error = await ending
        while error is None and self._further is not None:
            target, self._further = self._further, None
            error = await self._lane.move(self._info.name, target, speed)
        return error

    async def _run(self, operation: Coroutine[None, None, str | None]) -> None:
        error = await operation
        if error is not None or self.record.reading.moving:
            await self._wait_for_rest()
        self._is_moving, self._further = False, None
        self.record.end(error)

    async def _wait_for_rest(self) -> None:
        """Wait for a reading from now on at which the axis does not move; an axis that is offline has none."""
        self._read.clear()
        with suppress(TimeoutError):
            async with asyncio.timeout(REST_S):
                await self._read.wait()
                await self._wait_for_reading(lambda reading: not reading.moving)

    async def _wait_for_reading(self, shows: Callable[[AxisReading], bool]) -> None:
        """Wait until the reading is such a one; not for ever, because an axis that is offline has none."""
        with suppress(TimeoutError):
            async with asyncio.timeout(REST_S):
                while not shows(self.record.reading):
                    self._read.clear()
                    await self._read.wait()


@asynccontextmanager
async def open_axes(tutti: Tutti) -> AsyncGenerator[list[FleetAxis]]:
    """The real axes of a fleet, whose records follow its states while the context lasts. What they have begun ends with
    it. Raises `Refusal`."""
    fleet = await tutti.load_fleet()
    axes: dict[str, FleetAxis] = {}

    def note_end(report: JobReport) -> None:
        for name, entry in report.steps[-1].positions.items():
            reading = replace(axes[name].record.reading, position=entry.position, moving=False, utc_s=None)
            axes[name].take(replace(reading, fleet_ns=entry.read.latest_ns))

    async with tutti.attend() as attendance:
        states = await tutti.status()
        for controller, config in fleet.controllers.items():
            info = await tutti.controller_info(controller)
            common_lane = Lane(tutti, attendance.session, GATHER_S if len(config.axes) > 1 else 0.0, note_end)
            if controller not in states:
                text = f"controller {controller} has no adapter now"
                raise Refusal("absent", text, "begin when all controllers of the fleet have one", controller)
            for name, axis_config in config.axes.items():
                axis_now = states[controller].axes[name]
                lane = Lane(tutti, attendance.session, 0.0, note_end) if info.independent_axes else common_lane
                axis = f"{controller}.{name}"
                first = AxisReading(axis_now.position, axis_now.commanded, float(axis_now.offset))
                velocity = axis_config.limits.velocity * axis_config.manual_speed
                axes[axis] = FleetAxis(lane, await tutti.axis(axis), first, velocity)
        async with running(_follow_states(tutti, axes)), running(_watch_age(axes)):
            try:
                yield list(axes.values())
            finally:
                for axis in axes.values():
                    axis.close()


async def _follow_states(tutti: Tutti, axes: dict[str, FleetAxis]) -> None:
    async for state in tutti.states(list(axes)):
        for name, reading in _make_readings(state).items():
            axes[name].take(reading)


async def _watch_age(axes: dict[str, FleetAxis]) -> None:
    """Note an axis as offline when no reading of it comes any more."""
    last_readings: dict[str, AxisReading] = {}
    while True:
        await asyncio.sleep(STALE_S)
        for name, axis in axes.items():
            reading = axis.record.reading
            if last_readings.get(name) is reading and reading.online:
                axis.take(replace(reading, online=False, moving=False, utc_s=None, fleet_ns=None))
            last_readings[name] = reading


def _make_readings(state: StateReading) -> dict[str, AxisReading]:
    utc_s = datetime.fromisoformat(state.utc).timestamp()
    return {
        name: AxisReading(
            position=axis.position,
            commanded=axis.commanded,
            offset=float(axis.offset),
            moving=axis.moving or axis.homing,
            enabled=axis.enabled,
            referenced=axis.referenced,
            limit=axis.limit,
            fault=axis.fault or "",
            online=state.mode != "offline",
            utc_s=utc_s,
            fleet_ns=None if state.read is None else state.read.latest_ns,
        )
        for name, axis in state.axes.items()
    }
