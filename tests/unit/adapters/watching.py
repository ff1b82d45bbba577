"""The commanded motion of a simulated controller, observed all the time while a test runs."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from random import Random

from adapters.contract import Driver, JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from sim.core.controller import SimulatedController


@dataclass
class Track:
    """Instants (ns), positions (counts) and velocities (counts/s) of one axis."""

    at_ns: list[int] = field(default_factory=list)
    positions: list[float] = field(default_factory=list)
    velocities: list[float] = field(default_factory=list)

    @property
    def fastest(self) -> float:
        return max(map(abs, self.velocities), default=0.0)

    def steepest(self) -> float:
        """The largest change of velocity, counts/s², between two samples."""
        changes = zip(self.velocities, self.velocities[1:], self.at_ns, self.at_ns[1:], strict=False)
        return max((abs(b - a) / (t1 - t0) * 1e9 for a, b, t0, t1 in changes), default=0.0)

    def between(self, low: float, high: float) -> bool:
        return low <= min(self.positions) and max(self.positions) <= high


class Watch:
    """`async with Watch(...) as tracks`: the true motion of `axes`, by their names."""

    def __init__(
        self, clock: Clock, controller: SimulatedController, axes: Sequence[str], every_ns: int = NS_PER_MS
    ) -> None:
        self._clock = clock
        self._controller = controller
        self._every_ns = every_ns
        self.tracks = {axis: Track() for axis in axes}

    async def __aenter__(self) -> dict[str, Track]:
        self._task = asyncio.get_running_loop().create_task(self._look())
        return self.tracks

    async def __aexit__(self, *args: object) -> None:
        self._task.cancel()
        with suppress(asyncio.CancelledError):
            await self._task

    async def _look(self) -> None:
        while True:
            for axis, track in self.tracks.items():
                track.at_ns.append(self._clock.now_ns())
                track.positions.append(self._controller.position(axis))
                track.velocities.append(self._controller.velocity(axis))
            await sleep_ns(self._clock, self._every_ns)


class Polling:
    """`async with Polling(...)`: polls, or does something else, at a rate, in parallel to the body."""

    def __init__(self, clock: Clock, poll: Callable[[], Awaitable[object]], hz: float = 10.0) -> None:
        self._clock = clock
        self._poll = poll
        self._pause_ns = round(1e9 / hz)

    async def __aenter__(self) -> None:
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def __aexit__(self, *args: object) -> None:
        self._task.cancel()
        with suppress(asyncio.CancelledError):
            await self._task

    async def _run(self) -> None:
        while True:
            await self._poll()
            await sleep_ns(self._clock, self._pause_ns)


async def at_rest(clock: Clock, controller: SimulatedController, axis: str, within_ns: int) -> int:
    """Wait until an axis stands still, and return how long that took."""
    began_ns = clock.now_ns()
    while controller.is_moving(axis):
        assert clock.now_ns() - began_ns <= within_ns, f"{axis} still moves after {within_ns / 1e9} s"
        await sleep_ns(clock, NS_PER_MS // 4)
    return clock.now_ns() - began_ns


@dataclass
class Hand:
    """An operator at the keys of one axis, at random.

    axis, motor: its names in the fleet and in the make.
    low, high: the ends of its travel.
    ramp: counts/s².
    link_ns: from a stop's bytes to the first slower moment.
    """

    clock: Clock
    driver: Driver
    controller: SimulatedController
    axis: str
    motor: str
    draw: Random
    ramp: float
    link_ns: int
    top: float = 0.0

    def __post_init__(self) -> None:
        self.low, self.high = -self.draw.randrange(300, 30_000), self.draw.randrange(300, 30_000)

    async def play(self, rounds: int, alone: bool = True) -> None:
        """Press, change, release; then release finally. alone: this axis is not stopped from elsewhere."""
        for _ in range(rounds):
            if self.draw.random() < 0.7:
                await self._press(alone)
            else:
                await self._let_go(self.draw.random() < 0.5)
            await sleep_ns(self.clock, self.draw.choice((0, 3, 30, 300)) * NS_PER_MS)
        await self._let_go(True)

    async def _press(self, alone: bool) -> None:
        draw, sign = self.draw, self.draw.choice((1, -1))
        speed = draw.choice((draw.uniform(10, 500), draw.uniform(500, 60_000)))
        self.top = max(self.top, speed)
        ramp = draw.choice((self.ramp, self.ramp / 2))
        try:
            await self.driver.jog_axis(self.axis, JogMove(sign * speed, ramp, self.high if sign > 0 else self.low))
        except Refusal as refused:
            if refused.code == "at-end":
                assert self.controller.position(self.motor) in (self.low, self.high)
            else:
                assert refused.code == "stopped" and not alone

    async def _let_go(self, wait: bool) -> None:
        await self.driver.stop_axes([self.axis])
        if wait:
            slow_ns = round(self.top / (self.ramp / 2) * NS_PER_S) + self.link_ns
            await at_rest(self.clock, self.controller, self.motor, slow_ns)

    async def check(self, track: Track) -> None:
        """By the ground truth: never beyond the ends, never faster than requested, at rest, and at the position that
        the controller reports."""
        assert track.between(self.low, self.high)
        assert track.fastest <= self.top * (1 + 1e-9)
        reading = (await self.driver.poll()).axes[self.axis]
        assert reading.commanded_counts == self.controller.position(self.motor) and not reading.moving


def not_found(outcome: Mapping[str, Refusal] | BaseException, axis: str) -> str:
    """Why a homing of `axis` has failed, by its result or exception."""
    if isinstance(outcome, BaseException):
        assert isinstance(outcome, Refusal | ControllerFault | LinkClosed), repr(outcome)
        return str(outcome)
    return str(outcome[axis])
