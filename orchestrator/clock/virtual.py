"""Virtual time: an asyncio loop whose time jumps to the next timer, with processes that can hang and die.

Everything that a virtual process schedules carries the process in its context. A handle of a frozen process is
parked until the process is resumed; a handle of a killed one is dropped, so that none of its `finally` blocks runs,
as after `kill -9`. Calls of one instant run in the order in which they were scheduled, so a run depends only on its
seeds.
"""

import asyncio
import atexit
import gc
import heapq
from collections import deque
from collections.abc import Callable, Coroutine
from contextlib import suppress
from contextvars import Context, ContextVar, copy_context
from functools import cache
from typing import Any, TypeVar

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.utc import virtual_utc
from orchestrator.model.errors import TuttiError

T = TypeVar("T")

# A run creates and drops millions of small objects, hardly any in cycles: Python's default collection interval costs a
# quarter of the time (measured on an hour of the demo fleet).
GC_ALLOCATIONS = 200_000


class VirtualDeadlock(TuttiError):
    """The main coroutine waits, and no event is left that could wake it."""


class VirtualProcess:
    """A process of the virtual fleet: everything that runs in its context can be frozen (SIGSTOP) and killed
    (SIGKILL)."""

    def __init__(self, loop: "VirtualLoop", name: str) -> None:
        self.name = name
        self.alive = True
        self.frozen = False
        self._loop = loop
        self._parked: list[_VirtualHandle] = []
        self._on_death: list[Callable[[], None]] = []

    def run_inside(self, function: Callable[[], T]) -> T:
        """Call `function` as a part of this process; tasks that it creates belong to the process."""

        def call_inside() -> T:
            _PROCESS.set(self)
            return function()

        return copy_context().run(call_inside)

    def start_task(self, coroutine: Coroutine[Any, Any, T]) -> "asyncio.Task[T]":
        """Run `coroutine` as a task of this process. An error that ends it ends the whole run."""
        task: asyncio.Task[T] = self.run_inside(lambda: self._loop.create_task(coroutine))
        task.add_done_callback(self._on_task_end)
        return task

    def _on_task_end(self, task: "asyncio.Task[Any]") -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            self._loop.call_exception_handler({"message": f"{self.name} failed", "exception": error})

    def add_death_callback(self, callback: Callable[[], None]) -> None:
        """Register an action of the kernel for the process's death: close its sockets, drop its sessions."""
        self._on_death.append(callback)

    def freeze(self) -> None:
        """Like SIGSTOP: nothing of the process runs, its timers included."""
        self.frozen = True

    def resume(self) -> None:
        """Like SIGCONT: everything that became due meanwhile runs now, in order."""
        self.frozen = False
        parked_handles, self._parked = self._parked, []
        self._loop.requeue_handles(parked_handles)

    def kill(self) -> None:
        """Like SIGKILL: nothing of the process ever runs again. Does nothing to a dead process."""
        if not self.alive:
            return
        self.alive = False
        for callback in self._on_death:
            self._loop.call_soon(callback, context=Context())

    def may_run(self, handle: "_VirtualHandle") -> bool:
        """Return whether `handle` may run now; park it when the process is frozen."""
        if not self.frozen:
            return self.alive
        if self.alive:
            self._parked.append(handle)
        return False


_PROCESS: ContextVar[VirtualProcess | None] = ContextVar("process", default=None)


class _VirtualHandle:
    """A scheduled call: the result of `call_soon` and `call_at`."""

    __slots__ = ("args", "callback", "context")

    def __init__(self, callback: Callable[..., object], args: tuple[Any, ...], context: Context | None) -> None:
        self.callback: Callable[..., object] | None = callback
        self.args = args
        self.context = copy_context() if context is None else context

    def cancel(self) -> None:
        self.callback = None
        self.args = ()

    def cancelled(self) -> bool:
        return self.callback is None


