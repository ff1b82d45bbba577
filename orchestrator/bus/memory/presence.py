"""Presence on the in-memory bus: announced tokens, and the view that each watch has of them."""

import asyncio
import contextvars
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from orchestrator.bus.base import Priority
from orchestrator.bus.expression import intersects

if TYPE_CHECKING:
    from orchestrator.bus.memory.bus import MemoryBus, MemoryNet


class Token:
    """A process's announcement of presence under a key."""

    def __init__(self, board: "PresenceBoard", bus: "MemoryBus", key: str) -> None:
        self.bus = bus
        self.key = key
        self._board = board

    async def undeclare(self) -> None:
        self._board.forget_token(self)


class Watch:
    """A process's watch for presence."""

    def __init__(
        self, board: "PresenceBoard", bus: "MemoryBus", expression: str, callback: Callable[[str, bool], None]
    ) -> None:
        self.bus = bus
        self.expression = expression
        self.believed: dict[str, MemoryBus] = {}
        self.last_arrival_ns = 0
        self._board = board
        self._callback = callback
        self._context = contextvars.copy_context()
        self._stands = True

    def arrive(self, key: str, present: bool) -> None:
        """Notify the process, in its own context."""
        asyncio.get_running_loop().call_soon(self._tell, key, present, context=self._context)

    def _tell(self, key: str, present: bool) -> None:
        if self._stands and self.bus.alive:
            self._callback(key, present)

    async def undeclare(self) -> None:
        self._stands = False
        self._board.forget_watch(self)


class PresenceBoard:
    """All tokens and watches of a net."""

    def __init__(self, net: "MemoryNet") -> None:
        self._net = net
        self._tokens: list[Token] = []
        self._watches: list[Watch] = []

    def add_token(self, token: Token) -> None:
        self._tokens.append(token)
        self.refresh()

    def forget_token(self, token: Token) -> None:
        if token in self._tokens:
            self._tokens.remove(token)
            self.refresh()

    def add_watch(self, watch: Watch) -> None:
        self._watches.append(watch)
        self._refresh(watch)

    def forget_watch(self, watch: Watch) -> None:
        if watch in self._watches:
            self._watches.remove(watch)

    def gone(self, bus: "MemoryBus") -> None:
        """A process has left or its death was detected."""
        self._tokens = [token for token in self._tokens if token.bus is not bus]
        self._watches = [watch for watch in self._watches if watch.bus is not bus]
        self.refresh()

    def refresh(self) -> None:
        """Notify every watch of changes."""
        for watch in self._watches:
            self._refresh(watch)

    def _refresh(self, watch: Watch) -> None:
        net = self._net
        present = {token.key: token.bus for token in self._tokens if intersects(watch.expression, token.key)}
        for key, bus in list(watch.believed.items()):
            # Changes on the other side of a partition are unknown here until the lease has expired.
            if net.lost(watch.bus, bus) or (key not in present and not net.cut(watch.bus, bus)):
                del watch.believed[key]
                self._tell(watch, key, False)
        for key, bus in present.items():
            if key not in watch.believed and not net.cut(watch.bus, bus) and not net.lost(watch.bus, bus):
                watch.believed[key] = bus
                self._tell(watch, key, True)

    def _tell(self, watch: Watch, key: str, present: bool) -> None:
        watch.last_arrival_ns = max(self._net.arrival_ns(), watch.last_arrival_ns)
        call = partial(self._net.hand_over, watch.bus, Priority.EVENT, partial(watch.arrive, key, present))
        self._net.at(watch.last_arrival_ns, call)
