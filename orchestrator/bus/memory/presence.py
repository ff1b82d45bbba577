"""Presence on the in-memory bus: announced tokens, and the view that each watch has of them."""

import asyncio
import contextvars
from collections.abc import Callable
from functools import partial

from orchestrator.bus.base import Priority
from orchestrator.bus.expression import expressions_intersect
from orchestrator.bus.memory.medium import BusProcess, Medium


class PresenceToken:
    """A process's announcement of presence under a key."""

    def __init__(self, board: "PresenceBoard", bus: BusProcess, key: str) -> None:
        self.bus = bus
        self.key = key
        self._board = board

    async def undeclare(self) -> None:
        self._board.remove_token(self)


class PresenceWatch:
    """A process's watch for presence."""

    def __init__(
        self, board: "PresenceBoard", bus: BusProcess, expression: str, callback: Callable[[str, bool], None]
    ) -> None:
        self.bus = bus
        self.expression = expression
        self.believed: dict[str, BusProcess] = {}
        self.last_arrival_ns = 0
        self._board = board
        self._callback = callback
        self._context = contextvars.copy_context()
        self._stands = True

    def notify_process(self, key: str, *, present: bool) -> None:
        """Notify the process, in its own context."""
        call = partial(self._call_back, key, present=present)
        asyncio.get_running_loop().call_soon(call, context=self._context)

    def _call_back(self, key: str, *, present: bool) -> None:
        if self._stands and self.bus.alive:
            self._callback(key, present)

    async def undeclare(self) -> None:
        self._stands = False
        self._board.remove_watch(self)


class PresenceBoard:
    """All tokens and watches of a net."""

    def __init__(self, net: Medium) -> None:
        self._net = net
        self._tokens: list[PresenceToken] = []
        self._watches: list[PresenceWatch] = []

    def add_token(self, token: PresenceToken) -> None:
        self._tokens.append(token)
        self.refresh_watches()

    def remove_token(self, token: PresenceToken) -> None:
        if token in self._tokens:
            self._tokens.remove(token)
            self.refresh_watches()

    def add_watch(self, watch: PresenceWatch) -> None:
        self._watches.append(watch)
        self._refresh_watch(watch)

    def remove_watch(self, watch: PresenceWatch) -> None:
        if watch in self._watches:
            self._watches.remove(watch)

    def remove_process(self, bus: BusProcess) -> None:
        """A process has left or its death was detected."""
        self._tokens = [token for token in self._tokens if token.bus is not bus]
        self._watches = [watch for watch in self._watches if watch.bus is not bus]
        self.refresh_watches()

    def refresh_watches(self) -> None:
        """Notify every watch of changes."""
        for watch in self._watches:
            self._refresh_watch(watch)

    def _refresh_watch(self, watch: PresenceWatch) -> None:
        net = self._net
        present = {token.key: token.bus for token in self._tokens if expressions_intersect(watch.expression, token.key)}
        for key, bus in list(watch.believed.items()):
            # Changes on the other side of a partition are unknown here until the lease has expired.
            if net.is_lost(watch.bus, bus) or (key not in present and not net.is_cut(bus, watch.bus)):
                del watch.believed[key]
                self._notify_watch(watch, key, bus, present=False)
        for key, bus in present.items():
            if key not in watch.believed and not net.is_cut(bus, watch.bus) and not net.is_lost(watch.bus, bus):
                watch.believed[key] = bus
                self._notify_watch(watch, key, bus, present=True)

    def _notify_watch(self, watch: PresenceWatch, key: str, bus: BusProcess, *, present: bool) -> None:
        watch.last_arrival_ns = max(self._net.arrival_ns(bus, watch.bus), watch.last_arrival_ns)
        notify = partial(watch.notify_process, key, present=present)
        call = partial(self._net.deliver_call, watch.bus, Priority.EVENT, notify)
        self._net.schedule_call(watch.last_arrival_ns, call)
