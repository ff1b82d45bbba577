"""Owned tasks: the end of each is noticed, so that none dies unseen."""

import asyncio
from collections import deque
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

S = TypeVar("S")
T = TypeVar("T")

DefectCallback = Callable[[BaseException, bool], None]
"""Called with an exception that nothing handled, and whether the task was vital."""


def report_to_loop(error: BaseException, vital: bool) -> None:  # noqa: FBT001 - a callback
    """Give a defect to the exception handler of the event loop, for a component without a remedy of its own."""
    asyncio.get_running_loop().call_exception_handler({"message": "a background task failed", "exception": error})


@dataclass(slots=True)
class TaskOwner:
    """Owns the tasks of a component. on_defect: called when one ends with an exception.

    vital: the component cannot do its work without the task.
    """

    on_defect: DefectCallback = report_to_loop
    # In the order of their starts: a set would be cancelled in the order of addresses, which differs between runs.
    _tasks: dict[asyncio.Task[None], None] = field(default_factory=dict[asyncio.Task[None], None])

    @property
    def pending(self) -> list[asyncio.Task[None]]:
        """The tasks that run, in the order of their starts."""
        return [task for task in self._tasks if not task.done()]

    def spawn(self, coroutine: Coroutine[Any, Any, None], *, vital: bool = False) -> asyncio.Task[None]:
        """Start a task."""
        task = asyncio.get_running_loop().create_task(coroutine)
        self._tasks[task] = None
        task.add_done_callback(lambda ended_task: self._note_end(ended_task, vital=vital))
        return task

    def cancel_all(self) -> None:
        """Cancel all tasks that run."""
        for task in self.pending:
            task.cancel()

    async def end_all(self) -> None:
        """Cancel all tasks that run, and wait for their ends."""
        self.cancel_all()
        if tasks := self.pending:
            await asyncio.wait(tasks)

    def _note_end(self, task: asyncio.Task[None], *, vital: bool) -> None:
        self._tasks.pop(task, None)
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self.on_defect(error, vital)


@asynccontextmanager
async def running(coroutine: Coroutine[Any, Any, T]) -> AsyncGenerator[asyncio.Task[T]]:
    """Run a coroutine beside the context, whose end cancels it. The context may take its result; asyncio reports an
    exception that it does not take."""
    task = asyncio.get_running_loop().create_task(coroutine)
    try:
        yield task
    finally:
        task.cancel()


async def wait_for_first(*coroutines: Coroutine[Any, Any, object]) -> None:
    """Wait until one of `coroutines` has ended, raise its error, and cancel the others."""
    loop = asyncio.get_running_loop()
    tasks = [loop.create_task(coroutine) for coroutine in coroutines]
    try:
        done_tasks, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
    for task in done_tasks:
        task.result()


def _ignore_defect(error: BaseException, vital: bool) -> None:  # noqa: FBT001 - a callback
    """The error of a call is raised to the caller."""


async def call_for_each(function: Callable[[S], Coroutine[Any, Any, T]], subjects: Iterable[S]) -> list[T]:
    """Call `function` for each of `subjects` at once; return the results in their order.

    One task makes call after call, as long as none waits; where one does, another task goes on with the next. The first
    error is raised, and ends the others.
    """
    queue = deque(enumerate(subjects))
    results: dict[int, T] = {}

    async def work() -> None:
        while queue:
            number, subject = queue.popleft()
            results[number] = await function(subject)

    workers: list[asyncio.Task[None]] = []
    owner = TaskOwner(_ignore_defect)
    try:
        while queue:
            workers.append(owner.spawn(work()))
            await asyncio.sleep(0)
        await asyncio.gather(*workers)
    finally:
        owner.cancel_all()
    return [results[number] for number in sorted(results)]
