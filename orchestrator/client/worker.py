"""An event loop in a thread of its own, and the base of objects whose methods wait for it."""

import asyncio
import threading
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Generic, Protocol, TypeVar

from orchestrator.model.errors import TuttiError

T = TypeVar("T")
R = TypeVar("R")

STOP_S = 6.0  # for an interrupted call to stop what it has begun; a second interrupt does not wait


class Worker(Protocol):
    """What runs the coroutines of a blocking object."""

    def run_coroutine(self, work: Coroutine[Any, Any, R]) -> R:
        """Run `work` to its end and return its result. An interrupt cancels it, and waits until it has cleaned up."""
        ...

    def close(self) -> None: ...


class LoopThread:
    """A worker with an event loop in a thread of its own, so that it also works where one runs already, as in a
    notebook."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="tutti", daemon=True)
        self._thread.start()

    def run_coroutine(self, work: Coroutine[Any, Any, R]) -> R:
        if threading.current_thread() is self._thread:
            work.close()
            raise RuntimeError("a callback must not call the blocking object that calls it")
        ended_event = threading.Event()

        async def run() -> R:
            try:
                return await work
            finally:
                ended_event.set()

        future = asyncio.run_coroutine_threadsafe(run(), self._loop)
        try:
            return future.result()
        except KeyboardInterrupt:
            # What the call has begun is stopped by its own clean-up, which says so.
            future.cancel()
            ended_event.wait(STOP_S)
            raise

    def close(self) -> None:
        # In its own thread: the thread that closes it may be inside another loop.
        self.run_coroutine(self._loop.shutdown_asyncgens())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


def call_outside_loops(function: Callable[[], R]) -> R:
    """Call `function` where no event loop runs: in this thread, or, if one runs in it, as in a notebook, in another."""
    if asyncio._get_running_loop() is None:  # noqa: SLF001 # pyright: ignore[reportPrivateUsage]
        return function()
    with ThreadPoolExecutor(1, thread_name_prefix="tutti") as other_executor:
        return other_executor.submit(function).result()


class BlockingObject(Generic[T]):
    """An object whose methods wait for those of `wrapped`, which run in `worker`."""

    def __init__(self, wrapped: T, worker: Worker) -> None:
        self._wrapped = wrapped
        self._worker = worker

    def __repr__(self) -> str:
        words = repr(self._wrapped).removeprefix(f"<{type(self._wrapped).__name__} ").removesuffix(">")
        return f"<{type(self).__name__} {words}>"

    def _run(self, work: Coroutine[Any, Any, R]) -> R:
        try:
            return self._worker.run_coroutine(work)
        except TuttiError as error:
            raise error.with_traceback(None) from None

    def _iterate(self, items: AsyncGenerator[R]) -> Iterator[R]:
        """The items as they come; leaving the loop ends them."""
        try:
            while True:
                try:
                    yield self._run(_next(items))
                except StopAsyncIteration:
                    return
        finally:
            self._run(items.aclose())


async def _next(items: AsyncGenerator[R]) -> R:
    return await anext(items)
