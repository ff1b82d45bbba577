"""The contract of a clock. No part of Tutti reads a clock or sleeps by itself: it gets a `Clock` as an argument.

Instants are `int` nanoseconds on the clock's own scale (live: `CLOCK_MONOTONIC_RAW`, which no clock daemon slews or
steps; virtual: from 0). UTC appears only as RFC 3339 text, for people and logs.
"""

import asyncio
from collections.abc import Callable
from typing import Protocol

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
NS_PER_US = 1_000


class ClockTimer(Protocol):
    """A scheduled call that has not been made yet."""

    def cancel(self) -> None:
        """Cancel the call. Does nothing when it has been made or cancelled already."""
        ...


class Clock(Protocol):
    """Returns the time and calls back at an instant."""

    @property
    def kernel_id(self) -> str:
        """Identifies the time scale: two clocks with one `kernel_id` agree exactly."""
        ...

    def now_ns(self) -> int:
        """The current instant, in nanoseconds on this clock's scale."""
        ...

    def utc(self) -> str:
        """The current instant as RFC 3339 UTC with microseconds, e.g. `2026-11-21T10:00:00.000000Z`."""
        ...

    def call_at_ns(self, at_ns: int, callback: Callable[[], None], leeway_ns: int = 0) -> ClockTimer:
        """Call `callback` at `at_ns`, never earlier; immediately (but not before this returns) if it is past.

        leeway_ns: permitted delay of the call in live operation, where each call wakes a process.
        """
        ...


async def sleep_until_ns(clock: Clock, at_ns: int) -> None:
    """Suspend the running task until `at_ns` on `clock`."""
    loop = asyncio.get_running_loop()
    woken: asyncio.Future[None] = loop.create_future()

    def set_done() -> None:
        if not woken.done():
            woken.set_result(None)

    timer = clock.call_at_ns(at_ns, set_done)
    try:
        await woken
    finally:
        timer.cancel()


async def sleep_ns(clock: Clock, duration_ns: int) -> None:
    """Suspend the running task for `duration_ns`."""
    await sleep_until_ns(clock, clock.now_ns() + duration_ns)
