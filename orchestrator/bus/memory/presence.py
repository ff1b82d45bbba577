"""Presence on the in-memory bus: announced tokens, and the view that each watch has of them."""

from collections.abc import Callable

from orchestrator.bus.expression import expressions_intersect
from orchestrator.bus.memory.medium import BusProcess, Medium
from orchestrator.bus.memory.watches import ProcessWatch


class PresenceToken:
    """A process's announcement of presence under a key."""

    def __init__(self, board: "PresenceBoard", bus: BusProcess, key: str) -> None:
        self.bus = bus
        self.key = key
        self._board = board

    async def undeclare(self) -> None:
        self._board.remove_token(self)


class PresenceBoard:
    """All tokens and watches of a net."""

    def __init__(self, net: Medium) -> None:
        self._net = net
        self._tokens: list[PresenceToken] = []
        self._believed: dict[ProcessWatch, dict[str, BusProcess]] = {}
        """By watch: the tokens that are present, as it was notified last, each with its process."""

    def add_token(self, token: PresenceToken) -> None:
        self._tokens.append(token)
        self.refresh_watches()

    def remove_token(self, token: PresenceToken) -> None:
        if token in self._tokens:
            self._tokens.remove(token)
            self.refresh_watches()

    def add_watch(self, bus: BusProcess, expression: str, callback: Callable[[str, bool], None]) -> ProcessWatch:
        """Watch for presence."""
        self._net.traffic.count_declared(bus.name)
        watch = ProcessWatch(bus, expression, callback, self._remove_watch)
        self._believed[watch] = {}
        self._refresh_watch(watch)
        return watch

    def _remove_watch(self, watch: ProcessWatch) -> None:
        self._believed.pop(watch, None)

    def remove_process(self, bus: BusProcess) -> None:
        """A process has left or its death was detected."""
        self._tokens = [token for token in self._tokens if token.bus is not bus]
        self._believed = {watch: keys for watch, keys in self._believed.items() if watch.bus is not bus}
        self.refresh_watches()

    def refresh_watches(self) -> None:
        """Notify every watch of changes."""
        for watch in self._believed:
            self._refresh_watch(watch)

    def _refresh_watch(self, watch: ProcessWatch) -> None:
        net, believed_keys = self._net, self._believed[watch]
        present = {token.key: token.bus for token in self._tokens if expressions_intersect(watch.expression, token.key)}
        for key, bus in list(believed_keys.items()):
            # Changes on the other side of a partition are unknown here until the lease has expired.
            if net.is_lost(watch.bus, bus) or (key not in present and not net.is_cut(bus, watch.bus)):
                del believed_keys[key]
                watch.notify(net, bus, key, False)  # noqa: FBT003 - what the callback takes
        for key, bus in present.items():
            if key not in believed_keys and not net.is_cut(bus, watch.bus) and not net.is_lost(watch.bus, bus):
                believed_keys[key] = bus
                watch.notify(net, bus, key, True)  # noqa: FBT003 - what the callback takes
