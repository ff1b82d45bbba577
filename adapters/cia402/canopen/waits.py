"""Waiting for a state of a drive, which its messages change."""

import asyncio
from collections.abc import Callable

from orchestrator.clock.base import Clock
from orchestrator.link.base import LinkClosed


class StateWaits:
    """The tasks that wait for a state of one drive, until its link is lost."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._watchers: list[asyncio.Future[None]] = []
        self._closed: LinkClosed | None = None

    def close(self, error: LinkClosed) -> None:
        """Let all waiting tasks raise `error` once they are woken: the link is lost."""
        self._closed = error

    def wake(self) -> None:
        """Wake all waiting tasks to check their conditions."""
        for watcher in self._watchers:
            if not watcher.done():
                watcher.set_result(None)

    async def wait_until(self, condition: Callable[[], bool], until_ns: int) -> bool:
        """Wait until `condition` holds, at most until that instant; return whether it does. Raises `LinkClosed`."""
        while True:
            if self._closed is not None:
                raise self._closed
            if condition():
                return True
            if self._clock.now_ns() >= until_ns:
                return False
            watcher: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._watchers.append(watcher)

            def time_out(watcher: "asyncio.Future[None]" = watcher) -> None:
                if not watcher.done():
                    watcher.set_result(None)

            timer = self._clock.call_at_ns(until_ns, time_out)
            try:
                await watcher
            finally:
                timer.cancel()
                self._watchers.remove(watcher)
