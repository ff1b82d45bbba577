"""Counts of stops: a command that was under way at a stop must not begin a motion after it."""

import asyncio

from adapters.yaskawa.wire.record import AXIS_LETTERS
from orchestrator.clock.base import Clock, sleep_ns
from orchestrator.model.errors import Refusal


class StopCounts:
    """The number of stops of each axis of one controller."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._stop_counts = [0] * len(AXIS_LETTERS)
        self._all_stopped = asyncio.Event()

    def count_axis(self, index: int) -> None:
        """Count a stop of one axis."""
        self._stop_counts[index] += 1

    def count_all(self) -> None:
        """Count a stop of all axes."""
        self._stop_counts = [stop_count + 1 for stop_count in self._stop_counts]
        self._all_stopped.set()
        self._all_stopped = asyncio.Event()

    def stop_count(self, index: int) -> int:
        """Return a number that every stop of this axis increments."""
        return self._stop_counts[index]

    def require_no_stop(self, axis: str, index: int, since: int) -> None:
        """Raise `Refusal` when a stop has come since `stop_count` returned `since`."""
        if self._stop_counts[index] != since:
            raise Refusal("stopped", f"axis {axis} was stopped meanwhile", "")

    async def sleep_to_stop(self, span_ns: int) -> bool:
        """Sleep for `span_ns`, or until all axes are stopped; return whether they were stopped."""
        all_stopped = self._all_stopped
        sleeping = asyncio.ensure_future(sleep_ns(self._clock, span_ns))
        stopping = asyncio.ensure_future(all_stopped.wait())
        try:
            await asyncio.wait([sleeping, stopping], return_when=asyncio.FIRST_COMPLETED)
        finally:
            sleeping.cancel()
            stopping.cancel()
        return all_stopped.is_set()
