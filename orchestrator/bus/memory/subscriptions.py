"""Subscriptions on the in-memory bus, and the watches for whether there are any."""

import contextvars
from collections.abc import Callable

from orchestrator.bus.base import BusSample
from orchestrator.bus.expression import expressions_intersect
from orchestrator.bus.memory.medium import BusProcess, Medium
from orchestrator.bus.memory.watches import ProcessWatch


class Subscription:
    """The subscription of one process."""

    def __init__(
        self, board: "SubscriptionBoard", bus: BusProcess, expression: str, callback: Callable[[BusSample], None]
    ) -> None:
        self.bus = bus
        self.expression = expression
        self.context = contextvars.copy_context()
        self._board = board
        self._callback = callback
        self._stands = True

    def deliver_sample(self, sample: BusSample) -> None:
        """Call the process with a sample."""
        if self._stands and self.bus.alive:
            self._callback(sample)

    async def undeclare(self) -> None:
        self._stands = False
        self._board.remove_subscription(self)


class SubscriptionBoard:
    """All subscriptions of a net."""

    def __init__(self, net: Medium) -> None:
        self._net = net
        self._subscriptions: list[Subscription] = []
        self._routes: dict[str, list[tuple[BusProcess, list[Subscription]]]] = {}
        self._matches: dict[ProcessWatch, bool] = {}
        """By watch: whether there are subscribers, as it was notified last."""

    def add_subscription(self, subscription: Subscription) -> None:
        self._net.traffic.count_declared(subscription.bus.name)
        self._subscriptions.append(subscription)
        self._follow_change()

    def remove_subscription(self, subscription: Subscription) -> None:
        if subscription in self._subscriptions:
            self._subscriptions.remove(subscription)
            self._follow_change()

    def remove_process(self, bus: BusProcess) -> None:
        """A process has left or died."""
        self._subscriptions = [subscription for subscription in self._subscriptions if subscription.bus is not bus]
        self._matches = {watch: matches for watch, matches in self._matches.items() if watch.bus is not bus}
        self._follow_change()

    def add_watch(self, bus: BusProcess, expression: str, callback: Callable[[bool], None]) -> ProcessWatch:
        """Watch for subscribers."""
        self._net.traffic.count_declared(bus.name)
        watch = ProcessWatch(bus, expression, callback, self._remove_watch)
        self._matches[watch] = False
        self._refresh_watch(watch)
        return watch

    def _remove_watch(self, watch: ProcessWatch) -> None:
        self._matches.pop(watch, None)

    def find_receivers(self, key: str) -> list[tuple[BusProcess, list[Subscription]]]:
        """The processes that subscribe to `key`, each with its subscriptions."""
        route = self._routes.get(key)
        if route is None:
            by_bus: dict[str, tuple[BusProcess, list[Subscription]]] = {}
            for subscription in self._subscriptions:
                if expressions_intersect(subscription.expression, key):
                    by_bus.setdefault(subscription.bus.name, (subscription.bus, []))[1].append(subscription)
            route = self._routes[key] = list(by_bus.values())
        return route

    def _follow_change(self) -> None:
        self._routes.clear()
        for watch in self._matches:
            self._refresh_watch(watch)

    def _refresh_watch(self, watch: ProcessWatch) -> None:
        subscriber = next(
            (entry.bus for entry in self._subscriptions if expressions_intersect(entry.expression, watch.expression)),
            None,
        )
        matches = subscriber is not None
        if matches != self._matches[watch]:
            self._matches[watch] = matches
            watch.notify(self._net, subscriber or watch.bus, matches)