def _set_running_loop(loop: Any) -> None:
    asyncio._set_running_loop(loop)  # noqa: SLF001 # pyright: ignore[reportAttributeAccessIssue, reportUnknownMemberType]


class VirtualLoop(asyncio.AbstractEventLoop):
    """An event loop without input and output: it runs what is ready, then jumps to the next timer."""

    def __init__(self) -> None:
        self.now_ns = 0
        self._ready: deque[_VirtualHandle] = deque()
        self._timers: list[tuple[int, int, _VirtualHandle]] = []
        self._asked = 0
        self._stopping = False
        self._running = False
        self._closed = False
        self._errors: list[BaseException] = []
        self._tasks: list[asyncio.Task[Any]] = []
        self.created_tasks = 0
        """Number of tasks that were created in it."""

    @property
    def failure(self) -> BaseException | None:
        """The first error that nothing has received; it has stopped the run."""
        return self._errors[0] if self._errors else None

    # Time

    def time(self) -> float:
        return self.now_ns / NS_PER_S

    def call_at_ns(self, at_ns: int, callback: Callable[..., object], *args: Any, context: Context | None = None):
        """Like `call_at`, in whole nanoseconds."""
        handle = _VirtualHandle(callback, args, context)
        self._asked += 1
        heapq.heappush(self._timers, (at_ns if at_ns > self.now_ns else self.now_ns, self._asked, handle))
        return handle

    def call_at(self, when: float, callback: Callable[..., object], *args: Any, context: Context | None = None) -> Any:
        return self.call_at_ns(round(when * NS_PER_S), callback, *args, context=context)

    def call_later(
        self, delay: float, callback: Callable[..., object], *args: Any, context: Context | None = None
    ) -> Any:
        return self.call_at_ns(self.now_ns + round(delay * NS_PER_S), callback, *args, context=context)

    def call_soon(self, callback: Callable[..., object], *args: Any, context: Context | None = None) -> Any:
        handle = _VirtualHandle(callback, args, context)
        self._ready.append(handle)
        return handle

    def requeue_handles(self, handles: list[_VirtualHandle]) -> None:
        """Make parked handles ready again."""
        self._ready.extend(handles)

    # Running

    def run_forever(self) -> None:
        _set_running_loop(self)
        self._running = True
        try:
            self._run_ready()
        finally:
            self._running = False
            self._stopping = False
            _set_running_loop(None)

    def run_until_complete(self, future: Any) -> Any:
        task: asyncio.Future[Any] = asyncio.ensure_future(future, loop=self)

        def stop_loop(_: object) -> None:
            self.stop()

        task.add_done_callback(stop_loop)
        try:
            self.run_forever()
        finally:  # after an interrupt the same task may be run again
            task.remove_done_callback(stop_loop)
        if self._errors:
            raise self._errors[0]
        return task.result()

    def _run_ready(self) -> None:
        """Run ready calls one by one, until the loop is stopped."""
        ready = self._ready
        while not self._stopping:
            handle = ready.popleft() if ready else self._jump_to_next()
            callback, context = handle.callback, handle.context
            if callback is None:
                continue
            process = context.get(_PROCESS)
            if process is not None and not process.may_run(handle):
                continue
            try:
                context.run(callback, *handle.args)
            except (SystemExit, KeyboardInterrupt):
                raise
            except BaseException as error:
                self.call_exception_handler({"message": f"error in {callback!r}", "exception": error})

    def _jump_to_next(self) -> _VirtualHandle:
        """Advance to the next instant with scheduled calls, return the first of them, and make the rest ready."""
        timers, pop = self._timers, heapq.heappop
        while timers and timers[0][2].callback is None:
            pop(timers)
        if not timers:
            raise VirtualDeadlock(f"no event is left at {self.now_ns} ns of virtual time")
        self.now_ns, _, first = pop(timers)
        while timers and timers[0][0] == self.now_ns:
            self._ready.append(pop(timers)[2])
        return first

    def stop(self) -> None:
        self._stopping = True

    def is_running(self) -> bool:
        return self._running

    def is_closed(self) -> bool:
        return self._closed

    def close(self) -> None:
        """Close the loop: unfinished calls are dropped silently, because their process ends with the loop.

        So are the errors of their `finally` and `except` blocks, which Python runs when it drops a coroutine: they
        cannot wait for what they are for. What they begin belongs to this loop, and is dropped, too; without a running
        loop asyncio would make one of its own.
        """
        outer = asyncio._get_running_loop()  # noqa: SLF001 # pyright: ignore[reportAttributeAccessIssue, reportUnknownMemberType, reportUnknownVariableType]
        _set_running_loop(self)
        try:
            while self._tasks:  # also those that are begun meanwhile
                tasks, self._tasks = self._tasks, []
                for task in tasks:
                    if not task.done():
                        task._log_destroy_pending = False  # noqa: SLF001 # pyright: ignore[reportAttributeAccessIssue]
                        with suppress(Exception, asyncio.CancelledError):
                            task.get_coro().close()
        finally:
            _set_running_loop(outer)
        self._closed = True
        self._ready.clear()
        self._timers.clear()

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        """Stop the run at an error that was not awaited: in virtual time it is always a defect."""
        error = context.get("exception")
        self._errors.append(error if isinstance(error, BaseException) else RuntimeError(str(context.get("message"))))
        self.stop()

    # The asyncio loop interface

    def create_future(self) -> "asyncio.Future[Any]":
        return asyncio.Future(loop=self)

    def create_task(self, coro: Any, *, name: str | None = None, context: Context | None = None) -> Any:
        task: asyncio.Task[Any] = asyncio.Task(coro, loop=self, name=name, context=context)
        self._tasks.append(task)
        self.created_tasks += 1
        if len(self._tasks) > 4096:
            self._tasks = [task for task in self._tasks if not task.done()]
        return task

    def get_debug(self) -> bool:
        return False

    async def shutdown_asyncgens(self) -> None:
        return

    async def shutdown_default_executor(self, timeout: float | None = None) -> None:
        return


