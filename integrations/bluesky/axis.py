"""An axis of a fleet as a device that plans move, read, and fly at constant speed."""

import asyncio
from contextlib import AsyncExitStack
from dataclasses import dataclass
from functools import cached_property
from math import isfinite, sqrt

from ophyd_async.core import (
    AsyncStatus,
    FlyableLogic,
    FlyMotorInfo,
    LazyMock,
    MovableLogic,
    SignalRW,
    SoftSignalBackend,
    StandardFlyable,
    StandardMovable,
    StandardReadable,
    TimeoutCalculator,
    soft_signal_r_and_setter,
)
from ophyd_async.core import StandardReadableFormat as Format

from integrations.bluesky.connection import TuttiConnection
from integrations.bluesky.readings import PlaceReading, make_position_signal
from tutti import ArmedMove, AxisInfo, Move, StepReport, TuttiError

MARGIN_S = 60.0  # of a move's time-out: a fleet says by itself what has become of a move, unless it is gone


class OutOfLimits(TuttiError, ValueError):
    """A position outside the soft limits of an axis, or no number."""


@dataclass
class AxisFlight:
    """A flight at constant speed. context: keeps its live job. armed: the move that waits. ramp_s: to its speed."""

    context: AsyncExitStack
    armed: ArmedMove
    ramp_s: float


@dataclass
class AxisLogic(MovableLogic[float], FlyableLogic[FlyMotorInfo, AxisFlight]):
    """Moves and flies one axis. velocity: signal, in units of the axis per second."""

    velocity: SignalRW[float]
    axis: "TuttiAxis"
    flight: AxisFlight | None = None

    # Moves

    async def check_move(self, new_position: float) -> None:
        """Raise `OutOfLimits`."""
        self.axis.check_target(new_position)

    async def calculate_timeout(self, old_position: float, new_position: float) -> float:
        """At most this many seconds."""
        speed = await self.axis.find_speed()
        return abs(new_position - old_position) / speed + 2 * self.axis.find_ramp_s(speed) + MARGIN_S

    async def move(self, new_position: float, timeout: TimeoutCalculator) -> None:
        """Move, and show where the axis was read behind it. Raises `Refusal`, `StepFailed`, `JobFailed`."""
        await self.setpoint.set(new_position)
        speed = await self.axis.find_speed()
        async with asyncio.timeout(timeout()):
            await self.axis.move_to(new_position, speed)

    # Flights

    async def on_prepare(self, value: FlyMotorInfo) -> AxisFlight:
        """Move to the beginning of the run-up, and load the flight. Raises `OutOfLimits`, `Refusal`, `JobFailed`."""
        axis, info, speed = self.axis, self.axis.info, value.speed
        if not 0 < speed <= info.velocity:
            raise OutOfLimits(
                f"{info.name} flies at {speed:g} {info.unit}/s; its limit is {info.velocity:g} {info.unit}/s"
            )
        ramp_s = axis.find_ramp_s(speed)
        begin, end = value.ramp_up_start_pos(ramp_s), value.ramp_down_end_pos(ramp_s)
        axis.check_target(begin)
        axis.check_target(end)
        await axis.move_to(begin, await axis.find_speed())
        await self.setpoint.set(end)
        async with AsyncExitStack() as context:
            live = await context.enter_async_context(axis.connection.moves.use_live([info.name]))
            motion = await live.arm(
                Move(to={info.name: end}, speed=format_speed(speed, info)), timeout_s=axis.armed_timeout_s
            )
            self.flight = AxisFlight(context.pop_all(), motion, ramp_s)
        return self.flight

    async def on_kickoff(self, ctx: AxisFlight) -> AxisFlight:
        """Start the flight, and return when the axis has its speed. Raises `Refusal`."""
        await ctx.armed.go()
        # The promise of the start is some ms behind the request, and what follows needs the speed: not earlier.
        await asyncio.sleep(ctx.armed.lead_s + ctx.ramp_s)
        return ctx

    async def on_complete(self, ctx: AxisFlight) -> None:
        """Wait until the axis is at rest behind its run-down. Raises `StepFailed`, `JobFailed`."""
        try:
            self.axis.take_report(await ctx.armed.wait())
        finally:
            await self._end_flight()

    async def stop(self) -> None:
        """Stop a flight; a move is stopped by its cancelled task."""
        if self.flight is not None:
            async with self.axis.connection.moves.use_live([self.axis.info.name]) as live:
                await live.stop()
            await self._end_flight()

    async def _end_flight(self) -> None:
        flight, self.flight = self.flight, None
        if flight is not None:
            await flight.context.aclose()


