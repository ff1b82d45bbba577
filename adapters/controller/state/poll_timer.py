"""When a controller is polled next: after its period, or at once after a wake-up."""

import asyncio

from orchestrator.clock.base import Clock


class PollTimer:
    """Waits for the next poll of one controller."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._wake = asyncio.Event()

    def wake_up(self) -> None:
        """Poll soon: an activity has begun or ended."""
        self._wake.set()

    async def wait(self, period_s: float) -> None:
        """Wait for this time, or until a wake-up."""
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