class VirtualClock:
    """The `Clock` of a virtual loop. wall_step_ns: total step of the wall clock since the start."""

    def __init__(self, loop: VirtualLoop) -> None:
        self.loop = loop
        self.wall_step_ns = 0

    @property
    def kernel_id(self) -> str:
        return "virtual"

    def now_ns(self) -> int:
        return self.loop.now_ns

    def utc(self) -> str:
        return virtual_utc(self.loop.now_ns + self.wall_step_ns)

    def call_at_ns(
        self, at_ns: int, callback: Callable[[], None], leeway_ns: int = 0, context: Context | None = None
    ) -> _VirtualHandle:
        """Schedule a call exactly at the instant. context: the process that the call belongs to; the caller's by
        default."""
        del leeway_ns
        return self.loop.call_at_ns(at_ns, callback, context=context)


@cache
def _freeze_modules() -> None:
    """Take what has been imported out of all later garbage collections, once in a process: visiting it each time costs
    a twelfth of the time of a campaign. At the end of the process they are collected again: libraries report what is
    left (nanobind, Ruckig's)."""
    gc.collect()
    gc.freeze()
    atexit.register(gc.unfreeze)


def run_virtual(main: Callable[[VirtualClock], Coroutine[Any, Any, T]]) -> T:
    """Run `main(clock)` to its end in virtual time and return its result.

    Raises what `main` raises, the first error of any task that was not awaited, or `VirtualDeadlock`.
    """
    loop = VirtualLoop()
    _freeze_modules()
    thresholds = gc.get_threshold()
    gc.set_threshold(GC_ALLOCATIONS, *thresholds[1:])
    try:
        return loop.run_until_complete(main(VirtualClock(loop)))
    finally:
        loop.close()
        gc.set_threshold(*thresholds)
