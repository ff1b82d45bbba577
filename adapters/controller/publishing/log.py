"""The log of a driver: lines of its controller, with the controller's name and the epoch."""

from collections.abc import Callable
from typing import Any

from orchestrator.bus.log import ProcessLog


class ControllerLog:
    """Write the lines of one driver to `log`. epoch: returns the epoch of the leader, None while it is unknown.

    The log must have no bus: a published line would change the traffic, and so the timing, of a virtual run.
    """

    def __init__(self, log: ProcessLog, controller: str, epoch: Callable[[], int | None]) -> None:
        self._log = log
        self._controller = controller
        self._epoch = epoch

    def info(self, text: str, **fields: Any) -> None:
        self._log.info(text, controller=self._controller, epoch=self._epoch(), **fields)

    def warning(self, text: str, **fields: Any) -> None:
        self._log.warning(text, controller=self._controller, epoch=self._epoch(), **fields)
