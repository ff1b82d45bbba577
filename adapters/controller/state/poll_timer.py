"""When a controller is polled next: after its period, or at once after a wake-up."""

import asyncio

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock

GRID_NS = NS_PER_MS
"""For each controller of a host: polls at rest that are due within so long are made together. Where the processor
sleeps in between, each costs three times as much alone (50 light controllers on one host)."""
MAX_GRID_NS = 50 * NS_PER_MS  # a stop may have to wait for the polls that are made together


def find_poll_grid_ns(controllers: int) -> int:
    """The grid of the instants at which a host with so many controllers polls those at rest, ns."""
    return min(GRID_NS * controllers, MAX_GRID_NS)


class PollTimer:
    """Waits for the next poll of one controller. grid_ns: of the polls of its host."""

    def __init__(self, clock: Clock, grid_ns: int = 1) -> None:
        self._clock = clock
        self._grid_ns = grid_ns
        self._wake = asyncio.Event()

    def wake_up(self) -> None:
        """Poll soon: an activity has begun or ended."""
        self._wake.set()

    async def wait(self, period_s: float) -> None:
        """Wait for this time, or until a wake-up."""
        await self._wait_s(period_s)

    async def wait_on_grid(self, period_s: float) -> None:
        """Wait for about this time, until an instant at which other controllers of the host are polled too, or until a
        wake-up."""
        now_ns = self._clock.now_ns()
        grid_ns = max(1, min(self._grid_ns, round(period_s / 4 * NS_PER_S)))
        due_ns = round((now_ns + period_s * NS_PER_S) / grid_ns) * grid_ns
        await self._wait_s((due_ns - now_ns) / NS_PER_S)

    async def _wait_s(self, period_s: float) -> None:
        timer = asyncio.get_running_loop().call_later(period_s, self._wake.set)
        try:
            await self._wake.wait()
        finally:
            timer.cancel()
        self._wake.clear()

    async def wait_until_ns(self, until_ns: int) -> None:
        """Wait until an instant of the host's clock, or until a wake-up."""
        alarm = self._clock.call_at_ns(until_ns, self._wake.set)
        try:
            await self._wake.wait()
        finally:
            alarm.cancel()
        self._wake.clear()
