"""Executors for calls that wait for a disk.

In virtual time a call runs inline. Live it runs in a thread, because one call may take a tenth of a second, during
which the rest of the process must not stop."""

import asyncio
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol, TypeVar

T = TypeVar("T")

ThreadLock = threading.Lock
"""A lock for what is shared with the thread of an executor, or of the bus. In virtual time it is always free."""


class Executor(Protocol):
    """Runs calls in the order in which they are submitted."""

    async def __call__(self, function: Callable[..., T], *values: Any) -> T: ...


async def run_while_recording(record: Coroutine[Any, Any, None], work: Coroutine[Any, Any, T]) -> T:
    """Await `work` while `record` writes to disk, and return the result of `work`.

    Not for an act that must not happen before it is on disk; but consecutive records reach the disk in order."""
    task = asyncio.ensure_future(record)
    try:
        return await work
    finally:
        await task


async def run_inline(function: Callable[..., T], *values: Any) -> T:
    """Run the call immediately, in virtual time."""
    return function(*values)


class ThreadExecutor:
    """Runs calls in a thread of its own."""

    def __init__(self, name: str) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix=name)

    async def __call__(self, function: Callable[..., T], *values: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._pool, lambda: function(*values))
