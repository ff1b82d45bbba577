"""A worker whose time is virtual: it runs the virtual loop until a call is done, and time goes on only meanwhile."""

import asyncio
import gc
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any, TypeVar

from orchestrator.client.worker import STOP_S, call_outside_loops
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.virtual import GC_ALLOCATIONS, VirtualLoop
from orchestrator.testing.errors import BadTest, format_s

R = TypeVar("R")


class CallTooLong(BadTest):
    """A call that did not end within the limit of fleet time."""


class VirtualWorker:
    """Runs coroutines of blocking objects in one virtual loop.

    limit_ns: of fleet time for one call; a call that waits for what does not come would otherwise never return.
    """

    def __init__(self, loop: VirtualLoop, limit_ns: int) -> None:
        self._loop = loop
        self._limit_ns = limit_ns

    def run_coroutine(self, work: Coroutine[Any, Any, R]) -> R:
        """Run `work` to its end and return its result. Raises `CallTooLong`, and the first error of anything in the
        fleet that nothing else has received. An interrupt cancels it, and waits until it has cleaned up."""
        return self.run_limited(work, self._limit_ns)

    def run_limited(self, work: Coroutine[Any, Any, R], limit_ns: int | None) -> R:
        """Like `run_coroutine`, with a limit of its own; None: without one."""
        loop = self._loop
        if loop.is_running() or loop.is_closed() or loop.failure is not None:
            work.close()
            if loop.failure is not None:
                raise loop.failure
            state = "has ended" if loop.is_closed() else "is in a call already; inside `fleet.run` use its `tutti`"
            raise BadTest(f"the virtual fleet {state}")
        return call_outside_loops(lambda: self._run(work, limit_ns))

    def close(self) -> None:
        """The loop is closed by the fleet that it belongs to."""

    def _run(self, work: Coroutine[Any, Any, R], limit_ns: int | None) -> R:
        loop, too_long = self._loop, False
        thresholds = gc.get_threshold()
        gc.set_threshold(GC_ALLOCATIONS, *thresholds[1:])
        task: asyncio.Task[R] = loop.create_task(work)

        def end_call() -> None:
            nonlocal too_long
            too_long = task.cancel()

        timer = None if limit_ns is None else loop.call_at_ns(loop.now_ns + limit_ns, end_call)
        try:
            return loop.run_until_complete(task)
        except asyncio.CancelledError:
            if not too_long:
                raise
            text = f"the call has not ended within {format_s(limit_ns or 0)} of fleet time; the limit is an argument"
            raise CallTooLong(f"{text} of the fleet: limit=") from None
        except KeyboardInterrupt:
            task.cancel()
            patience = loop.call_at_ns(loop.now_ns + round(STOP_S * NS_PER_S), loop.stop)
            with suppress(Exception, asyncio.CancelledError):
                loop.run_until_complete(task)
            patience.cancel()
            raise
        finally:
            gc.set_threshold(*thresholds)
            if timer is not None:
                timer.cancel()