class TuttiAxis(StandardMovable[float], StandardFlyable[FlyMotorInfo, AxisFlight], StandardReadable):
    """`controller.axis` of the fleet of a connection.

    Reading: the position, with the UTC at which the controller was read; after a move it is at least as new as the end
    of that. Configuration: `velocity` (units per second, set it for later moves; at first the limit of the axis),
    `acceleration_time` (s, at that limit), `clock_bound` (s: how well the controller's clock is known),
    `start_bound` (s: the predicted start skew of the last move) and `verdict` of it (`green`: proven as promised).
    """

    armed_timeout_s = 600.0
    """How long a flight that is prepared waits for its kickoff."""

    def __init__(self, connection: TuttiConnection, axis: str, name: str = "") -> None:
        self.connection = connection
        self.axis = axis
        self._info: AxisInfo | None = None
        readback, self._place = make_position_signal(axis)
        self._with_units = {"": SoftSignalBackend(float), "/s": SoftSignalBackend(float)}
        with self.add_children_as_readables(Format.HINTED_SIGNAL):
            self.user_readback = readback
        with self.add_children_as_readables(Format.CONFIG_SIGNAL):
            self.velocity = SignalRW(self._with_units["/s"])
            self.acceleration_time, self._set_ramp = soft_signal_r_and_setter(float, units="s")
            self.clock_bound, self._set_clock_bound = soft_signal_r_and_setter(float, float("nan"), units="s")
            self.start_bound, self._set_start_bound = soft_signal_r_and_setter(float, float("nan"), units="s")
            self.verdict, self._set_verdict = soft_signal_r_and_setter(str, "none")
        self.user_setpoint = SignalRW(self._with_units[""])
        super().__init__(name=name)
        self._stage_funcs += (self._stage_moves,)
        self._unstage_funcs += (self._unstage_moves,)

    # Logic

    @cached_property
    def _logic(self) -> AxisLogic:
        return AxisLogic(self.user_setpoint, self.user_readback, velocity=self.velocity, axis=self)

    @cached_property
    def movable_logic(self) -> AxisLogic:
        """How it moves."""
        return self._logic

    @cached_property
    def flyable_logic(self) -> AxisLogic:
        """How it flies."""
        return self._logic

    # Connection

    async def connect(
        self,
        mock: bool | LazyMock = False,  # noqa: FBT001, FBT002 (the library's interface)
        timeout: float = 10.0,
        force_reconnect: bool = False,  # noqa: FBT001, FBT002
    ) -> None:
        """Connect to the fleet, and read what the axis is. Raises `Refusal`: codes `unknown-axis`, `absent`, and those
        of `TuttiConnection.open`. mock: without a fleet; moves set the reading."""
        await super().connect(mock=mock, timeout=timeout, force_reconnect=force_reconnect)
        if mock:
            return
        tutti = await self.connection.open()
        self._info = info = await tutti.axis(self.axis)
        for suffix, backend in (*self._with_units.items(), ("", self._place)):
            backend.metadata.update(units=info.unit + suffix, precision=info.digits)
        if not await self.velocity.get_value():
            await self.velocity.set(info.velocity)
        self._set_ramp(self.find_ramp_s(info.velocity))
        async with asyncio.timeout(timeout):
            await self.connection.reader.follow(tutti, self.axis, self._show)
        await self.user_setpoint.set(await self.user_readback.get_value())

    @property
    def info(self) -> AxisInfo:
        """What does not change about the axis. Raises `RuntimeError` before it is connected, and of a mock."""
        if self._info is None:
            raise RuntimeError(f"{self.name or self.axis} is not connected to a fleet")
        return self._info

    def check_target(self, position: float) -> None:
        """Raise `OutOfLimits` for what is no position of the axis."""
        name = self.name or self.axis
        if not isfinite(position):
            raise OutOfLimits(f"{name}: {position} is no position")
        info = self._info
        if info is None or info.least is None or info.most is None:
            return
        if not info.least <= position <= info.most:
            limits = f"{info.least:g} … {info.most:g} {info.unit}"
            raise OutOfLimits(f"{name}: {position:g} {info.unit} is outside the soft limits of {info.name}, {limits}")

    async def find_speed(self) -> float:
        """The speed of the next move, units per second. Raises `OutOfLimits`."""
        speed = await self.velocity.get_value()
        most = self.info.velocity if self._info is not None else speed
        if not 0 < speed <= most:
            unit = "" if self._info is None else f" {self._info.unit}/s"
            raise OutOfLimits(
                f"{self.velocity.name}: {speed:g}{unit} is no speed; set more than 0 and at most {most:g}{unit}"
            )
        return speed

    def find_ramp_s(self, speed: float) -> float:
        """How long the axis needs from rest to a speed, with its limits of acceleration and jerk, s."""
        if self._info is None:
            return 0.0
        acceleration, jerk = self._info.acceleration, self._info.jerk
        if jerk is None:
            return speed / acceleration
        if speed * jerk < acceleration * acceleration:
            return 2 * sqrt(speed / jerk)
        return speed / acceleration + acceleration / jerk

    # Moves

    async def move_to(self, position: float, speed: float) -> None:
        """Move at a speed, units per second, and take where it was read behind that. Raises `Refusal`, `StepFailed`,
        `JobFailed`."""
        if self._info is not None:
            report = await self.connection.moves.move(self.axis, position, format_speed(speed, self._info))
            self.take_report(report)

    def take_report(self, report: StepReport) -> None:
        """Show what the report of a move has: the reading behind it, its bound and its verdict."""
        if self.axis in report.positions:
            self.connection.reader.note_place(self.axis, report.positions[self.axis])
        if report.budget is not None:
            self._set_start_bound(report.budget.predicted_ns / 1e9)
        self._set_verdict(report.verdict)

    def _show(self, reading: PlaceReading) -> None:
        self._place.show(reading)
        self._set_clock_bound(reading.clock_bound_s)

    @AsyncStatus.wrap
    async def _stage_moves(self) -> None:
        self.connection.moves.stage(self.axis)

    @AsyncStatus.wrap
    async def _unstage_moves(self) -> None:
        await self.connection.moves.unstage(self.axis)


def format_speed(speed: float, info: AxisInfo) -> str:
    """A speed as steps have it."""
    return f"{speed:.9g} {info.unit}/s"
