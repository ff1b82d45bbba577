"""Subscriptions on the in-memory bus, and the watches for whether there are any."""

import asyncio
import contextvars
from collections.abc import Callable
from functools import partial

from orchestrator.bus.base import BusSample, Priority
from orchestrator.bus.expression import expressions_intersect
from orchestrator.bus.memory.medium import BusProcess, Medium


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


class SubscriberWatch:
    """A process's watch for subscribers of an expression. matches: whether there are any, as it was notified last."""

    def __init__(
        self, board: "SubscriptionBoard", bus: BusProcess, expression: str, callback: Callable[[bool], None]
    ) -> None:
        self.bus = bus
        self.expression = expression
        self.matches = False
        self.last_arrival_ns = 0
        self._board = board
        self._callback = callback
        self._context = contextvars.copy_context()
        self._stands = True

    def notify_process(self, *, matches: bool) -> None:
        """Notify the process, in its own context."""
        asyncio.get_running_loop().call_soon(partial(self._call_back, matches=matches), context=self._context)

    def _call_back(self, *, matches: bool) -> None:
        if self._stands and self.bus.alive:
            self._callback(matches)

    async def undeclare(self) -> None:
        self._stands = False
        self._board.remove_watch(self)


class SubscriptionBoard:
    """All subscriptions of a net."""

    def __init__(self, net: Medium) -> None:
        self._net = net
        self._subscriptions: list[Subscription] = []
        self._routes: dict[str, list[tuple[BusProcess, list[Subscription]]]] = {}
        self._watches: list[SubscriberWatch] = []

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
        self._watches = [watch for watch in self._watches if watch.bus is not bus]
        self._follow_change()

    def add_watch(self, watch: SubscriberWatch) -> None:
        self._net.traffic.count_declared(watch.bus.name)
        self._watches.append(watch)
        self._refresh_watch(watch)

    def remove_watch(self, watch: SubscriberWatch) -> None:
        if watch in self._watches:
            self._watches.remove(watch)

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
        for watch in self._watches:
            self._refresh_watch(watch)

    def _refresh_watch(self, watch: SubscriberWatch) -> None:
        subscriber = next(
            (entry.bus for entry in self._subscriptions if expressions_intersect(entry.expression, watch.expression)),
            None,
        )
        matches = subscriber is not None
        if matches == watch.matches:
            return
        watch.matches = matches
        watch.last_arrival_ns = max(self._net.arrival_ns(subscriber or watch.bus, watch.bus), watch.last_arrival_ns)
        notify = partial(watch.notify_process, matches=matches)
        call = partial(self._net.deliver_call, watch.bus, Priority.EVENT, notify)
        self._net.schedule_call(watch.last_arrival_ns, call)
