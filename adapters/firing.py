"""Bytes that are written at an instant: the order, the last step that all firers share, and the firer of a loop.

Live, a process of its own fires (`adapters.firing_process`): beside a busy event loop even a thread is late by
milliseconds. In virtual time the loop is exact, so it fires itself, through the same last step.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from adapters.contract import Fired
from orchestrator.clock.base import Clock, Timer
from orchestrator.link.base import Link


@dataclass(frozen=True, slots=True)
class Order:
    """Write `data` at host time `at_ns`, and not at all if that could only be after `latest_ns`."""

    data: bytes
    at_ns: int
    latest_ns: int


def fire(order: Order, now_ns: Callable[[], int], write: Callable[[bytes], object]) -> Fired:
    """The last step: `at_ns` has come. Never fires late."""
    instant_ns = now_ns()
    if instant_ns > order.latest_ns:
        return Fired(instant_ns, late=True)
    write(order.data)
    return Fired(instant_ns, late=False)


class _LoopOrder:
    """An order that waits on the clock."""

    def __init__(self, clock: Clock, link: Link, order: Order) -> None:
        self._fired: asyncio.Future[Fired] = asyncio.get_running_loop().create_future()
        self._clock = clock
        self._link = link
        self._order = order
        self._timer: Timer = clock.call_at_ns(order.at_ns, self._fire)

    def _fire(self) -> None:
        if not self._fired.done():
            try:
                self._fired.set_result(fire(self._order, self._clock.now_ns, self._link.write))
            except Exception as error:
                self._fired.set_exception(error)

    def cancel(self) -> bool:
        if self._fired.done():
            return False
        self._timer.cancel()
        self._fired.cancel()
        return True

    async def done(self) -> Fired:
        return await asyncio.shield(self._fired)


class LoopFirer:
    """Fires from the event loop, which is exact in virtual time. `wake_ns` draws how late a process would wake."""

    def __init__(self, clock: Clock, wake_ns: Callable[[], int] = lambda: 0) -> None:
        self._clock = clock
        self._wake_ns = wake_ns

    def schedule(self, link: Link, data: bytes, at_ns: int, latest_ns: int) -> _LoopOrder:
        return _LoopOrder(self._clock, link, Order(data, at_ns + self._wake_ns(), latest_ns))
