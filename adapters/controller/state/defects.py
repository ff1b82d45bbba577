"""Errors that nothing expected, in the tasks of one controller: each is a fault of the controller, and is counted."""

import asyncio

from orchestrator.bus.log import ProcessLog
from orchestrator.model.errors import TuttiError
from orchestrator.model.state import FaultReport

CODE = "adapter-defect"


class AdapterDefect(TuttiError):
    """The adapter begins anew after a defect in one of its tasks."""


class DefectRecord:
    """The defects of one controller's adapter since its start. must_reconnect: a task has ended by one, and the link
    must be given up, because what the adapter believes may be wrong."""

    def __init__(self, log: ProcessLog, controller: str) -> None:
        self._log = log
        self._controller = controller
        self._count = 0
        self._last: Exception | None = None
        self.must_reconnect = False

    def note_defect(self, error: Exception) -> FaultReport:
        """Count the defect, log it with its place, and return the fault to show."""
        self.must_reconnect = False
        if isinstance(error, AdapterDefect) and self._last is not None:
            return self._make_fault(self._last)  # counted when its task ended
        self._count += 1
        self._last = error
        fault = self._make_fault(error)
        self._log.warning(fault.text, controller=self._controller, code=CODE)
        asyncio.get_running_loop().call_exception_handler({"message": fault.text, "exception": error})
        return fault

    def raise_new_defect(self) -> None:
        """Raise `AdapterDefect` if a task has ended by a defect since the controller was connected."""
        if self.must_reconnect:
            raise AdapterDefect

    def _make_fault(self, error: Exception) -> FaultReport:
        times = "" if self._count == 1 else f" (defect number {self._count} since the start of the adapter)"
        return FaultReport(
            code=CODE,
            text=f"a defect of the adapter, {type(error).__name__}: {error}{times}",
            remedy="it connects again by itself; report the log of the adapter host and `tutti trace`",
        )
