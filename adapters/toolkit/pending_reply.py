"""A reply that is outstanding, with its timeout."""

import asyncio
from typing import Generic, TypeVar

from orchestrator.clock.base import ClockTimer

_Reply = TypeVar("_Reply")


class PendingReply(Generic[_Reply]):
    """An outstanding reply. timer: its timeout, which the session sets and which ends with the reply."""

    def __init__(self) -> None:
        self.future: asyncio.Future[_Reply] = asyncio.get_running_loop().create_future()
        self.timer: ClockTimer | None = None

    def set_reply(self, reply: _Reply) -> None:
        self.cancel_timeout()
        if not self.future.done():
            self.future.set_result(reply)

    def set_failure(self, error: Exception) -> None:
        self.cancel_timeout()
        if not self.future.done():
            self.future.set_exception(error)
            # Retrieved: a waiter that was cancelled meanwhile leaves no unretrieved exception.
            self.future.exception()

    def cancel_timeout(self) -> None:
        if self.timer is not None:
            self.timer.cancel()
