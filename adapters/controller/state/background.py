"""Background work of one controller: its errors are logged, and its defects make the adapter begin anew."""

import asyncio
from collections.abc import Coroutine
from typing import Any

from adapters.controller.state.context import ControllerContext
from adapters.controller.state.defects import DefectRecord
from adapters.controller.state.poll_timer import PollTimer
from orchestrator.clock.owner import TaskOwner
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.state import FaultReport


class BackgroundTasks:
    """The tasks of one controller's adapter."""

    def __init__(self, context: ControllerContext, defects: DefectRecord, timer: PollTimer) -> None:
        self._context = context
        self._defects = defects
        self._timer = timer
        self._tasks = TaskOwner(self._handle_task_error)

    def spawn(self, coroutine: Coroutine[Any, Any, None]) -> "asyncio.Task[None]":
        """Run a coroutine in the background."""
        task = self._tasks.spawn(self.log_errors(coroutine))
        # A task that is cancelled before its first turn would leave the coroutine unstarted.
        task.add_done_callback(lambda _: coroutine.close())
        return task

    async def log_errors(self, coroutine: Coroutine[Any, Any, None]) -> None:
        """Run `coroutine` and log its errors: link supervision handles what goes wrong in the background."""
        try:
            await coroutine
        except (LinkClosed, LinkRefused, ControllerFault, Refusal) as error:
            self._context.log.warning(f"in the background: {error}", controller=self._context.controller)

    def _handle_task_error(self, error: BaseException, _: bool) -> None:  # noqa: FBT001 - a callback
        if isinstance(error, Exception):
            self.handle_defect(error)

    def handle_defect(self, error: Exception) -> FaultReport:
        """Handle an error that nothing expected, in a task or a command of this controller: what the adapter believes
        may be wrong, so it gives up the link and begins anew. Returns the fault."""
        fault = self._defects.note_defect(error)
        self._defects.must_reconnect = True
        self._timer.wake_up()
        return fault

    def cancel_all(self) -> None:
        """Cancel all tasks that run."""
        self._tasks.cancel_all()
