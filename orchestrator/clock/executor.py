"""Executors for calls that wait for a disk, or take long.

In virtual time a call runs inline. Live it runs in a thread, because one call may take a tenth of a second, during
which the rest of the process must not stop; one that would hold the interpreter's lock as long, in a process."""

import asyncio
import os
import resource
import signal
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from multiprocessing import active_children, get_context
from typing import Any, Protocol, TypeVar

from orchestrator.clock.collection import CollectionPause
from orchestrator.clock.parent import prepare_worker
from orchestrator.clock.realtime import reset_priority
from orchestrator.model.errors import Refusal

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
    """Runs calls in a thread of its own. many_objects: its calls make so many that collections would pause everything:
    there are none meanwhile."""

    def __init__(self, name: str, *, many_objects: bool = False) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._pause = CollectionPause() if many_objects else nullcontext()

    async def __call__(self, function: Callable[..., T], *values: Any) -> T:
        with self._pause:
            return await asyncio.get_running_loop().run_in_executor(self._pool, lambda: function(*values))


CALL_S = 20  # that a call may take; the longest path of a job takes two
MAX_CALLS = 8  # that wait and run
MAX_PROCESS_BYTES = 2_000_000_000  # of address space


class ProcessExecutor:
    """Runs calls of module functions in a process of its own, one after the other; it begins with the first call.

    A call that takes too long, or too much memory, ends with that process, and the next one begins a new one. Raises
    what the call raises, and `Refusal`, code `too-much-work`, for one that was ended or found no place.
    """

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._calls = 0
        self._turn = asyncio.Lock()

    async def __call__(self, function: Callable[..., T], *values: Any) -> T:
        if self._calls >= MAX_CALLS:
            raise Refusal("too-much-work", f"{MAX_CALLS} large requests are being read", "send this one again later")
        self._calls += 1
        try:
            async with self._turn:
                return await self._run(function, values)
        finally:
            self._calls -= 1

    async def _run(self, function: Callable[..., T], values: tuple[Any, ...]) -> T:
        pool = self._pool = self._pool or ProcessPoolExecutor(
            1, get_context("spawn"), initializer=_prepare_process, initargs=(os.getpid(),)
        )
        try:
            return await asyncio.get_running_loop().run_in_executor(pool, _run_in_time, function, values)
        except MemoryError:
            raise _too_much() from None
        except BrokenProcessPool:
            self._pool = None
            raise _too_much() from None

    def close(self) -> None:
        """End the process, whatever it does. Without, the end of this program would wait for its call."""
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in active_children():
                process.kill()


def _too_much() -> Refusal:
    text = f"the request was not read within {CALL_S} s and {MAX_PROCESS_BYTES // 1_000_000_000} GB of memory"
    return Refusal("too-much-work", text, "send it in smaller parts")


def _run_in_time(function: Callable[..., T], values: tuple[Any, ...]) -> T:
    """A call in the process: the kernel ends it when it takes too long, whatever it does."""
    signal.alarm(CALL_S)
    try:
        return function(*values)
    finally:
        signal.alarm(0)


def _prepare_process(parent_pid: int) -> None:
    """It takes neither the priority of its parent nor all memory."""
    prepare_worker(parent_pid)
    reset_priority()
    resource.setrlimit(resource.RLIMIT_AS, (MAX_PROCESS_BYTES, MAX_PROCESS_BYTES))
