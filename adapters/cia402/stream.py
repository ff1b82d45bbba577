"""Positions that drives follow, kept ahead of them: behind the SYNC that starts them, one more each period.

All of it is written at instants that were set with the first SYNC, so that the period does not drift against this
computer's clock, and is handed over some periods ahead, so that a busy event loop does no harm. One write has a SYNC,
and behind it the positions for the next one, each twice: a single one that is lost is not missed. In the middle of each
period it is judged by the drives' answers whether all have heard the SYNC and followed.
"""

from collections import deque
from typing import Protocol

from adapters.cia402.bus import SYNC, Bus
from adapters.contract import FireOrder, Firer
from orchestrator.clock.base import sleep_until_ns
from orchestrator.link.can import CanFrame, encode

AHEAD = 5
"""Periods that have been handed over for writing."""
TAIL = 3
"""SYNCs behind the last position: a SYNC may come before the drive is quite there, and have it take one period more."""
COPIES = 2


class Rider(Protocol):
    """One drive in a stream. SYNCs, and the positions that they have the drive go to, are numbered from 0."""

    @property
    def count(self) -> int:
        """Its positions."""
        ...

    def frame(self, number: int) -> CanFrame:
        """A position, which the SYNC of that number takes."""
        ...

    def written(self, number: int, at_ns: int) -> None:
        """A SYNC was handed over at host time `at_ns`."""
        ...

    def judge(self, number: int) -> None:
        """Its answer to a SYNC must have come."""
        ...

    def fail(self, text: str) -> None:
        """The stream can not go on, because of `text`."""
        ...

    def over(self) -> None:
        """No SYNC is to come any more."""
        ...


class Stream:
    """The SYNCs of one start. first_ns: when the first is written. period_ns: from one to the next."""

    def __init__(self, bus: Bus, firer: Firer, first_ns: int, period_ns: int) -> None:
        self._bus = bus
        self._firer = firer
        self._first_ns = first_ns
        self._period_ns = period_ns
        self._riders: dict[int, Rider] = {}
        self._orders: deque[FireOrder] = deque()

    @property
    def riding(self) -> bool:
        return bool(self._riders)

    def join(self, node: int, rider: Rider) -> None:
        """Before the first SYNC."""
        self._riders[node] = rider

    def leave(self, node: int) -> bool:
        """It gets no further position but those that were handed over; whether it was there. No SYNC without riders."""
        was = self._riders.pop(node, None) is not None
        if not self._riders:
            self.cancel()
        return was

    def cancel(self) -> None:
        """What was handed over is not written any more."""
        while self._orders:
            self._orders.popleft().cancel()

    async def run(self, written_ns: int) -> None:
        """From the first SYNC, which was written at `written_ns`, to the last one. Raises `LinkClosed`."""
        # Nobody knew who would ride when the first SYNC was ordered: the second positions follow alone.
        self._order(self._at_ns(0) + self._period_ns // 4, self._positions(1))
        ordered = number = 0
        try:
            while self._riders and number < max(rider.count for rider in self._riders.values()) + TAIL:
                while ordered < number + AHEAD:
                    ordered += 1
                    self._order(self._at_ns(ordered), encode(SYNC) + self._positions(ordered + 1))
                await sleep_until_ns(self._bus.clock, self._at_ns(number) + self._period_ns // 2)
                if not self._riders:
                    return
                fired = await self._orders.popleft().done()
                if fired.late:
                    self._fail(f"had no SYNC in period {number} of its stream: this computer was too busy (underrun)")
                    return
                self._judge(number, fired.written_ns if number else written_ns)
                number += 1
        finally:
            self.cancel()
            for rider in list(self._riders.values()):
                rider.over()

    # Inside

    def _at_ns(self, number: int) -> int:
        return self._first_ns + number * self._period_ns

    def _order(self, at_ns: int, data: bytes) -> None:
        """Later than by a quarter of the period it would meet the next one."""
        self._orders.append(self._firer.schedule(self._bus.can.link, data, at_ns, at_ns + self._period_ns // 4))

    def _positions(self, number: int) -> bytes:
        frames = [rider.frame(number) for rider in self._riders.values() if number < rider.count + TAIL]
        return encode(*frames * COPIES)

    def _judge(self, number: int, written_ns: int) -> None:
        late_ns = self._bus.clock.now_ns() - self._at_ns(number) - self._period_ns // 2
        for rider in list(self._riders.values()):
            rider.written(number, written_ns)
            # Whoever looks too late does not know which SYNC an answer is to.
            if late_ns < self._period_ns // 4:
                rider.judge(number)

    def _fail(self, text: str) -> None:
        for rider in list(self._riders.values()):
            rider.fail(text)
