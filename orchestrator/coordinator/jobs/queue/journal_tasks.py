"""Background work on the journal: a journal that cannot be written is logged, and ends nothing."""

from collections.abc import Callable, Coroutine
from typing import Any, ParamSpec

from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JournalError

P = ParamSpec("P")


class JournalTasks:
    """Tasks of one component. failure: what a `JournalError` means there, before its text in the log."""

    def __init__(self, services: JobServices, failure: str = "") -> None:
        self._services = services
        self._failure = failure
        self._tasks = TaskOwner(services.fleet.tasks.on_defect)

    def spawn(self, function: Callable[P, Coroutine[Any, Any, None]], *values: P.args, **names: P.kwargs) -> None:
        """Start a task. One that ends with another error than `JournalError` is a defect of the coordinator."""

        async def work() -> None:
            try:
                await function(*values, **names)
            except JournalError as error:
                self._services.log.warning(f"{self._failure}{error}")

        self._tasks.spawn(work(), vital=True)

    def cancel_all(self) -> None:
        """Cancel all tasks that run."""
        self._tasks.cancel_all()
