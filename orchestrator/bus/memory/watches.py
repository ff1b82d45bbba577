"""What a process of the in-memory bus has declared to be notified of: its calls, in its own context, in their order."""

import asyncio
import contextvars
from collections.abc import Callable
from functools import partial

from orchestrator.bus.base import Priority
from orchestrator.bus.memory.medium import BusProcess, Medium


class ProcessWatch:
    """A watch of a process for an expression. callback: of the process. remove: called with it when it ends."""

    def __init__(
        self,
        bus: BusProcess,
        expression: str,
        callback: Callable[..., None],
        remove: Callable[["ProcessWatch"], None],
    ) -> None:
        self.bus = bus
        self.expression = expression
        self._callback = callback
        self._remove = remove
        self._context = contextvars.copy_context()
        self._last_arrival_ns = 0
        self._stands = True

    def notify(self, net: Medium, origin: BusProcess, *values: object) -> None:
        """Call the process with `values` when news of `origin` reaches it, and not before earlier ones."""
        self._last_arrival_ns = max(net.arrival_ns(origin, self.bus), self._last_arrival_ns)
        call = partial(net.deliver_call, self.bus, Priority.EVENT, partial(self._enter_process, *values))
        net.schedule_call(self._last_arrival_ns, call)

    def _enter_process(self, *values: object) -> None:
        asyncio.get_running_loop().call_soon(partial(self._call_back, *values), context=self._context)

    def _call_back(self, *values: object) -> None:
        if self._stands and self.bus.alive:
            self._callback(*values)

    async def undeclare(self) -> None:
        self._stands = False
        self._remove(self)
