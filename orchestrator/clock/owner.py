"""Owned tasks: the end of each is noticed, so that none dies unseen."""

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any

DefectCallback = Callable[[BaseException, bool], None]
"""Called with an exception that nothing handled, and whether the task was vital."""


@dataclass(slots=True)
class TaskOwner:
    """Owns the tasks of a component. on_defect: called when one ends with an exception.

    vital: the component cannot do its work without the task.
    """

    on_defect: DefectCallback
    _tasks: set[asyncio.Task[None]] = field(default_factory=set[asyncio.Task[None]])

    def spawn(self, coroutine: Coroutine[Any, Any, None], *, vital: bool) -> asyncio.Task[None]:
        """Start a task."""
        task = asyncio.get_running_loop().create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(lambda ended_task: self._note_end(ended_task, vital=vital))
        return task

    def cancel_all(self) -> None:
        """Cancel all tasks that run."""
        for task in list(self._tasks):
            task.cancel()

    def _note_end(self, task: asyncio.Task[None], *, vital: bool) -> None:
        self._tasks.discard(task)
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self.on_defect(error, vital)
