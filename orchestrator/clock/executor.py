"""Executors for calls that wait for a disk, or take long.

In virtual time a call runs inline. Live it runs in a thread, because one call may take a tenth of a second, during
which the rest of the process must not stop; one that would hold the interpreter's lock as long, in a process."""

import asyncio
import os
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from multiprocessing import active_children, get_context
from typing import Any, NamedTuple, Protocol, TypeVar

from orchestrator.clock.collection import CollectionPause, return_memory
from orchestrator.clock.parent import prepare_worker
from orchestrator.clock.process_limits import end_after, limit_memory
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


MAX_CALLS = 8  # that wait and run


class WorkLimits(NamedTuple):
    """The most that one call in another process may need. call_s: time; max_bytes: of address space. task: what is not
    done beyond them, with its remedy, and what those are that wait."""

    call_s: int
    max_bytes: int
    task: str
    remedy: str
    waiting: str


READING = WorkLimits(
    20, 2_000_000_000, "the request was not read", "send it in smaller parts", "large requests are being read"
)
"""Of a large request; the longest path of a job takes two seconds."""
CHECKING = WorkLimits(
    300, 6_000_000_000, "the job was not checked", "split its paths into several jobs", "long paths are being planned"
)
"""Of a job with a long path: its plan takes 50 s and 1.5 GB for 100,000 pieces."""
PLANNING = CHECKING._replace(task="the path was not planned", remedy="split it into several paths")
"""Of a long path that is to be run."""


class ProcessExecutor:
    """Runs calls of module functions in a process of its own, one after the other; it begins with the first call.

    A call that takes too long, or too much memory, ends with that process, and the next one begins a new one. Raises
    what the call raises, and `Refusal`, code `too-much-work`, for one that was ended or found no place.
    """

    def __init__(self, limits: WorkLimits = READING) -> None:
        self._limits = limits
        self._pool: ProcessPoolExecutor | None = None
        self._calls = 0
        self._turn = asyncio.Lock()

    async def __call__(self, function: Callable[..., T], *values: Any) -> T:
        if self._calls >= MAX_CALLS:
            text = f"{MAX_CALLS} {self._limits.waiting}"
            raise Refusal("too-much-work", text, "send this one again later")
        self._calls += 1
        try:
            async with self._turn:
                return await self._run(function, values)
        finally:
            self._calls -= 1

    async def _run(self, function: Callable[..., T], values: tuple[Any, ...]) -> T:
        pool = self._pool = self._pool or ProcessPoolExecutor(
            1, get_context("spawn"), initializer=_prepare_process, initargs=(os.getpid(), self._limits.max_bytes)
        )
        try:
            return await asyncio.get_running_loop().run_in_executor(
                pool, _run_in_time, self._limits.call_s, function, values
            )
        except MemoryError:
            raise _too_much(self._limits) from None
        except BrokenProcessPool:
            self._pool = None
            raise _too_much(self._limits) from None

    def close(self) -> None:
        """End the process, whatever it does. Without, the end of this program would wait for its call."""
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in active_children():
                process.kill()


def _too_much(limits: WorkLimits) -> Refusal:
    text = f"{limits.task} within {limits.call_s} s and {limits.max_bytes // 1_000_000_000} GB of memory"
    return Refusal("too-much-work", text, limits.remedy)


def _run_in_time(call_s: int, function: Callable[..., T], values: tuple[Any, ...]) -> T:
    """A call in the process: the kernel ends it when it takes too long, whatever it does."""
    end_after(call_s)
    try:
        return function(*values)
    finally:
        end_after(0)
        return_memory()


def _prepare_process(parent_pid: int, max_bytes: int) -> None:
    """It takes neither the priority of its parent nor all memory."""
    prepare_worker(parent_pid)
    reset_priority()
    limit_memory(max_bytes)
