"""Virtual time without asyncio: a queue of timed calls, for one simulated controller on its own."""

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field

from orchestrator.clock.utc import virtual_utc


@dataclass(slots=True)
class _ScheduledCall:
    callback: Callable[[], None] | None

    def cancel(self) -> None:
        self.callback = None


@dataclass(slots=True)
class EventQueue:
    """A `Clock` whose time moves only when its methods are called. Calls of one instant run in the order in which
    they were scheduled."""

    _now_ns: int = 0
    _heap: list[tuple[int, int, _ScheduledCall]] = field(default_factory=list[tuple[int, int, _ScheduledCall]])
    _scheduled: int = 0

    @property
    def kernel_id(self) -> str:
        return "virtual"

    def now_ns(self) -> int:
        return self._now_ns

    def utc(self) -> str:
        return virtual_utc(self._now_ns)

    def call_at_ns(self, at_ns: int, callback: Callable[[], None], leeway_ns: int = 0) -> _ScheduledCall:
        del leeway_ns
        call = _ScheduledCall(callback)
        heapq.heappush(self._heap, (max(at_ns, self._now_ns), self._scheduled, call))
        self._scheduled += 1
        return call

    def next_ns(self) -> int | None:
        """Return the instant of the earliest pending call, or None."""
        while self._heap and self._heap[0][2].callback is None:
            heapq.heappop(self._heap)
        return self._heap[0][0] if self._heap else None

    def make_next_call(self) -> bool:
        """Advance to the earliest call and make it. Return False when there is none."""
        if self.next_ns() is None:
            return False
        at_ns, _, call = heapq.heappop(self._heap)
        self._now_ns = at_ns
        callback, call.callback = call.callback, None
        if callback is not None:
            callback()
        return True

    def run_until_ns(self, at_ns: int) -> None:
        """Make every call up to and including `at_ns`, and leave the clock there."""
        while (due_ns := self.next_ns()) is not None and due_ns <= at_ns:
            self.make_next_call()
        self._now_ns = max(self._now_ns, at_ns)
